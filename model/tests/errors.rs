//! What a forecast says when it cannot start, and when it blows up.

use crate::common::{FORMS, shallow_water, stepped, turbulence};
use isobar_model::forecast::{forecast, forecast_tl, forecast_together, trajectory};
use isobar_model::{Boundary, Duration, ForecastError, Leapfrog, Model, ModelError, TimeScheme, initial};

#[test]
fn a_forecast_does_not_start_without_depth_or_with_a_value_that_is_not_finite() {
    let tendency = shallow_water(8, 9, Boundary::Channel, FORMS[0]);
    let leapfrog = Leapfrog::new(tendency.clone(), Duration::from_seconds(60), 0.05).unwrap();
    let model = stepped(tendency.clone(), 60, TimeScheme::Rk4);
    let good = turbulence(&tendency);
    for depth_m in [0.0, -3.0] {
        let mut x = good.clone();
        x.values_mut()[2 * 8 + 5] = depth_m;
        let expected = ForecastError::Start(ModelError::Thickness { row: 2, column: 5, thickness_m: depth_m });
        assert_eq!(forecast(&model, &mut x, 1), Err(expected.clone()));
        assert_eq!(forecast_tl::<f64>(&model, &mut x, &mut [], 1), Err(expected.clone()));
        assert_eq!(trajectory(&model, &x, 1), Err(expected.clone()));
        let mut pair = leapfrog.start(&good);
        pair.values_mut()[3 * 72 + 2 * 8 + 5] = depth_m;
        assert_eq!(forecast(&leapfrog, &mut pair, 1), Err(expected), "the earlier level counts as well");
    }
    let mut x = good.clone();
    x.values_mut()[72 + 3 * 8 + 1] = f64::NAN;
    let message = forecast(&model, &mut x, 1).unwrap_err().to_string();
    assert_eq!(message, "the forecast cannot start: u at row 3, column 1 is NaN: it must be finite");
    assert!(initial::rest(&tendency, 0.0).is_err() && initial::rest(&tendency, f64::NAN).is_err());
}

#[test]
fn a_blow_up_names_step_variable_cell_and_cfl_number() {
    let tendency = shallow_water(8, 9, Boundary::Periodic, FORMS[1]);
    let start = turbulence(&tendency);
    let leapfrog = Leapfrog::new(tendency.clone(), Duration::from_seconds(2000), 0.05).unwrap();
    let models: [(Box<dyn Model>, _); 2] = [
        (Box::new(stepped(tendency.clone(), 4000, TimeScheme::Rk4)), start.clone()),
        (Box::new(leapfrog.clone()), leapfrog.start(&start)),
    ];
    for (model, start) in models {
        let error = forecast(&*model, &mut start.clone(), 1000).unwrap_err();
        let ForecastError::NotFinite { step, ref place, value, cfl } = error else { panic!("{error}") };
        assert!(!value.is_finite() && cfl > 1.0 && (2..1000).contains(&step), "{error}");
        // The step before was still finite, and gives the CFL number.
        let mut before = start.clone();
        forecast(&*model, &mut before, step - 1).unwrap();
        assert_eq!(cfl, model.time_step().as_f64() / model.largest_time_step_s(&before));
        model.step(&mut before);
        let index = before.first_non_finite().unwrap();
        assert_eq!(*place, before.layout().describe(index));
        let calm = initial::rest(&tendency, 1000.0).unwrap();
        let calm = if start.values().len() > calm.values().len() { leapfrog.start(&calm) } else { calm };
        let mut together = [calm.clone(), start.clone(), calm];
        let same = forecast_together(&*model, &mut together, 1000).unwrap_err();
        assert_eq!(format!("{same:?}"), format!("{error:?}"), "beside states that are well");
        let message = error.to_string();
        assert!(message.contains(&format!("after step {step}: {place} is {value} (CFL number")), "{message}");
    }
}
