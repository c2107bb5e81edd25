//! The drift of calibration parameters over a period.

use faer::MatMut;
use isobar_model::Duration;
use isobar_obs::Calibration;

/// Forecasts the covariance `[p, p]` of calibration parameters over a time, `P_c ← φ P_c φ + Q_c`; returns φ, by which the caller
/// multiplies their mean.
///
/// # Panics
/// If the covariance has another size.
pub fn drift(calibration: &Calibration, time: Duration, mut covariance: MatMut<'_, f64>) -> Vec<f64> {
    let kept = calibration.kept(time);
    assert_eq!((covariance.nrows(), covariance.ncols()), (kept.len(), kept.len()), "the covariance of the parameters");
    for (j, of_column) in kept.iter().enumerate() {
        kept.iter().enumerate().for_each(|(i, of_row)| covariance[(i, j)] *= of_row * of_column);
        covariance[(j, j)] += calibration.parameters[j].drift.added_variance(time);
    }
    kept
}
