//! Leapfrog: contract, start, order, amplification, stability.

use crate::common::{
    BOUNDARIES, FORMS, difference, grid, norm, parameters, perturbed_jet, shallow_water, stepped, turbulence,
};
use isobar_model::forecast::{forecast, forecast_tl};
use isobar_model::initial::{self, GaussianHill};
use isobar_model::random::{standard_normals, stream};
use isobar_model::testing::check_contract;
use isobar_model::{
    Advection, AdvectionScheme, Duration, Leapfrog, LinearShallowWater, Model, ModelError, RestartedLeapfrog,
    ShallowWater, ShallowWaterParameters, State, Tendency, TimeScheme, VectorInvariant, Wind, check_time_step,
};

fn leapfrog<T: Tendency>(tendency: T, step_s: i64, robert_filter: f64) -> Leapfrog<T> {
    Leapfrog::new(tendency, Duration::from_seconds(step_s), robert_filter).unwrap()
}

#[test]
fn leapfrog_keeps_the_contract_for_every_tendency() {
    for boundary in BOUNDARIES {
        for form in FORMS {
            for (drag_per_s, hyperdiffusion_m4_per_s) in [(0.0, 0.0), (1e-6, 5e14)] {
                let parameters = ShallowWaterParameters { drag_per_s, hyperdiffusion_m4_per_s, ..parameters(boundary) };
                let tendency = ShallowWater::new(grid(14, 11, boundary), parameters, form).unwrap();
                for start in [perturbed_jet(&tendency), turbulence(&tendency)] {
                    let model = leapfrog(tendency.clone(), 100, 0.05);
                    // At the start, and where the two levels have gone their ways.
                    let mut at = model.start(&start);
                    assert!(check_contract(&model, &at).taylor_decades >= Some(4));
                    forecast(&model, &mut at, 5).unwrap();
                    assert!(check_contract(&model, &at).taylor_decades >= Some(4));
                    let linear = LinearShallowWater::about_uniform_flow(tendency.clone(), 1000.0, 15.0).unwrap();
                    assert_eq!(check_contract(&leapfrog(linear, 100, 0.05), &at).taylor_decades, None);
                }
            }
        }
        let (grid, wind) = (grid(9, 12, boundary), Wind::Vortex { speed_m_per_s: 40.0 });
        let hill = GaussianHill { center_x_m: 4e5, center_y_m: 5e5, amplitude: 2.0, radius_m: 2.5e5 };
        let model = leapfrog(Advection::new(grid, &wind, AdvectionScheme::ThirdOrderUpwind).unwrap(), 300, 0.1);
        let start = initial::gaussian_hills(model.tendency().layout(), 1.0, &[hill]).unwrap();
        assert_eq!(check_contract(&model, &model.start(&start)).taylor_decades, None);
    }
}

/// From one start to the next it is the leapfrog steps between them to the bit, with one level; with one step it is Euler's.
#[test]
fn a_restarted_leapfrog_keeps_the_contract_and_is_the_steps_from_its_start() {
    for (boundary, steps) in BOUNDARIES.into_iter().flat_map(|boundary| [1, 7].map(|steps| (boundary, steps))) {
        let tendency = shallow_water(14, 11, boundary, FORMS[0]);
        let single = leapfrog(tendency.clone(), 100, 0.05);
        let model = RestartedLeapfrog::new(single.clone(), steps).unwrap();
        assert_eq!((model.time_step().seconds(), model.substeps()), (100 * steps as i64, steps));
        for at in [perturbed_jet(&tendency), turbulence(&tendency)] {
            assert!(check_contract(&model, &at).taylor_decades >= Some(4));
            // The Euler step at the start makes waves grow, most of all if there is no other.
            let longest = [model.largest_time_step_s(&at), single.largest_time_step_s(&single.start(&at))];
            assert!(longest[0] < longest[1], "{longest:?}");
            let (mut levels, mut x) = (single.start(&at), at.clone());
            forecast(&single, &mut levels, steps).unwrap();
            model.step(&mut x);
            assert_eq!(x, single.present(&levels));
        }
        assert!(RestartedLeapfrog::new(single, 0).is_err());
    }
}

/// The start is x − Δt f(x) to rounding, so that the first step is x + Δt f(x); its tangent-linear is its derivative
/// (a central difference, whose error is ε², against it), and its adjoint the transpose to 100 machine epsilons.
#[test]
fn the_first_step_is_eulers_and_the_start_has_tangent_linear_and_adjoint() {
    for boundary in BOUNDARIES {
        let tendency = shallow_water(10, 9, boundary, FORMS[0]);
        let x = turbulence(&tendency);
        let model = leapfrog(tendency.clone(), 100, 0.05);
        let mut slope = vec![0.0; x.values().len()];
        tendency.tendency(x.values(), &mut slope, &mut vec![0.0; tendency.scratch_len()]);
        let euler: Vec<f64> = x.values().iter().zip(&slope).map(|(x, slope)| x + 100.0 * slope).collect();
        let mut pair = model.start(&x);
        model.step(&mut pair);
        // Rounding of the state, not of its much smaller change.
        let (moved, rounding) = (norm(&difference(&euler, x.values())), 1e-15 * norm(x.values()));
        assert!(moved > 1e8 * rounding);
        assert!(norm(&difference(model.present(&pair).values(), &euler)) < rounding);
        let filtered = &pair.values()[x.values().len()..];
        assert!(norm(&difference(filtered, x.values())) < rounding, "the filter changes nothing in the first step");

        let mut dx = standard_normals(&mut stream(2, "dx"), 2 * x.values().len());
        dx.chunks_exact_mut(x.values().len()).for_each(|dx| tendency.constrain(dx));
        let tangent = model.start_tl(&x, &dx);
        for (column, tangent) in dx.chunks_exact(x.values().len()).zip(tangent.chunks_exact(2 * x.values().len())) {
            let [plus, minus] = [1e-4, -1e-4].map(|epsilon| {
                let values = x.values().iter().zip(column).map(|(x, d)| x + epsilon * d).collect();
                model.start(&State::from_values(x.layout(), values))
            });
            let derivative: Vec<f64> = difference(plus.values(), minus.values()).iter().map(|d| d / 2e-4).collect();
            assert!(norm(&difference(&derivative, tangent)) < 1e-8 * norm(tangent));
        }
        let dy = standard_normals(&mut stream(2, "dy"), tangent.len());
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let (forward, backward) = (dot(&tangent, &dy), dot(&dx, &model.start_ad(&x, &dy)));
        let terms: f64 = tangent.iter().zip(&dy).map(|(a, b)| (a * b).abs()).sum();
        assert!((forward - backward).abs() < 100.0 * f64::EPSILON * terms, "{forward:e} {backward:e}");
    }
}

#[test]
fn leapfrog_converges_with_order_two_and_its_tangent_linear_follows_the_difference_of_forecasts() {
    let tendency = shallow_water(16, 14, BOUNDARIES[1], VectorInvariant::Energy);
    let start = turbulence(&tendency);
    let mut exact = start.clone();
    forecast(&stepped(tendency.clone(), 10, TimeScheme::Rk4), &mut exact, 960).unwrap();
    let errors = [80, 40, 20].map(|step_s| {
        let model = leapfrog(tendency.clone(), step_s, 0.0);
        let mut x = model.start(&start);
        forecast(&model, &mut x, (9600 / step_s) as usize).unwrap();
        norm(&difference(model.present(&x).values(), exact.values()))
    });
    let order = (errors[1] / errors[2]).log2();
    assert!((order - 2.0).abs() < 0.1, "order {order:.3} of {errors:?}");

    let model = leapfrog(tendency.clone(), 80, 0.02);
    let direction = difference(exact.values(), start.values());
    let forward = |epsilon: f64| {
        let values = start.values().iter().zip(&direction).map(|(x, d)| x + epsilon * d).collect();
        let mut x = model.start(&State::from_values(start.layout(), values));
        forecast(&model, &mut x, 50).unwrap();
        x
    };
    let mut x = model.start(&start);
    let mut columns = model.start_tl(&start, &direction);
    forecast_tl(&model, &mut x, &mut columns, 50).unwrap();
    let remainders = [1e-2, 1e-3].map(|epsilon| {
        let change = difference(forward(epsilon).values(), x.values());
        let tangent: Vec<f64> = columns.iter().map(|value| epsilon * value).collect();
        norm(&difference(&change, &tangent))
    });
    assert!((remainders[0] / remainders[1]).log10() > 1.95, "{remainders:?}");
}

/// Just below the limit noise must not grow, above it must: the limit is that of the amplification factors.
#[test]
fn the_limit_of_gravity_waves_is_sharp_and_damping_needs_the_filter() {
    for robert_filter in [0.0, 0.1] {
        let nonlinear = shallow_water(8, 8, BOUNDARIES[0], FORMS[0]);
        let linear = LinearShallowWater::about_uniform_flow(nonlinear, 1000.0, 0.0).unwrap();
        let around = linear.basic_state().clone();
        let probe = leapfrog(linear.clone(), 1, robert_filter);
        let limit_s = probe.largest_time_step_s(&probe.start(&around));
        let growth = |part: f64| {
            let model = leapfrog(linear.clone(), (part * limit_s).floor() as i64, robert_filter);
            let mut noisy = around.clone();
            let noise = standard_normals(&mut stream(5, "noise"), noisy.values().len());
            noisy.values_mut().iter_mut().zip(&noise).for_each(|(x, noise)| *x += 1e-3 * noise);
            let (mut x, rest) = (model.start(&noisy), model.start(&around));
            assert_eq!(check_time_step(&model, &x).is_ok(), part < 1.0);
            let start = norm(&difference(x.values(), rest.values()));
            (0..2000).for_each(|_| model.step(&mut x));
            norm(&difference(x.values(), rest.values())) / start
        };
        assert!(growth(0.98) < 20.0, "unstable below the limit");
        assert!(growth(1.03) > 1e6 || growth(1.03).is_nan(), "stable above the limit");
    }
    let damped = ShallowWaterParameters { drag_per_s: 1e-5, ..parameters(BOUNDARIES[0]) };
    let tendency = ShallowWater::new(grid(8, 8, BOUNDARIES[0]), damped, FORMS[0]).unwrap();
    let model = leapfrog(tendency.clone(), 1, 0.0);
    let at = model.start(&initial::rest(&tendency, 1000.0).unwrap());
    assert_eq!(model.largest_time_step_s(&at), 0.0);
    assert!(matches!(check_time_step(&model, &at), Err(ModelError::TimeStepTooLong { .. })));
    for robert_filter in [-0.1, 1.0, f64::NAN] {
        let refused = Leapfrog::new(tendency.clone(), Duration::from_seconds(1), robert_filter);
        assert!(matches!(refused, Err(ModelError::Parameter { name: "robert_filter", .. })));
    }
}

#[test]
fn rest_stays_exactly_at_rest_and_messages_tell_the_levels_apart() {
    for boundary in BOUNDARIES {
        let tendency = shallow_water(8, 9, boundary, FORMS[1]);
        let model = leapfrog(tendency.clone(), 100, 0.05);
        let start = model.start(&initial::rest(&tendency, 750.0).unwrap());
        let mut x = start.clone();
        forecast(&model, &mut x, 50).unwrap();
        assert_eq!(x, start);
        assert_eq!(x.layout().variable("v"), Some(2));
        assert_eq!(x.layout().describe(8), "h at row 1, column 0");
        assert_eq!(x.layout().describe(3 * 72 + 8), "h one time step earlier at row 1, column 0");
    }
}
