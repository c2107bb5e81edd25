//! A model that several ranks integrate together is the same as on one, to the bit.

use crate::common::{BOUNDARIES, FORMS, SCHEMES, grid, jet, largest, parameters, perturbed_jet, stepped};
use isobar_model::initial::Vortex;
use isobar_model::random::{standard_normals, stream};
use isobar_model::testing::on_ranks;
use isobar_model::{
    Adjoint, Advection, AdvectionScheme, BandedModel, Boundary, ColumnsMut, Duration, ExactShift, Forced, Forcing,
    ForecastError, InBands, Leapfrog, LinearShallowWater, RestartedLeapfrog, ShallowWater, ShallowWaterParameters,
    Source, State, Stored, Time, TimeFunction, Wind, forecast, initial,
};
use std::sync::Arc;

const STEPS: usize = 3;

/// Rank 1, …, 4 get every value of states, now and in parts, and of increments in parts in either precision that one rank has.
fn check(model: Arc<dyn Adjoint>, start: &State) {
    let start = start.clone().valid_at(Time::from_seconds(1000));
    let increments = |number: u64| standard_normals(&mut stream(number, "bands"), start.values().len());
    let states: Vec<State> = (0..3)
        .map(|j| {
            let values =
                start.values().iter().zip(increments(j)).map(|(value, normal)| value + 1e-4 * normal).collect();
            State::from_values(start.layout(), values).valid_at(start.time())
        })
        .collect();
    let columns: Vec<f64> = (0..10).flat_map(increments).collect();
    let single: Vec<f32> = columns.iter().map(|&value| f32::narrow(value)).collect();
    let (mut advanced, mut columns_after, mut single_after) = (states.clone(), columns.clone(), single.clone());
    forecast::forecast_together(&*model, &mut advanced, STEPS).unwrap();
    forecast::forecast_tl(&*model, &mut start.clone(), &mut columns_after, STEPS).unwrap();
    forecast::forecast_tl(&*model, &mut start.clone(), &mut single_after, STEPS).unwrap();
    for ranks in 1..=4 {
        on_ranks(ranks, |communicator| {
            let banded = BandedModel::new(Arc::clone(&model), Arc::new(communicator)).unwrap();
            let mut whole = states.clone();
            forecast::forecast_together(&banded, &mut whole, STEPS).unwrap();
            assert_eq!(whole, advanced);
            let bands = banded.bands();
            let mut parts: Vec<Vec<f64>> = states.iter().map(|state| bands.own_part(state.values())).collect();
            let mut borrowed: Vec<&mut [f64]> = parts.iter_mut().map(|part| &mut part[..]).collect();
            banded.forecast_parts(&mut borrowed, start.time(), STEPS).unwrap();
            for (part, after) in parts.iter().zip(&advanced) {
                assert_eq!(*part, bands.own_part(after.values()), "{ranks} ranks");
            }
            let mut part: Vec<f64> = columns.chunks(start.values().len()).flat_map(|it| bands.own_part(it)).collect();
            let mut in_single: Vec<f32> = part.iter().map(|&value| f32::narrow(value)).collect();
            banded.forecast_tl_parts(&start, ColumnsMut::Double(&mut part), STEPS).unwrap();
            banded.forecast_tl_parts(&start, ColumnsMut::Single(&mut in_single), STEPS).unwrap();
            let after = columns_after.chunks(start.values().len());
            assert_eq!(part, after.flat_map(|column| bands.own_part(column)).collect::<Vec<_>>(), "{ranks} ranks");
            // What one process advances in double precision and rounds once, ranks round after each step.
            let widened: Vec<f64> = single_after.iter().map(|value| value.widen()).collect();
            let after = widened.chunks(start.values().len()).flat_map(|column| bands.own_part(column));
            let off =
                in_single.iter().zip(after).map(|(value, after)| (value.widen() - after).abs()).fold(0.0, f64::max);
            assert!(off <= 1e-6 * largest(&widened), "{ranks} ranks in single precision: {off:e}");
        });
    }
}

#[test]
fn ranks_give_the_bits_of_one_process() {
    for boundary in BOUNDARIES {
        for (form, scheme) in FORMS.into_iter().flat_map(|form| SCHEMES.map(|scheme| (form, scheme))) {
            for hyperdiffusion_m4_per_s in [0.0, 5e14] {
                let damped =
                    ShallowWaterParameters { drag_per_s: 1e-6, hyperdiffusion_m4_per_s, ..parameters(boundary) };
                let nonlinear = ShallowWater::new(grid(14, 23, boundary), damped, form).unwrap();
                let start = perturbed_jet(&nonlinear);
                check(Arc::new(stepped(nonlinear.clone(), 200, scheme)), &start);
                let steady = initial::geostrophic_jet(&nonlinear, &jet(&nonlinear)).unwrap();
                let linear = LinearShallowWater::about_steady_flow(nonlinear, steady).unwrap();
                check(Arc::new(stepped(linear, 200, scheme)), &start);
            }
        }
    }
}

#[test]
fn ranks_give_the_bits_of_one_process_with_leapfrog_a_forcing_and_advection() {
    for boundary in BOUNDARIES {
        let nonlinear = ShallowWater::new(grid(12, 17, boundary), parameters(boundary), FORMS[0]).unwrap();
        let (start, layout) = (perturbed_jet(&nonlinear), isobar_model::Tendency::layout(&nonlinear).clone());
        let pattern = (0..layout.grid.cells()).map(|cell| 1e-5 * (cell % 29) as f64).collect();
        let function = TimeFunction::Constant;
        let forcing = Arc::new(Forcing { sources: vec![Source { variable: 0, pattern, function }] });
        let leapfrog = Leapfrog::new(nonlinear.clone(), Duration::from_seconds(100), 0.05).unwrap();
        let restarted = RestartedLeapfrog::new(leapfrog, 4).unwrap();
        check(Arc::new(restarted.clone()), &start);
        check(Arc::new(restarted.forced(Arc::clone(&forcing)).unwrap()), &start);
        let runge_kutta = Arc::new(stepped(nonlinear, 200, SCHEMES[0]));
        check(Forced::of(runge_kutta, &forcing).unwrap(), &start);
        let grid = grid(12, 17, boundary);
        let hill = State::from_values(
            &isobar_model::advection::layout(grid.clone()),
            (0..grid.cells()).map(|cell| (cell % 31) as f64).collect(),
        );
        for wind in [Wind::Vortex { speed_m_per_s: 20.0 }, Wind::Uniform { u_m_per_s: 9.0, v_m_per_s: 0.0 }] {
            let advection = Advection::new(grid.clone(), &wind, AdvectionScheme::ThirdOrderUpwind).unwrap();
            check(Arc::new(stepped(advection, 200, SCHEMES[1])), &hill);
        }
        if boundary == Boundary::Periodic {
            for rows in [2, -3] {
                check(Arc::new(ExactShift::new(grid.clone(), 5, rows, Duration::from_seconds(60)).unwrap()), &hill);
            }
        }
    }
}

/// What a rank has is itself large enough to be swept by several threads.
#[test]
fn ranks_of_several_threads_give_the_bits_of_one_process() {
    for boundary in BOUNDARIES {
        let damped = ShallowWaterParameters { hyperdiffusion_m4_per_s: 5e14, ..parameters(boundary) };
        let nonlinear = ShallowWater::new(grid(256, 600, boundary), damped, FORMS[0]).unwrap();
        let y_m = 0.5 * isobar_model::Tendency::layout(&nonlinear).grid.height_m();
        let vortex = Vortex { center_x_m: 9e6, center_y_m: y_m, amplitude_m: 40.0, radius_m: 8e5 };
        let start = initial::vortices(&nonlinear, 1000.0, &[vortex]).unwrap();
        let model: Arc<dyn Adjoint> = Arc::new(stepped(nonlinear, 100, SCHEMES[0]));
        let mut advanced = start.clone();
        forecast::forecast(&*model, &mut advanced, STEPS).unwrap();
        on_ranks(2, |communicator| {
            let banded = BandedModel::new(Arc::clone(&model), Arc::new(communicator)).unwrap();
            let mut part = banded.bands().own_part(start.values());
            let threads = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
            threads.install(|| banded.forecast_parts(&mut [&mut part[..]], None, STEPS)).unwrap();
            assert!(part == banded.bands().own_part(advanced.values()), "{boundary:?}");
        });
    }
}

/// All ranks get the error that one process gets: of the start, and of the forecast.
#[test]
fn a_state_that_fails_on_one_rank_fails_on_all() {
    let boundary = Boundary::Channel;
    let nonlinear = ShallowWater::new(grid(12, 17, boundary), parameters(boundary), FORMS[0]).unwrap();
    let start = perturbed_jet(&nonlinear);
    let model: Arc<dyn Adjoint> = Arc::new(stepped(nonlinear, 2000, SCHEMES[0]));
    let mut broken = start.clone();
    broken.values_mut()[15 * 12 + 4] = -1.0;
    let expected = [&start, &broken].map(|x| forecast::forecast(&*model, &mut (*x).clone(), 200).unwrap_err());
    assert!(matches!(expected, [ForecastError::NotFinite { .. }, ForecastError::Start(_)]), "{expected:?}");
    let errors = on_ranks(3, |communicator| {
        let banded = BandedModel::new(Arc::clone(&model), Arc::new(communicator)).unwrap();
        [&start, &broken].map(|x| {
            let mut part = banded.bands().own_part(x.values());
            let error = banded.forecast_parts(&mut [&mut part[..]], None, 200).unwrap_err();
            assert_eq!(part, banded.bands().own_part(x.values()), "it stays as it was");
            error
        })
    });
    let in_words = |errors: &[ForecastError; 2]| errors.each_ref().map(ToString::to_string);
    assert!(errors.iter().all(|errors| in_words(errors) == in_words(&expected)), "{errors:?}");
    let too_many = on_ranks(18, |communicator| BandedModel::new(Arc::clone(&model), Arc::new(communicator)).err());
    let message = too_many[0].as_ref().expect("18 ranks").to_string();
    assert_eq!(message, "18 ranks cannot share the 17 rows of the grid");
}
