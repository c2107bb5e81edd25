//! Advection against its exact solutions.

use crate::common::{difference, largest, norm, stepped};
use isobar_model::forecast::forecast;
use isobar_model::initial::{self, CosineWave, GaussianHill};
use isobar_model::{
    Advection, AdvectionScheme, Boundary, Duration, ExactShift, Grid, Location, ModelError, State, Tendency,
    TimeScheme, Wind, advection,
};
use std::f64::consts::TAU;

fn square(n: usize, boundary: Boundary) -> Grid {
    let spacing = 1.6e6 / n as f64;
    Grid { nx: n, ny: n, dx_m: spacing, dy_m: spacing, boundary }
}

/// Root-mean-square error, relative to the amplitude, of a wave blown for 8000 s.
fn wave_error(n: usize, kind: AdvectionScheme) -> f64 {
    let grid = square(n, Boundary::Periodic);
    let wind = Wind::Uniform { u_m_per_s: 20.0, v_m_per_s: -10.0 };
    let wave = CosineWave { mean: 3.0, amplitude: 1.0, waves_x: 1, waves_y: 2, phase: 0.0 };
    let model = stepped(Advection::new(grid.clone(), &wind, kind).unwrap(), (800 * 16 / n) as i64, TimeScheme::Rk4);
    let mut x = initial::cosine_wave(model.tendency().layout(), &wave).unwrap();
    forecast(&model, &mut x, 10 * n / 16).unwrap();
    // The cells hold point values: the exact solution is the wave at the points the wind came from.
    let exact: Vec<f64> = (0..n * n)
        .map(|k| {
            let (x_m, y_m) = (grid.x_m(Location::Center, k % n) - 1.6e5, grid.y_m(Location::Center, k / n) + 0.8e5);
            3.0 + (TAU * (x_m + 2.0 * y_m) / 1.6e6).cos()
        })
        .collect();
    norm(&difference(x.values(), &exact)) / n as f64
}

#[test]
fn the_schemes_converge_with_their_order() {
    use AdvectionScheme::{FirstOrderUpwind, FourthOrderCentred, ThirdOrderUpwind};
    for (kind, order, n) in [(FirstOrderUpwind, 1.0, 64), (ThirdOrderUpwind, 3.0, 32), (FourthOrderCentred, 4.0, 32)] {
        let measured = (wave_error(n, kind) / wave_error(2 * n, kind)).log2();
        assert!((measured - order).abs() < 0.15, "{kind:?}: order {measured:.3}");
    }
}

#[test]
fn uniform_tracer_stays_uniform_and_the_total_is_conserved() {
    for boundary in crate::common::BOUNDARIES {
        for kind in [AdvectionScheme::FirstOrderUpwind, AdvectionScheme::ThirdOrderUpwind] {
            let tendency = Advection::new(square(16, boundary), &Wind::Vortex { speed_m_per_s: 40.0 }, kind).unwrap();
            let model = stepped(tendency, 900, TimeScheme::SspRk3);
            let layout = model.tendency().layout();
            let mut x = State::from_values(layout, vec![2.5; 256]);
            forecast(&model, &mut x, 100).unwrap();
            assert!(x.values().iter().all(|value| (value - 2.5).abs() < 1e-13));
            let hill = GaussianHill { center_x_m: 5e5, center_y_m: 6e5, amplitude: 1.0, radius_m: 2e5 };
            let start = initial::gaussian_hills(layout, 0.0, &[hill]).unwrap();
            let mut x = start.clone();
            forecast(&model, &mut x, 100).unwrap();
            let total = |x: &State| x.values().iter().sum::<f64>();
            assert!((total(&x) / total(&start) - 1.0).abs() < 1e-13);
            assert!(norm(&difference(x.values(), start.values())) > 0.5, "the hill must have moved");
        }
    }
}

#[test]
fn the_vortex_is_without_divergence_and_as_fast_as_it_says() {
    let grid = square(64, Boundary::Channel);
    let (u, v) = Wind::Vortex { speed_m_per_s: 40.0 }.at_faces(&grid).unwrap();
    for (j, i) in (0..64).flat_map(|j| (0..64).map(move |i| (j, i))) {
        let at = |field: &[f64], j: usize, i: usize| field[(j % 64) * 64 + i % 64];
        let divergence = at(&u, j, i + 1) - at(&u, j, i) + at(&v, j + 1, i) - at(&v, j, i);
        assert!(divergence.abs() < 1e-12, "{divergence:e}");
    }
    assert!((largest(&u) / 40.0 - 1.0).abs() < 2e-3, "{}", largest(&u));
    assert!(v[..64].iter().all(|&v| v == 0.0));
    let blowing = Wind::Uniform { u_m_per_s: 1.0, v_m_per_s: 2.0 }.at_faces(&grid);
    assert!(matches!(blowing, Err(ModelError::Parameter { name: "v_m_per_s", .. })));
}

#[test]
fn the_jet_is_where_it_says_and_goes_round_a_periodic_edge() {
    for boundary in [Boundary::Channel, Boundary::Periodic] {
        // Rows of 1/16 of the height, the middle of the jet in that of the second one.
        let grid = square(16, boundary);
        let row = grid.dy_m;
        let jet = Wind::Jet { u_m_per_s: 10.0, jet_m_per_s: 5.0, center_y_m: 1.5 * row, half_width_m: 4.0 * row };
        let (u, v) = jet.at_faces(&grid).unwrap();
        let wind = |row: usize| u[row * 16 + 7];
        assert!((wind(1) - 15.0).abs() < 1e-12 && (wind(3) - 12.5).abs() < 1e-12 && (wind(5) - 10.0).abs() < 1e-12);
        let beyond = if boundary == Boundary::Periodic { 12.5 } else { 10.0 };
        assert!((wind(15) - beyond).abs() < 1e-12, "{}", wind(15));
        assert!(u.chunks_exact(16).all(|row| row.iter().all(|&wind| wind == row[0])) && v.iter().all(|&v| v == 0.0));
    }
    let narrow = Wind::Jet { u_m_per_s: 10.0, jet_m_per_s: 5.0, center_y_m: 0.0, half_width_m: 0.0 };
    let error = narrow.at_faces(&square(16, Boundary::Channel));
    assert!(matches!(error, Err(ModelError::Parameter { name: "half_width_m", .. })));
}

#[test]
fn the_exact_shift_moves_a_hill_by_whole_cells() {
    let grid = Grid { nx: 20, ny: 10, dx_m: 1e4, dy_m: 2e4, boundary: Boundary::Periodic };
    let model = ExactShift::new(grid.clone(), 3, -1, Duration::from_seconds(600)).unwrap();
    let layout = advection::layout(grid);
    let hill = |center_x_m: f64, center_y_m: f64| {
        let hill = GaussianHill { center_x_m, center_y_m, amplitude: 1.0, radius_m: 3e4 };
        initial::gaussian_hills(&layout, 0.0, &[hill]).unwrap()
    };
    let mut x = hill(25e3, 50e3);
    forecast(&model, &mut x, 7).unwrap();
    // 21 columns east of 25 km on a ring of 200 km, 7 rows south of 50 km on one of 200 km.
    let error = difference(x.values(), hill(35e3, 110e3).values());
    assert!(largest(&error) < 1e-15, "{:e}", largest(&error));
    let walls = Grid { boundary: Boundary::Channel, ..layout.grid.clone() };
    assert!(ExactShift::new(walls, 1, 0, Duration::from_seconds(600)).is_err());
}

/// First-order upwind loses variance exactly as theory says: one Euler-like short step at Courant number c takes a
/// wave's amplitude squared to 1 − 2c(1 − c)(1 − cos θ); the semi-discrete rate is exp(−2c(1 − cos θ)).
#[test]
fn first_order_upwind_damps_a_wave_as_its_symbol_says() {
    let grid = square(16, Boundary::Periodic);
    let wind = Wind::Uniform { u_m_per_s: 10.0, v_m_per_s: 0.0 };
    let model = stepped(Advection::new(grid, &wind, AdvectionScheme::FirstOrderUpwind).unwrap(), 100, TimeScheme::Rk4);
    let wave = CosineWave { mean: 0.0, amplitude: 1.0, waves_x: 4, waves_y: 0, phase: 0.0 };
    let mut x = initial::cosine_wave(model.tendency().layout(), &wave).unwrap();
    let start = norm(x.values());
    forecast(&model, &mut x, 100).unwrap();
    // θ = π/2, c = 0.01 for 100 steps: the amplitude falls by exp(−1), up to the time scheme's error.
    assert!((norm(x.values()) / start - (-1f64).exp()).abs() < 1e-8);
}
