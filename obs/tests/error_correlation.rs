//! Random errors that are correlated within reports: those that are drawn, and those that methods assume.

use crate::common::*;
use isobar_model::{Boundary, State};
use isobar_obs::{
    ErrorCorrelation, ErrorCorrelationKind, FurtherColumns, Network, ObservationFile, ObservationWindow,
    RecordedSettings, SatelliteSettings,
};
use std::f64::consts::PI;

const LENGTH_M: f64 = 250e3;

fn correlated(network: Network, kind: ErrorCorrelationKind, length_m: f64, assumed_length_m: f64) -> Network {
    Network { error_correlation: Some(ErrorCorrelation { kind, length_m, assumed_length_m }), ..network }
}

/// A satellite that flies the same way in every cycle.
fn still() -> Network {
    let config = SatelliteSettings { shift_per_cycle_m: 0.0, biases: Vec::new(), ..satellite() };
    let config = SatelliteSettings { heading: isobar_obs::Heading::Northward, ..config };
    Network::new("polar", config)
}

/// Stations that report h alone.
fn sondes(count: usize) -> Network {
    let mut settings = radiosondes(count);
    settings.variables.retain(|it| it.name == "h");
    Network::new("sondes", settings)
}

fn windows(network: Network, boundary: Boundary, cycles: usize) -> Vec<ObservationWindow> {
    let mut system = system(&layout(boundary), &[network]);
    let truth = State::zeros(&layout(boundary));
    (0..cycles).map(|_| system.observe(&truth)).collect()
}

/// Drawn errors have the covariance that a window with the same assumption claims, and that one is σ² exp(−d/L) with d along
/// the line, or the chord on a periodic plane. Of N draws a covariance has the standard error √((R_ii R_jj + R_ij²)/N).
#[test]
fn drawn_errors_have_the_covariance_that_they_claim() {
    let cycles = 4000;
    for (network, kind, boundary) in [
        (still(), ErrorCorrelationKind::ScanLine, Boundary::Channel),
        (sondes(20), ErrorCorrelationKind::ByDistance, Boundary::Channel),
        (sondes(20), ErrorCorrelationKind::ByDistance, Boundary::Periodic),
    ] {
        let windows = windows(correlated(network, kind, LENGTH_M, LENGTH_M), boundary, cycles);
        let first = &windows[0];
        let n = first.len().min(33);
        let covariance = first.error_regression.covariance(&first.sigma);
        let (mut largest, mut count_of_pairs) = (0.0f64, 0);
        for i in 0..n {
            for j in 0..=i {
                let (a, b) = (&first.reports[i], &first.reports[j]);
                let expected = match kind {
                    ErrorCorrelationKind::ScanLine if i / 11 != j / 11 => 0.0,
                    ErrorCorrelationKind::ScanLine => {
                        (-(a.scan.unwrap() - b.scan.unwrap()).abs() * 500e3 / LENGTH_M).exp()
                    }
                    ErrorCorrelationKind::ByDistance => {
                        let chord = |d: f64, around: f64| around / PI * (PI * d / around).sin();
                        let dy = a.y_m - b.y_m;
                        let dy = if boundary == Boundary::Periodic { chord(dy, 1440e3) } else { dy };
                        (-chord(a.x_m - b.x_m, 2400e3).hypot(dy) / LENGTH_M).exp()
                    }
                };
                let variance = first.sigma[i] * first.sigma[j];
                assert!((covariance[i][j] / variance - expected).abs() < 1e-9, "{kind:?} {i} {j}");
                let drawn = windows.iter().map(|it| it.values[i] * it.values[j]).sum::<f64>() / cycles as f64;
                let error = variance * ((1.0 + expected * expected) / cycles as f64).sqrt();
                largest = largest.max((drawn - covariance[i][j]).abs() / error);
                count_of_pairs += 1;
            }
        }
        // The largest of some hundred normal numbers.
        println!("{kind:?} {boundary:?}: of {count_of_pairs} the farthest is {largest:.2} standard errors off");
        assert!(largest < 4.5, "{kind:?}: {largest} standard errors");
    }
}

/// Along a line an error depends on the one before it alone, also where footprints are missing; other lines are other reports.
#[test]
fn along_a_scan_line_each_error_depends_on_the_one_before() {
    let network = Network { missing_rate: 0.3, ..still() };
    let window =
        &windows(correlated(network, ErrorCorrelationKind::ScanLine, LENGTH_M, LENGTH_M), Boundary::Channel, 1)[0];
    let mut rows = isobar_obs::SparseRows::new();
    (0..window.len()).for_each(|row| rows.push_row([(row, 1.0)]));
    let whitened = window.error_regression.whiten_rows(&window.sigma, &rows);
    let mut firsts = 0;
    for row in 0..window.len() {
        let line = |row: usize| window.reports[row].platform.split(' ').nth(1).unwrap().to_string();
        let is_first = row == 0 || line(row) != line(row - 1);
        let read: Vec<usize> = whitened.row(row).iter().map(|entry| entry.0).collect();
        assert_eq!(read, if is_first { vec![row] } else { vec![row - 1, row] });
        firsts += usize::from(is_first);
    }
    assert!(window.len() < 18 * 11 && firsts == 18, "{} {firsts}", window.len());
}

/// What methods assume changes nothing of what is drawn, and a length of zero, or far below the distances, nothing at all.
#[test]
fn errors_far_apart_are_those_without_correlation_to_the_bit() {
    let values = |network: Network| -> Vec<Vec<f64>> {
        windows(network, Boundary::Channel, 3).into_iter().map(|window| window.values).collect()
    };
    for (network, kind) in
        [(still as fn() -> Network, ErrorCorrelationKind::ScanLine), (|| sondes(20), ErrorCorrelationKind::ByDistance)]
    {
        let independent = values(network());
        for length_m in [0.0, 1e-3] {
            assert_eq!(values(correlated(network(), kind, length_m, LENGTH_M)), independent);
            let window = &windows(correlated(network(), kind, LENGTH_M, length_m), Boundary::Channel, 1)[0];
            assert!(window.error_regression.is_independent());
        }
        assert_ne!(values(correlated(network(), kind, LENGTH_M, 0.0)), independent);
        assert_eq!(
            values(correlated(network(), kind, LENGTH_M, 0.0)),
            values(correlated(network(), kind, LENGTH_M, 2.0 * LENGTH_M))
        );
    }
}

/// Recorded observations have the reports that a column names.
#[test]
fn recorded_observations_are_correlated_within_their_reports() {
    let text = "cycle,x_m,y_m,variable,value,sigma,id,orbit\n\
                1,1e5,3e5,h,7,2,a,9\n1,2e5,3e5,h,7,2,b,9\n1,3e5,3e5,h,7,2,c,10\n1,4e5,3e5,h,7,2,d,9\n1,1e5,3e5,u,7,2,a,9\n";
    let further = FurtherColumns { report_by: Some("orbit".into()), ..Default::default() };
    let observations = ObservationFile::parse_with(text, "file.csv", None, further).unwrap();
    let network = Network::new("net", RecordedSettings::new(observations));
    let network = correlated(network, ErrorCorrelationKind::ByDistance, LENGTH_M, LENGTH_M);
    let mut system = system(&layout(Boundary::Channel), &[network]);
    let window = system.observe_checked(None, None);
    let r = window.error_regression.covariance(&window.sigma);
    let chord = |d: f64| 2400e3 / PI * (PI * d / 2400e3).sin();
    let correlation = |d: f64| 4.0 * (-chord(d) / LENGTH_M).exp();
    for (i, j, expected) in [(0, 1, correlation(1e5)), (0, 3, correlation(3e5)), (0, 2, 0.0), (0, 4, 0.0), (2, 2, 4.0)]
    {
        assert!((r[i][j] - expected).abs() < 1e-12, "{i} {j}: {}", r[i][j]);
    }
    assert_eq!(window.values, [7.0; 5]);
}

/// Two stations in one place have nearly one error; nothing is divided by zero.
#[test]
fn observations_at_one_place_differ_a_little() {
    let text = "cycle,x_m,y_m,variable,value,sigma,id\n1,1e5,3e5,h,7,2,a\n1,1e5,3e5,h,8,2,b\n1,1e5,3e5,h,9,2,c\n";
    let observations = ObservationFile::parse(text, "file.csv", None).unwrap();
    let network = Network::new("net", RecordedSettings::new(observations));
    let network = correlated(network, ErrorCorrelationKind::ByDistance, LENGTH_M, LENGTH_M);
    let window = system(&layout(Boundary::Channel), &[network]).observe_checked(None, None);
    let r = window.error_regression.covariance(&window.sigma);
    assert!(r.iter().flatten().all(|value| (value - 4.0).abs() < 1e-5), "{r:?}");
    let own = window.error_regression.whitened_sigma(&window.sigma);
    assert!(own[1] > 1e-3 && own[2] > 1e-3, "{own:?}");
}

#[test]
fn impossible_correlations_are_errors() {
    let message = |network: Network| {
        let layout = layout(Boundary::Channel);
        try_system(&layout, None, &[network]).err().expect("it is refused").to_string()
    };
    let by_distance = ErrorCorrelationKind::ByDistance;
    for (length_m, assumed_m) in [(-1.0, 0.0), (f64::NAN, 0.0), (0.0, f64::INFINITY)] {
        let found = message(correlated(sondes(20), by_distance, length_m, assumed_m));
        assert!(found.contains("length") && found.contains("at least 0 m"), "{found}");
    }
    let found = message(correlated(sondes(20), ErrorCorrelationKind::ScanLine, 1.0, 1.0));
    assert_eq!(found, "sondes: error_correlation is along scan lines, which its observations do not have");
    let found = message(correlated(sondes(2001), by_distance, 1.0, 1.0));
    assert!(found.starts_with("sondes: error_correlation is by distance among 2001 observations"), "{found}");
    let rows: String = (0..2001).map(|row| format!("1,1,{row},h,7,2,{row}\n")).collect();
    let text = format!("cycle,x_m,y_m,variable,value,sigma,id\n{rows}");
    let observations = ObservationFile::parse(&text, "file.csv", None).unwrap();
    let network = Network::new("net", RecordedSettings::new(observations));
    assert!(
        message(correlated(network, by_distance, 1.0, 1.0)).contains("2001 observations of a report, of at most 2000")
    );
}
