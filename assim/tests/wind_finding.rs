//! Wind-finding: offsets and winds within what is claimed, exact without errors, equal to the dense solution.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use isobar_assim::block_angular::Prior;
use isobar_assim::wind_finding::{Fix, Reading, Tracker, find_winds, offset_names, reading_of};
use isobar_model::random::{standard_normals, stream};

fn trackers() -> Vec<Tracker> {
    let tracker = |name: &str, place_m| Tracker {
        name: name.into(),
        place_m,
        sigma_range_m: 20.0,
        sigma_azimuth_rad: 1e-3,
        sigma_elevation_rad: 1e-3,
    };
    vec![tracker("a", [0.0, 0.0, 20.0]), tracker("b", [30_000.0, 5_000.0, 150.0])]
}

const OFFSETS: [f64; 6] = [25.0, 3e-3, -2e-3, -40.0, -1e-3, 1.5e-3];

/// Fixes ten seconds apart and the positions; `errors` is the factor on the random errors, and the second tracker loses
/// every fifth.
fn flight(count: usize, seed: u64, errors: f64) -> (Vec<Fix>, Vec<[f64; 3]>) {
    let random = &mut stream(seed, "flight");
    let (mut position, trackers) = ([5_000.0, -12_000.0, 300.0], trackers());
    let (mut fixes, mut positions) = (Vec::new(), Vec::new());
    for k in 0..count {
        let speed = 4.0 + position[2] / 1_500.0;
        position = [position[0] + 9.0 * speed, position[1] + 4.0 * speed, position[2] + 5e4 / count as f64 * 0.4];
        let mut readings: Vec<Option<Reading>> = Vec::new();
        for (j, tracker) in trackers.iter().enumerate() {
            let (exact, e) = (reading_of(tracker, position), standard_normals(random, 3));
            let azimuth = exact.azimuth_rad + OFFSETS[3 * j + 1] + errors * tracker.sigma_azimuth_rad * e[1];
            readings.push((j == 0 || k % 5 != 0).then_some(Reading {
                range_m: exact.range_m + OFFSETS[3 * j] + errors * tracker.sigma_range_m * e[0],
                // A full turn more is the same direction.
                azimuth_rad: azimuth + if k % 2 == 0 { std::f64::consts::TAU } else { 0.0 },
                elevation_rad: exact.elevation_rad + OFFSETS[3 * j + 2] + errors * tracker.sigma_elevation_rad * e[2],
            }));
        }
        fixes.push(Fix { seconds: 10.0 * k as f64, readings });
        positions.push(position);
    }
    (fixes, positions)
}

#[test]
fn without_errors_everything_is_exact() {
    let (fixes, positions) = flight(200, 1, 0.0);
    let found = find_winds(&trackers(), &fixes, None).unwrap();
    for (found, truth) in found.positions_m.iter().zip(&positions) {
        (0..3).for_each(|i| assert!((found[i] - truth[i]).abs() < 1e-5, "{found:?} {truth:?}"));
    }
    for (i, (found, truth)) in found.offsets.iter().zip(OFFSETS).enumerate() {
        assert!((found - truth).abs() < if i % 3 == 0 { 1e-5 } else { 1e-9 });
    }
    let wind = (positions[51][0] - positions[50][0]) / 10.0;
    assert!((found.winds_m_per_s[50][0] - wind).abs() < 1e-5);
}

#[test]
fn offsets_and_winds_are_within_what_is_claimed() {
    let (mut offsets, mut winds) = (Vec::new(), Vec::new());
    for seed in 0..60 {
        let (fixes, positions) = flight(300, seed, 1.0);
        let found = find_winds(&trackers(), &fixes, None).unwrap();
        assert!((found.chi2_per_degree - 1.0).abs() < 0.25, "{}", found.chi2_per_degree);
        for i in 0..6 {
            offsets.push((found.offsets[i] - OFFSETS[i]) / found.offsets_covariance[(i, i)].sqrt());
        }
        for k in (0..299).step_by(10) {
            for i in 0..3 {
                let truth = (positions[k + 1][i] - positions[k][i]) / 10.0;
                winds.push((found.winds_m_per_s[k][i] - truth) / found.sigma_winds_m_per_s[k][i]);
            }
        }
    }
    for (name, scores) in [("offsets", offsets), ("winds", winds)] {
        let beyond = scores.iter().filter(|z| z.abs() > 3.0).count();
        assert!(beyond * 100 <= scores.len(), "{name}: {beyond} of {}", scores.len());
        let square = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
        assert!((0.7..1.3).contains(&square), "{name}: {square}");
    }
}

/// Offsets and positions, with their whole covariance, are those of one dense regression about the solution.
#[test]
fn it_is_the_dense_solution() {
    let (fixes, _) = flight(40, 3, 1.0);
    let (trackers, m) = (trackers(), 3 * 40);
    let spread = [50.0, 5e-3, 5e-3, 50.0, 5e-3, 5e-3];
    let covariance = Mat::from_fn(6, 6, |i, j| if i == j { spread[i] * spread[i] } else { 0.0 });
    let prior = Prior { mean: vec![0.0; 6], covariance };
    let found = find_winds(&trackers, &fixes, Some(&prior)).unwrap();
    let (mut matrix, mut right) = (Mat::<f64>::zeros(m + 6, m + 6), Mat::<f64>::zeros(m + 6, 1));
    let mut add = |entries: &[(usize, f64)], value: f64, sigma: f64| {
        for &(i, a) in entries {
            right[(i, 0)] += a * value / sigma.powi(2);
            entries.iter().for_each(|&(j, b)| matrix[(i, j)] += a * b / sigma.powi(2));
        }
    };
    for (k, fix) in fixes.iter().enumerate() {
        for (j, tracker) in trackers.iter().enumerate() {
            let Some(read) = fix.readings[j] else { continue };
            let at = |position: [f64; 3]| {
                let it = reading_of(tracker, position);
                [it.range_m, it.azimuth_rad, it.elevation_rad]
            };
            let here = found.positions_m[k];
            let (model, read) = (at(here), [read.range_m, read.azimuth_rad, read.elevation_rad]);
            for kind in 0..3 {
                let mut entries = vec![(m + 3 * j + kind, 1.0)];
                for i in 0..3 {
                    let (mut above, mut below) = (here, here);
                    (above[i], below[i]) = (here[i] + 1.0, here[i] - 1.0);
                    entries.push((3 * k + i, (at(above)[kind] - at(below)[kind]) / 2.0));
                }
                let mut left = read[kind] - model[kind] - found.offsets[3 * j + kind];
                if kind == 1 {
                    left = (left + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
                }
                add(&entries, left, [20.0, 1e-3, 1e-3][kind]);
            }
        }
    }
    (0..6).for_each(|i| add(&[(m + i, 1.0)], -found.offsets[i], spread[i]));
    let llt = matrix.llt(Side::Lower).unwrap();
    let (change, covariance) = (llt.solve(&right), llt.inverse());
    for i in 0..6 {
        let sigma = covariance[(m + i, m + i)].sqrt();
        assert!(change[(m + i, 0)].abs() < 1e-4 * sigma, "nothing is left to improve");
        assert!((found.offsets_covariance[(i, i)].sqrt() / sigma - 1.0).abs() < 1e-5);
    }
    for (k, sigmas) in found.sigma_positions_m.iter().enumerate() {
        for (i, found) in sigmas.iter().enumerate() {
            assert!((found / covariance[(3 * k + i, 3 * k + i)].sqrt() - 1.0).abs() < 1e-5);
        }
    }
}

#[test]
fn what_one_tracker_cannot_know_is_named_and_a_prior_helps() {
    let (fixes, _) = flight(50, 2, 1.0);
    let alone: Vec<Fix> = fixes.iter().map(|fix| Fix { readings: fix.readings[..1].to_vec(), ..fix.clone() }).collect();
    let error = find_winds(&trackers()[..1], &alone, None).unwrap_err().to_string();
    assert!(["a/range", "a/azimuth", "a/elevation"].iter().all(|name| error.contains(name)), "{error}");
    assert_eq!(offset_names(&trackers())[4], "b/azimuth");
    let covariance = Mat::from_fn(3, 3, |i, j| if i == j { [400.0, 1e-6, 1e-6][i] } else { 0.0 });
    let prior = Prior { mean: vec![5.0, 1e-3, 0.0], covariance };
    let found = find_winds(&trackers()[..1], &alone, Some(&prior)).unwrap();
    assert!((found.offsets[0] - 5.0).abs() < 1e-6 && (found.offsets_covariance[(0, 0)] - 400.0).abs() < 1e-6);
}

#[test]
fn readings_that_make_no_sense_are_refused() {
    let (fixes, _) = flight(20, 2, 1.0);
    let refused = |change: &dyn Fn(&mut Vec<Fix>)| {
        let mut own = fixes.clone();
        change(&mut own);
        find_winds(&trackers(), &own, None).unwrap_err().to_string()
    };
    assert!(refused(&|fixes| fixes.clear()).contains("needs a tracker and a fix"));
    assert!(refused(&|fixes| fixes[3].readings = vec![None, None]).contains("fix 4 has no reading"));
    assert!(refused(&|fixes| fixes[3].seconds = 0.0).contains("fix 4 is not after"));
    assert!(refused(&|fixes| fixes[6].readings.truncate(1)).contains("fix 7 has 1 readings for 2 trackers"));
    let broken = |fixes: &mut Vec<Fix>| fixes[2].readings[0].as_mut().unwrap().range_m = f64::NAN;
    assert!(refused(&broken).contains("fix 3: the reading of a is none"));
}
