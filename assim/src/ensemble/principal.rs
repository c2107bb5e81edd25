//! Principal directions of whitened perturbations whose rows differ by many orders of magnitude.

use crate::linalg::squared_norm;
use faer::Mat;

/// Rounding errors of a row are at most this number of machine epsilons of its norm.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Sweeps over all pairs: convergence is quadratic, and takes six to ten.
const SWEEPS: usize = 40;

/// Ỹᵀ V with orthogonal V, and Vᵀ d̃.
pub(super) struct Principal {
    /// Ỹᵀ V: orthogonal columns, of the lengths √λ, `[N, n]`.
    pub columns: Mat<f64>,
    /// λ, `[n]`.
    pub values: Vec<f64>,
    /// Vᵀ d̃, `[n]`.
    pub amplitudes: Vec<f64>,
}

/// The one-sided Jacobi method (Hestenes 1958): rotations of pairs of columns of Ỹᵀ until all are orthogonal.
///
/// Each rotation rounds a column by epsilons of that column alone, so that the directions which an accurate observation shows
/// do not drown those of the others, as they do in an eigendecomposition of Ỹ Ỹᵀ, whose errors are epsilons of the largest
/// eigenvalue (Demmel and Veselić 1992, SIAM J. Matrix Anal. Appl. 13, 1204–1245). What is known of a column, its norm
/// times [`ROUNDING`] and the given rounding at first, is rotated with it. A column that is below its rounding is one that
/// the others determine, and becomes zero: else two observations of one place that differ by more than rounding leaves of
/// their σ would be fitted by an increment without bounds, in a direction that is nothing but rounding.
///
/// `perturbations` is Ỹ, `[n, N]`; n² N operations for a sweep.
pub(super) fn principal(perturbations: &Mat<f64>, departures: &[f64], rounding: &[f64], factor: f64) -> Principal {
    let (n, members) = (perturbations.nrows(), perturbations.ncols());
    let row = |i: usize| (0..members).map(|j| factor * perturbations[(i, j)]).collect::<Vec<f64>>();
    let mut columns: Vec<Column> = (0..n)
        .map(|i| {
            let values = row(i);
            let rounding = ROUNDING * squared_norm(&values).sqrt() + factor * rounding[i];
            Column { values, amplitude: departures[i], rounding }
        })
        .collect();
    columns.sort_by(|a, b| squared_norm(&b.values).total_cmp(&squared_norm(&a.values)));
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for second in 1..n {
            let (left, right) = columns.split_at_mut(second);
            for first in left {
                rotated |= first.rotate(&mut right[0]);
            }
        }
        if !rotated {
            break;
        }
    }
    Principal {
        values: columns.iter().map(|column| squared_norm(&column.values)).collect(),
        amplitudes: columns.iter().map(|column| column.amplitude).collect(),
        columns: Mat::from_fn(members, n, |i, j| columns[j].values[i]),
    }
}

/// A column of Ỹᵀ V, its part of Vᵀ d̃, and the rounding of the column.
struct Column {
    values: Vec<f64>,
    amplitude: f64,
    rounding: f64,
}

impl Column {
    /// Makes this column and another one orthogonal, unless they are.
    fn rotate(&mut self, other: &mut Column) -> bool {
        let (a, b) = (squared_norm(&self.values), squared_norm(&other.values));
        let dot: f64 = self.values.iter().zip(&other.values).map(|(x, y)| x * y).sum();
        if dot == 0.0 || dot.abs() <= 4.0 * f64::EPSILON * (a * b).sqrt() {
            return false;
        }
        let zeta = (b - a) / (2.0 * dot);
        let tangent = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
        let cosine = 1.0 / tangent.hypot(1.0);
        let sine = cosine * tangent;
        for (x, y) in self.values.iter_mut().zip(&mut other.values) {
            (*x, *y) = (cosine * *x - sine * *y, sine * *x + cosine * *y);
        }
        let (x, y) = (self.amplitude, other.amplitude);
        (self.amplitude, other.amplitude) = (cosine * x - sine * y, sine * x + cosine * y);
        let (x, y, sine) = (self.rounding, other.rounding, sine.abs());
        (self.rounding, other.rounding) = (cosine * x + sine * y, sine * x + cosine * y);
        self.drop_rounding();
        other.drop_rounding();
        true
    }

    fn drop_rounding(&mut self) {
        if squared_norm(&self.values) <= self.rounding * self.rounding {
            self.values.fill(0.0);
        }
    }
}
