//! What the observations say of the biases, the state being unknown.

use super::conjugate_gradient::{self, Ending, Stopping};
use super::control_space::ControlSpace;
use crate::linalg::product;
use crate::problem::Innovations;
use faer::Mat;

/// M = Fᵀ (I + K_x K_xᵀ)⁻¹ F with F = R^-½ G and K_x = R^-½ H √s U, the part of K that is the state's: the information on the
/// biases c. The posterior covariance of c is (P_c⁻¹ + M)⁻¹.
pub(super) struct BiasInformation {
    /// M, `[p, p]`.
    pub matrix: Mat<f64>,
    /// How the solution for each column of F ended.
    pub endings: Vec<Ending>,
}

impl BiasInformation {
    /// From the innovations of one cycle, or of those of a window one after another; `multiply` takes vectors of whitened
    /// observations to K_x K_xᵀ times each.
    ///
    /// Each column f of F is one system (I + K_x K_xᵀ) y = f in the space of the observations, whose cost has nothing to do
    /// with the number of biases. With the residuals r that conjugate gradients leave, Fᵀ Y + Yᵀ R differs from M by
    /// Rᵀ (I + K_x K_xᵀ)⁻¹ R, which is of second order. In units of the biases' errors that is at most the square of the
    /// tolerance, because |r| falls below the tolerance over σ of the bias.
    pub fn new(
        innovations: &[Innovations],
        control: &ControlSpace<'_>,
        stopping: Stopping,
        multiply: impl Fn(&[&[f64]]) -> Vec<Vec<f64>>,
    ) -> Self {
        let (p, n) = (control.parameters(), innovations.iter().map(Innovations::len).sum());
        let columns = columns(innovations, p);
        let dense = |column: &Vec<(usize, f64)>| {
            let mut right = vec![0.0; n];
            column.iter().for_each(|&(row, value)| right[row] += value);
            right
        };
        let right: Vec<Vec<f64>> = columns.iter().map(dense).collect();
        let largest = |number: usize| stopping.tolerance / control.bias_sigma(number);
        let solutions = conjugate_gradient::solve(right, largest, stopping, |directions| {
            let mut images = multiply(directions);
            for (image, direction) in images.iter_mut().zip(directions) {
                image.iter_mut().zip(*direction).for_each(|(image, own)| *image += own);
            }
            images
        });
        let y = Mat::from_fn(n, p, |row, k| solutions[k].values[row]);
        let residuals = Mat::from_fn(n, p, |row, k| solutions[k].residual[row]);
        let mut matrix = product(y.transpose(), residuals.as_ref());
        for (i, column) in columns.iter().enumerate() {
            for j in 0..p {
                matrix[(i, j)] += column.iter().map(|&(row, value)| value * y[(row, j)]).sum::<f64>();
            }
        }
        let matrix = Mat::from_fn(p, p, |i, j| 0.5 * (matrix[(i, j)] + matrix[(j, i)]));
        Self { matrix, endings: solutions.into_iter().map(|solution| solution.ending).collect() }
    }
}

/// The entries (row, value) of each column of F.
fn columns(innovations: &[Innovations], parameters: usize) -> Vec<Vec<(usize, f64)>> {
    let (mut columns, mut first) = (vec![Vec::new(); parameters], 0);
    for own in innovations {
        for row in 0..own.len() {
            let sigma = own.variance[row].sqrt();
            for &(parameter, weight) in own.jacobian.calibration.row(row) {
                columns[parameter].push((first + row, weight / sigma));
            }
        }
        first += own.len();
    }
    columns
}
