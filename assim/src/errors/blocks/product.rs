//! The covariance times a vector, without the matrix.

use super::solution::{augmented, of_blocks};
use super::{BlockErrors, Frame};
use faer::MatRef;
use isobar_model::vector::{add, axpy, dot};

impl BlockErrors {
    /// (blkdiag(C) + Φ Φᵀ) h for an h over (x, c). It costs as much as the factors, (m + p) r, and the blocks that h touches.
    pub(super) fn product(&self, h: &[f64]) -> Vec<f64> {
        let Frame { blocks, local, shared, layout, .. } = &*self.frame;
        let (factors, m) = (self.factors(), layout.len());
        // h of the block variables where it is not zero.
        let of_blocks: Vec<(usize, f64)> = of_blocks(h, m, local).enumerate().filter(|entry| entry.1 != 0.0).collect();
        let has_parameters = factors.has_parameters();
        let mut amplitudes: Vec<f64> = (0..factors.columns())
            .map(|j| {
                let seen = of_blocks.iter().map(|&(variable, weight)| weight * factors.value(variable, j)).sum::<f64>();
                let of_shared = shared.iter().zip(factors.shared.col_as_slice(j)).filter(|_| has_parameters);
                seen + of_shared.map(|(&number, value)| h[m + number] * value).sum::<f64>()
            })
            .collect();
        factors.sum(&mut amplitudes);
        let mut image = vec![0.0; blocks.variables()];
        factors.multiply_add(&amplitudes, &mut image);
        let mut through_blocks = vec![0.0; image.len()];
        for &(variable, weight) in &of_blocks {
            let Some((members, own)) = self.part_of(variable) else { continue };
            let column = members.binary_search(&variable).expect("a variable is in its block");
            members.iter().enumerate().for_each(|(i, &member)| through_blocks[member] += weight * own[(i, column)]);
        }
        factors.sum(&mut through_blocks);
        add(&mut image, &through_blocks);
        let mut of_shared = vec![0.0; shared.len()];
        (0..factors.columns()).for_each(|j| axpy(amplitudes[j], factors.shared.col_as_slice(j), &mut of_shared));
        augmented(&image, &of_shared, local, shared)
    }

    /// aᵀ (blkdiag(C) + Φ Φᵀ) b for few entries (number in (x, c), value). It reads only the rows of Φ and the blocks that they
    /// touch, and needs nothing as long as the state.
    pub(super) fn bilinear(&self, a: &[(usize, f64)], b: &[(usize, f64)]) -> f64 {
        let Frame { local, shared, layout, .. } = &*self.frame;
        let (factors, m) = (self.factors(), layout.len());
        let position = |all: &[usize], number: usize| all.iter().position(|&own| own == number);
        // Block variables, and rows of the shared parameters.
        let split = |h: &[(usize, f64)]| {
            let [mut of_blocks, mut of_shared] = [const { Vec::new() }; 2];
            for &(number, weight) in h {
                match number.checked_sub(m) {
                    None => of_blocks.push((number, weight)),
                    Some(parameter) => match (position(local, parameter), position(shared, parameter)) {
                        (Some(own), _) => of_blocks.push((m + own, weight)),
                        (None, Some(own)) => of_shared.push((own, weight)),
                        (None, None) => {}
                    },
                }
            }
            [of_blocks, of_shared]
        };
        let ([a_blocks, a_shared], [b_blocks, b_shared]) = (split(a), split(b));
        let has_parameters = factors.has_parameters();
        let amplitudes = |of_blocks: &[(usize, f64)], of_shared: &[(usize, f64)]| {
            let amplitude = |column: usize| {
                let blocks = of_blocks.iter().map(|&(variable, weight)| weight * factors.value(variable, column));
                let shared = of_shared.iter().filter(|_| has_parameters);
                blocks.sum::<f64>() + shared.map(|&(row, weight)| weight * factors.shared[(row, column)]).sum::<f64>()
            };
            let mut amplitudes: Vec<f64> = (0..factors.columns()).map(amplitude).collect();
            factors.sum(&mut amplitudes);
            amplitudes
        };
        let mut through_blocks = [0.0];
        for &(variable, weight) in &a_blocks {
            let Some((members, own)) = self.part_of(variable) else { continue };
            let column = members.binary_search(&variable).expect("a variable is in its block");
            for &(other, its_weight) in &b_blocks {
                if let Ok(row) = members.binary_search(&other) {
                    through_blocks[0] += weight * its_weight * own[(row, column)];
                }
            }
        }
        factors.sum(&mut through_blocks);
        dot(&amplitudes(&a_blocks, &a_shared), &amplitudes(&b_blocks, &b_shared)) + through_blocks[0]
    }

    /// The block variables that one is correlated with apart from the factors, and their covariance: those of its block, or of
    /// the patch of blocks that observations have linked. `None` if another rank has its block.
    fn part_of(&self, variable: usize) -> Option<(&[usize], MatRef<'_, f64>)> {
        let (blocks, covariance) = (&self.frame.blocks, &self.memory.covariance);
        if let Some(patch) = covariance.linked.iter().find(|it| it.variables.binary_search(&variable).is_ok()) {
            return Some((patch.variables.as_slice(), patch.covariance.as_ref()));
        }
        let block = blocks.place(variable).0;
        covariance.own.own().contains(&block).then(|| (blocks.members(block), covariance.own.block(blocks, block)))
    }
}
