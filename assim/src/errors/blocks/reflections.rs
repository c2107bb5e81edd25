//! An orthogonal matrix that is a product of a few Householder reflections.

use crate::linalg::{add_lower_product, add_product, entries, entries_mut, mirror_lower, product};
use faer::prelude::ReborrowMut;
use faer::{Mat, MatMut};
use isobar_model::vector::{axpy, dot, scale};

/// `Q = H_1 … H_p = I − V T Vᵀ`, `[n, n]`, such that Qᵀ A = \[R; 0\] for a matrix A of p columns (Schreiber and Van Loan 1989,
/// SIAM J. Sci. Stat. Comput. 10, 53–57): its first p columns carry A, the others are orthogonal to it. It is never formed.
pub(super) struct Reflections {
    /// V, `[n, p]`, with unit columns.
    v: Mat<f64>,
    /// T, `[p, p]`, upper triangular.
    t: Mat<f64>,
}

impl Reflections {
    /// Those of A, `[n, p]` with n ≥ p, and R, `[p, p]`.
    pub fn new(mut a: Mat<f64>) -> (Self, Mat<f64>) {
        let (n, p) = (a.nrows(), a.ncols());
        let (mut v, mut t) = (Mat::zeros(n, p), Mat::zeros(p, p));
        for k in 0..p {
            let (earlier, mut own) = v.as_mut().split_at_col_mut(k);
            let own = entries_mut(own.rb_mut().col_mut(0));
            own[k..].copy_from_slice(&a.col_as_slice(k)[k..]);
            let length = dot(own, own).sqrt();
            // Away from zero: the difference of two numbers that are nearly the same would be rounding.
            own[k] += length.copysign(own[k]);
            let length = dot(own, own).sqrt();
            if length > 0.0 {
                scale(own, length.recip());
            }
            for j in k..p {
                let column = a.col_as_slice_mut(j);
                let along = dot(own, column);
                axpy(-2.0 * along, own, column);
            }
            // T_·k = −2 T Vᵀ v_k.
            let overlaps: Vec<f64> = earlier.as_ref().col_iter().map(|earlier| dot(entries(earlier), own)).collect();
            for i in 0..k {
                t[(i, k)] = -2.0 * (i..k).map(|l| t[(i, l)] * overlaps[l]).sum::<f64>();
            }
            t[(k, k)] = 2.0;
        }
        let r = Mat::from_fn(p, p, |i, j| if i <= j { a[(i, j)] } else { 0.0 });
        (Self { v, t }, r)
    }

    /// C ← Q C.
    pub fn apply(&self, c: MatMut<'_, f64>) {
        let turned = product(self.t.as_ref(), product(self.v.transpose(), c.as_ref()).as_ref());
        add_product(c, -1.0, self.v.as_ref(), turned.as_ref());
    }

    /// G ← Qᵀ G Q of a symmetric G, by a symmetric update of rank 2p: with X = G V T and Z = X − ½ V Tᵀ Vᵀ X it is
    /// `G − V Zᵀ − Z Vᵀ`.
    pub fn conjugate(&self, mut g: MatMut<'_, f64>) {
        let p = self.v.ncols();
        let mut z = product(product(g.as_ref(), self.v.as_ref()).as_ref(), self.t.as_ref());
        let inner = product(self.t.transpose(), product(self.v.transpose(), z.as_ref()).as_ref());
        add_product(z.as_mut(), -0.5, self.v.as_ref(), inner.as_ref());
        let side_by_side = |left: &Mat<f64>, right: &Mat<f64>| {
            Mat::from_fn(left.nrows(), 2 * p, |i, j| if j < p { left[(i, j)] } else { right[(i, j - p)] })
        };
        let (left, right) = (side_by_side(&self.v, &z), side_by_side(&z, &self.v));
        add_lower_product(g.rb_mut(), -1.0, left.as_ref(), right.transpose());
        mirror_lower(g);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    fn random(rows: usize, columns: usize, seed: u64) -> Mat<f64> {
        let normals = standard_normals(&mut stream(seed, "reflections"), rows * columns);
        Mat::from_fn(rows, columns, |i, j| normals[j * rows + i])
    }

    #[test]
    fn they_are_an_orthogonal_matrix_whose_first_columns_carry_the_given_ones() {
        for (n, p) in [(9, 3), (3, 3), (200, 5), (4, 0)] {
            let mut a = random(n, p, 1);
            // A column without a component of its own, and one of zeros.
            if p == 5 {
                let first = a.col_as_slice(0).to_vec();
                a.col_as_slice_mut(2).copy_from_slice(&first);
                a.col_as_slice_mut(3).fill(0.0);
            }
            let (reflections, r) = Reflections::new(a.clone());
            let mut q = Mat::<f64>::identity(n, n);
            reflections.apply(q.as_mut());
            assert!((q.transpose() * &q - Mat::<f64>::identity(n, n)).norm_max() < 1e-14 * n as f64, "{n}, {p}");
            let difference = q.as_ref().get(.., ..p) * &r - &a;
            assert!(p == 0 || difference.norm_max() < 1e-14 * n as f64, "{n}, {p}");
            let half = random(n, n, 2);
            let g = &half + half.transpose();
            let mut conjugate = g.clone();
            reflections.conjugate(conjugate.as_mut());
            assert!((conjugate - q.transpose() * &g * &q).norm_max() < 1e-13 * n as f64, "{n}, {p}");
        }
    }
}
