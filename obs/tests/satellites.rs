//! Satellites: where their footprints are, what they average, and their scan-dependent biases.

use crate::common::*;
use isobar_model::{Boundary, Grid, State};
use isobar_obs::instrument::satellite::{HEIGHT_SIGMA_M, SCAN_BIAS_SIGMAS};
use isobar_obs::{
    BiasProcess, Heading, InitialBias, Network, ObservationWindow, ObservingSystem, SatelliteSettings, ScanBias,
    ScanTerm, Schedule,
};

fn system_of(config: SatelliteSettings, boundary: Boundary) -> ObservingSystem {
    system(&layout(boundary), &[Network::new("polar", config)])
}

fn passes(network: Network, cycles: usize) -> Vec<ObservationWindow> {
    let mut system = system(&layout(Boundary::Channel), &[network]);
    let truth = random_state(&layout(Boundary::Channel), 1);
    (0..cycles).map(|_| system.observe(&truth)).collect()
}

/// (scan position, x, y) of every footprint.
fn places(window: &ObservationWindow) -> Vec<(f64, f64, f64)> {
    window.reports.iter().map(|report| (report.scan.unwrap(), report.x_m, report.y_m)).collect()
}

#[test]
fn the_swath_is_where_it_should_be() {
    let config = SatelliteSettings { heading: Heading::Northward, ..satellite() };
    let windows = passes(Network::new("polar", config), 4);
    // y = 720 km ± n · 80 km within [0, 1440) km: the line at the northern wall itself is outside.
    assert_eq!(windows[0].len(), 18 * 11);
    for (cycle, window) in windows.iter().enumerate() {
        let crossing = 1_200e3 + 700e3 * cycle as f64;
        for (number, (s, x, y)) in places(window).into_iter().enumerate() {
            assert!((s - (number % 11) as f64 / 5.0 + 1.0).abs() < 1e-15);
            assert!((y - 80e3 * (number / 11) as f64).abs() < 1e-6, "line after line to the north: {y}");
            let expected = (crossing + 500e3 * s).rem_euclid(2_400e3);
            assert!((x - expected).abs() < 1e-6, "cycle {cycle}: {x}, not {expected}");
        }
    }
    assert_eq!(&*windows[0].reports[12].platform, "line 2 position 2");
}

#[test]
fn scan_positions_turn_with_the_heading() {
    let windows = passes(Network::new("polar", satellite()), 2);
    let [north, south] = [places(&windows[0]), places(&windows[1])];
    assert!(north[0].2 < north[11].2 && south[0].2 > south[11].2);
    let east = |spots: &[(f64, f64, f64)], crossing: f64| {
        let (s, x, _) = spots[7];
        (x - crossing).signum() == s.signum()
    };
    assert!(east(&north, 1_200e3), "to the north, the right is east");
    assert!(!east(&south, 1_900e3), "to the south, the right is west");
    let schedule = Schedule { every_cycles: 2, first_cycle: 1 };
    let every_other = passes(Network { schedule, ..Network::new("polar", satellite()) }, 3);
    assert!(every_other[1].is_empty());
    let third = places(&every_other[2]);
    assert!(third[0].2 > third[11].2, "the second pass goes south, whichever cycle it is in");
}

#[test]
fn an_oblique_track_keeps_its_angle_its_width_and_covers_the_domain() {
    let angle: f64 = 30.0;
    let config =
        SatelliteSettings { heading: Heading::Northward, track_angle_deg: angle, swath_width_m: 600e3, ..satellite() };
    let windows = passes(Network::new("polar", config), 1);
    let spots = places(&windows[0]);
    let center = |spot: &&(f64, f64, f64)| spot.0 == 0.0;
    let track: Vec<_> = spots.iter().filter(center).collect();
    let (first, last) = (track[0], track[track.len() - 1]);
    let slope = (first.1 - last.1) / (first.2 - last.2);
    assert!((slope - angle.to_radians().tan()).abs() < 1e-9, "{slope}");
    // Every scan position comes within a line's spacing of both walls.
    for position in 0..11 {
        let s = position as f64 / 5.0 - 1.0;
        let y: Vec<f64> = spots.iter().filter(|spot| (spot.0 - s).abs() < 1e-9).map(|spot| spot.2).collect();
        let (low, high) = (y.iter().fold(f64::MAX, |a, &b| a.min(b)), y.iter().fold(0.0, |a: f64, &b| a.max(b)));
        assert!(low < 80e3 && high > 1_440e3 - 80e3, "position {position}: {low} to {high}");
    }
    // On one line, neighbours are a tenth of the swath apart.
    let line: Vec<_> = (windows[0].reports.iter())
        .filter(|report| report.platform.starts_with("line 15 "))
        .map(|report| (report.x_m, report.y_m))
        .collect();
    assert_eq!(line.len(), 11);
    for pair in line.windows(2) {
        let distance = (pair[0].0 - pair[1].0).hypot(pair[0].1 - pair[1].1);
        assert!((distance - 60e3).abs() < 1e-6, "{distance}");
        // To the right of a track that goes to the north-north-east is the east-south-east.
        let across = ((pair[1].0 - pair[0].0) / 60e3, (pair[1].1 - pair[0].1) / 60e3);
        let (sin, cos) = angle.to_radians().sin_cos();
        assert!((across.0 - cos).abs() < 1e-9 && (across.1 + sin).abs() < 1e-9, "{across:?}");
    }
}

#[test]
fn footprints_average_linear_fields_to_their_centre() {
    let layout = layout(Boundary::Channel);
    // Every second line lies on a row of h's points, and every footprint on one of their columns.
    let config = SatelliteSettings {
        crossing_x_m: 1_250e3,
        shift_per_cycle_m: 0.0,
        swath_width_m: 400e3,
        scan_positions: 5,
        along_track_spacing_m: 40e3,
        footprint_sigma_m: 90e3,
        ..satellite()
    };
    let truth = state_of(&layout, |_, x, y| 100.0 + 1e-5 * x - 2e-5 * y);
    let mut system = system(&layout, &[Network::new("polar", config)]);
    let observed = system.observe(&truth);
    let mean = observed.operator.simulate(&truth, &[0.0; 3]);
    let mut checked = 0;
    for (value, report) in mean.iter().zip(&observed.reports) {
        let on_a_point = (report.y_m / 80e3).fract() == 0.5;
        if on_a_point && (270e3..1_170e3).contains(&report.y_m) {
            let expected = 100.0 + 1e-5 * report.x_m - 2e-5 * report.y_m;
            assert!((value - expected).abs() < 1e-10, "{report:?}: {value}, not {expected}");
            checked += 1;
        }
    }
    assert_eq!(checked, 5 * 12);
}

#[test]
fn the_bias_depends_on_the_scan_position_as_described() {
    let term = |term, value| ScanBias {
        term,
        process: BiasProcess { initial: InitialBias::Given { value }, ..BiasProcess::constant(1.0) },
    };
    let biases = vec![term(ScanTerm::Offset, 10.0), term(ScanTerm::Linear, -4.0), term(ScanTerm::Quadratic, 6.0)];
    let mut system = system_of(SatelliteSettings { biases, ..satellite() }, Boundary::Periodic);
    let names: Vec<_> = system.calibration().parameters.iter().map(|parameter| parameter.name.as_str()).collect();
    assert_eq!(names, ["polar/offset", "polar/scan_linear", "polar/scan_quadratic"]);
    let observed = system.observe(&State::zeros(&layout(Boundary::Periodic)));
    for (number, (s, _, _)) in places(&observed).into_iter().enumerate() {
        let found = observed.values[number] - system.values_bias_removed()[number];
        let expected = 10.0 - 4.0 * s + 6.0 * (s * s - 1.0 / 3.0);
        assert!((found - expected).abs() < 1e-11, "{s}: {found}, not {expected}");
    }
}

#[test]
fn random_errors_have_their_size() {
    let mut system = system_of(satellite(), Boundary::Channel);
    let truth = State::zeros(&layout(Boundary::Channel));
    let mut errors = Vec::new();
    for _ in 0..20 {
        system.observe(&truth);
        errors.extend(system.values_bias_removed().iter().map(|value| value / HEIGHT_SIGMA_M));
    }
    assert_eq!(errors.len(), 20 * 18 * 11);
    assert_standard_normal(&errors, "satellite");
}

/// 2.9 times the random error root-mean-square and about 3.2 peak to peak: AMSU-A's scan bias.
#[test]
fn the_default_bias_is_of_the_published_size() {
    let mean = |f: &dyn Fn(f64) -> f64| (0..1000).map(|i| f((i as f64 + 0.5) / 500.0 - 1.0)).sum::<f64>() / 1000.0;
    let terms = [ScanTerm::Offset, ScanTerm::Linear, ScanTerm::Quadratic];
    let square: f64 =
        terms.iter().zip(SCAN_BIAS_SIGMAS).map(|(term, sigma)| mean(&|s| (sigma * term.value(s)).powi(2))).sum();
    assert!((square.sqrt() - 2.9).abs() < 0.02, "{}", square.sqrt());
    for pair in [(0, 1), (0, 2), (1, 2)] {
        let product = mean(&|s| terms[pair.0].value(s) * terms[pair.1].value(s));
        assert!(product.abs() < 1e-5, "the terms are orthogonal: {product}");
    }
    let [_, linear, quadratic] = SCAN_BIAS_SIGMAS;
    let along = |i: i32| linear * f64::from(i) / 100.0 + quadratic * (f64::from(i) / 100.0).powi(2);
    let (low, high) = (-100..=100).map(along).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
    assert!((high - low - 3.2).abs() < 0.1, "{}", high - low);

    let grid = Grid { nx: 64, ny: 48, dx_m: 80e3, dy_m: 80e3, boundary: Boundary::Channel };
    let system = system(&layout_of(grid), &[Network::new("polar", SatelliteSettings::default())]);
    let priors: Vec<f64> = system.calibration().parameters.iter().map(|parameter| parameter.sigma_prior).collect();
    assert_eq!(priors, SCAN_BIAS_SIGMAS.map(|sigma| sigma * HEIGHT_SIGMA_M));
}
