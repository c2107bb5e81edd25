//! Which errors a method believes to go together with that of one value.

use isobar_assim::{CovarianceColumn, Estimate};
use isobar_model::Layout;
use serde::{Deserialize, Serialize};

/// The correlations of the analysis error of one value with those of all others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlations {
    /// The number of the value in the state.
    pub of: usize,
    /// With every value of the state, in \[−1, 1\].
    pub state: Vec<f32>,
    /// With every calibration parameter; 0 with those that the method does not estimate.
    pub calibration: Vec<f32>,
}

impl Correlations {
    /// The value whose correlations are shown: h, or the first variable, in the middle of the domain.
    pub fn middle(layout: &Layout) -> usize {
        let grid = &layout.grid;
        layout.variable("h").unwrap_or(0) * grid.cells() + grid.ny / 2 * grid.nx + grid.nx / 2
    }

    /// Those of a value from its covariances and the analysis they belong to; `None` without claimed spread.
    pub fn new(of: usize, column: &CovarianceColumn, analysis: &Estimate) -> Option<Self> {
        let spread = analysis.state_spread.as_deref()?;
        let own = *spread.get(of)?;
        let divide = |covariances: &[f64], spread: &[f64]| -> Vec<f32> {
            let correlation = |(covariance, sigma): (&f64, &f64)| {
                let product = own * sigma;
                if product > 0.0 { (covariance / product).clamp(-1.0, 1.0) as f32 } else { 0.0 }
            };
            covariances.iter().zip(spread).map(correlation).collect()
        };
        let mut calibration =
            analysis.calibration_spread.as_deref().map_or(Vec::new(), |it| divide(&column.calibration, it));
        calibration.resize(column.calibration.len(), 0.0);
        Some(Self { of, state: divide(&column.state, spread), calibration })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::{Boundary, Grid, State, shallow_water};

    #[test]
    fn covariances_are_divided_by_both_spreads() {
        let layout = shallow_water::layout(Grid { nx: 4, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic });
        assert_eq!(Correlations::middle(&layout), 10);
        let spread: Vec<f64> = (0..48).map(|i| if i == 7 { 0.0 } else { 1.0 + i as f64 }).collect();
        let column =
            CovarianceColumn { state: spread.iter().map(|it| 5.5 * it).collect(), calibration: vec![-22.0, 3.0] };
        let analysis = Estimate {
            state: State::zeros(&layout),
            calibration: vec![0.0; 2],
            state_spread: Some(spread),
            calibration_spread: Some(vec![4.0, 0.0]),
        };
        let found = Correlations::new(10, &column, &analysis).unwrap();
        assert!(found.state.iter().enumerate().all(|(i, &it)| it == if i == 7 { 0.0 } else { 0.5 }));
        assert_eq!(found.calibration, [-0.5, 0.0]);
        assert_eq!(Correlations::new(10, &column, &Estimate { state_spread: None, ..analysis }), None);
    }
}
