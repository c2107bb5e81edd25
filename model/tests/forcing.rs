//! Models with a forcing: contract, order, exact cases, superposition, time that goes on.

use crate::common::{
    BOUNDARIES, FORMS, SCHEMES, grid, largest, norm, perturbed_jet, shallow_water, stepped, turbulence,
};
use isobar_model::forecast::{backward_ad, forecast, forecast_tl, trajectory};
use isobar_model::random::{standard_normals, stream};
use isobar_model::testing::check_contract;
use isobar_model::vector::dot;
use isobar_model::{
    Adjoint, Advection, AdvectionScheme, Boundary, Duration, ExactShift, Forced, Forcing, ForecastError, Grid, Layout,
    Leapfrog, LinearShallowWater, Location, Model, ModelError, RestartedLeapfrog, ShallowWater, ShallowWaterParameters,
    Source, State, Tendency, Time, TimeFunction, TimeScheme, VectorInvariant, Wind,
};
use std::sync::Arc;

const START: Time = Time::from_seconds(1_768_435_200);

fn seconds(seconds: i64) -> Duration {
    Duration::from_seconds(seconds)
}

/// Three functions of time that vary within an hour or two.
fn functions() -> [TimeFunction; 3] {
    let knots = [(-50, 2.0), (410, -1.0), (1900, 0.5), (100_000, 4.0)];
    [
        TimeFunction::Constant,
        TimeFunction::Sinusoid { period: seconds(5000), highest_at: seconds(1234) },
        TimeFunction::Table(knots.map(|(s, value)| (START + seconds(s), value)).to_vec()),
    ]
}

/// A source of each variable with a random pattern, which adds about this part of a typical value in an hour.
fn forcing(layout: &Layout, part: f64) -> Arc<Forcing> {
    let sizes = if layout.variables.len() == 3 { [50.0, 10.0, 10.0] } else { [1.0; 3] };
    let grid = &layout.grid;
    let sources = layout.variables.iter().enumerate().map(|(variable, own)| {
        let mut pattern = standard_normals(&mut stream(3, own.name), grid.cells());
        pattern.iter_mut().for_each(|value| *value *= part * sizes[variable] / 3600.0);
        if grid.boundary == Boundary::Channel && own.location == Location::YFace {
            pattern[..grid.nx].fill(0.0);
        }
        Source { variable, pattern, function: functions()[variable].clone() }
    });
    Arc::new(Forcing { sources: sources.collect() })
}

fn forced(model: impl Adjoint + 'static, forcing: &Arc<Forcing>) -> Arc<dyn Adjoint> {
    Forced::of(Arc::new(model), forcing).unwrap()
}

fn restarted<T: Tendency>(tendency: T, step_s: i64, filter: f64, steps: usize) -> RestartedLeapfrog<T> {
    RestartedLeapfrog::new(Leapfrog::new(tendency, seconds(step_s), filter).unwrap(), steps).unwrap()
}

/// The same tendency by both Runge–Kutta schemes and by leapfrog, with the forcing.
fn by_all_schemes<T: Tendency + Clone + 'static>(
    tendency: &T,
    step_s: i64,
    steps: usize,
    forcing: &Arc<Forcing>,
) -> Vec<Arc<dyn Adjoint>> {
    let leapfrog = restarted(tendency.clone(), step_s, 0.0, steps).forced(Arc::clone(forcing)).unwrap();
    let mut models: Vec<Arc<dyn Adjoint>> = vec![Arc::new(leapfrog)];
    models.extend(SCHEMES.map(|scheme| forced(stepped(tendency.clone(), step_s, scheme), forcing)));
    models
}

#[test]
fn forced_models_keep_the_contract() {
    for boundary in BOUNDARIES {
        let tendency = shallow_water(14, 11, boundary, FORMS[0]);
        let forcing = forcing(tendency.layout(), 0.2);
        for at in [perturbed_jet(&tendency), turbulence(&tendency)] {
            let at = at.valid_at(START);
            for model in by_all_schemes(&tendency, 100, 7, &forcing) {
                assert!(check_contract(&*model, &at).taylor_decades >= Some(4));
            }
            let linear = LinearShallowWater::about_uniform_flow(tendency.clone(), 1000.0, 15.0).unwrap();
            for model in by_all_schemes(&linear, 100, 7, &forcing) {
                assert_eq!(check_contract(&*model, &at).taylor_decades, None);
            }
        }
    }
}

/// ⟨M'δx, y⟩ = ⟨δx, M'ᵀy⟩ over several steps along a trajectory with the forcing, and M' is the derivative of the forecast.
#[test]
fn several_forced_steps_have_their_derivative_and_its_transpose() {
    let tendency = shallow_water(14, 11, Boundary::Channel, FORMS[1]);
    let at = turbulence(&tendency).valid_at(START);
    let forcing = forcing(tendency.layout(), 1.0);
    for model in by_all_schemes(&tendency, 100, 3, &forcing) {
        let (dx, y) = (difference_of(&tendency, "dx"), difference_of(&tendency, "y"));
        let (mut forward, mut end) = (dx.clone(), at.clone());
        forecast_tl(&*model, &mut end, &mut forward, 5).unwrap();
        let mut back = y.clone();
        backward_ad(&*model, &trajectory(&*model, &at, 5).unwrap(), &mut back);
        let (left, right) = (dot(&forward, &y), dot(&dx, &back));
        let magnitude: f64 = forward.iter().zip(&y).map(|(a, b)| (a * b).abs()).sum();
        assert!((left - right).abs() < 1e-13 * magnitude, "{left} {right}");
        let remainder = |epsilon: f64| {
            let mut moved = at.clone();
            isobar_model::vector::axpy(epsilon, &dx, moved.values_mut());
            forecast(&*model, &mut moved, 5).unwrap();
            let of_value = |i: usize| moved.values()[i] - end.values()[i] - epsilon * forward[i];
            norm(&(0..dx.len()).map(of_value).collect::<Vec<_>>())
        };
        let slope = (remainder(1e-2) / remainder(1e-3)).log10();
        assert!((slope - 2.0).abs() < 0.05, "{slope}");
    }
}

fn difference_of(tendency: &ShallowWater, purpose: &str) -> Vec<f64> {
    let mut values = standard_normals(&mut stream(11, purpose), tendency.layout().len());
    tendency.constrain(&mut values);
    values
}

/// Uniform winds of linear shallow water on a plane turn with f: with w = u + i v, dw/dt = −i f w + b cos(ω (t − t₀)), and
///
/// w = e^(−i f t) (w₀ − p(0)) + p(t),    p = b/2 (e^(i ω (t − t₀))/(i (f + ω)) + e^(−i ω (t − t₀))/(i (f − ω))).
#[test]
fn the_forcing_is_of_second_order_with_every_scheme() {
    let (f, hours) = (1e-4, 20.0);
    let parameters = ShallowWaterParameters { gravity_m_per_s2: 9.81, coriolis_per_s: f, ..Default::default() };
    let grid = Grid { nx: 4, ny: 4, dx_m: 1e6, dy_m: 1e6, boundary: Boundary::Periodic };
    let water = ShallowWater::new(grid, parameters, VectorInvariant::Energy).unwrap();
    let tendency = LinearShallowWater::about_uniform_flow(water, 100.0, 0.0).unwrap();
    let (period, highest_at) = (seconds(43_200), seconds(5000));
    let (b, omega) = (3e-4, std::f64::consts::TAU / 43_200.0);
    let function = TimeFunction::Sinusoid { period, highest_at };
    let forcing = Arc::new(Forcing { sources: vec![Source { variable: 1, pattern: vec![b; 16], function }] });
    let since = (START.seconds() - highest_at.seconds()).rem_euclid(43_200) as f64;
    // e^(iφ)/i = sin φ − i cos φ.
    let particular = |t: f64| {
        let phase = omega * (since + t);
        let (plus, minus) = (0.5 * b / (f + omega), 0.5 * b / (f - omega));
        (plus * phase.sin() - minus * phase.sin(), -(plus + minus) * phase.cos())
    };
    let (t, w0, p0) = (hours * 3600.0, (4.0, -7.0), particular(0.0));
    let (cos, sin, free) = ((f * t).cos(), (f * t).sin(), (w0.0 - p0.0, w0.1 - p0.1));
    let at_end = particular(t);
    let exact = (free.0 * cos + free.1 * sin + at_end.0, free.1 * cos - free.0 * sin + at_end.1);
    let mut start = State::zeros(tendency.layout()).valid_at(START);
    start.field_mut(0).fill(100.0);
    start.field_mut(1).fill(w0.0);
    start.field_mut(2).fill(w0.1);
    let errors = [1800_i64, 900, 450, 225].map(|step_s| {
        let steps = (t as i64 / step_s) as usize;
        let models = by_all_schemes(&tendency, step_s, steps, &forcing);
        models
            .iter()
            .map(|model| {
                let mut x = start.clone();
                forecast(&**model, &mut x, steps / model.substeps()).unwrap();
                (x.field(1)[(0, 0)] - exact.0).hypot(x.field(2)[(0, 0)] - exact.1)
            })
            .collect::<Vec<f64>>()
    });
    // The third-order error of the third scheme falls by 8, and is as large as the other down to minutes.
    for (scheme, most) in [(0, 4.2), (1, 4.2), (2, 8.2)] {
        let errors = errors.each_ref().map(|errors| errors[scheme]);
        assert!(errors[0] < 1.0 && errors[3] < 0.02, "{errors:?}");
        let ratio = errors[2] / errors[3];
        assert!((3.8..most).contains(&ratio), "scheme {scheme}: {errors:?}");
    }
}

/// Without a wind the state is x + B ∫ u dt, to rounding, with any step and any scheme.
#[test]
fn without_a_flow_the_integrals_are_exact() {
    let grid = grid(6, 5, Boundary::Periodic);
    let still =
        Advection::new(grid, &Wind::Uniform { u_m_per_s: 0.0, v_m_per_s: 0.0 }, AdvectionScheme::ThirdOrderUpwind);
    let still = still.unwrap();
    let pattern = standard_normals(&mut stream(5, "pattern"), 30);
    for function in functions() {
        let source = Source { variable: 0, pattern: pattern.clone(), function: function.clone() };
        let forcing = Arc::new(Forcing { sources: vec![source] });
        let amount = function.integral(START, [0.0, 4200.0]);
        for (step_s, steps) in [(4200, 1), (600, 7), (7, 600)] {
            for model in by_all_schemes(&still, step_s, steps, &forcing) {
                let mut x = State::zeros(still.layout()).valid_at(START);
                forecast(&*model, &mut x, steps / model.substeps()).unwrap();
                let errors: Vec<f64> =
                    x.values().iter().zip(&pattern).map(|(value, own)| value - amount * own).collect();
                assert!(largest(&errors) < 1e-11 * 4200.0, "{function:?} {step_s}: {}", largest(&errors));
                assert_eq!(x.time(), Some(START + seconds(4200)));
            }
        }
    }
}

/// A shift along the lines on which the pattern is constant does not change what is added either.
#[test]
fn a_flow_along_the_pattern_leaves_the_integrals_exact() {
    let grid = grid(6, 5, Boundary::Periodic);
    let shift = ExactShift::new(grid.clone(), 2, 0, seconds(600)).unwrap();
    let pattern: Vec<f64> = (0..30).map(|cell| (cell / 6) as f64 - 2.0).collect();
    let function = functions()[1].clone();
    let amount = function.integral(START, [0.0, 4200.0]);
    let forcing = Arc::new(Forcing { sources: vec![Source { variable: 0, pattern: pattern.clone(), function }] });
    let model = forced(shift.clone(), &forcing);
    check_contract(&*model, &State::zeros(shift.layout()).valid_at(START));
    let mut x = State::from_values(shift.layout(), standard_normals(&mut stream(6, "x"), 30)).valid_at(START);
    let mut plain = x.clone();
    forecast(&*model, &mut x, 7).unwrap();
    forecast(&shift, &mut plain, 7).unwrap();
    for (cell, value) in x.values().iter().enumerate() {
        assert!((value - plain.values()[cell] - amount * pattern[cell]).abs() < 1e-9);
    }
}

/// A step is the model's own between the increments of its halves, to the bit; and in a linear model the effect of a forcing is
/// the same from every state.
#[test]
fn a_forced_run_is_the_model_with_the_increments_by_hand() {
    let water = shallow_water(14, 11, Boundary::Channel, FORMS[0]);
    let start = turbulence(&water).valid_at(START);
    let linear = LinearShallowWater::about_uniform_flow(water, 1000.0, 15.0).unwrap();
    let forcing = forcing(linear.layout(), 1.0);
    let plain = stepped(linear.clone(), 200, TimeScheme::Rk4);
    let model = forced(plain.clone(), &forcing);
    let mut by_hand = start.clone();
    for step in 0..9 {
        let begin = START + seconds(200 * step);
        let add = |x: &mut State, span: [f64; 2]| {
            for Source { variable, pattern, function } in &forcing.sources {
                let amount = function.integral(begin, span);
                x.field_mut(*variable).iter_mut().zip(pattern).for_each(|(value, own)| *value += amount * own);
            }
        };
        add(&mut by_hand, [0.0, 100.0]);
        plain.step(&mut by_hand);
        add(&mut by_hand, [100.0, 200.0]);
    }
    let mut x = start.clone();
    forecast(&*model, &mut x, 9).unwrap();
    assert_eq!(x, by_hand);
    let mut other = perturbed_jet(&shallow_water(14, 11, Boundary::Channel, FORMS[0])).valid_at(START);
    let (mut unforced, mut other_unforced) = (start, other.clone());
    forecast(&*model, &mut other, 9).unwrap();
    forecast(&plain, &mut unforced, 9).unwrap();
    forecast(&plain, &mut other_unforced, 9).unwrap();
    let effects = [(&x, &unforced), (&other, &other_unforced)]
        .map(|(forced, plain)| forced.values().iter().zip(plain.values()).map(|(a, b)| a - b).collect::<Vec<f64>>());
    let difference: Vec<f64> = effects[0].iter().zip(&effects[1]).map(|(a, b)| a - b).collect();
    assert!(largest(&effects[0]) > 1.0 && largest(&difference) < 1e-10, "{}", largest(&difference));
}

#[test]
fn time_goes_on_from_one_forecast_to_the_next() {
    let tendency = shallow_water(14, 11, Boundary::Periodic, FORMS[0]);
    let start = turbulence(&tendency).valid_at(START);
    let forcing = forcing(tendency.layout(), 0.5);
    for model in by_all_schemes(&tendency, 100, 4, &forcing) {
        let (mut whole, mut parts) = (start.clone(), start.clone());
        forecast(&*model, &mut whole, 6).unwrap();
        forecast(&*model, &mut parts, 2).unwrap();
        let stored = postcard::to_stdvec(&parts).unwrap();
        let mut parts: State = postcard::from_bytes(&stored).unwrap();
        forecast(&*model, &mut parts, 4).unwrap();
        assert_eq!(whole, parts);
        let at_start: State = parts.valid_at(START);
        let (mut again, mut later) = (at_start.clone(), at_start.clone().valid_at(START + seconds(1700)));
        forecast(&*model, &mut again, 1).unwrap();
        forecast(&*model, &mut later, 1).unwrap();
        assert!(again.values() != later.values(), "another time, another forcing");
        // A state of no time is no start.
        let mut timeless = at_start.valid_at(None);
        let refused = Err(ForecastError::Start(ModelError::NoTime));
        assert_eq!(forecast(&*model, &mut timeless, 1), refused);
        assert_eq!(forecast_tl::<f64>(&*model, &mut timeless, &mut [], 1), refused);
    }
}

#[test]
fn what_does_not_fit_is_refused_and_no_source_changes_nothing() {
    let tendency = shallow_water(8, 9, Boundary::Channel, FORMS[0]);
    let model = || Arc::new(stepped(tendency.clone(), 100, TimeScheme::Rk4)) as Arc<dyn Adjoint>;
    let source = |variable: usize, pattern: Vec<f64>| Source { variable, pattern, function: TimeFunction::Constant };
    for (bad, expected) in [
        (source(3, vec![1.0; 72]), "a variable that the model does not have"),
        (source(0, vec![1.0; 71]), "71 values, but the grid 72 cells"),
        (source(1, [vec![1.0; 71], vec![f64::NAN]].concat()), "the value NaN"),
        (source(2, vec![1.0; 72]), "acts on v at the southern wall"),
    ] {
        let error = Forced::of(model(), &Arc::new(Forcing { sources: vec![bad] })).err().unwrap().to_string();
        assert!(error.contains("source 0 of the forcing") && error.contains(expected), "{error}");
    }
    let plain = model();
    assert!(Arc::ptr_eq(&Forced::of(Arc::clone(&plain), &Arc::default()).unwrap(), &plain));
}
