//! The shallow-water tendency against NCAR's SWM mini-app: 4000 leapfrog steps, 100 hours.

use isobar_model::{Boundary, Grid, ShallowWater, ShallowWaterParameters, Tendency, VectorInvariant};

const N: usize = 16;

/// A reference field, from `[x, y]` with wrap-around to `[y, x]` without.
fn field(bytes: &[u8]) -> Vec<f64> {
    let values: Vec<f64> = bytes.chunks_exact(8).map(|chunk| f64::from_le_bytes(chunk.try_into().unwrap())).collect();
    assert_eq!(values.len(), (N + 1) * (N + 1));
    (0..N * N).map(|k| values[(k % N) * (N + 1) + k / N]).collect()
}

#[test]
fn four_thousand_leapfrog_steps_end_where_the_reference_does() {
    let start = [
        field(include_bytes!("ncar-swm/p.step0.init.bin")),
        field(include_bytes!("ncar-swm/u.step0.init.bin")),
        field(include_bytes!("ncar-swm/v.step0.init.bin")),
    ]
    .concat();
    let end = [
        field(include_bytes!("ncar-swm/p.step4000.final.bin")),
        field(include_bytes!("ncar-swm/u.step4000.final.bin")),
        field(include_bytes!("ncar-swm/v.step4000.final.bin")),
    ]
    .concat();
    let grid = Grid { nx: N, ny: N, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    // Geopotential for thickness: then gravity is one.
    let parameters = ShallowWaterParameters {
        gravity_m_per_s2: 1.0,
        coriolis_per_s: 0.0,
        beta_per_m_per_s: 0.0,
        drag_per_s: 0.0,
        hyperdiffusion_m4_per_s: 0.0,
    };
    let model = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).unwrap();
    let (dt, robert) = (90.0, 0.001);
    let (mut old, mut now) = (start.clone(), start.clone());
    let (mut slope, mut scratch) = (vec![0.0; start.len()], vec![0.0; model.scratch_len()]);
    for step in 0..4000 {
        model.tendency(&now, &mut slope, &mut scratch);
        let span = if step == 0 { dt } else { 2.0 * dt };
        let new: Vec<f64> = old.iter().zip(&slope).map(|(old, slope)| old + span * slope).collect();
        for k in 0..now.len() {
            old[k] = if step == 0 { now[k] } else { now[k] + robert * (new[k] - 2.0 * now[k] + old[k]) };
        }
        now = new;
    }
    for (variable, scale) in [(0, 5e4), (1, 10.0), (2, 10.0)] {
        let range = variable * N * N..(variable + 1) * N * N;
        let error = |to: &[f64]| range.clone().fold(0.0, |error: f64, k| error.max((now[k] - to[k]).abs())) / scale;
        assert!(error(&end) < 1e-12, "variable {variable}: relative error {:e}", error(&end));
        assert!(error(&start) > 1e-4, "the state must have moved");
    }
}
