//! Standard deviations from the diagonal of a covariance that rounding may have spoilt.

use crate::error::Error;

/// A variance that is negative by less than this share of the largest one is zero but for rounding.
const ROUNDING: f64 = 1e-8;

/// The roots of the variances; `place` says in words to what a number belongs. What is not finite stays so.
///
/// # Errors
/// [`Error::NegativeVariance`] if a variance is negative by more than rounding can make it.
pub(crate) fn standard_deviations(
    variances: &[f64],
    covariance: &str,
    place: impl Fn(usize) -> String,
) -> Result<Vec<f64>, Error> {
    let largest = variances.iter().copied().fold(0.0, f64::max);
    if let Some(number) = variances.iter().position(|&variance| variance < -ROUNDING * largest) {
        let (covariance, place) = (covariance.to_string(), place(number));
        return Err(Error::NegativeVariance { covariance, place, variance: variances[number], largest });
    }
    // NaN compares as false, so that it stays NaN.
    Ok(variances.iter().map(|&variance| if variance < 0.0 { 0.0 } else { variance.sqrt() }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_forgiven_and_a_lost_covariance_is_named() {
        let roots = |variances: &[f64]| standard_deviations(variances, "P", |number| format!("value {number}"));
        assert_eq!(roots(&[4.0, 0.0, -1e-9]).unwrap(), [2.0, 0.0, 0.0]);
        assert!(roots(&[4.0, f64::NAN]).unwrap()[1].is_nan());
        let error = roots(&[4.0, 1.0, -1e-3]).unwrap_err().to_string();
        assert!(error.contains("P is not positive semidefinite") && error.contains("value 2 is -0.001"), "{error}");
        assert!(roots(&[-1.0, -2.0]).is_err());
    }
}
