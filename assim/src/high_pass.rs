//! Lange's High-pass Filter: the calibration from a batch of observations with no prior, neither of it nor of the state.
//!
//! The observations of every cycle are sorted into boxes of the plane. In box k the state is the background plus an
//! unknown correction of each observed variable, of which nothing is assumed, and what the correction, being constant over
//! the box, leaves over:
//!
//! ```text
//! y_k − h(x_b) = X_k b_k + G_k c + e_k,     Cov(e_k) = V_k = R_k + s B_kk
//! ```
//!
//! Each b_k, however large, is eliminated: what remains of the observations are their differences within a box (they have
//! passed a high-pass filter), and from these comes ĉ (WO 97/18442, eq. (10) and text; Lange 1988). A grid has far more
//! values than the observations of some cycles see, so that a correction of every value could not be determined; boxes
//! that nothing observes have none, and none is needed for c. B_kk is the background's covariance as the
//! reports see it, H B Hᵀ: within a box it acts as ordinary kriging does, and it is not a prior of the mean.
//!
//! What is neglected is the correlation of these remainders between boxes and between cycles. It makes the claimed
//! standard deviations too small, by an eighth in a test where a field moves on by a third of its correlation length in a
//! cycle, and by 4 % there with a scale s of 2.
//!
//! Boxes must hold several observations each to say anything, and be smaller than the state's errors are wide. What is
//! determined only against a prior stays undetermined, and is named: without a reference sonde the mean height and a bias
//! that all share.

use crate::block_angular::{Block, BorderRows, RegressionRows};
use crate::covariance::Covariance;
use crate::error::Error;
use faer::Mat;
use isobar_model::State;
use isobar_obs::{Calibration, ObservationWindow};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Weights up to which H B Hᵀ is formed exactly.
const MOST_WEIGHTS: usize = 8;

/// How a batch of cycles is used for the first calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HighPassSettings {
    /// Cycles before the first analysis: those whose observations calibrate, and the one that is analysed first.
    pub cycles: usize,
    /// Width of a box \[m\].
    pub box_m: f64,
    /// Factor s on the covariance of what a box's correction leaves over.
    pub covariance_scale: f64,
}

/// The filter, in the course of a batch.
#[derive(Clone)]
pub struct HighPassFilter {
    calibration: Calibration,
    background_error: Arc<dyn Covariance>,
    settings: HighPassSettings,
    rows: BorderRows,
}

/// What a batch came to.
#[derive(Clone, Debug)]
pub struct HighPassSolution {
    /// ĉ in the order of the calibration; zero, the prior mean, in what is not determined.
    pub estimate: Vec<f64>,
    /// Its covariance; in what is not determined that of the parameters' priors.
    pub covariance: Mat<f64>,
    /// What is not determined: combinations of parameters by coefficient and name, the largest coefficient 1.
    pub undetermined: Vec<Vec<(f64, String)>>,
}

impl HighPassFilter {
    /// A filter that has seen nothing.
    pub fn new(calibration: Calibration, background_error: Arc<dyn Covariance>, settings: HighPassSettings) -> Self {
        let rows = BorderRows::new(calibration.len());
        Self { calibration, background_error, settings, rows }
    }

    /// Takes in the observations of a cycle, as seen from a background that has seen none of them.
    ///
    /// # Errors
    /// A departure that is not finite; a V_k that is not positive definite.
    pub fn observe(&mut self, observed: &ObservationWindow, background: &State) -> Result<(), Error> {
        let zero = vec![0.0; self.calibration.len()];
        let jacobian = observed.operator.linearize(background, &zero);
        let simulated = observed.operator.simulate(background, &zero);
        let layout = background.layout();
        let (grid, cells) = (&layout.grid, layout.grid.cells());
        for (row, report) in observed.reports.iter().enumerate() {
            let departure = observed.values[row] - simulated[row];
            if !departure.is_finite() {
                return Err(Error::NotFinite {
                    what: format!("the innovation of {}/{}", report.network, report.platform),
                });
            }
        }
        let boxes = self.boxes(observed);
        let block = |rows: &Vec<usize>| {
            // How much a correction of 1 of its variable changes an observation: 1, but beside a wall.
            let weight = |row: usize| {
                let variable = observed.reports[row].variable;
                let of_variable = jacobian.state.row(row).iter().filter(|entry| entry.0 / cells == variable);
                of_variable.map(|entry| entry.1).sum::<f64>()
            };
            let mut variables: Vec<usize> = rows.iter().map(|&row| observed.reports[row].variable).collect();
            variables.sort_unstable();
            variables.dedup();
            variables.retain(|&variable| {
                rows.iter().any(|&row| observed.reports[row].variable == variable && weight(row).abs() > 1e-6)
            });
            // Where a report reads the state: its own weights, or for a wide footprint the cell in its middle.
            let reads = |row: usize| -> Vec<(usize, f64)> {
                let (entries, report) = (jacobian.state.row(row), &observed.reports[row]);
                if entries.len() <= MOST_WEIGHTS {
                    entries.to_vec()
                } else {
                    vec![(report.variable * cells + grid.cell_at(report.x_m, report.y_m), 1.0)]
                }
            };
            let reads: Vec<Vec<(usize, f64)>> = rows.iter().map(|&row| reads(row)).collect();
            let between = |i: usize, j: usize| {
                let pairs = reads[i].iter().flat_map(|a| reads[j].iter().map(move |b| (a, b)));
                pairs.map(|(a, b)| a.1 * b.1 * self.background_error.covariance(a.0, b.0)).sum::<f64>()
            };
            let n = rows.len();
            let g = Mat::from_fn(n, self.calibration.len(), |i, j| {
                let entries = jacobian.calibration.row(rows[i]).iter().filter(|entry| entry.0 == j);
                entries.map(|entry| entry.1).sum()
            });
            let v = Mat::from_fn(n, n, |i, j| {
                let random = if i == j { observed.sigma[rows[i]].powi(2) } else { 0.0 };
                random + self.settings.covariance_scale * between(i.min(j), i.max(j))
            });
            let x = Mat::from_fn(n, variables.len(), |i, j| {
                if observed.reports[rows[i]].variable == variables[j] { weight(rows[i]) } else { 0.0 }
            });
            let y = rows.iter().map(|&row| observed.values[row] - simulated[row]).collect();
            Block::Regression(RegressionRows { x, g, y, v })
        };
        let blocks: Vec<Block> = boxes.values().map(block).collect();
        self.rows.add(&blocks)
    }

    /// The numbers of the observations in each box.
    fn boxes(&self, observed: &ObservationWindow) -> BTreeMap<(usize, usize), Vec<usize>> {
        let number = |place_m: f64| (place_m / self.settings.box_m) as usize;
        let mut boxes: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
        for (row, report) in observed.reports.iter().enumerate() {
            boxes.entry((number(report.y_m), number(report.x_m))).or_default().push(row);
        }
        boxes
    }

    /// How many numbers the observations of a cycle take: V and G of all boxes, twice while they are eliminated, and what is
    /// known of the biases.
    pub(crate) fn numbers(&self, observed: &ObservationWindow) -> f64 {
        numbers(self.boxes(observed).values().map(Vec::len), self.calibration.len())
    }

    /// The calibration as far as the batch determines it.
    pub fn solve(&self) -> HighPassSolution {
        let parameters = &self.calibration.parameters;
        let scales: Vec<f64> = parameters.iter().map(|parameter| parameter.sigma_prior).collect();
        let border = self.rows.solve(&scales);
        let named = |combination: &Vec<f64>| {
            let terms = combination.iter().zip(parameters).filter(|(coefficient, _)| **coefficient != 0.0);
            terms.map(|(&coefficient, parameter)| (coefficient, parameter.name.clone())).collect()
        };
        HighPassSolution {
            undetermined: border.undetermined.iter().map(named).collect(),
            estimate: border.estimate,
            covariance: border.covariance,
        }
    }

    /// What it carries from cycle to cycle.
    pub(crate) fn triangle(&self) -> &Mat<f64> {
        self.rows.triangle()
    }

    /// Takes back what [`HighPassFilter::triangle`] gave.
    pub(crate) fn restore(&mut self, triangle: Mat<f64>) {
        self.rows = BorderRows::from_triangle(triangle);
    }
}

/// The numbers held for boxes, given the observations in each and the number of biases.
pub(crate) fn numbers(boxes: impl Iterator<Item = usize>, parameters: usize) -> f64 {
    let p = parameters as f64;
    let of_boxes: f64 = boxes.map(|n| n as f64 * (n as f64 + p)).sum();
    2.0 * of_boxes + 3.0 * p * p
}

/// A combination of parameters in words: `europe/h/A + 0.5 polar/offset`.
pub fn in_words(combination: &[(f64, String)]) -> String {
    let mut words = String::new();
    for (number, (coefficient, name)) in combination.iter().enumerate() {
        words += match (number, *coefficient < 0.0) {
            (0, false) => "",
            (0, true) => "−",
            (_, false) => " + ",
            (_, true) => " − ",
        };
        let size = coefficient.abs();
        if (size - 1.0).abs() > 5e-3 {
            words += &format!("{size:.2} ");
        }
        words += name;
    }
    words
}
