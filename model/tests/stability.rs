//! Time steps just below the reported limit are stable, and steps well above it are not.

use crate::common::{SCHEMES, grid, norm, parameters, shallow_water, stepped, turbulence};
use isobar_model::initial::{self, GaussianHill};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Advection, AdvectionScheme, Boundary, LinearShallowWater, Model, ModelError, ShallowWater, ShallowWaterParameters,
    State, Tendency, TimeScheme, VectorInvariant, Wind, check_time_step,
};

/// Growth of white noise over 2000 steps of `part` of the largest time step.
fn growth<T: Tendency + Clone>(tendency: &T, around: &State, scheme: TimeScheme, part: f64) -> f64 {
    let limit_s = stepped(tendency.clone(), 1, scheme).largest_time_step_s(around);
    let model = stepped(tendency.clone(), (part * limit_s).floor() as i64, scheme);
    assert_eq!(check_time_step(&model, around).is_ok(), part < 1.0);
    let mut x = around.clone();
    let noise = standard_normals(&mut stream(5, "noise"), x.values().len());
    model_constrained(tendency, x.values_mut(), &noise);
    let start = norm(&difference(&x, around));
    for _ in 0..2000 {
        model.step(&mut x);
    }
    norm(&difference(&x, around)) / start
}

fn model_constrained<T: Tendency>(tendency: &T, x: &mut [f64], noise: &[f64]) {
    x.iter_mut().zip(noise).for_each(|(x, noise)| *x += 1e-3 * noise);
    tendency.constrain(x);
}

fn difference(x: &State, y: &State) -> Vec<f64> {
    crate::common::difference(x.values(), y.values())
}

fn assert_limit<T: Tendency + Clone>(tendency: &T, around: &State, scheme: TimeScheme, above: f64) {
    let below = growth(tendency, around, scheme, 0.98);
    assert!(below < 20.0, "unstable below the limit: noise grows by {below:e}");
    let growth = growth(tendency, around, scheme, above);
    assert!(growth.is_nan() || growth > 1e6, "stable at {above} of the limit: noise grows by {growth:e}");
}

#[test]
fn the_limit_of_gravity_waves_is_sharp() {
    for scheme in SCHEMES {
        for boundary in crate::common::BOUNDARIES {
            let nonlinear = shallow_water(8, 8, boundary, VectorInvariant::Energy);
            let at_rest = LinearShallowWater::about_uniform_flow(nonlinear, 1000.0, 0.0).unwrap();
            let around = at_rest.basic_state().clone();
            assert_limit(&at_rest, &around, scheme, if boundary == Boundary::Periodic { 1.03 } else { 1.1 });
        }
    }
}

#[test]
fn the_limit_holds_with_a_mean_flow_and_with_rotation_faster_than_gravity_waves() {
    for scheme in SCHEMES {
        let nonlinear = shallow_water(8, 8, Boundary::Periodic, VectorInvariant::PotentialEnstrophy);
        let flow = LinearShallowWater::about_uniform_flow(nonlinear, 1000.0, 80.0).unwrap();
        let around = flow.basic_state().clone();
        assert_limit(&flow, &around, scheme, 1.4);
        let fast = ShallowWaterParameters { coriolis_per_s: 1e-2, ..parameters(Boundary::Periodic) };
        let nonlinear =
            ShallowWater::new(grid(8, 8, Boundary::Periodic), fast, VectorInvariant::PotentialEnstrophy).unwrap();
        let rotating = LinearShallowWater::about_uniform_flow(nonlinear, 1000.0, 0.0).unwrap();
        let around = rotating.basic_state().clone();
        assert_limit(&rotating, &around, scheme, 1.05);
    }
}

#[test]
fn the_limit_of_hyperdiffusion_is_sharp() {
    for scheme in SCHEMES {
        let thick = ShallowWaterParameters {
            gravity_m_per_s2: 1e-6,
            coriolis_per_s: 0.0,
            hyperdiffusion_m4_per_s: 1e16,
            ..parameters(Boundary::Periodic)
        };
        let nonlinear = ShallowWater::new(grid(8, 8, Boundary::Periodic), thick, VectorInvariant::Energy).unwrap();
        let tendency = LinearShallowWater::about_uniform_flow(nonlinear, 1.0, 0.0).unwrap();
        let around = tendency.basic_state().clone();
        assert_limit(&tendency, &around, scheme, 1.05);
    }
}

#[test]
fn advection_is_stable_below_its_limit_and_not_far_above_it() {
    use AdvectionScheme::{FirstOrderUpwind, FourthOrderCentred, ThirdOrderUpwind};
    for scheme in SCHEMES {
        for kind in [FirstOrderUpwind, ThirdOrderUpwind, FourthOrderCentred] {
            let grid = grid(16, 12, Boundary::Periodic);
            let wind = Wind::Uniform { u_m_per_s: 30.0, v_m_per_s: -20.0 };
            let tendency = Advection::new(grid, &wind, kind).unwrap();
            let hill = GaussianHill { center_x_m: 8e5, center_y_m: 5e5, amplitude: 0.0, radius_m: 2e5 };
            let around = initial::gaussian_hills(tendency.layout(), 1.0, &[hill]).unwrap();
            // With damping the limit is that of the triangle within the stability region: safe, not sharp.
            let above = if kind == FourthOrderCentred { 1.1 } else { 2.5 };
            assert_limit(&tendency, &around, scheme, above);
        }
    }
}

#[test]
fn nonlinear_turbulence_is_stable_below_the_limit_and_blows_up_above() {
    for scheme in SCHEMES {
        let tendency = shallow_water(16, 14, Boundary::Periodic, VectorInvariant::Energy);
        let start = turbulence(&tendency);
        let limit_s = stepped(tendency.clone(), 1, scheme).largest_time_step_s(&start);
        let run = |part: f64| {
            let model = stepped(tendency.clone(), (part * limit_s) as i64, scheme);
            isobar_model::forecast::forecast(&model, &mut start.clone(), 1500)
        };
        run(0.95).unwrap();
        assert!(run(1.3).is_err());
    }
}

#[test]
fn a_step_too_long_is_refused_with_the_largest_allowed() {
    let tendency = shallow_water(8, 8, Boundary::Periodic, VectorInvariant::Energy);
    let x = initial::rest(&tendency, 1000.0).unwrap();
    // 2√2 / (2 √(9.81 · 1000) √(1/100² + 1/80²) / 1000) s.
    let largest_s = 2.828427 / (2.0 * 9810f64.sqrt() * (1e-10 + 1.5625e-10_f64).sqrt());
    match check_time_step(&stepped(tendency, 1800, TimeScheme::Rk4), &x) {
        Err(ModelError::TimeStepTooLong { time_step_s: 1800, largest_s: reported }) => {
            assert!((reported / largest_s - 1.0).abs() < 1e-6, "{reported} {largest_s}");
        }
        other => panic!("{other:?}"),
    }
    let error = ModelError::TimeStepTooLong { time_step_s: 1800, largest_s: 1234.4 };
    assert_eq!(error.to_string(), "time step 1800 s exceeds the largest stable one, 1234 s");
}
