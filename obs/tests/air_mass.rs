//! Biases that depend on the state: what is observed, and what methods are given.

use crate::common::*;
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, State};
use isobar_obs::quality::Reference;
use isobar_obs::{AirMassBias, BiasProcess, InitialBias, Network, ObservingSystem, QualityControl, SatelliteSettings};

fn air_mass(variable: &str, mean: f64, scale: f64, value: f64) -> AirMassBias {
    let process = BiasProcess { initial: InitialBias::Given { value }, ..BiasProcess::constant(1.0) };
    AirMassBias { variable: variable.to_owned(), mean, scale, process }
}

/// Scan terms, and two predictors: the observed variable, and another which lives elsewhere on the grid.
fn system_with(air_mass_biases: Vec<AirMassBias>) -> ObservingSystem {
    let config = SatelliteSettings { air_mass_biases, ..satellite() };
    system(&layout(Boundary::Channel), &[Network::new("polar", config), Network::new("net", radiosondes(9))])
}

fn two() -> Vec<AirMassBias> {
    vec![air_mass("h", 0.5, 2.0, 3.0), air_mass("u", -1.0, 0.25, -0.5)]
}

fn state(seed: u64) -> State {
    random_state(&layout(Boundary::Channel), seed)
}

/// y − ε = X x + (G + P(x)) c with p = (H_v x − mean) / scale, H_v the footprint on the predictor's variable.
#[test]
fn the_bias_is_proportional_to_the_predictor() {
    let layout = layout(Boundary::Channel);
    let truth = state_of(&layout, |variable, x_m, y_m| match variable {
        0 => 1e-6 * x_m * (1.0 - x_m / 2_400e3) + 2e-6 * y_m,
        1 => 7.0,
        _ => 0.0,
    });
    let mut system = system_with(two());
    let names: Vec<_> = system.calibration().parameters.iter().map(|it| (it.name.as_str(), it.unit.as_str())).collect();
    assert_eq!(names[3..], [("polar/air_mass_h", "m"), ("polar/air_mass_u", "m")]);
    let observed = system.observe(&truth);
    let c = true_biases(&system);
    assert_eq!(c[3..], [3.0, -0.5]);
    let none = vec![0.0; c.len()];
    let height = observed.operator.simulate(&truth, &none);
    let mut seen = 0;
    for (row, report) in observed.reports.iter().enumerate() {
        let found = observed.values[row] - system.values_bias_removed()[row];
        let Some(s) = report.scan else {
            assert_eq!(found, 0.0, "a radiosonde has no bias of the satellite");
            continue;
        };
        let scan = c[0] + c[1] * s + c[2] * (s * s - 1.0 / 3.0);
        let expected = scan + 3.0 * (height[row] - 0.5) / 2.0 - 0.5 * (7.0 + 1.0) / 0.25;
        assert!((found - expected).abs() < 1e-10, "{report:?}: {found}, not {expected}");
        seen += 1;
    }
    assert_eq!(seen, 18 * 11);
}

/// h_b(x, c) = X x + (G + P(x_b)) c exactly; at x = x_b it is the operator itself, elsewhere it misses Σ c_j (p_j(x) − p_j(x_b)).
#[test]
fn anchored_at_a_background_the_operator_is_linear_and_misses_what_it_says() {
    let mut system = system_with(two());
    let observed = system.observe(&state(1));
    let (background, x) = (state(2), state(3));
    let c = standard_normals(&mut stream(4, "calibration"), system.calibration().len());
    let anchored = observed.anchored(&background);
    assert_eq!((&anchored.values, &anchored.reports), (&observed.values, &observed.reports));
    let close =
        |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-12 * (1.0 + a.abs().max(b.abs())));

    let jacobian = anchored.operator.linearize(&x, &c);
    assert_eq!(jacobian, anchored.operator.linearize(&background, &vec![0.0; c.len()]), "the same everywhere");
    let without = observed.operator.linearize(&x, &vec![0.0; c.len()]).state;
    for row in 0..observed.len() {
        let seen: Vec<_> = without.row(row).iter().filter(|entry| entry.1 != 0.0).copied().collect();
        assert_eq!(jacobian.state.row(row), seen, "X does not see the bias");
    }
    assert_eq!(jacobian.calibration, observed.operator.linearize(&background, &c).calibration, "G + P(x_b)");
    assert_eq!(anchored.operator.simulate(&x, &c), jacobian.apply(x.values(), &c));
    assert!(close(&anchored.operator.simulate(&background, &c), &observed.operator.simulate(&background, &c)));

    let at = |place: &State| observed.operator.linearize(place, &c).calibration;
    let (there, here) = (at(&x), at(&background));
    let (whole, fixed) = (observed.operator.simulate(&x, &c), anchored.operator.simulate(&x, &c));
    let left: Vec<f64> = whole.iter().zip(&fixed).map(|(whole, fixed)| whole - fixed).collect();
    let stated: Vec<f64> = (0..observed.len()).map(|row| there.row_dot(row, &c) - here.row_dot(row, &c)).collect();
    assert!(close(&left, &stated) && left.iter().any(|left| left.abs() > 0.1));
}

#[test]
fn a_known_bias_is_in_no_operator_and_without_predictors_nothing_is_copied() {
    let known = |mut bias: AirMassBias| {
        bias.process.known = true;
        bias
    };
    let mut system = system_with(two().into_iter().map(known).collect());
    assert_eq!(system.calibration().len(), 3);
    let observed = system.observe(&state(1));
    assert!(matches!(observed.anchored(&state(2)), std::borrow::Cow::Borrowed(_)));
}

/// Where the predictor of the reference is large, the prior of β leads one to expect a large bias.
#[test]
fn quality_control_expects_the_bias_that_the_reference_predicts() {
    let layout = layout(Boundary::Channel);
    let only_here = |which: usize, size: f64| {
        state_of(&layout, |variable, x_m, y_m| {
            let here = (1_150e3..1_250e3).contains(&x_m) && (680e3..760e3).contains(&y_m);
            if variable == which && here { size } else { 0.0 }
        })
    };
    let control = QualityControl { length_m: 300e3, limit: 4.0 };
    // The footprints around the cell are points halfway between its centre and its neighbours': they see a quarter of it.
    let reference = only_here(3, 160.0);
    let rejected = |air_mass_biases, truth: &State| {
        let sharp = SatelliteSettings { footprint_sigma_m: 0.0, ..satellite() };
        let config = SatelliteSettings { biases: Vec::new(), air_mass_biases, ..sharp };
        let mut system = system(&layout, &[Network::new("polar", config)]);
        system
            .observe_checked(
                Some(truth.into()),
                Some((&control, Reference { states: (&reference).into(), sigma: &[] })),
            )
            .aside
            .rejected()
            .count()
    };
    let mut bias = air_mass("tracer", 0.0, 1.0, 10.0);
    bias.process.assumed_sigma_prior = Some(10.0);
    assert_eq!(rejected(vec![bias], &reference), 0, "a bias of 400 m, of which σ is 400 m");
    assert!(rejected(Vec::new(), &only_here(0, 1600.0)) > 0, "the same with no predictor to explain it");
}
