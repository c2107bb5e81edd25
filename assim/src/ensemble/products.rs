//! Products with what the members make of some observations, for the places in all lanes.

use pulp::{Simd, WithSimd};

/// Products with observed perturbations Y that all lanes share, `[n, N]` row by row.
pub(super) struct Products<'a> {
    pub members: usize,
    pub y: &'a [f64],
    pub operation: Operation<'a>,
}

pub(super) enum Operation<'a> {
    /// Y x of some vectors x, `[vectors, N, lanes]`, into `[vectors, n, lanes]`.
    Observe { x: &'a [f64], observed: &'a mut [f64] },
    /// Adds Yᵀ z of some z, `[vectors, n, lanes]`, to vectors `[vectors, N, lanes]`.
    Combine { z: &'a [f64], x: &'a mut [f64] },
    /// Adds Yᵀ diag(w) Y with weights `[n, lanes]` to the lower triangle of matrices `[N, N, lanes]`.
    Square { weights: &'a [f64], matrix: &'a mut [f64] },
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (members, y) = (self.members, self.y);
        let n = y.len() / members;
        match self.operation {
            Operation::Observe { x, observed } => {
                let ((x, _), (observed, _)) = (S::as_simd_f64s(x), S::as_mut_simd_f64s(observed));
                for (x, observed) in x.chunks_exact(members).zip(observed.chunks_exact_mut(n)) {
                    for (y, observed) in y.chunks(4 * members).zip(observed.chunks_mut(4)) {
                        observe(simd, y, x, observed);
                    }
                }
            }
            Operation::Combine { z, x } => {
                let ((z, _), (x, _)) = (S::as_simd_f64s(z), S::as_mut_simd_f64s(x));
                for (z, x) in z.chunks_exact(n).zip(x.chunks_exact_mut(members)) {
                    for (block, x) in x.chunks_mut(4).enumerate() {
                        combine(simd, &y[4 * block..], members, z, x);
                    }
                }
            }
            Operation::Square { weights, matrix } => {
                let ((weights, _), (matrix, _)) = (S::as_simd_f64s(weights), S::as_mut_simd_f64s(matrix));
                for column in (0..members).step_by(4) {
                    for row in (column..members).step_by(4) {
                        square(simd, y, members, weights, matrix, [row, column]);
                    }
                }
            }
        }
    }
}

/// The products of up to four rows of Y with x.
#[inline(always)]
fn observe<S: Simd>(simd: S, y: &[f64], x: &[S::f64s], observed: &mut [S::f64s]) {
    let members = x.len();
    if let [a, b, c, d] = observed {
        let mut sums = [simd.splat_f64s(0.0); 4];
        let rows: [&[f64]; 4] = std::array::from_fn(|row| &y[row * members..][..members]);
        for (i, &x) in x.iter().enumerate() {
            for row in 0..4 {
                sums[row] = simd.mul_add_f64s(simd.splat_f64s(rows[row][i]), x, sums[row]);
            }
        }
        [*a, *b, *c, *d] = sums;
    } else {
        for (observed, y) in observed.iter_mut().zip(y.chunks_exact(members)) {
            let mut sum = simd.splat_f64s(0.0);
            for (&y, &x) in y.iter().zip(x) {
                sum = simd.mul_add_f64s(simd.splat_f64s(y), x, sum);
            }
            *observed = sum;
        }
    }
}

/// Adds the products of z with up to four columns of Y, the first ones of what `y` has left of each row.
#[inline(always)]
fn combine<S: Simd>(simd: S, y: &[f64], members: usize, z: &[S::f64s], x: &mut [S::f64s]) {
    if let Some((four, [])) = x.split_first_chunk_mut::<4>() {
        for (y, &z) in y.chunks(members).zip(z) {
            for column in 0..4 {
                four[column] = simd.mul_add_f64s(simd.splat_f64s(y[column]), z, four[column]);
            }
        }
    } else {
        for (y, &z) in y.chunks(members).zip(z) {
            for (x, &y) in x.iter_mut().zip(y) {
                *x = simd.mul_add_f64s(simd.splat_f64s(y), z, *x);
            }
        }
    }
}

/// Adds a block of up to four rows and columns of Yᵀ diag(w) Y.
#[inline(always)]
fn square<S: Simd>(
    simd: S,
    y: &[f64],
    members: usize,
    weights: &[S::f64s],
    matrix: &mut [S::f64s],
    [row, column]: [usize; 2],
) {
    let mut sums = [[simd.splat_f64s(0.0); 4]; 4];
    if row + 4 <= members {
        for (y, &weight) in y.chunks_exact(members).zip(weights) {
            let (left, right) = (&y[row..row + 4], &y[column..column + 4]);
            for j in 0..4 {
                let weighted = simd.mul_f64s(weight, simd.splat_f64s(right[j]));
                for i in 0..4 {
                    sums[j][i] = simd.mul_add_f64s(weighted, simd.splat_f64s(left[i]), sums[j][i]);
                }
            }
        }
    } else {
        for (y, &weight) in y.chunks_exact(members).zip(weights) {
            for (sums, &right) in sums.iter_mut().zip(&y[column..]) {
                let weighted = simd.mul_f64s(weight, simd.splat_f64s(right));
                for (sum, &left) in sums.iter_mut().zip(&y[row..]) {
                    *sum = simd.mul_add_f64s(weighted, simd.splat_f64s(left), *sum);
                }
            }
        }
    }
    for (j, sums) in sums.iter().enumerate().take(members - column) {
        for (i, &sum) in sums.iter().enumerate().take(members - row) {
            let entry = &mut matrix[(column + j) * members + row + i];
            *entry = simd.add_f64s(*entry, sum);
        }
    }
}
