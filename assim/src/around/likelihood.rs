//! Factors on covariances, and what the likelihood of innovations says of them so far.

use crate::error::Error;
use crate::estimated::EstimatedParameter;
use crate::linalg::{cholesky, column, inverse_from_cholesky, product};
use crate::memory::require;
use faer::Mat;
use serde::{Deserialize, Serialize};

/// The most that the logarithm of a factor changes in a cycle: a Newton step from afar may be far too long.
const LONGEST_STEP: f64 = 1.0;

/// A factor that keeps more than this part of its prior standard deviation, which is 1 in its logarithm, is not determined.
const DETERMINED: f64 = 0.5;

/// A correlation of two factors' errors above which they cannot be distinguished.
const INSEPARABLE: f64 = 0.95;

/// Logarithms θ of factors by name, with prior N(0, 1), and their information J. See [`Adaptive`](super::adaptive::Adaptive).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ErrorFactors {
    names: Vec<String>,
    /// θ.
    logarithms: Vec<f64>,
    /// J, row by row.
    information: Vec<Vec<f64>>,
}

impl ErrorFactors {
    /// The number of the factor of this name, which is added if it does not exist yet.
    pub fn number(&mut self, name: &str) -> usize {
        self.names.iter().position(|own| own == name).unwrap_or_else(|| {
            self.names.push(name.to_string());
            self.logarithms.push(0.0);
            self.information.iter_mut().for_each(|row| row.push(0.0));
            self.information.push(vec![0.0; self.names.len()]);
            self.names.len() - 1
        })
    }

    /// The factor.
    pub fn value(&self, number: usize) -> f64 {
        self.logarithms[number].exp()
    }

    /// A Newton step from the score and the information of a cycle on the factors `present`, with a memory of
    /// `memory_cycles`.
    pub fn update(&mut self, memory_cycles: usize, present: &[usize], score: &[f64], information: &[Vec<f64>]) {
        let forgotten = 1.0 / memory_cycles as f64;
        self.information.iter_mut().flatten().for_each(|entry| *entry *= 1.0 - forgotten);
        let mut gradient: Vec<f64> = self.logarithms.iter().map(|theta| -theta * forgotten).collect();
        for (row, &i) in present.iter().enumerate() {
            gradient[i] += score[row];
            present.iter().enumerate().for_each(|(column, &j)| self.information[i][j] += information[row][column]);
        }
        let step = product(self.covariance().as_ref(), column(&gradient).as_ref());
        for (theta, step) in self.logarithms.iter_mut().zip(step.col_as_slice(0)) {
            *theta += step.clamp(-LONGEST_STEP, LONGEST_STEP);
        }
    }

    /// Cov(θ) = (J + I)⁻¹. Should J not be positive, which only a gain that is not of the assumed covariances can make it,
    /// that of its diagonal.
    fn covariance(&self) -> Mat<f64> {
        let n = self.names.len();
        let with_prior = Mat::from_fn(n, n, |i, j| self.information[i][j] + if i == j { 1.0 } else { 0.0 });
        match cholesky(with_prior, String::new) {
            Ok(root) => inverse_from_cholesky(root.as_ref()),
            Err(_) => {
                Mat::from_fn(n, n, |i, j| if i == j { 1.0 / (1.0 + self.information[i][i].max(0.0)) } else { 0.0 })
            }
        }
    }

    /// The factors with their claimed σ, and whether they are determined.
    pub fn parameters(&self) -> Vec<EstimatedParameter> {
        let covariance = self.covariance();
        let sigma: Vec<f64> = (0..self.names.len()).map(|i| covariance[(i, i)].sqrt()).collect();
        let verdict = |i: usize| {
            let correlation = |&j: &usize| (covariance[(i, j)] / (sigma[i] * sigma[j])).abs();
            let others = (0..self.names.len()).filter(|&j| j != i);
            let nearest = others.max_by(|a, b| correlation(a).total_cmp(&correlation(b)));
            match nearest.filter(|j| correlation(j) > INSEPARABLE) {
                Some(j) => format!("not determined: cannot be told from {}", self.names[j]),
                None if sigma[i] > DETERMINED => "not determined: the innovations say too little of it".to_string(),
                None => "determined".to_string(),
            }
        };
        (0..self.names.len())
            .map(|i| EstimatedParameter {
                name: format!("adapt/{}", self.names[i]),
                unit: "1".into(),
                value: self.value(i),
                sigma: Some(self.value(i) * sigma[i]),
                verdict: verdict(i),
            })
            .collect()
    }

    /// Fails unless they are whole, and the first of them has the name that it must have.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn require(&self, first: Option<&str>) -> Result<(), Error> {
        let n = self.names.len();
        let is_square = self.information.len() == n && self.information.iter().all(|row| row.len() == n);
        let is_finite = self.logarithms.iter().chain(self.information.iter().flatten()).all(|it| it.is_finite());
        let begins = first.is_none_or(|first| self.names.first().is_some_and(|own| own == first));
        require(self.logarithms.len() == n && is_square && is_finite && begins, "the factors on the errors")
    }
}
