//! The increment δx: a difference of two states, an element of a vector space.

use crate::state::{Layout, Values, field};
use crate::vector;
use ndarray::ArrayView2;
use serde::{Deserialize, Serialize};
use std::ops::{AddAssign, MulAssign};
use std::sync::Arc;

/// A difference of states, `[variable, y, x]`. A column of a covariance factor *is* the values of an increment.
///
/// It is serialised with its layout, as a [`State`](crate::State) is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Values")]
pub struct Increment {
    layout: Arc<Layout>,
    values: Vec<f64>,
}

impl TryFrom<Values> for Increment {
    type Error = String;
    fn try_from(values: Values) -> Result<Self, String> {
        let (layout, values) = values.checked()?;
        Ok(Self { layout, values })
    }
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
        vector::dot(&self.values, &other.values)
    }
}

impl AddAssign<&Increment> for Increment {
    fn add_assign(&mut self, other: &Increment) {
        vector::add(&mut self.values, &other.values);
    }
}

impl MulAssign<f64> for Increment {
    fn mul_assign(&mut self, factor: f64) {
        vector::scale(&mut self.values, factor);
    }
}
