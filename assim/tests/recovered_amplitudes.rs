//! Amplitudes of known functions of time and place, recovered from observations of a truth that is known.

use crate::common::{DAY, WINDOW, calibration, constant, factor, parameters, problem, volume_settings, window};
use isobar_assim::time_volume::{Factor, Target, TimeShape, TimeVolume};
use isobar_assim::{Assimilator, Problem};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Location, State, Time};
use isobar_obs::{ObservationWindow, Report};

/// Twelve cycles of observations of a truth that is drawn from the covariances of the problem. Those with the first bias
/// have also what `further` says for a report, a time and amplitudes drawn from N(0, 1), by the same coefficient.
struct World {
    problem: Problem,
    amplitudes: Vec<f64>,
    windows: Vec<ObservationWindow>,
}

impl World {
    fn new(name: &str, seed: u64, amplitudes: usize, further: impl Fn(&Report, Time, &[f64]) -> f64) -> Self {
        let problem = problem(true, calibration(2, 0, 0.0), 7);
        let layout = problem.background.layout().clone();
        let (m, p) = (layout.len(), 2);
        let random = &mut stream(seed, name);
        let normal = |random: &mut _, n: usize| standard_normals(random, n);
        let mut truth: Vec<f64> = normal(random, m).iter().map(|it| 1.5 * it).collect();
        let bias: Vec<f64> =
            normal(random, p).iter().zip(&problem.calibration.parameters).map(|(n, it)| n * it.sigma_prior).collect();
        let amplitudes = normal(random, amplitudes);
        let mut windows = Vec::new();
        for cycle in 1..=12 {
            let mut state = State::from_values(&layout, truth);
            problem.model.step(&mut state);
            truth = state.values().to_vec();
            truth.iter_mut().zip(normal(random, m)).for_each(|(value, error)| *value += 0.4 * error);
            let mut observed = window(&problem, 24, false, cycle, 1000 + seed);
            let state = State::from_values(&layout, truth.clone());
            let jacobian = observed.operator.linearize(&state, &bias);
            for (row, report) in observed.reports.iter_mut().enumerate() {
                let cell = jacobian.state.row(row)[0].0 % layout.grid.cells();
                let (grid, center) = (&layout.grid, Location::Center);
                (report.x_m, report.y_m) = (grid.x_m(center, cell % grid.nx), grid.y_m(center, cell / grid.nx));
            }
            let errors = normal(random, observed.len());
            let mut values = observed.operator.simulate(&state, &bias);
            for (row, value) in values.iter_mut().enumerate() {
                let own = jacobian.calibration.row(row).iter().filter(|entry| entry.0 == 0).map(|entry| entry.1);
                let further = further(&observed.reports[row], observed.time, &amplitudes);
                *value += own.sum::<f64>() * further + observed.sigma[row] * errors[row];
            }
            observed.values = values;
            windows.push(observed);
        }
        Self { problem, amplitudes, windows }
    }

    /// What a time volume with a factor makes of it: (C − truth)/σ of each amplitude, and χ²/n over all cycles.
    fn scores(&self, factor: Factor) -> (Vec<f64>, f64) {
        let mut volume = TimeVolume::new(self.problem.clone(), volume_settings(12, vec![factor]), None).unwrap();
        let chi2 = |observed: &ObservationWindow| {
            let from_volume = volume.forecast(WINDOW).unwrap();
            volume.analyse(&from_volume, observed).unwrap().innovation_chi2.unwrap()
        };
        let sum: f64 = self.windows.iter().map(chi2).sum();
        let count: usize = self.windows.iter().map(ObservationWindow::len).sum();
        let found = parameters(&volume);
        let scores = found.iter().zip(&self.amplitudes).map(|(it, truth)| (it.value - truth) / it.sigma.unwrap());
        (scores.collect(), sum / count as f64)
    }
}

/// At most one in a hundred beyond three standard deviations, and the mean square 1 within five of its standard errors.
fn assert_normal(scores: &[f64]) {
    let beyond = scores.iter().filter(|z| z.abs() > 3.0).count();
    assert!(beyond * 100 <= scores.len(), "{beyond} of {}", scores.len());
    let (count, square) = (scores.len() as f64, scores.iter().map(|z| z * z).sum::<f64>());
    assert!((square / count - 1.0).abs() < 5.0 * (2.0 / count).sqrt(), "{}", square / count);
}

#[test]
fn a_diurnal_bias_is_recovered_within_what_is_claimed() {
    let shape = TimeShape::Sinusoid { period: DAY };
    let diurnal = |seed| {
        let further = |_: &Report, time, own: &[f64]| (0..2).map(|f| own[f] * shape.value(f, time)).sum::<f64>();
        let factor = factor("diurnal", Target::Observations(vec![0]), shape, constant(None));
        World::new("diurnal", seed, 2, further).scores(factor).0
    };
    assert_normal(&(0..200).flat_map(diurnal).collect::<Vec<f64>>());
}

/// A bias that the sensors of a network have in common, but each as much as a pattern says at its place: the amplitudes of
/// two patterns, of which the mean over the domain is zero, are recovered; an amplitude that is the same everywhere leaves
/// the misfit where it was.
#[test]
fn amplitudes_of_patterns_are_recovered_and_a_constant_is_no_substitute() {
    let layout = crate::common::layout();
    let (nx, cells) = (layout.grid.nx, layout.grid.cells());
    let wave = |i: usize, number: usize| {
        let phase = std::f64::consts::TAU * ((i % nx) as f64 + 0.5) / nx as f64;
        4.0 * if number == 0 { phase.cos() } else { phase.sin() }
    };
    let patterns: Vec<Vec<f64>> = (0..2).map(|number| (0..cells).map(|i| wave(i, number)).collect()).collect();
    let of_pattern = |report: &Report, pattern: &[f64]| -> f64 {
        let stencil = layout.grid.stencil(Location::Center, report.x_m, report.y_m).unwrap();
        stencil.entries.iter().map(|&(index, weight)| weight * pattern[index]).sum()
    };
    let (mut scores, mut with, mut without) = (Vec::new(), 0.0, 0.0);
    for seed in 0..200 {
        let further = |report: &Report, _: Time, own: &[f64]| {
            own.iter().zip(&patterns).map(|(amplitude, pattern)| amplitude * of_pattern(report, pattern)).sum()
        };
        let world = World::new("patterns", seed, 2, further);
        let target = || Target::Observations(vec![0]);
        let same = factor("eof", target(), TimeShape::Constant, constant(Some(4.0)));
        let (own, chi2) = world.scores(Factor { patterns: patterns.clone(), ..same.clone() });
        assert_eq!(own.len(), 2);
        scores.extend(own);
        with += chi2 / 200.0;
        without += world.scores(same).1 / 200.0;
    }
    assert_normal(&scores);
    // 200 runs of 288 observations: the mean of χ²/n has a standard error of 0.006.
    println!("χ²/n {with:.3} with the patterns, {without:.3} with a constant");
    assert!((with - 1.0).abs() < 0.03, "χ²/n {with} with the patterns");
    assert!(without > 1.3, "χ²/n {without} with a constant");
}
