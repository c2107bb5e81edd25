//! Initial states are what they say, and parameters out of range are refused with their numbers.

use crate::common::{BOUNDARIES, FORMS, difference, grid, jet, largest, parameters, shallow_water};
use isobar_model::initial::{
    self, HeightPerturbation, JetConfig, RandomConfig, Vortex, geostrophic_jet, random_balanced, vortices,
};
use isobar_model::random::stream;
use isobar_model::shallow_water::{H, U, V};
use isobar_model::{
    Boundary, Duration, Grid, LinearShallowWater, Location, ModelError, ShallowWater, ShallowWaterParameters, State,
    Stepped, Tendency, TimeScheme, VectorInvariant,
};

const FORM: VectorInvariant = VectorInvariant::PotentialEnstrophy;

/// The tendency at `x` of the model linearised about rest on the f-plane of f0.
fn linear_tendency(model: &ShallowWater, x: &State) -> Vec<f64> {
    let plane = ShallowWaterParameters { beta_per_m_per_s: 0.0, ..*model.parameters() };
    let nonlinear = ShallowWater::new(model.layout().grid.clone(), plane, FORM).unwrap();
    let linear = LinearShallowWater::about_uniform_flow(nonlinear, 1000.0, 0.0).unwrap();
    let mut out = vec![0.0; x.values().len()];
    linear.tendency(x.values(), &mut out, &mut vec![0.0; linear.scratch_len()]);
    out
}

#[test]
fn vortices_are_in_discrete_geostrophic_balance_and_where_they_were_put() {
    for boundary in BOUNDARIES {
        let model = shallow_water(24, 20, boundary, FORM);
        let high = Vortex { center_x_m: 650e3, center_y_m: 840e3, amplitude_m: 40.0, radius_m: 250e3 };
        let low = Vortex { center_x_m: 2e6, center_y_m: 400e3, amplitude_m: -30.0, radius_m: 200e3 };
        let x = vortices(&model, 1000.0, &[high, low]).unwrap();
        let (h, v) = (x.field(H), x.field(V));
        let highest = h.iter().fold(0.0, |highest: f64, &h| highest.max(h));
        assert!((highest - 1040.0).abs() < 3.0 && (h[[10, 6]] - highest).abs() < 1e-9, "{highest}");
        // Anticyclonic: northward wind west of the high's centre on the northern hemisphere.
        assert!(v[[10, 3]] > 1.0 && v[[10, 9]] < -1.0);
        let slope = linear_tendency(&model, &x);
        assert!(largest(&slope) < 1e-14, "{boundary:?}: {:e}", largest(&slope));
        if boundary == Boundary::Channel {
            assert!(v.row(0).iter().all(|&v| v == 0.0));
        }
    }
}

#[test]
fn random_states_are_balanced_with_the_variance_and_length_asked_for() {
    for boundary in BOUNDARIES {
        let model = shallow_water(32, 40, boundary, FORM);
        let config = RandomConfig { mean_depth_m: 1000.0, height_standard_deviation_m: 20.0, length_scale_m: 300e3 };
        let (mut variance, mut covariance, mut count) = (0.0, 0.0, 0.0);
        let mut random = stream(11, "test/random states");
        for _ in 0..200 {
            let x = random_balanced(&model, &config, &mut random).unwrap();
            let h = x.field(H);
            assert!((h.mean().unwrap() - 1000.0).abs() < 1e-10);
            assert!(largest(&linear_tendency(&model, &x)) < 1e-14);
            // In the middle third, away from walls; neighbours 300 km apart in x.
            for (j, i) in (14..26).flat_map(|j| (0..32).map(move |i| (j, i))) {
                variance += (h[[j, i]] - 1000.0).powi(2);
                covariance += (h[[j, i]] - 1000.0) * (h[[j, (i + 3) % 32]] - 1000.0);
                count += 1.0;
            }
        }
        // About 200 × 10 independent values: the standard deviation is known to some 2 %.
        let deviation = (variance / count).sqrt();
        assert!((deviation / 20.0 - 1.0).abs() < 0.07, "{boundary:?}: {deviation}");
        // exp(−½) of the continuous field; the four-corner mean and the periodic domain change it by some per cent.
        let correlation = covariance / variance;
        assert!((correlation - (-0.5f64).exp()).abs() < 0.06, "{boundary:?}: {correlation}");
    }
}

#[test]
fn the_same_seed_gives_the_same_state() {
    let model = shallow_water(8, 8, Boundary::Periodic, FORM);
    let config = RandomConfig { mean_depth_m: 1000.0, height_standard_deviation_m: 20.0, length_scale_m: 300e3 };
    let draw = |seed| random_balanced(&model, &config, &mut stream(seed, "test")).unwrap();
    assert_eq!(draw(1), draw(1));
    assert!(largest(&difference(draw(1).values(), draw(2).values())) > 1.0);
}

#[test]
fn the_jet_has_its_speed_and_its_perturbation_is_added() {
    let model = shallow_water(24, 25, Boundary::Channel, FORM);
    let config = jet(&model);
    let x = geostrophic_jet(&model, &config).unwrap();
    assert_eq!(x.field(U)[[12, 5]], 30.0);
    let bump = HeightPerturbation {
        amplitude_m: 25.0,
        center_x_m: model.layout().grid.x_m(Location::Center, 7),
        center_y_m: model.layout().grid.y_m(Location::Center, 9),
        width_x_m: 200e3,
        width_y_m: 100e3,
    };
    let perturbed = geostrophic_jet(&model, &JetConfig { perturbation: Some(bump), ..config }).unwrap();
    let change = difference(perturbed.values(), x.values());
    let cells = 24 * 25;
    assert!((change[9 * 24 + 7] - 25.0).abs() < 1e-10 && (largest(&change) - 25.0).abs() < 1e-10);
    // Two columns east is one width: 1/e.
    assert!((change[9 * 24 + 9] - 25.0 * (-1f64).exp()).abs() < 1e-10);
    assert!(largest(&change[cells..]) == 0.0);
}

#[test]
fn a_periodic_jet_has_a_counterflow_that_closes_it() {
    let model = shallow_water(8, 24, Boundary::Periodic, FORM);
    let x = geostrophic_jet(&model, &jet(&model)).unwrap();
    let (h, u) = (x.field(H), x.field(U));
    assert!(u[[0, 0]] < -3.0 && u[[12, 0]] > 20.0, "{} {}", u[[0, 0]], u[[12, 0]]);
    assert!((h[[23, 0]] - h[[0, 0]]).abs() < 60.0);
}

fn parameter(error: ModelError) -> (&'static str, f64) {
    match error {
        ModelError::Parameter { name, value, .. } => (name, value),
        other => panic!("{other}"),
    }
}

#[test]
fn parameters_out_of_range_are_refused_with_their_names_and_values() {
    let good = parameters(Boundary::Periodic);
    let refused = |parameters: ShallowWaterParameters| {
        parameter(ShallowWater::new(grid(8, 8, Boundary::Periodic), parameters, FORMS[0]).unwrap_err())
    };
    assert_eq!(refused(ShallowWaterParameters { gravity_m_per_s2: 0.0, ..good }), ("gravity_m_per_s2", 0.0));
    assert_eq!(refused(ShallowWaterParameters { beta_per_m_per_s: 1e-11, ..good }), ("beta_per_m_per_s", 1e-11));
    assert_eq!(refused(ShallowWaterParameters { drag_per_s: -1.0, ..good }), ("drag_per_s", -1.0));
    assert_eq!(
        refused(ShallowWaterParameters { hyperdiffusion_m4_per_s: -2.0, ..good }),
        ("hyperdiffusion_m4_per_s", -2.0)
    );
    assert_eq!(refused(ShallowWaterParameters { coriolis_per_s: f64::NAN, ..good }).0, "coriolis_per_s");
    let flat = Grid { dx_m: 0.0, ..grid(8, 8, Boundary::Periodic) };
    assert_eq!(parameter(ShallowWater::new(flat, good, FORM).unwrap_err()), ("dx_m", 0.0));
    let small = ShallowWater::new(grid(8, 3, Boundary::Periodic), good, FORM).unwrap_err();
    assert_eq!(small, ModelError::GridTooSmall { nx: 8, ny: 3, least: 4 });
    let model = shallow_water(8, 8, Boundary::Periodic, FORM);
    assert_eq!(parameter(initial::rest(&model, -5.0).unwrap_err()), ("mean_depth_m", -5.0));
    let stepped = Stepped::new(model, Duration::from_seconds(0), TimeScheme::Rk4).unwrap_err();
    assert_eq!(parameter(stepped), ("time_step_s", 0.0));
}

#[test]
fn states_that_cannot_be_are_refused() {
    let model = shallow_water(16, 16, Boundary::Channel, FORM);
    // The surface would have to fall by far more than the depth.
    let shallow = JetConfig { mean_depth_m: 20.0, speed_m_per_s: 200.0, ..jet(&model) };
    let error = geostrophic_jet(&model, &shallow).unwrap_err();
    assert!(matches!(error, ModelError::NoBalance { .. } | ModelError::Thickness { .. }), "{error}");
    let deep = Vortex { center_x_m: 8e5, center_y_m: 6e5, amplitude_m: -1200.0, radius_m: 300e3 };
    assert!(matches!(vortices(&model, 1000.0, &[deep]), Err(ModelError::Thickness { .. })));
    let still = ShallowWaterParameters { coriolis_per_s: 0.0, ..parameters(Boundary::Channel) };
    let still = ShallowWater::new(grid(16, 16, Boundary::Channel), still, FORM).unwrap();
    assert_eq!(parameter(vortices(&still, 1000.0, &[]).unwrap_err()), ("coriolis_per_s", 0.0));
}
