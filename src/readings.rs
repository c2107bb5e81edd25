//! Observations without the biases that a method has found in them.

use isobar_assim::{CalibrationAccuracy, Estimate};
use isobar_obs::{ObservationWindow, Rejection, SparseRows, Unused, UnusedObservation};
use serde::{Deserialize, Serialize};

/// What sensors would have read if they had the biases that a method has estimated, and how well these are known: for each
/// observation y with the row g of the calibration's Jacobian G
///
/// ```text
/// y − g ĉ,     σ² = g S gᵀ
/// ```
///
/// (WO 90/13794: the calibrated readings). σ is the claimed error of the correction; the random error of y comes on top of it.
/// Used observations come first, then the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Readings {
    /// y − g ĉ; it is not finite where y is not, or where a predictor of its bias is missing.
    pub values: Vec<f64>,
    /// σ.
    pub sigma: Vec<f64>,
}

impl Readings {
    /// The readings of a cycle after its analysis; `accuracy` is asked for S only where biases of several parameters add up,
    /// or where the estimate says nothing of their errors.
    pub fn new(
        observed: &ObservationWindow,
        analysis: &Estimate,
        accuracy: impl FnOnce() -> CalibrationAccuracy,
    ) -> Self {
        let Estimate { state, calibration, calibration_spread, .. } = analysis;
        let rows =
            [&observed.operator, &observed.aside.operator].map(|it| it.linearize_calibration(state, calibration));
        let simple = |rows: &SparseRows| (0..rows.rows()).all(|row| rows.row(row).len() <= 1);
        let spread = calibration_spread.as_ref().filter(|_| rows.iter().all(simple));
        let accuracy = if spread.is_none() { Some(accuracy()) } else { None };
        let variance = |row: &[(usize, f64)]| match (spread, &accuracy) {
            (Some(spread), _) => row.iter().map(|&(parameter, g)| (g * spread[parameter]).powi(2)).sum(),
            (None, Some(accuracy)) => {
                let s = accuracy.covariance();
                let of = |&(i, g): &(usize, f64)| row.iter().map(|&(j, other)| g * s[(i, j)] * other).sum::<f64>();
                row.iter().map(of).sum::<f64>()
            }
            (None, None) => 0.0,
        };
        let lacks_predictor = |it: &UnusedObservation| it.why == Unused::Rejected(Rejection::NoPredictor);
        let unused = observed.aside.unused.iter();
        let unused = unused.map(|it| if lacks_predictor(it) { f64::NAN } else { it.value });
        let values: Vec<f64> = observed.values.iter().copied().chain(unused).collect();
        let rows = rows.iter().flat_map(|rows| (0..rows.rows()).map(move |row| (rows, row)));
        let (values, sigma) = values
            .into_iter()
            .zip(rows)
            .map(|(value, (rows, row))| {
                (value - rows.row_dot(row, calibration), variance(rows.row(row)).max(0.0).sqrt())
            })
            .unzip();
        Self { values, sigma }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::mat;
    use isobar_model::{Layout, State, Time};
    use isobar_obs::{Aside, Jacobian, LinearOperator, Report};
    use std::sync::Arc;

    fn operator(rows: &[&[(usize, f64)]]) -> Arc<LinearOperator> {
        let mut jacobian = Jacobian::default();
        for row in rows {
            jacobian.state.push_row([(0, 1.0)]);
            jacobian.calibration.push_row(row.iter().copied());
        }
        Arc::new(LinearOperator { jacobian })
    }

    /// g S gᵀ by hand: 0.5² · 4 + 2 · 0.5 · 2 · (−1) + 2² · 1 = 3, and 3² · 1 = 9.
    #[test]
    fn errors_of_biases_that_add_up_are_those_of_their_sum() {
        let report =
            || Report { network: "n".into(), platform: "p".into(), variable: 0, x_m: 0.0, y_m: 0.0, scan: None };
        let time = Time::from_seconds(0);
        let passive =
            UnusedObservation { report: report(), time, value: 10.0, sigma: 1.0, why: Unused::Passive, check: None };
        let aside = Aside { checks: Vec::new(), unused: vec![passive], operator: operator(&[&[(1, 3.0)]]) };
        let observed = ObservationWindow {
            time,
            cycle: 1,
            reports: vec![report()],
            times: vec![time],
            values: vec![7.0],
            sigma: vec![1.0],
            error_regression: Default::default(),
            aside,
            comparisons: Vec::new(),
            operator: operator(&[&[(0, 0.5), (1, 2.0)]]),
        };
        let state = State::from_values(&Layout::ring(2, "x", "1"), vec![0.0; 2]);
        let analysis = Estimate {
            state,
            calibration: vec![2.0, 3.0],
            state_spread: None,
            calibration_spread: Some(vec![2.0, 1.0]),
        };
        let accuracy = || CalibrationAccuracy::new(mat![[4.0, -1.0], [-1.0, 1.0]], 2);
        let readings = Readings::new(&observed, &analysis, accuracy);
        assert_eq!(readings.values, [0.0, 1.0]);
        assert!((readings.sigma[0] - 3.0_f64.sqrt()).abs() < 1e-15 && (readings.sigma[1] - 3.0).abs() < 1e-15);
        // Where biases do not add up, the spread says it all.
        let simple = ObservationWindow { operator: operator(&[&[(0, 0.5)]]), ..observed };
        let readings = Readings::new(&simple, &analysis, || panic!("S is not needed"));
        assert_eq!((readings.values, readings.sigma), (vec![6.0, 1.0], vec![1.0, 3.0]));
    }
}
