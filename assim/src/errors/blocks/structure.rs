//! The filter's parts and leading common factors, for viewers.

use super::{BlockErrors, Frame};
use crate::augmented::Augmented;
use crate::block_angular;
use crate::filter::ErrorBlocks;
use crate::linalg::{eigen, product};
use crate::structure::{CommonFactor, Structure};
use crate::ties::first_largest;
use faer::Mat;
use isobar_model::Increment;
use isobar_obs::ObservationWindow;

impl ErrorBlocks for BlockErrors {
    fn structure(&self, s: &Augmented, observed: &ObservationWindow, factors: usize) -> Structure {
        let blocks = &self.frame.blocks;
        let rows = observed.operator.linearize(&s.state, &s.bias).state;
        let components = block_angular::components(blocks.count(), &blocks.touched(&rows));
        let mut part = vec![usize::MAX; blocks.count()];
        for (number, component) in components.iter().enumerate() {
            component.blocks.iter().for_each(|&block| part[block] = number);
        }
        // Blocks that no observation touches are parts of their own.
        let mut observed = vec![true; components.len()];
        for part in part.iter_mut().filter(|part| **part == usize::MAX) {
            *part = observed.len();
            observed.push(false);
        }
        let cells = self.frame.layout.grid.cells();
        let part_of_cell = (0..cells).map(|cell| part[blocks.place(cell).0]).collect();
        Structure { part_of_cell, observed, factors: self.leading_factors(factors, s.bias.len()) }
    }
}

impl BlockErrors {
    /// The leading principal directions of Φ in the norm of the compression, Φ V with V from S⁻¹ Φ_b = U Σ Vᵀ: they are
    /// orthogonal in that norm, and all of them together have the same Φ Φᵀ.
    fn leading_factors(&self, count: usize, parameters: usize) -> Vec<CommonFactor> {
        let Frame { blocks, layout, scales, local, shared, .. } = &*self.frame;
        let factors = self.factors();
        let (b, m, r) = (blocks.variables(), layout.len(), factors.columns());
        let count = count.min(r);
        if count == 0 {
            return Vec::new();
        }
        let mut gram = Mat::zeros(r, r);
        factors.scaled_gram(None, scales, gram.as_mut());
        let (energies, vectors) = eigen(gram.as_ref());
        // In descending order.
        let rotation = Mat::from_fn(r, count, |i, j| vectors[(i, r - 1 - j)]);
        let on_shared = product(factors.shared.as_ref(), rotation.as_ref());
        let (variances, _) = self.memory.covariance.variances(blocks);
        let total: f64 = variances.iter().zip(scales).map(|(variance, scale)| variance / (scale * scale)).sum();
        let factor = |j: usize| {
            let mut values = vec![0.0; b];
            factors.multiply_add(rotation.col_as_slice(j), &mut values);
            // A direction has no sign of its own: the largest value is positive.
            let scaled = values.iter().zip(scales).map(|(value, scale)| value.abs() / scale);
            let sign = if first_largest(scaled).is_some_and(|largest| values[largest] < 0.0) { -1.0 } else { 1.0 };
            values.iter_mut().for_each(|value| *value *= sign);
            let mut calibration = vec![0.0; parameters];
            local.iter().zip(&values[m..]).for_each(|(&number, value)| calibration[number] = *value);
            shared.iter().enumerate().for_each(|(i, &number)| calibration[number] = sign * on_shared[(i, j)]);
            values.truncate(m);
            let increment = Increment::from_values(layout, values);
            CommonFactor { increment, calibration, share: if total > 0.0 { energies[r - 1 - j] / total } else { 0.0 } }
        };
        (0..count).map(factor).collect()
    }
}
