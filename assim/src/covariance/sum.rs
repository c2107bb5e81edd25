//! The covariance of a sum of independent errors.

use super::{Covariance, Spectrum};

/// Σᵢ Uᵢ Uᵢᵀ, with the control vectors one after another.
pub struct Sum {
    len: usize,
    terms: Vec<Box<dyn Covariance>>,
}

impl Sum {
    /// The covariance of increments of `len` values with these independent terms; none at all is zero covariance.
    ///
    /// # Panics
    /// If a term has another length.
    pub fn new(len: usize, terms: Vec<Box<dyn Covariance>>) -> Self {
        assert!(terms.iter().all(|term| term.len() == len), "the terms of a covariance act on one space");
        Self { len, terms }
    }
}

impl Covariance for Sum {
    fn len(&self) -> usize {
        self.len
    }

    fn control_len(&self) -> usize {
        self.terms.iter().map(|term| term.control_len()).sum()
    }

    fn control_cells(&self) -> Option<Vec<usize>> {
        let parts: Option<Vec<Vec<usize>>> = self.terms.iter().map(|term| term.control_cells()).collect();
        parts.map(|parts| parts.concat())
    }

    fn spectrum(&self, scales: &[f64]) -> Option<Spectrum> {
        self.terms.iter().try_fold(Spectrum::default(), |sum, term| Some(sum.with(term.spectrum(scales)?)))
    }

    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        let mut rest = control;
        for term in &self.terms {
            let (own, others) = rest.split_at(term.control_len());
            term.root_add(own, increment);
            rest = others;
        }
    }

    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        let mut rest = control;
        for term in &self.terms {
            let (own, others) = rest.split_at_mut(term.control_len());
            term.root_transpose_add(increment, own);
            rest = others;
        }
    }

    fn multiply_add(&self, increment: &[f64], result: &mut [f64]) {
        self.terms.iter().for_each(|term| term.multiply_add(increment, result));
    }

    fn covariance(&self, first: usize, second: usize) -> f64 {
        self.terms.iter().map(|term| term.covariance(first, second)).sum()
    }
}
