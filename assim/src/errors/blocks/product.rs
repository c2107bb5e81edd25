//! The covariance times a vector, without the matrix.

use super::solution::{augmented, of_blocks};
use super::{BlockErrors, Frame};
use isobar_model::vector::axpy;

impl BlockErrors {
    /// (blkdiag(C) + Φ Φᵀ) h for an h over (x, c). It costs as much as the factors, (m + p) r, and the blocks that h touches.
    pub(super) fn product(&self, h: &[f64]) -> Vec<f64> {
        let Frame { blocks, local, shared, layout, .. } = &*self.frame;
        let (covariance, factors, m) = (&self.memory.covariance, self.factors(), layout.len());
        // h of the block variables where it is not zero.
        let of_blocks: Vec<(usize, f64)> = of_blocks(h, m, local).enumerate().filter(|entry| entry.1 != 0.0).collect();
        let amplitudes: Vec<f64> = (0..factors.columns())
            .map(|j| {
                let seen = of_blocks.iter().map(|&(variable, weight)| weight * factors.value(variable, j)).sum::<f64>();
                let of_shared = factors.shared.col_as_slice(j);
                seen + shared.iter().zip(of_shared).map(|(&number, value)| h[m + number] * value).sum::<f64>()
            })
            .collect();
        let mut image = vec![0.0; blocks.variables()];
        factors.multiply_add(&amplitudes, &mut image);
        for &(variable, weight) in &of_blocks {
            // A patch holds the blocks that observations have linked, the variable's own among them.
            let linked = covariance.linked.iter().find(|it| it.variables.binary_search(&variable).is_ok());
            let (members, own) = match linked {
                Some(patch) => (patch.variables.as_slice(), patch.covariance.as_ref()),
                None => {
                    let block = blocks.place(variable).0;
                    (blocks.members(block), covariance.own.block(blocks, block))
                }
            };
            let column = members.binary_search(&variable).expect("a variable is in its block");
            members.iter().enumerate().for_each(|(i, &member)| image[member] += weight * own[(i, column)]);
        }
        let mut of_shared = vec![0.0; shared.len()];
        (0..factors.columns()).for_each(|j| axpy(amplitudes[j], factors.shared.col_as_slice(j), &mut of_shared));
        augmented(&image, &of_shared, local, shared)
    }
}
