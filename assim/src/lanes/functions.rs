//! Functions of several matrices at a time, one in each lane of the processor's vectors.
//!
//! What has a value for each matrix is stored with the matrices last: `[…, lanes]`.

use pulp::{Arch, Simd, WithSimd};

/// Shifted systems that are solved together, to hide the latency of each.
const TOGETHER: usize = 4;

/// How many matrices are treated together on this processor.
pub(crate) fn lanes(arch: Arch) -> usize {
    struct Lanes;
    impl WithSimd for Lanes {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F64_LANES
        }
    }
    arch.dispatch(Lanes)
}

/// Numbers that begin where the processor likes vectors to begin.
#[derive(Default)]
pub(crate) struct Aligned {
    values: Vec<f64>,
    first: usize,
    len: usize,
}

impl Aligned {
    /// Becomes this number of zeros.
    pub fn reset(&mut self, len: usize) -> &mut [f64] {
        const LINE_BYTES: usize = 64;
        self.values.clear();
        self.values.resize(len + LINE_BYTES / 8, 0.0);
        self.first = self.values.as_ptr().align_offset(LINE_BYTES).min(LINE_BYTES / 8);
        self.len = len;
        self.as_mut()
    }

    pub fn as_ref(&self) -> &[f64] {
        &self.values[self.first..][..self.len]
    }

    pub fn as_mut(&mut self) -> &mut [f64] {
        &mut self.values[self.first..][..self.len]
    }
}

/// Functions of a symmetric positive definite matrix M in each lane on some vectors x, and M⁻¹ on another one, r.
///
/// M = Q T Qᵀ with T tridiagonal, by Householder's reflections (Golub and Van Loan 2013, Matrix Computations, algorithm
/// 8.3.1); then `g(M) x = Q Σ_j ω_j (T + σ_j)⁻¹ Qᵀ x`, for which solving a tridiagonal system is next to nothing. So no
/// eigenvalues are needed, and there is no iteration whose steps would differ from lane to lane.
pub(crate) struct Functions<'a> {
    /// The order of M, k ≥ 1.
    pub size: usize,
    /// M, `[k, k, lanes]`, whose lower triangles are read, column by column; the reflections after.
    pub matrix: &'a mut [f64],
    /// r, `[k, lanes]`; lost.
    pub right: &'a mut [f64],
    /// x, `[vectors, k, lanes]`; g(M) x after.
    pub vectors: &'a mut [f64],
    /// xᵀ M⁻¹ r, `[vectors, lanes]`.
    pub inner: &'a mut [f64],
    /// σ and ω.
    pub shifts: &'a [f64],
    pub weights: &'a [f64],
    pub work: &'a mut Aligned,
}

impl WithSimd for Functions<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let size = self.size;
        let (matrix, _) = S::as_mut_simd_f64s(self.matrix);
        let (right, _) = S::as_mut_simd_f64s(self.right);
        let (vectors, _) = S::as_mut_simd_f64s(self.vectors);
        let (inner, _) = S::as_mut_simd_f64s(self.inner);
        let numbers = (4 + 2 * TOGETHER) * size + vectors.len();
        let (work, _) = S::as_mut_simd_f64s(self.work.reset(numbers * S::F64_LANES));
        let (diagonal, work) = work.split_at_mut(size);
        let (off, work) = work.split_at_mut(size);
        let (scale, work) = work.split_at_mut(size);
        let (sums, work) = work.split_at_mut(size);
        tridiagonalise(simd, size, matrix, diagonal, off, scale, sums);
        let tridiagonal = Tridiagonal { diagonal, off };
        let reflection = |k: usize| (&matrix[k * size + k + 1..(k + 1) * size], scale[k]);
        for vector in vectors.chunks_exact_mut(size).chain([&mut *right]) {
            for k in 0..size {
                reflect(simd, reflection(k), &mut vector[k + 1..]);
            }
        }
        tridiagonal.solve(simd, right, sums);
        for (vector, inner) in vectors.chunks_exact(size).zip(inner) {
            *inner = dot(simd, vector, right);
        }
        tridiagonal.resolve(simd, [self.shifts, self.weights], vectors, work);
        for vector in vectors.chunks_exact_mut(size) {
            for k in (0..size).rev() {
                reflect(simd, reflection(k), &mut vector[k + 1..]);
            }
        }
    }
}

/// Symmetric tridiagonal matrices.
struct Tridiagonal<'a, S: Simd> {
    /// `[k]`.
    diagonal: &'a [S::f64s],
    /// Between a row and the next; the last has no meaning.
    off: &'a [S::f64s],
}

/// Leaves in each column of a matrix below the diagonal the vector v of the reflection I − s v vᵀ, and s in `scale`.
#[inline(always)]
fn tridiagonalise<S: Simd>(
    simd: S,
    size: usize,
    matrix: &mut [S::f64s],
    diagonal: &mut [S::f64s],
    off: &mut [S::f64s],
    scale: &mut [S::f64s],
    sums: &mut [S::f64s],
) {
    let zero = simd.splat_f64s(0.0);
    // What is below it is zero beside a diagonal that is not below one.
    let negligible = simd.splat_f64s(1e-280);
    for k in 0..size {
        let (done, rest) = matrix.split_at_mut((k + 1) * size);
        diagonal[k] = done[k * size + k];
        let v = &mut done[k * size + k + 1..];
        let Some((&first, others)) = v.split_first() else { break };
        let squares = dot(simd, others, others);
        let is_significant = simd.greater_than_f64s(squares, negligible);
        let norm = simd.sqrt_f64s(simd.mul_add_f64s(first, first, squares));
        let minus = simd.neg_f64s(norm);
        let image = simd.select_f64s(simd.less_than_f64s(first, zero), norm, minus);
        let half = simd.mul_f64s(norm, simd.add_f64s(norm, simd.abs_f64s(first)));
        let factor = simd.select_f64s(is_significant, simd.div_f64s(simd.splat_f64s(1.0), half), zero);
        off[k] = simd.select_f64s(is_significant, image, first);
        scale[k] = factor;
        v[0] = simd.sub_f64s(first, image);
        let (v, w) = (&*v, &mut sums[..size - k - 1]);
        symmetric_times(simd, size, k + 1, rest, v, w);
        // w = s M v − (s²/2)(vᵀ M v) v.
        let inner = simd.mul_f64s(simd.mul_f64s(factor, factor), dot(simd, v, w));
        let half = simd.mul_f64s(simd.splat_f64s(-0.5), inner);
        for (w, &v) in w.iter_mut().zip(v) {
            *w = simd.mul_add_f64s(half, v, simd.mul_f64s(factor, *w));
        }
        subtract_products(simd, size, k + 1, rest, v, w);
    }
}

/// Two neighbouring columns of the lower triangle of a matrix whose first rows and columns are done, from the diagonal
/// of the second one on; and the three elements above.
macro_rules! pairs_of_columns {
    ($size:expr, $first:expr, $columns:expr) => {{
        let (size, first) = ($size, $first);
        $columns.chunks_mut(2 * size).enumerate().map(move |(pair, columns)| {
            let row = first + 2 * pair;
            let (left, right) = columns.split_at_mut(size);
            (2 * pair, &mut left[row..], right.get_mut(row + 1..).unwrap_or_default())
        })
    }};
}

/// M v, from the lower triangle; `columns` are those from number `first` on.
#[inline(always)]
fn symmetric_times<S: Simd>(
    simd: S,
    size: usize,
    first: usize,
    columns: &mut [S::f64s],
    v: &[S::f64s],
    product: &mut [S::f64s],
) {
    product.fill(simd.splat_f64s(0.0));
    for (j, left, right) in pairs_of_columns!(size, first, columns) {
        let a = v[j];
        let mut of_left = simd.mul_add_f64s(left[0], a, product[j]);
        if right.is_empty() {
            product[j] = of_left;
            break;
        }
        let b = v[j + 1];
        of_left = simd.mul_add_f64s(left[1], b, of_left);
        let mut of_right = simd.mul_add_f64s(right[0], b, simd.mul_add_f64s(left[1], a, product[j + 1]));
        let below = left[2..].iter().zip(&right[1..]).zip(&v[j + 2..]).zip(&mut product[j + 2..]);
        for (((&left, &right), &v), product) in below {
            of_left = simd.mul_add_f64s(left, v, of_left);
            of_right = simd.mul_add_f64s(right, v, of_right);
            *product = simd.mul_add_f64s(right, b, simd.mul_add_f64s(left, a, *product));
        }
        product[j] = of_left;
        product[j + 1] = of_right;
    }
}

/// M − v wᵀ − w vᵀ, in the lower triangle.
#[inline(always)]
fn subtract_products<S: Simd>(
    simd: S,
    size: usize,
    first: usize,
    columns: &mut [S::f64s],
    v: &[S::f64s],
    w: &[S::f64s],
) {
    let minus = |m: S::f64s, (v, w): (S::f64s, S::f64s), (a, b): (S::f64s, S::f64s)| {
        simd.negate_mul_add_f64s(w, a, simd.negate_mul_add_f64s(v, b, m))
    };
    for (j, left, right) in pairs_of_columns!(size, first, columns) {
        let a = (v[j], w[j]);
        left[0] = minus(left[0], a, a);
        if right.is_empty() {
            break;
        }
        let b = (v[j + 1], w[j + 1]);
        left[1] = minus(left[1], b, a);
        right[0] = minus(right[0], b, b);
        let below = left[2..].iter_mut().zip(&mut right[1..]).zip(&v[j + 2..]).zip(&w[j + 2..]);
        for (((left, right), &v), &w) in below {
            *left = minus(*left, (v, w), a);
            *right = minus(*right, (v, w), b);
        }
    }
}

/// Σ aᵢ bᵢ.
#[inline(always)]
fn dot<S: Simd>(simd: S, a: &[S::f64s], b: &[S::f64s]) -> S::f64s {
    let mut sums = [simd.splat_f64s(0.0); 4];
    let (fours_a, rest_a) = a.as_chunks::<4>();
    let (fours_b, rest_b) = b.as_chunks::<4>();
    for (a, b) in fours_a.iter().zip(fours_b) {
        for i in 0..4 {
            sums[i] = simd.mul_add_f64s(a[i], b[i], sums[i]);
        }
    }
    for (&a, &b) in rest_a.iter().zip(rest_b) {
        sums[0] = simd.mul_add_f64s(a, b, sums[0]);
    }
    simd.add_f64s(simd.add_f64s(sums[0], sums[1]), simd.add_f64s(sums[2], sums[3]))
}

/// x − s v (vᵀ x).
#[inline(always)]
fn reflect<S: Simd>(simd: S, (v, scale): (&[S::f64s], S::f64s), x: &mut [S::f64s]) {
    let factor = simd.mul_f64s(scale, dot(simd, v, x));
    for (x, &v) in x.iter_mut().zip(v) {
        *x = simd.negate_mul_add_f64s(factor, v, *x);
    }
}

impl<S: Simd> Tridiagonal<'_, S> {
    /// x ← T⁻¹ x.
    #[inline(always)]
    fn solve(&self, simd: S, x: &mut [S::f64s], inverse: &mut [S::f64s]) {
        let one = simd.splat_f64s(1.0);
        let size = x.len();
        inverse[0] = simd.div_f64s(one, self.diagonal[0]);
        for i in 1..size {
            let ratio = simd.mul_f64s(self.off[i - 1], inverse[i - 1]);
            let pivot = simd.negate_mul_add_f64s(ratio, self.off[i - 1], self.diagonal[i]);
            inverse[i] = simd.div_f64s(one, pivot);
            x[i] = simd.negate_mul_add_f64s(ratio, x[i - 1], x[i]);
        }
        x[size - 1] = simd.mul_f64s(x[size - 1], inverse[size - 1]);
        for i in (1..size).rev() {
            let rest = simd.negate_mul_add_f64s(self.off[i - 1], x[i], x[i - 1]);
            x[i - 1] = simd.mul_f64s(inverse[i - 1], rest);
        }
    }

    /// Each x ← Σ_j ω_j (T + σ_j)⁻¹ x, `[vectors, k]`.
    #[inline(always)]
    fn resolve(&self, simd: S, [shifts, weights]: [&[f64]; 2], vectors: &mut [S::f64s], work: &mut [S::f64s]) {
        let (zero, one, size) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0), self.diagonal.len());
        let (work, sums) = work.split_at_mut(2 * TOGETHER * size);
        let (inverse, half) = work.split_at_mut(TOGETHER * size);
        let (inverse, _) = inverse.as_chunks_mut::<TOGETHER>();
        let (half, _) = half.as_chunks_mut::<TOGETHER>();
        sums.fill(zero);
        for (shifts, weights) in shifts.chunks(TOGETHER).zip(weights.chunks(TOGETHER)) {
            // What is missing in the last group has no weight.
            let at = |values: &[f64], j: usize, missing| simd.splat_f64s(values.get(j).copied().unwrap_or(missing));
            let shift: [S::f64s; TOGETHER] = std::array::from_fn(|j| at(shifts, j, 1.0));
            let weight: [S::f64s; TOGETHER] = std::array::from_fn(|j| at(weights, j, 0.0));
            let mut before = [zero; TOGETHER];
            for i in 0..size {
                let off = if i > 0 { self.off[i - 1] } else { zero };
                let square = simd.mul_f64s(off, off);
                for j in 0..TOGETHER {
                    let pivot = simd.negate_mul_add_f64s(square, before[j], simd.add_f64s(self.diagonal[i], shift[j]));
                    before[j] = simd.div_f64s(one, pivot);
                }
                inverse[i] = before;
            }
            for (x, sum) in vectors.chunks_exact(size).zip(sums.chunks_exact_mut(size)) {
                let mut value = [x[0]; TOGETHER];
                half[0] = value;
                for i in 1..size {
                    for j in 0..TOGETHER {
                        let ratio = simd.mul_f64s(self.off[i - 1], inverse[i - 1][j]);
                        value[j] = simd.negate_mul_add_f64s(ratio, value[j], x[i]);
                    }
                    half[i] = value;
                }
                value = [zero; TOGETHER];
                for i in (0..size).rev() {
                    for j in 0..TOGETHER {
                        let ratio = simd.mul_f64s(self.off[i], inverse[i][j]);
                        let own = simd.mul_f64s(half[i][j], inverse[i][j]);
                        value[j] = simd.negate_mul_add_f64s(ratio, value[j], own);
                        sum[i] = simd.mul_add_f64s(weight[j], value[j], sum[i]);
                    }
                }
            }
        }
        vectors.copy_from_slice(sums);
    }
}
