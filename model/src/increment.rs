//! The increment δx: a difference of two states, an element of a vector space.

use crate::state::{Layout, field};
use ndarray::ArrayView2;
use std::ops::{AddAssign, MulAssign};
use std::sync::Arc;

/// A difference of states, `[variable, y, x]`. A column of a covariance factor *is* the values of an increment.
#[derive(Clone, Debug, PartialEq)]
pub struct Increment {
    layout: Arc<Layout>,
    values: Vec<f64>,
}

impl Increment {
    /// The increment that changes nothing.
    pub fn zeros(layout: &Arc<Layout>) -> Self {
        Self::from_values(layout, vec![0.0; layout.len()])
    }

    /// An increment of the given values, `[variable, y, x]`.
    ///
    /// # Panics
    /// If the number of values is not that of the layout.
    pub fn from_values(layout: &Arc<Layout>, values: Vec<f64>) -> Self {
        assert_eq!(values.len(), layout.len(), "an increment needs one value per variable and cell");
        Self { layout: Arc::clone(layout), values }
    }

    /// The meaning of the values.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// All values, `[variable, y, x]`.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// All values, `[variable, y, x]`.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// The field of one variable, `[y, x]`.
    pub fn field(&self, variable: usize) -> ArrayView2<'_, f64> {
        field(&self.layout, &self.values, variable)
    }

    /// Euclidean inner product.
    pub fn dot(&self, other: &Increment) -> f64 {
        self.values.iter().zip(&other.values).map(|(a, b)| a * b).sum()
    }
}

impl AddAssign<&Increment> for Increment {
    fn add_assign(&mut self, other: &Increment) {
        assert_eq!(self.values.len(), other.values.len(), "the increments have different layouts");
        for (value, other) in self.values.iter_mut().zip(&other.values) {
            *value += other;
        }
    }
}

impl MulAssign<f64> for Increment {
    fn mul_assign(&mut self, factor: f64) {
        self.values.iter_mut().for_each(|value| *value *= factor);
    }
}
