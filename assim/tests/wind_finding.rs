//! Wind-finding: offsets and winds within what is claimed, exact without errors, equal to the dense solution.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use isobar_assim::block_angular::Prior;
use isobar_assim::wind_finding::{Fix, Motion, Reading, Tracker, find_winds, offset_names, reading_of};
use isobar_model::random::{standard_normals, stream};
use std::f64::consts::{PI, TAU};

fn trackers() -> Vec<Tracker> {
    let tracker = |name: &str, place_m| Tracker {
        name: name.into(),
        place_m,
        sigma_range_m: Some(20.0),
        sigma_azimuth_rad: Some(1e-3),
        sigma_elevation_rad: Some(1e-3),
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
        let readings = (trackers.iter().enumerate())
            .map(|(j, tracker)| {
                let (exact, e) = (reading_of(tracker, position).values(), standard_normals(random, 3));
                let read = |i: usize| Some(exact[i]? + OFFSETS[3 * j + i] + errors * tracker.sigmas()[i]? * e[i]);
                // A full turn more is the same direction.
                let turned = read(1).map(|azimuth| azimuth + if k % 2 == 0 { TAU } else { 0.0 });
                let seen = Reading { range_m: read(0), azimuth_rad: turned, elevation_rad: read(2) };
                if j == 0 || k % 5 != 0 { seen } else { Reading::default() }
            })
            .collect();
        fixes.push(Fix { seconds: 10.0 * k as f64, readings });
        positions.push(position);
    }
    (fixes, positions)
}

#[test]
fn without_errors_everything_is_exact() {
    let (fixes, positions) = flight(200, 1, 0.0);
    let found = find_winds(&trackers(), &fixes, None, None).unwrap();
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
        let found = find_winds(&trackers(), &fixes, None, None).unwrap();
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

/// Offsets, positions and winds, with their covariance, are those of one dense regression about the solution: without a motion
/// and with one, where fixes lie at uneven times.
#[test]
fn it_is_the_dense_solution() {
    let (mut fixes, _) = flight(80, 3, 1.0);
    fixes.iter_mut().enumerate().for_each(|(k, fix)| fix.seconds += (k % 3) as f64);
    is_dense(&fixes[..40], None);
    // Longer than a part of the chain.
    is_dense(&fixes, Some(Motion { sigma_change_m_per_s: 3.0 }));
}

fn is_dense(fixes: &[Fix], motion: Option<Motion>) {
    let (trackers, m) = (trackers(), 3 * fixes.len());
    let spread = [50.0, 5e-3, 5e-3, 50.0, 5e-3, 5e-3];
    let covariance = Mat::from_fn(6, 6, |i, j| if i == j { spread[i] * spread[i] } else { 0.0 });
    let prior = Prior { mean: vec![0.0; 6], covariance };
    let found = find_winds(&trackers, fixes, Some(&prior), motion).unwrap();
    let (mut matrix, mut right) = (Mat::<f64>::zeros(m + 6, m + 6), Mat::<f64>::zeros(m + 6, 1));
    let mut add = |entries: &[(usize, f64)], value: f64, sigma: f64| {
        for &(i, a) in entries {
            right[(i, 0)] += a * value / sigma.powi(2);
            entries.iter().for_each(|&(j, b)| matrix[(i, j)] += a * b / sigma.powi(2));
        }
    };
    for (k, fix) in fixes.iter().enumerate() {
        for (j, tracker) in trackers.iter().enumerate() {
            let at = |position: [f64; 3]| reading_of(tracker, position).values().map(Option::unwrap);
            let here = found.positions_m[k];
            let model = at(here);
            for kind in 0..3 {
                let Some(read) = fix.readings[j].values()[kind] else { continue };
                let mut entries = vec![(m + 3 * j + kind, 1.0)];
                for i in 0..3 {
                    let (mut above, mut below) = (here, here);
                    (above[i], below[i]) = (here[i] + 1.0, here[i] - 1.0);
                    entries.push((3 * k + i, (at(above)[kind] - at(below)[kind]) / 2.0));
                }
                let mut left = read - model[kind] - found.offsets[3 * j + kind];
                if kind == 1 {
                    left = (left + PI).rem_euclid(TAU) - PI;
                }
                add(&entries, left, [20.0, 1e-3, 1e-3][kind]);
            }
        }
    }
    let span = |k: usize| fixes[k + 1].seconds - fixes[k].seconds;
    for k in 1..fixes.len() - 1 {
        let Some(Motion { sigma_change_m_per_s }) = motion else { continue };
        let sigma = sigma_change_m_per_s * ((span(k - 1) + span(k)) / 120.0).sqrt();
        for i in 0..3 {
            let change = found.winds_m_per_s[k][i] - found.winds_m_per_s[k - 1][i];
            let (before, after) = (1.0 / span(k - 1), 1.0 / span(k));
            add(&[(3 * k - 3 + i, before), (3 * k + i, -before - after), (3 * k + 3 + i, after)], -change, sigma);
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
    for k in 0..fixes.len() {
        for i in 0..3 {
            let at = |k: usize| 3 * k + i;
            let sigma = covariance[(at(k), at(k))].sqrt();
            assert!(change[(at(k), 0)].abs() < 1e-4 * sigma, "nothing is left to improve");
            assert!((found.sigma_positions_m[k][i] / sigma - 1.0).abs() < 1e-5);
            if k + 1 < fixes.len() {
                let both = covariance[(at(k), at(k))] + covariance[(at(k + 1), at(k + 1))];
                let sigma = (both - 2.0 * covariance[(at(k), at(k + 1))]).sqrt() / span(k);
                assert!((found.sigma_winds_m_per_s[k][i] / sigma - 1.0).abs() < 1e-5);
            }
        }
    }
}

/// What two flights say together is what the second says with the offsets of the first as its prior, eq. (16).
#[test]
fn flight_after_flight_is_all_flights_at_once() {
    // Small errors: the first flight is linearised about its own estimates, and not about those of both.
    let (fixes, _) = flight(120, 5, 0.03);
    let first = find_winds(&trackers(), &fixes[..60], None, None).unwrap();
    let known = Prior { mean: first.offsets, covariance: first.offsets_covariance };
    let second = find_winds(&trackers(), &fixes[60..], Some(&known), None).unwrap();
    let both = find_winds(&trackers(), &fixes, None, None).unwrap();
    for i in 0..6 {
        let sigma = both.offsets_covariance[(i, i)].sqrt();
        let difference = (second.offsets[i] - both.offsets[i]) / sigma;
        assert!(difference.abs() < 1e-3, "{i}: {difference}");
        let ratio = second.offsets_covariance[(i, i)].sqrt() / sigma;
        assert!((ratio - 1.0).abs() < 1e-3, "{i}: {ratio}");
    }
    for k in 0..59 {
        for i in 0..3 {
            let (later, all, sigma) =
                (&second.winds_m_per_s[k], &both.winds_m_per_s[60 + k], &both.sigma_winds_m_per_s);
            assert!((later[i] - all[i]).abs() < 1e-3 * sigma[60 + k][i]);
        }
    }
}

/// A balloon that moves as the motion says: winds are better than without it, and within what is claimed.
#[test]
fn a_motion_makes_winds_better_by_what_it_claims() {
    let motion = Motion { sigma_change_m_per_s: 1.0 };
    let (mut squares, mut scores) = ([0.0; 2], Vec::new());
    for seed in 0..20 {
        let random = &mut stream(seed, "motion");
        let (mut position, mut wind) = ([5_000.0, -12_000.0, 300.0], [8.0, 3.0, 5.0]);
        let (mut fixes, mut winds) = (Vec::new(), Vec::new());
        for k in 0..120 {
            let mut read_by = |tracker: &Tracker| {
                let (exact, e) = (reading_of(tracker, position).values(), standard_normals(random, 3));
                let read = |i: usize| Some(exact[i]? + tracker.sigmas()[i]? * e[i]);
                Reading { range_m: read(0), azimuth_rad: read(1), elevation_rad: read(2) }
            };
            let readings = trackers().iter().map(&mut read_by).collect();
            fixes.push(Fix { seconds: 10.0 * k as f64, readings });
            winds.push(wind);
            (0..3).for_each(|i| position[i] += 10.0 * wind[i]);
            let change = standard_normals(random, 3);
            (0..3).for_each(|i| wind[i] += change[i] * (10.0_f64 / 60.0).sqrt());
        }
        for (number, motion) in [None, Some(motion)].into_iter().enumerate() {
            let found = find_winds(&trackers(), &fixes, None, motion).unwrap();
            for (k, truth) in winds[..119].iter().enumerate() {
                for (i, truth) in truth.iter().enumerate() {
                    let error = found.winds_m_per_s[k][i] - truth;
                    squares[number] += error * error;
                    if number == 1 {
                        scores.push(error / found.sigma_winds_m_per_s[k][i]);
                    }
                }
            }
        }
    }
    let square = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    assert!((0.85..1.15).contains(&square), "{square}");
    assert!(squares[1] < 0.1 * squares[0], "{squares:?}");
}

/// Two radiotheodolites without range: directions that cross are enough, and a fix that only one of them sees needs a motion.
#[test]
fn directions_alone_find_a_balloon() {
    let (fixes, positions) = flight(60, 1, 0.0);
    let blind: Vec<Tracker> = trackers().into_iter().map(|it| Tracker { sigma_range_m: None, ..it }).collect();
    let fixes: Vec<Fix> = (fixes.into_iter())
        .map(|fix| Fix { readings: fix.readings.iter().map(|it| Reading { range_m: None, ..*it }).collect(), ..fix })
        .collect();
    assert_eq!(offset_names(&blind), ["a/azimuth", "a/elevation", "b/azimuth", "b/elevation"]);
    let kept = [OFFSETS[1], OFFSETS[2], OFFSETS[4], OFFSETS[5]];
    let prior = Prior { mean: kept.to_vec(), covariance: Mat::from_fn(4, 4, |i, j| if i == j { 1e-8 } else { 0.0 }) };
    let error = find_winds(&blind, &fixes, Some(&prior), None).unwrap_err().to_string();
    assert!(error.contains("fix 1 has fewer than three readings") && error.contains("assume a motion"), "{error}");
    let both: Vec<Fix> = fixes.iter().filter(|fix| fix.readings[1] != Reading::default()).cloned().collect();
    let found = find_winds(&blind, &both, Some(&prior), None).unwrap();
    for (k, found) in (0..60).filter(|k| k % 5 != 0).zip(&found.positions_m) {
        (0..3).for_each(|i| assert!((found[i] - positions[k][i]).abs() < 1e-4, "{found:?} {:?}", positions[k]));
    }
    let motion = Some(Motion { sigma_change_m_per_s: 1.0 });
    let found = find_winds(&blind, &fixes, Some(&prior), motion).unwrap();
    for (k, (found, sigma)) in found.positions_m.iter().zip(&found.sigma_positions_m).enumerate() {
        (0..3).for_each(|i| assert!((found[i] - positions[k][i]).abs() < 2.0 * sigma[i], "{k}"));
    }
}

#[test]
fn what_one_tracker_cannot_know_is_named_and_a_prior_helps() {
    let (fixes, _) = flight(50, 2, 1.0);
    let alone: Vec<Fix> = fixes.iter().map(|fix| Fix { readings: fix.readings[..1].to_vec(), ..fix.clone() }).collect();
    let error = find_winds(&trackers()[..1], &alone, None, None).unwrap_err().to_string();
    assert!(["a/range", "a/azimuth", "a/elevation"].iter().all(|name| error.contains(name)), "{error}");
    assert_eq!(offset_names(&trackers())[4], "b/azimuth");
    let covariance = Mat::from_fn(3, 3, |i, j| if i == j { [400.0, 1e-6, 1e-6][i] } else { 0.0 });
    let prior = Prior { mean: vec![5.0, 1e-3, 0.0], covariance };
    let found = find_winds(&trackers()[..1], &alone, Some(&prior), None).unwrap();
    assert!((found.offsets[0] - 5.0).abs() < 1e-6 && (found.offsets_covariance[(0, 0)] - 400.0).abs() < 1e-6);
}

#[test]
fn readings_that_make_no_sense_are_refused() {
    let (fixes, _) = flight(20, 2, 1.0);
    let refused = |change: &dyn Fn(&mut Vec<Fix>)| {
        let mut own = fixes.clone();
        change(&mut own);
        find_winds(&trackers(), &own, None, None).unwrap_err().to_string()
    };
    assert!(refused(&|fixes| fixes.clear()).contains("needs a tracker and a fix"));
    assert!(refused(&|fixes| fixes[3].readings = vec![Reading::default(); 2]).contains("fix 4 has no reading"));
    assert!(refused(&|fixes| fixes[3].seconds = 0.0).contains("fix 4 is not after"));
    assert!(refused(&|fixes| fixes[6].readings.truncate(1)).contains("fix 7 has 1 readings for 2 trackers"));
    let broken = |fixes: &mut Vec<Fix>| fixes[2].readings[0].range_m = Some(f64::NAN);
    assert!(refused(&broken).contains("fix 3: a cannot read the range NaN"));
}
