//! Linear waves: the C grid's dispersion relation, the geostrophic mode, orders of convergence in space and time.

use crate::common::{FORMS, SCHEMES, difference, grid, largest, norm, parameters, shallow_water, stepped, turbulence};
use isobar_model::forecast::forecast;
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Boundary, Grid, LinearShallowWater, Location, Model, ShallowWater, ShallowWaterParameters, State, TangentLinear,
    Tendency, TimeScheme, VectorInvariant,
};
use std::f64::consts::{PI, TAU};

const DEPTH_M: f64 = 1000.0;

fn at_rest(nx: usize, ny: usize, form: VectorInvariant) -> LinearShallowWater {
    LinearShallowWater::about_uniform_flow(shallow_water(nx, ny, Boundary::Periodic, form), DEPTH_M, 0.0).unwrap()
}

/// ω² of oracle and literature: f² cos² cos² + 4 g H (sin²/dx² + sin²/dy²).
fn frequency_squared(grid: &Grid, parameters: &ShallowWaterParameters, m: usize, n: usize) -> f64 {
    let (a, b) = (PI * m as f64 / grid.nx as f64, PI * n as f64 / grid.ny as f64);
    (parameters.coriolis_per_s * a.cos() * b.cos()).powi(2)
        + 4.0 * parameters.gravity_m_per_s2 * DEPTH_M * ((a.sin() / grid.dx_m).powi(2) + (b.sin() / grid.dy_m).powi(2))
}

/// A wave (m, n) of random amplitude and phase in each of h, u, v, scaled to comparable energies.
fn random_wave(grid: &Grid, m: usize, n: usize) -> Vec<f64> {
    let random = standard_normals(&mut stream(3, &format!("wave {m} {n}")), 6);
    let mut values = Vec::new();
    for (variable, scale) in [(0, 10.0), (1, 1.0), (2, 1.0)] {
        for (j, i) in (0..grid.ny).flat_map(|j| (0..grid.nx).map(move |i| (j, i))) {
            let phase =
                TAU * (((m * i) % grid.nx) as f64 / grid.nx as f64 + ((n * j) % grid.ny) as f64 / grid.ny as f64);
            values.push(scale * (random[2 * variable] * phase.cos() + random[2 * variable + 1] * phase.sin()));
        }
    }
    values
}

fn apply(tendency: &LinearShallowWater, dx: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; dx.len()];
    tendency.tendency_tl(&(), dx, &mut out, &mut vec![0.0; tendency.scratch_len()]);
    out
}

/// On a wave of one wavenumber the eigenvalues of L are 0 and ±iω, so that L³ = −ω² L.
#[test]
fn every_wave_has_the_frequency_of_the_c_grid() {
    for form in FORMS {
        let tendency = at_rest(8, 6, form);
        let grid = &tendency.layout().grid.clone();
        for (m, n) in (0..8).flat_map(|m| (0..6).map(move |n| (m, n))) {
            let once = apply(&tendency, &random_wave(grid, m, n));
            let thrice = apply(&tendency, &apply(&tendency, &once));
            let squared = frequency_squared(grid, tendency.nonlinear().parameters(), m, n);
            let error = (0..once.len()).map(|k| thrice[k] + squared * once[k]).collect::<Vec<_>>();
            assert!(
                largest(&error) <= 1e-12 * 4e-7 * largest(&once) + 1e-25,
                "({m}, {n}): {:e} of {:e}, ω² = {squared:e}",
                largest(&error),
                largest(&thrice)
            );
        }
    }
}

/// The same seen from outside: a step multiplies a wave's gravity part by the scheme's polynomial of ±iωΔt.
#[test]
fn a_step_amplifies_waves_by_the_schemes_polynomial() {
    for scheme in SCHEMES {
        let tendency = at_rest(8, 6, VectorInvariant::Energy);
        let grid = tendency.layout().grid.clone();
        let parameters = *tendency.nonlinear().parameters();
        let model = stepped(tendency.clone(), 250, scheme);
        let at = State::zeros(model.layout());
        for (m, n) in [(1, 0), (0, 2), (4, 3), (2, 1), (3, 5)] {
            // L (anything) has no geostrophic part. With R(iθ) = a + ib: M g = a g + b L g/ω.
            let wave = apply(&tendency, &random_wave(&grid, m, n));
            let slope = apply(&tendency, &wave);
            let frequency = frequency_squared(&grid, &parameters, m, n).sqrt();
            let theta = frequency * 250.0;
            let (a, b) = match scheme {
                TimeScheme::Rk4 => (1.0 - theta.powi(2) / 2.0 + theta.powi(4) / 24.0, theta - theta.powi(3) / 6.0),
                TimeScheme::SspRk3 => (1.0 - theta.powi(2) / 2.0, theta - theta.powi(3) / 6.0),
            };
            let expected: Vec<f64> = wave.iter().zip(&slope).map(|(g, slope)| a * g + b * slope / frequency).collect();
            let mut stepped = wave.clone();
            model.step_tl(&at, &mut stepped);
            let error = norm(&difference(&stepped, &expected)) / norm(&expected);
            assert!(error < 1e-13, "{scheme:?} ({m}, {n}): {error:e}");
        }
    }
}

#[test]
fn the_geostrophic_mode_is_steady_to_rounding() {
    for form in FORMS {
        let tendency = at_rest(16, 14, form);
        let start = turbulence(tendency.nonlinear());
        let slope = apply(&tendency, start.values());
        // Against the terms that cancel: g δh/dx and f v.
        assert!(largest(&slope[..224]) < 1e-14, "h: {:e}", largest(&slope[..224]));
        assert!(largest(&slope[224..]) < 1e-14, "winds: {:e}", largest(&slope[224..]));
        assert!(largest(&start.values()[224..]) > 1.0);
        let mut x = start.clone();
        forecast(&stepped(tendency, 250, TimeScheme::Rk4), &mut x, 100).unwrap();
        let change = difference(x.values(), start.values());
        assert!(largest(&change) < 1e-9, "{:e}", largest(&change));
    }
}

/// An inertia-gravity wave h = a cos(kx + ly − ωt) on the f-plane (oracle 11's depth and size), after a quarter of its period,
/// on n × n cells: the root-mean-square error of h.
fn inertia_gravity_wave_error(n: usize) -> f64 {
    let (length_m, amplitude_m) = (1e7, 0.1);
    let spacing = length_m / n as f64;
    let parameters = ShallowWaterParameters { gravity_m_per_s2: 10.0, ..parameters(Boundary::Periodic) };
    let grid = Grid { nx: n, ny: n, dx_m: spacing, dy_m: spacing, boundary: Boundary::Periodic };
    let nonlinear = ShallowWater::new(grid.clone(), parameters, VectorInvariant::Energy).unwrap();
    let tendency = LinearShallowWater::about_uniform_flow(nonlinear, DEPTH_M, 0.0).unwrap();
    let (k, l) = (TAU / length_m, 2.0 * TAU / length_m);
    let (f, g) = (parameters.coriolis_per_s, parameters.gravity_m_per_s2);
    let squares = k * k + l * l;
    let frequency = (f * f + g * DEPTH_M * squares).sqrt();
    let exact = |time_s: f64| {
        let mut values = Vec::new();
        for location in [Location::Center, Location::XFace, Location::YFace] {
            for (j, i) in (0..n).flat_map(|j| (0..n).map(move |i| (j, i))) {
                let phase = k * grid.x_m(location, i) + l * grid.y_m(location, j) - frequency * time_s;
                let (cosine, sine) = (phase.cos(), phase.sin());
                values.push(match location {
                    Location::Center => DEPTH_M + amplitude_m * cosine,
                    // From ∂u/∂t − f v = −g ∂h/∂x, ∂v/∂t + f u = −g ∂h/∂y, ∂h/∂t = −H (∂u/∂x + ∂v/∂y).
                    Location::XFace => amplitude_m / (DEPTH_M * squares) * (k * frequency * cosine - l * f * sine),
                    _ => amplitude_m / (DEPTH_M * squares) * (l * frequency * cosine + k * f * sine),
                });
            }
        }
        State::from_values(tendency.layout(), values)
    };
    let steps = 24 * n / 16;
    let end_s = (0.25 * TAU / frequency / steps as f64).round() * steps as f64;
    let model = stepped(tendency.clone(), (end_s / steps as f64) as i64, TimeScheme::Rk4);
    let mut x = exact(0.0);
    forecast(&model, &mut x, steps).unwrap();
    norm(&difference(&x.values()[..n * n], &exact(end_s).values()[..n * n])) / n as f64
}

#[test]
fn inertia_gravity_waves_converge_with_order_two_in_space() {
    let errors = [16, 32, 64].map(inertia_gravity_wave_error);
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((order - 2.0).abs() < 0.1, "order {order:.3} of {errors:?}");
    }
}

#[test]
fn the_time_schemes_converge_with_their_order() {
    for boundary in crate::common::BOUNDARIES {
        let tendency =
            ShallowWater::new(grid(16, 14, boundary), parameters(boundary), VectorInvariant::Energy).unwrap();
        let start = turbulence(&tendency);
        let run = |scheme: TimeScheme, step_s: i64| {
            let mut x = start.clone();
            forecast(&stepped(tendency.clone(), step_s, scheme), &mut x, (9600 / step_s) as usize).unwrap();
            x
        };
        let exact = run(TimeScheme::Rk4, 10);
        for scheme in SCHEMES {
            let errors = [160, 80, 40].map(|step_s| norm(&difference(run(scheme, step_s).values(), exact.values())));
            let order = (errors[1] / errors[2]).log2();
            assert!((order - f64::from(scheme.order())).abs() < 0.1, "{scheme:?}: order {order:.3} of {errors:?}");
        }
    }
}
