//! Leapfrog and the potential-enstrophy form against NCAR's SWM mini-app: first steps, and 4000 steps, 100 hours.

use isobar_model::forecast::forecast;
use isobar_model::invariants::{mass_m3, potential_enstrophy, total_energy};
use isobar_model::{
    Boundary, Duration, Grid, Leapfrog, ShallowWater, ShallowWaterParameters, State, Tendency, VectorInvariant,
};

const N: usize = 16;

/// A reference field, from `[x, y]` with wrap-around to `[y, x]` without.
fn field(bytes: &[u8]) -> Vec<f64> {
    let values: Vec<f64> = bytes.chunks_exact(8).map(|chunk| f64::from_le_bytes(chunk.try_into().unwrap())).collect();
    assert_eq!(values.len(), (N + 1) * (N + 1));
    (0..N * N).map(|k| values[(k % N) * (N + 1) + k / N]).collect()
}

macro_rules! reference {
    ($when:literal) => {
        [
            field(include_bytes!(concat!("ncar-swm/p.", $when, ".bin"))),
            field(include_bytes!(concat!("ncar-swm/u.", $when, ".bin"))),
            field(include_bytes!(concat!("ncar-swm/v.", $when, ".bin"))),
        ]
        .concat()
    };
}

/// Geopotential for thickness: then gravity is one.
fn equations() -> ShallowWater {
    let grid = Grid { nx: N, ny: N, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    let parameters = ShallowWaterParameters { gravity_m_per_s2: 1.0, coriolis_per_s: 0.0, ..Default::default() };
    ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).unwrap()
}

fn model() -> Leapfrog<ShallowWater> {
    Leapfrog::new(equations(), Duration::from_seconds(90), 0.001).unwrap()
}

fn start() -> State {
    State::from_values(equations().layout(), reference!("step0.init"))
}

/// The largest error of each variable over the size of its reference: 50 000 m²/s² and 10 m/s.
fn errors(x: &State, reference: &[f64]) -> [f64; 3] {
    let cells = N * N;
    [(0, 5e4), (1, 10.0), (2, 10.0)].map(|(variable, scale)| {
        let range = variable * cells..(variable + 1) * cells;
        range.fold(0.0, |error: f64, k| error.max((x.values()[k] - reference[k]).abs())) / scale
    })
}

/// Rounding of a geopotential of 5·10⁴ is about 10⁻¹¹; a gradient of it over a cell times a step of 90 s changes a wind of
/// 10 m/s by 10⁻¹⁵ of it: tolerance 10⁻¹².
#[test]
fn the_first_steps_are_those_of_the_reference() {
    let (model, start) = (model(), start());
    let references =
        [reference!("step0.init"), reference!("step1.init"), reference!("step2.init"), reference!("step3.init")];
    let mut x = model.start(&start);
    for (step, reference) in references.iter().enumerate() {
        if step > 0 {
            forecast(&model, &mut x, 1).unwrap();
            assert!(
                errors(&start, reference).iter().all(|&error| error > 1e-7),
                "step {step}: the reference must move"
            );
        }
        let errors = errors(&model.present(&x), reference);
        assert!(errors.iter().all(|&error| error < 1e-12), "step {step}: relative errors {errors:?}");
    }
}

/// In 4000 steps rounding errors stay those of the first to within a factor (the flow is smooth and not chaotic in
/// 100 hours): tolerance 10⁻¹¹. Mass is a sum of fluxes that cancel: conserved to rounding of the sum of 256 numbers,
/// 4000 times. Energy and potential enstrophy are conserved by the leapfrog only to its error in time and the filter's
/// damping; both budgets are printed, and bounded by the published 7·10⁻¹¹ of the energy with some margin.
#[test]
fn four_thousand_steps_end_where_the_reference_does() {
    let (model, equations, start) = (model(), equations(), start());
    let mut x = model.start(&start);
    forecast(&model, &mut x, 4000).unwrap();
    let end = model.present(&x);
    let errors_at_end = errors(&end, &reference!("step4000.final"));
    println!("relative errors of p, u, v after 4000 steps: {errors_at_end:?}");
    assert!(errors_at_end.iter().all(|&error| error < 1e-11), "{errors_at_end:?}");
    assert!(errors(&start, end.values()).iter().all(|&error| error > 1e-4), "the state must have moved");
    let change =
        |invariant: fn(&ShallowWater, &State) -> f64| invariant(&equations, &end) / invariant(&equations, &start) - 1.0;
    let (mass, energy, enstrophy) = (change(mass_m3), change(total_energy), change(potential_enstrophy));
    println!("relative changes: mass {mass:e}, energy {energy:e}, potential enstrophy {enstrophy:e}");
    assert!(mass.abs() < 1e-14, "mass {mass:e}");
    assert!(energy.abs() < 1e-9, "energy {energy:e}");
    assert!(enstrophy.abs() < 1e-9, "potential enstrophy {enstrophy:e}");
}
