//! What comparisons of sensors add to χ².

use crate::calibration_accuracy::CalibrationAccuracy;
use crate::linalg::{cholesky, solve_lower};
use faer::Mat;
use isobar_obs::ObservationWindow;

/// The comparisons' part of χ², given the observations, from what an analysis left of them and of c; `None` where rounding has left
/// nothing of it.
pub(super) fn chi2(claims: &CalibrationAccuracy, left: &[f64], observed: &ObservationWindow) -> Option<f64> {
    let (s, rows) = (claims.covariance(), &observed.comparisons);
    let between = |i: usize, j: usize| -> f64 {
        let pairs = rows[i].row().flat_map(|a| rows[j].row().map(move |b| (a, b)));
        pairs.map(|(a, b)| a.1 * s[(a.0, b.0)] * b.1).sum()
    };
    let of_left = Mat::from_fn(left.len(), left.len(), |i, j| {
        let random = if i == j { rows[i].sigma.powi(2) } else { 0.0 };
        random - between(i, j)
    });
    let root = cholesky(of_left, || "what an analysis left of comparisons".into()).ok()?;
    let mut whitened = Mat::from_fn(left.len(), 1, |i, _| left[i]);
    solve_lower(root.as_ref(), whitened.as_mut());
    Some(whitened.col_as_slice(0).iter().map(|value| value * value).sum())
}
