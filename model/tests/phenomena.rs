//! Phenomena with known solutions: Kelvin and Rossby waves, geostrophic adjustment; and a long run of a jet.
//!
//! Bishnu, Petersen & Quaife (2024): A verification suite of test cases for the barotropic solver of ocean models.
//! JAMES 16. Matsuno (1966): Quasi-geostrophic motions in the equatorial area. J. Met. Soc. Japan 44.

use crate::common::{difference, norm, perturbed_jet, shallow_water, stepped};
use isobar_model::forecast::forecast;
use isobar_model::invariants::{mass_m3, potential_enstrophy, total_energy};
use isobar_model::{
    Boundary, Grid, LinearShallowWater, Location, ShallowWater, ShallowWaterParameters, State, Tendency, TimeScheme,
    VectorInvariant,
};
use std::f64::consts::TAU;

const DEPTH_M: f64 = 1000.0;
const GRAVITY: f64 = 10.0;
/// √(g H) of both.
const SPEED_M_PER_S: f64 = 100.0;

fn linear(grid: Grid, coriolis_per_s: f64, beta_per_m_per_s: f64) -> LinearShallowWater {
    let parameters =
        ShallowWaterParameters { gravity_m_per_s2: GRAVITY, coriolis_per_s, beta_per_m_per_s, ..Default::default() };
    let nonlinear = ShallowWater::new(grid, parameters, VectorInvariant::Energy).unwrap();
    LinearShallowWater::about_uniform_flow(nonlinear, DEPTH_M, 0.0).unwrap()
}

/// The state whose anomalies of h, u and v at (x, y) are those of the function.
fn state(tendency: &LinearShallowWater, anomaly: impl Fn(usize, f64, f64) -> f64) -> State {
    let grid = &tendency.layout().grid;
    let mut x = tendency.basic_state().clone();
    for (variable, location) in [Location::Center, Location::XFace, Location::YFace].into_iter().enumerate() {
        for k in 0..grid.cells() {
            let point = (grid.x_m(location, k % grid.nx), grid.y_m(location, k / grid.nx));
            x.field_mut(variable)[k] += anomaly(variable, point.0, point.1);
        }
    }
    x
}

/// Root-mean-square errors of h, and of the winds in units of h, after `end_s` in `steps` steps of fourth order; the
/// error in time is below 10⁻⁴ of that in space.
fn error(tendency: &LinearShallowWater, steps: usize, step_s: i64, exact: impl Fn(usize, f64, f64, f64) -> f64) -> f64 {
    let model = stepped(tendency.clone(), step_s, TimeScheme::Rk4);
    let mut x = state(tendency, |variable, x, y| exact(variable, x, y, 0.0));
    forecast(&model, &mut x, steps).unwrap();
    let end_s = (step_s * steps as i64) as f64;
    let error = &x - &state(tendency, |variable, x, y| exact(variable, x, y, end_s));
    let (cells, per_wind) = (tendency.layout().grid.cells(), (DEPTH_M / GRAVITY).sqrt());
    let squares = norm(&error.values()[..cells]).powi(2) + (per_wind * norm(&error.values()[cells..])).powi(2);
    (squares / cells as f64).sqrt()
}

fn assert_second_order(errors: [f64; 3]) {
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((order - 2.0).abs() < 0.1, "order {order:.3} of {errors:?}");
    }
}

/// A coastal Kelvin wave along the southern wall of a channel, h = a exp(−y/L_d) cos(k (x − c t)), u = √(g/H) h, v = 0:
/// exact in a channel of any height (wavelength 5000 km, amplitude 10⁻⁴ m).
#[test]
fn a_kelvin_wave_converges_with_order_two() {
    let (length_m, amplitude_m, coriolis_per_s) = (5e6, 1e-4, 1e-4);
    let radius_m = SPEED_M_PER_S / coriolis_per_s;
    let exact = |variable: usize, x: f64, y: f64, time_s: f64| {
        let h = amplitude_m * (-y / radius_m).exp() * (TAU / length_m * (x - SPEED_M_PER_S * time_s)).cos();
        [h, (GRAVITY / DEPTH_M).sqrt() * h, 0.0][variable]
    };
    // A quarter of a period, 12 500 s.
    assert_second_order([32, 64, 128].map(|n| {
        let grid = Grid { nx: n, ny: n, dx_m: length_m / n as f64, dy_m: 4e6 / n as f64, boundary: Boundary::Channel };
        error(&linear(grid, coriolis_per_s, 0.0), 12_500 * n / 32 / 500, 500 * 32 / n as i64, exact)
    }));
}

/// The first equatorial Rossby wave of Matsuno, exact on the beta-plane, in a channel whose walls are six equatorial
/// radii away (where it has decayed to 10⁻⁶). In units of the radius √(c/β) and the time 1/√(βc), with θ = kx − ωt and
/// ψ = 2y exp(−y²/2):
///
/// ```text
/// v = ψ cos θ,  u = (ω y ψ − k ψ')/(k² − ω²) sin θ,  g h/c = (k y ψ − ω ψ')/(k² − ω²) sin θ,  ω² − k² − k/ω = 3
/// ```
#[test]
fn an_equatorial_rossby_wave_converges_with_order_two() {
    let (beta, k) = (2e-11, 1.0);
    let (radius_m, unit_s) = ((SPEED_M_PER_S / beta).sqrt(), 1.0 / (beta * SPEED_M_PER_S).sqrt());
    let mut frequency: f64 = -0.25;
    for _ in 0..50 {
        let (value, slope) = (frequency.powi(3) - (k * k + 3.0) * frequency - k, 3.0 * frequency.powi(2) - k * k - 3.0);
        frequency -= value / slope;
    }
    assert!((frequency + 0.2541).abs() < 1e-4, "the slow, westward root: {frequency}");
    let exact = |variable: usize, x_m: f64, y_m: f64, time_s: f64| {
        let (x, y) = (x_m / radius_m, y_m / radius_m - 6.0);
        let (sine, cosine) = (k * x - frequency * time_s / unit_s).sin_cos();
        let (psi, slope) = (2.0 * y * (-0.5 * y * y).exp(), (2.0 - 2.0 * y * y) * (-0.5 * y * y).exp());
        let per = 1e-2 / (k * k - frequency * frequency);
        match variable {
            0 => SPEED_M_PER_S / GRAVITY * per * (k * y * psi - frequency * slope) * sine,
            1 => per * (frequency * y * psi - k * slope) * sine,
            _ => 1e-2 * psi * cosine,
        }
    };
    // About a quarter of a period, 138 000 s.
    assert_second_order([16, 32, 64].map(|n| {
        let grid = Grid {
            nx: n,
            ny: 2 * n,
            dx_m: TAU * radius_m / n as f64,
            dy_m: 6.0 * radius_m / n as f64,
            boundary: Boundary::Channel,
        };
        error(&linear(grid, 0.0, beta), 46 * n / 16, 3000 * 16 / n as i64, exact)
    }));
}

/// A step of h released at rest on an f-plane ends, when its gravity waves are averaged out, in geostrophic balance:
///
/// ```text
/// η = −η₀ sgn(x) (1 − exp(−|x|/L_d)),  L_d = √(g H)/f,  kinetic energy = potential energy lost / 3
/// ```
///
/// (Gill 1982, Atmosphere–Ocean Dynamics, § 7.2.) The domain, of 40 L_d, has a step up and a step down. The mean over
/// 20 inertial periods has Hann's window, which leaves less than 10⁻⁴ of anything of period 2π/f or less. L_d is ten
/// cells: the discretisation's error is (dx/L_d)²/24 of the profile's curvature in the smooth part and more in
/// the cells beside the step; 1 % bounds both.
#[test]
fn a_step_adjusts_to_the_rossby_radius_and_keeps_a_third_of_the_energy() {
    let (amplitude_m, coriolis_per_s, nx) = (0.1, 1e-4, 400);
    let grid = Grid { nx, ny: 4, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    let tendency = linear(grid, coriolis_per_s, 0.0);
    let model = stepped(tendency.clone(), 500, TimeScheme::Rk4);
    let up = |x: f64| if (1e7..3e7).contains(&x) { -1.0 } else { 1.0 };
    let start = state(&tendency, |variable, x, _| if variable == 0 { amplitude_m * up(x) } else { 0.0 });
    let steps = (20.0 * TAU / coriolis_per_s / 500.0) as usize;
    let (mut x, mut mean, mut weights) = (start.clone(), vec![0.0; start.values().len()], 0.0);
    for step in 1..steps {
        forecast(&model, &mut x, 1).unwrap();
        let weight = (TAU / 2.0 * step as f64 / steps as f64).sin().powi(2);
        weights += weight;
        mean.iter_mut().zip(x.values()).for_each(|(mean, value)| *mean += weight * value);
    }
    mean.iter_mut().zip(tendency.basic_state().values()).for_each(|(mean, basic)| *mean = *mean / weights - basic);
    let radius_m = SPEED_M_PER_S / coriolis_per_s;
    let h_start: Vec<f64> = start.values()[..nx].iter().map(|h| h - DEPTH_M).collect();
    let mut largest: f64 = 0.0;
    for i in 0..nx {
        let x_m = (i as f64 + 0.5) * 1e5;
        let distance = (x_m - 1e7).abs().min((x_m - 3e7).abs());
        let expected = amplitude_m * up(x_m) * (1.0 - (-distance / radius_m).exp());
        largest = largest.max((mean[i] - expected).abs());
    }
    assert!(largest < 0.01 * amplitude_m, "the profile differs by {:.4} of the step", largest / amplitude_m);
    let (h, u, v) = (&mean[..nx], &mean[4 * nx..5 * nx], &mean[8 * nx..9 * nx]);
    assert!(norm(u) < 1e-3 * norm(v), "no flow across the step");
    let potential = |h: &[f64]| GRAVITY * norm(h).powi(2);
    let ratio = DEPTH_M * norm(v).powi(2) / (potential(&h_start) - potential(h));
    println!("kinetic energy over potential energy released: {ratio:.4}");
    assert!((ratio - 1.0 / 3.0).abs() < 0.01 / 3.0, "{ratio}");
}

/// Twenty days of an unstable jet. Mass: rounding of each of 8640 steps, which cancels in the sum to far less than
/// 10⁻¹⁶ each. The invariant of the form changes only by the time scheme's error, of fourth order in Δt (measured: of
/// fifth, as the leading error is dispersion): halving Δt must divide its drift by at least 2^3.8.
#[test]
fn a_long_run_of_the_nonlinear_jet_conserves_to_the_order_of_the_scheme() {
    type Invariant = fn(&ShallowWater, &State) -> f64;
    let cases: [(Boundary, VectorInvariant, Invariant); 3] = [
        (Boundary::Channel, VectorInvariant::Energy, total_energy),
        (Boundary::Periodic, VectorInvariant::Energy, total_energy),
        (Boundary::Periodic, VectorInvariant::PotentialEnstrophy, potential_enstrophy),
    ];
    for (boundary, form, invariant) in cases {
        let tendency = shallow_water(32, 24, boundary, form);
        let start = perturbed_jet(&tendency);
        let drift = |step_s: i64| {
            let mut x = start.clone();
            forecast(&stepped(tendency.clone(), step_s, TimeScheme::Rk4), &mut x, 20 * 86_400 / step_s as usize)
                .unwrap();
            assert!(norm(&difference(x.values(), start.values())) > 100.0, "the jet must have changed");
            let mass = mass_m3(&tendency, &x) / mass_m3(&tendency, &start) - 1.0;
            assert!(mass.abs() < 1e-13, "{boundary:?} {form:?}: mass {mass:e}");
            (invariant(&tendency, &x) / invariant(&tendency, &start) - 1.0).abs()
        };
        let drifts = [240, 120].map(drift);
        println!("{boundary:?} {form:?}: relative drifts {drifts:?} for 240 s and 120 s");
        assert!(drifts[0] < 1e-3 && drifts[0] / drifts[1] > f64::powf(2.0, 3.8), "{boundary:?} {form:?}: {drifts:?}");
    }
}
