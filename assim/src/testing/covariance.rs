//! The contract every covariance operator must keep: [`check_covariance`].

use crate::covariance::{Covariance, dense, multiply, randomize};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use isobar_model::random::{standard_normals, stream};
use isobar_model::vector::{difference, dot, norm};

/// What [`check_covariance`] measured.
#[derive(Clone, Debug, PartialEq)]
pub struct CovarianceContract {
    /// |⟨U χ, δ⟩ − ⟨χ, Uᵀ δ⟩| over |U χ| |δ|.
    pub dot_product_error: f64,
    /// Eigenvalues above 10⁻¹⁰ of the largest.
    pub rank: usize,
    /// Largest over smallest eigenvalue if the operator is invertible in double precision.
    pub condition: Option<f64>,
}

/// Rounding of sums of products, relative to the vectors' norms; transforms of some hundred values stay well below.
const ROUNDING: f64 = 100.0 * f64::EPSILON;

/// Runs the battery on an operator B = U Uᵀ; its matrix is formed, so grids must be small.
///
/// * Additions: U χ and Uᵀ δ are added to what is there, to rounding of the sum, and equal calls give equal bits.
/// * Linearity: U(2a − 3b) = 2 U a − 3 U b, and the same for Uᵀ.
/// * Root and transpose: ⟨U χ, δ⟩ = ⟨χ, Uᵀ δ⟩ to 100 machine epsilons of |U χ| |δ|.
/// * Symmetry: ⟨a, B b⟩ = ⟨B a, b⟩; the matrix equals its transpose, and its columns are B times unit vectors.
/// * Product: B a, where it is computed in a way of its own, is U (Uᵀ a).
/// * Positive: ⟨a, B a⟩ = |Uᵀ a|² and no eigenvalue below −100 machine epsilons of the largest.
/// * Inverse, if the condition number is below 10⁸ (so that eight digits are left): B B⁻¹ a = a.
/// * Draws: zero where the variance is zero, and within five standard deviations elsewhere.
///
/// # Panics
/// With the numbers, if the operator breaks the contract.
pub fn check_covariance(covariance: &dyn Covariance) -> CovarianceContract {
    let (n, controls) = (covariance.len(), covariance.control_len());
    let normals = |purpose: &str, len: usize| standard_normals(&mut stream(1, purpose), len);
    let (a, b) = (normals("contract/a", n), normals("contract/b", n));
    let (chi, psi) = (normals("contract/chi", controls), normals("contract/psi", controls));
    let root = |chi: &[f64]| {
        let mut increment = vec![0.0; n];
        covariance.root_add(chi, &mut increment);
        increment
    };
    let transpose = |increment: &[f64]| {
        let mut control = vec![0.0; controls];
        covariance.root_transpose_add(increment, &mut control);
        control
    };
    check_linear("U", &root, &chi, &psi, |chi, onto| covariance.root_add(chi, onto));
    check_linear("Uᵀ", &transpose, &a, &b, |a, onto| covariance.root_transpose_add(a, onto));

    let image = root(&chi);
    let (forward, backward) = (dot(&image, &a), dot(&chi, &transpose(&a)));
    let dot_product_error = relative((forward - backward).abs(), norm(&image) * norm(&a));
    assert!(
        dot_product_error < ROUNDING,
        "⟨U χ, δ⟩ = {forward:e}, but ⟨χ, Uᵀ δ⟩ = {backward:e}: relative difference {dot_product_error:e}"
    );

    let (of_a, of_b) = (multiply(covariance, &a), multiply(covariance, &b));
    let error = relative((dot(&a, &of_b) - dot(&of_a, &b)).abs(), norm(&a) * norm(&of_b));
    assert!(error < ROUNDING, "B is not symmetric: ⟨a, B b⟩ and ⟨B a, b⟩ differ by {error:e} of |a| |B b|");
    let (variance, squares) = (dot(&a, &of_a), norm(&transpose(&a)).powi(2));
    let by_root = root(&transpose(&a));
    let error = relative(norm(&difference(&of_a, &by_root)), norm(&by_root));
    assert!(error < ROUNDING, "B a is not U (Uᵀ a): relative difference {error:e}");
    let error = relative((variance - squares).abs(), norm(&a) * norm(&of_a));
    assert!(error < ROUNDING, "⟨a, B a⟩ = {variance:e} is not |Uᵀ a|² = {squares:e}");

    let matrix = dense(covariance);
    check_matrix(covariance, &matrix);
    let eigenvalues = matrix.self_adjoint_eigenvalues(Side::Lower).expect("finite values have eigenvalues");
    let (smallest, largest) = (eigenvalues.first().copied().unwrap_or(0.0), eigenvalues.last().copied().unwrap_or(0.0));
    assert!(smallest >= -ROUNDING * largest, "B is not positive: eigenvalue {smallest:e} beside {largest:e}");
    let rank = eigenvalues.iter().filter(|&&eigenvalue| eigenvalue > 1e-10 * largest).count();
    let condition = (smallest > 1e-8 * largest).then(|| largest / smallest);
    if let Some(condition) = condition {
        let right = Mat::from_fn(n, 1, |i, _| a[i]);
        let solution = matrix.llt(Side::Lower).expect("a positive definite matrix").solve(&right);
        let back = multiply(covariance, &(0..n).map(|i| solution[(i, 0)]).collect::<Vec<_>>());
        let error = norm(&difference(&back, &a)) / norm(&a);
        assert!(error < ROUNDING * condition, "B B⁻¹ a is not a: relative error {error:e}, condition {condition:e}");
    }
    CovarianceContract { dot_product_error, rank, condition }
}

fn check_linear(
    name: &str,
    apply: &dyn Fn(&[f64]) -> Vec<f64>,
    a: &[f64],
    b: &[f64],
    add: impl Fn(&[f64], &mut [f64]),
) {
    let combine = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| 2.0 * a - 3.0 * b).collect() };
    let (of_a, of_b) = (apply(a), apply(b));
    assert!(of_a == apply(a), "{name} gives other bits the second time");
    let size = norm(&of_a) + norm(&of_b);
    let error = relative(norm(&difference(&apply(&combine(a, b)), &combine(&of_a, &of_b))), size);
    assert!(error < ROUNDING, "{name} is not linear: relative error {error:e}");
    let mut sum = of_b.clone();
    add(a, &mut sum);
    let expected: Vec<f64> = of_a.iter().zip(&of_b).map(|(a, b)| a + b).collect();
    let error = relative(norm(&difference(&sum, &expected)), size);
    assert!(error < ROUNDING, "{name} does not add to what is there: relative error {error:e}");
}

fn check_matrix(covariance: &dyn Covariance, matrix: &Mat<f64>) {
    let n = covariance.len();
    assert_eq!((matrix.nrows(), matrix.ncols()), (n, n));
    let largest = (0..n).fold(0.0, |largest: f64, i| largest.max(matrix[(i, i)]));
    for column in 0..n {
        for row in 0..column {
            let difference = (matrix[(row, column)] - matrix[(column, row)]).abs();
            assert!(
                difference <= ROUNDING * largest,
                "the matrix is not symmetric at ({row}, {column}): {difference:e}"
            );
        }
    }
    for column in (0..n).step_by((n / 23).max(1)) {
        let mut unit = vec![0.0; n];
        unit[column] = 1.0;
        for (row, value) in multiply(covariance, &unit).into_iter().enumerate() {
            let difference = (value - matrix[(row, column)]).abs();
            assert!(difference <= ROUNDING * largest, "B e and the matrix differ at ({row}, {column}): {difference:e}");
        }
    }
    let draw = randomize(covariance, &mut stream(1, "contract/draw"));
    for (index, value) in draw.into_iter().enumerate() {
        let sigma = matrix[(index, index)].max(0.0).sqrt();
        assert!(
            value.abs() <= 5.0 * sigma,
            "a draw of {value:e} at {index}, where the standard deviation is {sigma:e}"
        );
    }
}

/// The error relative to a size; absolute beside zero.
fn relative(error: f64, size: f64) -> f64 {
    if size > 0.0 { error / size } else { error }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::{Balanced, BalancedParameters, Sum, Univariate, White};
    use isobar_model::{Boundary, Grid, Layout};
    use std::sync::Arc;

    fn layout(boundary: Boundary) -> Arc<Layout> {
        isobar_model::shallow_water::layout(Grid { nx: 9, ny: 8, dx_m: 2e5, dy_m: 1.5e5, boundary })
    }

    fn balanced(layout: &Layout, balanced_at_walls: bool) -> Balanced {
        let parameters = BalancedParameters {
            sigma_height_m: 20.0,
            length_m: 3e5,
            gravity_m_per_s2: 9.81,
            coriolis_per_s: 1e-4,
            beta_per_m_per_s: if layout.grid.boundary == Boundary::Channel { 1.6e-11 } else { 0.0 },
            balanced_at_walls,
        };
        Balanced::new(layout, &parameters).unwrap()
    }

    #[test]
    fn every_operator_keeps_the_contract() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            let layout = layout(boundary);
            for variable in 0..3 {
                let walls = if boundary == Boundary::Channel && variable == 2 { 9 } else { 0 };
                let white = White::new(&layout, variable, 2.0);
                assert_eq!(check_covariance(&white).rank, 72 - walls);
                let correlated = Univariate::new(&layout, variable, 2.0, 2.5e5).unwrap();
                assert!((20..=72 - walls).contains(&check_covariance(&correlated).rank));
            }
            // One streamfunction for three variables: no more degrees of freedom than it has corners.
            for at_walls in [false, true] {
                let contract = check_covariance(&balanced(&layout, at_walls));
                assert!((20..=81).contains(&contract.rank) && contract.condition.is_none(), "{contract:?}");
            }
            assert_eq!(check_covariance(&Sum::new(layout.len(), Vec::new())).rank, 0);
        }
    }

    /// White noise on each variable makes the sum invertible where no wall keeps v zero; alone it has condition one.
    #[test]
    fn sums_keep_the_contract_and_are_invertible_with_noise_everywhere() {
        let layout = layout(Boundary::Periodic);
        let noise = |sigma: f64| -> Vec<Box<dyn Covariance>> {
            (0..3).map(|variable| Box::new(White::new(&layout, variable, sigma)) as Box<dyn Covariance>).collect()
        };
        let contract = check_covariance(&Sum::new(layout.len(), noise(0.5)));
        assert!((contract.condition.unwrap() - 1.0).abs() < 1e-12, "{contract:?}");
        let mut terms = noise(0.5);
        terms.push(Box::new(balanced(&layout, false)));
        terms.push(Box::new(Univariate::new(&layout, 0, 3.0, 4e5).unwrap()));
        let contract = check_covariance(&Sum::new(layout.len(), terms));
        assert!(contract.rank == layout.len() && contract.condition.unwrap() > 100.0, "{contract:?}");
        let walled = self::layout(Boundary::Channel);
        let terms: Vec<Box<dyn Covariance>> =
            vec![Box::new(balanced(&walled, false)), Box::new(White::new(&walled, 2, 1.0))];
        assert_eq!(check_covariance(&Sum::new(walled.len(), terms)).condition, None);
    }

    /// White noise of which one thing is wrong.
    struct Broken {
        white: White,
        /// Factor of one value under the root, and under its transpose.
        factors: [f64; 2],
        /// Whether results overwrite what is there.
        overwrites: bool,
        /// Added to a value of U χ whatever χ.
        offset: f64,
    }

    impl Covariance for Broken {
        fn len(&self) -> usize {
            self.white.len()
        }
        fn control_len(&self) -> usize {
            self.white.control_len()
        }
        fn root_add(&self, control: &[f64], increment: &mut [f64]) {
            if self.overwrites {
                increment.fill(0.0);
            }
            let mut control = control.to_vec();
            control[3] *= self.factors[0];
            self.white.root_add(&control, increment);
            increment[5] += self.offset;
        }
        fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
            let before = control[3];
            self.white.root_transpose_add(increment, control);
            control[3] = before + (control[3] - before) * self.factors[1];
        }
    }

    #[test]
    fn the_battery_catches_what_is_wrong() {
        let passes = |factors: [f64; 2], overwrites: bool, offset: f64| {
            let white = White::new(&layout(Boundary::Periodic), 0, 2.0);
            std::panic::catch_unwind(|| check_covariance(&Broken { white, factors, overwrites, offset })).is_ok()
        };
        assert!(passes([1.0, 1.0], false, 0.0) && passes([1.5, 1.5], false, 0.0));
        assert!(!passes([1.0, 1.0 + 1e-9], false, 0.0), "a transpose that is none");
        assert!(!passes([1.0, 1.0], true, 0.0), "a root that overwrites");
        assert!(!passes([1.0, 1.0], false, 1e-9), "a root that is not linear");
    }
}
