//! How much a proposed observation would reduce an error variance.

use crate::covariance_column::{CovarianceColumn, JointErrors, Unknown};
use crate::error::Error;
use crate::linalg::{cholesky, solve_lower};
use faer::Mat;

/// By how much observations would reduce the error variance of a functional vᵀs of the unknowns s = (x, c), given a method's
/// error covariance P:
///
/// ```text
/// observation hᵀs + ε, Var ε = r         vᵀ P h (hᵀ P h + r)⁻¹ hᵀ P v
/// several, H s + ε, R = diag(r)          vᵀ P Hᵀ (H P Hᵀ + R)⁻¹ H P v
/// ```
///
/// This is the reduction of vᵀ P v in the analysis of a Kalman filter, whatever the observed value (Berliner, Lu and Snyder 1999,
/// J. Atmos. Sci. 56; Bishop and Toth 1999, J. Atmos. Sci. 56, on adaptive observations). P v is computed once; one
/// observation then costs one [`JointErrors::covariance_between`], k together k (k + 1)/2.
pub struct Advice<'a> {
    errors: &'a dyn JointErrors,
    /// P v.
    with_functional: CovarianceColumn,
    /// vᵀ P v.
    variance: f64,
}

impl<'a> Advice<'a> {
    /// Advice for a functional, given as a combination of unknowns; `None` if the method does not estimate one of them.
    pub fn new(errors: &'a dyn JointErrors, functional: &[(Unknown, f64)]) -> Option<Self> {
        let with_functional = errors.covariance_with(functional)?;
        let variance = with_functional.with_combination(functional);
        Some(Self { errors, with_functional, variance })
    }

    /// vᵀ P v, the variance of the functional now.
    pub fn variance(&self) -> f64 {
        self.variance
    }

    /// By how much observations, each a combination of unknowns with an error variance, would together reduce the variance of
    /// the functional: 0 without observations, or for a single one of something that is known exactly. `None` if the method does
    /// not estimate an unknown that they observe.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] if one of several observations follows from the others without error.
    pub fn reduction(&self, rows: &[(Vec<(Unknown, f64)>, f64)]) -> Result<Option<f64>, Error> {
        if rows.is_empty() {
            return Ok(Some(0.0));
        }
        let seen: Vec<f64> = rows.iter().map(|(h, _)| self.with_functional.with_combination(h)).collect();
        if let [(h, r)] = rows {
            let Some(variance) = self.errors.covariance_between(h, h) else { return Ok(None) };
            let total = variance + r;
            return Ok(Some(if total > 0.0 { seen[0] * seen[0] / total } else { 0.0 }));
        }
        let k = rows.len();
        let mut system = Mat::<f64>::zeros(k, k);
        for (i, (a, r)) in rows.iter().enumerate() {
            for (j, (b, _)) in rows.iter().enumerate().take(i + 1) {
                let Some(covariance) = self.errors.covariance_between(a, b) else { return Ok(None) };
                (system[(i, j)], system[(j, i)]) = (covariance, covariance);
            }
            system[(i, i)] += r;
        }
        let root = cholesky(system, || "the covariance of the proposed observations".into())?;
        let mut whitened = Mat::from_fn(k, 1, |i, _| seen[i]);
        solve_lower(root.as_ref(), whitened.as_mut());
        Ok(Some(whitened.col_as_slice(0).iter().map(|value| value * value).sum()))
    }
}
