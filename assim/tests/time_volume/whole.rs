//! All cycles of a moving time volume as one dense least-squares problem.

use crate::common::{WINDOW, accuracy, column};
use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use isobar_assim::time_volume::{AmplitudeEvolution, Factor, Target, TimeShape, TimeVolume};
use isobar_assim::{Problem, Unknown};
use isobar_model::Time;
use isobar_obs::ObservationWindow;

/// Entries, right-hand side and standard deviation of a row.
type Row = (Vec<(usize, f64)>, f64, f64);

/// Rows of a weighted least-squares problem.
pub struct Dense {
    pub unknowns: usize,
    rows: Vec<Row>,
}

impl Dense {
    fn row(&mut self, entries: Vec<(usize, f64)>, right: f64, sigma: f64) {
        self.rows.push((entries, right, sigma));
    }

    /// Estimate and covariance.
    pub fn solve(&self) -> (Mat<f64>, Mat<f64>) {
        let (mut matrix, mut right) = (Mat::<f64>::zeros(self.unknowns, self.unknowns), Mat::zeros(self.unknowns, 1));
        for (entries, value, sigma) in &self.rows {
            for &(i, a) in entries {
                right[(i, 0)] += a * value / (sigma * sigma);
                entries.iter().for_each(|&(j, b)| matrix[(i, j)] += a * b / (sigma * sigma));
            }
        }
        let llt = matrix.llt(Side::Lower).unwrap();
        (llt.solve(&right), llt.inverse())
    }
}

/// The propagator of a cycle, column by column.
fn propagator(problem: &Problem) -> Vec<f64> {
    let m = problem.background.values().len();
    let mut columns = vec![0.0; m * m];
    columns.iter_mut().step_by(m + 1).for_each(|diagonal| *diagonal = 1.0);
    problem.model.step_tl(&problem.background, &mut columns);
    columns
}

/// All cycles of `factors` as one dense problem, with the standard deviations of `common::problem`. The unknowns are the
/// states 0 … T, the parameters, the constant amplitudes, and for each evolving one its values 0 … T.
pub struct Whole {
    pub dense: Dense,
    pub m: usize,
    p: usize,
    cycles: usize,
    constant: Vec<(usize, usize)>,
    evolving: Vec<(usize, usize)>,
}

impl Whole {
    pub fn new(problem: &Problem, factors: &[Factor], windows: &[ObservationWindow]) -> Self {
        let (m, p, cycles) = (problem.background.values().len(), problem.calibration.len(), windows.len());
        let (mut constant, mut evolving) = (Vec::new(), Vec::new());
        for (number, factor) in factors.iter().enumerate() {
            let functions = match factor.shape {
                TimeShape::Sinusoid { .. } => 2,
                TimeShape::Hats { count, .. } => count,
                _ => 1,
            };
            let kind = match factor.evolution {
                AmplitudeEvolution::Constant { .. } => &mut constant,
                _ => &mut evolving,
            };
            kind.extend((0..functions).map(|function| (number, function)));
        }
        let unknowns = m * (cycles + 1) + p + constant.len() + evolving.len() * (cycles + 1);
        let dense = Dense { unknowns, rows: Vec::new() };
        let mut whole = Self { dense, m, p, cycles, constant, evolving };
        whole.fill(problem, factors, windows);
        whole
    }

    pub fn state(&self, time: usize, i: usize) -> usize {
        time * self.m + i
    }

    pub fn parameter(&self, number: usize) -> usize {
        self.m * (self.cycles + 1) + number
    }

    pub fn amplitude(&self, k: usize) -> usize {
        self.parameter(self.p) + k
    }

    pub fn evolving(&self, k: usize, time: usize) -> usize {
        self.amplitude(self.constant.len()) + k * (self.cycles + 1) + time
    }

    /// The unknowns of all amplitudes at a time with their factors and functions.
    fn amplitudes(&self, time: usize) -> Vec<(usize, usize, usize)> {
        let constant = self.constant.iter().enumerate().map(|(k, it)| (self.amplitude(k), it.0, it.1));
        let evolving = self.evolving.iter().enumerate().map(|(k, it)| (self.evolving(k, time), it.0, it.1));
        constant.chain(evolving).collect()
    }

    fn fill(&mut self, problem: &Problem, factors: &[Factor], windows: &[ObservationWindow]) {
        let a = propagator(problem);
        let (m, p) = (self.m, self.p);
        let cells = problem.background.layout().grid.cells();
        (0..m).for_each(|i| self.dense.row(vec![(self.state(0, i), 1.0)], problem.background.values()[i], 1.5));
        for number in 0..p {
            let sigma = problem.calibration.parameters[number].sigma_prior;
            self.dense.row(vec![(self.parameter(number), 1.0)], 0.0, sigma);
        }
        for (k, &(number, _)) in self.constant.clone().iter().enumerate() {
            if let AmplitudeEvolution::Constant { sigma_prior: Some(sigma) } = factors[number].evolution {
                self.dense.row(vec![(self.amplitude(k), 1.0)], 0.0, sigma);
            }
        }
        let days = WINDOW.days();
        for (k, &(number, _)) in self.evolving.clone().iter().enumerate() {
            let (start, phi, added) = match factors[number].evolution {
                AmplitudeEvolution::RandomWalk { sigma_prior, sigma_per_sqrt_day } => {
                    (sigma_prior, 1.0, sigma_per_sqrt_day * days.sqrt())
                }
                AmplitudeEvolution::FirstOrder { sigma, correlation_time } => {
                    let phi = (-WINDOW.as_f64() / correlation_time.as_f64()).exp();
                    (sigma, phi, sigma * (1.0 - phi * phi).sqrt())
                }
                AmplitudeEvolution::Constant { .. } => unreachable!(),
            };
            self.dense.row(vec![(self.evolving(k, 0), 1.0)], 0.0, start);
            for time in 0..self.cycles {
                self.dense.row(vec![(self.evolving(k, time + 1), 1.0), (self.evolving(k, time), -phi)], 0.0, added);
            }
        }
        for (time, observed) in windows.iter().enumerate() {
            for i in 0..m {
                let mut entries = vec![(self.state(time + 1, i), 1.0)];
                entries.extend((0..m).map(|j| (self.state(time, j), -a[j * m + i])));
                for (unknown, number, function) in self.amplitudes(time) {
                    if factors[number].target == Target::Forecast(i / cells) {
                        // One pattern, or the same everywhere.
                        let place = factors[number].patterns.first().map_or(1.0, |pattern| pattern[i % cells]);
                        entries.push((unknown, -place * factors[number].shape.value(function, observed.time)));
                    }
                }
                self.dense.row(entries, 0.0, 0.4);
            }
            let jacobian = observed.operator.linearize(&problem.background, &vec![0.0; p]);
            for row in 0..observed.len() {
                let of_state = jacobian.state.row(row).iter().map(|&(i, value)| (self.state(time + 1, i), value));
                let of_bias = jacobian.calibration.row(row).iter().map(|&(i, value)| (self.parameter(i), value));
                let mut entries: Vec<(usize, f64)> = of_state.chain(of_bias).collect();
                for (unknown, number, function) in self.amplitudes(time + 1) {
                    if let Target::Observations(numbers) = &factors[number].target {
                        let own = jacobian.calibration.row(row).iter().filter(|entry| numbers.contains(&entry.0));
                        let weight: f64 = own.map(|entry| entry.1).sum();
                        entries.push((unknown, weight * factors[number].shape.value(function, observed.time)));
                    }
                }
                self.dense.row(entries, observed.values[row], observed.sigma[row]);
            }
        }
    }
}

impl Whole {
    /// Every column of the covariance of the last state and the parameters as they are now, and what is said of the
    /// parameters and the state's means, against the dense matrix.
    pub fn compare_covariances(
        &self,
        volume: &TimeVolume,
        covariance: &Mat<f64>,
        factors: &[Factor],
        now: Time,
        name: &str,
    ) {
        let (m, p) = (self.m, self.p);
        let mut weights = Mat::<f64>::zeros(m + p, self.dense.unknowns);
        (0..m).for_each(|i| weights[(i, self.state(self.cycles, i))] = 1.0);
        for number in 0..p {
            weights[(m + number, self.parameter(number))] = 1.0;
            for (unknown, factor, function) in self.amplitudes(self.cycles) {
                if matches!(&factors[factor].target, Target::Observations(numbers) if numbers.contains(&number)) {
                    weights[(m + number, unknown)] = factors[factor].shape.value(function, now);
                }
            }
        }
        let dense = &weights * covariance * weights.transpose();
        let sigma = |i: usize| dense[(i, i)].sqrt();
        let unknown = |i: usize| if i < m { Unknown::Value(i) } else { Unknown::Parameter(i - m) };
        for j in 0..m + p {
            let column = column(volume, unknown(j)).unwrap();
            assert_eq!((column.state.len(), column.calibration.len()), (m, p));
            for i in 0..m + p {
                let off = (column.with(unknown(i)) - dense[(i, j)]).abs() / (sigma(i) * sigma(j));
                assert!(off < 1e-8, "{name}: covariance of {i} with {j}: off by {off} in units of correlation");
            }
        }
        assert!(column(volume, Unknown::Parameter(p)).is_none(), "an amplitude is no parameter");
        // Two variables.
        let cells = m / 2;
        let accuracy = accuracy(volume).unwrap();
        let close = |value: f64, expected: f64, scale: f64| (value - expected).abs() < 1e-8 * scale;
        for j in 0..p {
            for i in 0..p {
                let (value, expected) = (accuracy.covariance()[(i, j)], dense[(m + i, m + j)]);
                assert!(close(value, expected, sigma(m + i) * sigma(m + j)), "{name}: {value} and not {expected}");
            }
        }
        let means: Vec<_> = accuracy.of_means().collect();
        assert_eq!(means.len(), m / cells);
        for (variable, (with, variance)) in means.into_iter().enumerate() {
            let range = variable * cells..(variable + 1) * cells;
            let mean = |j: usize| range.clone().map(|i| dense[(i, j)]).sum::<f64>() / cells as f64;
            let expected = range.clone().map(mean).sum::<f64>() / cells as f64;
            assert!(close(variance, expected, expected), "{name}: variance {variance} of a mean and not {expected}");
            for (number, &value) in with.iter().enumerate() {
                let scale = expected.sqrt() * sigma(m + number);
                assert!(close(value, mean(m + number), scale), "{name}: a mean with a parameter: {value}");
            }
        }
    }
}
