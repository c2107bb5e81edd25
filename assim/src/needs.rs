//! What data would determine a calibration parameter: Lange, WO 93/22625, claim 1 f, "indicating when there is need for … test
//! point data, sensor comparison".

use crate::calibration_accuracy::CalibrationAccuracy;
use crate::ties::first_largest;

/// One more datum that would bring the variance of a calibration parameter to a threshold.
///
/// An observation `hᵀc + N(0, r)` takes `(hᵀS)_j²/(hᵀS h + r)` from the variance `S_jj` of parameter j, so that t is left where
/// `r = (hᵀS)_j²/(S_jj − t) − hᵀS h`; if that is negative, even an exact one is not enough.
#[derive(Clone, Debug, PartialEq)]
pub struct Needs {
    /// The largest standard deviation of a test point, an observation of the parameter alone, in its unit.
    pub test_point_sigma: f64,
    /// The comparison with another sensor that may have the largest error, if any is enough.
    pub comparison: Option<NeededComparison>,
}

/// A comparison of a sensor with another, `c_j − c_k`, that would determine it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeededComparison {
    /// Number k of the parameter of the other sensor.
    pub with: usize,
    /// The largest standard deviation of its error, in the parameters' unit.
    pub sigma: f64,
}

impl Needs {
    /// Of parameter `number`, whose variance is to be at most `variance`; it can be compared with the parameters `others`. `None`
    /// if its variance is not larger than that already.
    pub fn new(
        accuracy: &CalibrationAccuracy,
        number: usize,
        variance: f64,
        others: impl IntoIterator<Item = usize>,
    ) -> Option<Self> {
        let covariance = accuracy.covariance();
        let own = covariance[(number, number)];
        // Also if one of them is no number.
        if variance.partial_cmp(&own) != Some(std::cmp::Ordering::Less) {
            return None;
        }
        let most = |with_parameter: f64, of_itself: f64| with_parameter.powi(2) / (own - variance) - of_itself;
        let comparisons: Vec<(usize, f64)> = others
            .into_iter()
            .filter(|&other| other != number)
            .map(|other| {
                let both = covariance[(other, number)];
                (other, most(own - both, own + covariance[(other, other)] - 2.0 * both))
            })
            .collect();
        let best = first_largest(comparisons.iter().map(|it| it.1)).map(|best| comparisons[best]);
        let comparison = best.filter(|it| it.1 > 0.0).map(|(with, r)| NeededComparison { with, sigma: r.sqrt() });
        Some(Self { test_point_sigma: most(own, own).sqrt(), comparison })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Mat;

    const S: [[f64; 3]; 3] = [[4.0, 1.0, -0.5], [1.0, 1.0, 0.2], [-0.5, 0.2, 0.3]];

    fn accuracy() -> CalibrationAccuracy {
        CalibrationAccuracy::new(Mat::from_fn(3, 3, |i, j| S[i][j]), 3)
    }

    /// The variance of parameter 0 after an observation of h with standard deviation `sigma`, by the Kalman filter.
    fn after(h: [f64; 3], sigma: f64) -> f64 {
        let with: Vec<f64> = (0..3).map(|i| (0..3).map(|j| S[i][j] * h[j]).sum()).collect();
        let innovation = (0..3).map(|i| h[i] * with[i]).sum::<f64>() + sigma * sigma;
        S[0][0] - with[0].powi(2) / innovation
    }

    #[test]
    fn a_datum_as_good_as_is_needed_leaves_exactly_the_threshold() {
        let needs = Needs::new(&accuracy(), 0, 1.2, 0..3).unwrap();
        assert!((after([1.0, 0.0, 0.0], needs.test_point_sigma) - 1.2).abs() < 1e-12, "{needs:?}");
        let NeededComparison { with, sigma } = needs.comparison.unwrap();
        assert_eq!(with, 2, "the sensor that is known best");
        assert!((after([1.0, 0.0, -1.0], sigma) - 1.2).abs() < 1e-12, "{needs:?}");
        assert!(after([1.0, -1.0, 0.0], sigma) > 1.2, "a comparison with the other sensor is worth less");
    }

    #[test]
    fn no_comparison_is_enough_where_the_other_sensor_is_not_known_well_enough() {
        // Compared exactly with parameter 1, parameter 0 keeps 4 − 3²/3 = 1.
        assert_eq!(Needs::new(&accuracy(), 0, 0.99, [1]).unwrap().comparison, None);
        assert!(Needs::new(&accuracy(), 0, 1.01, [1]).unwrap().comparison.is_some());
        assert_eq!(Needs::new(&accuracy(), 0, 1.01, [0]).unwrap().comparison, None, "with itself");
    }

    #[test]
    fn what_is_determined_needs_nothing() {
        assert_eq!(Needs::new(&accuracy(), 1, 1.0, 0..3), None);
        assert_eq!(Needs::new(&accuracy(), 1, f64::NAN, 0..3), None);
    }
}
