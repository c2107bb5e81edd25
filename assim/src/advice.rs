//! What an observation that has not been made would tell.

use crate::covariance_column::{CovarianceColumn, JointErrors, Unknown};
use crate::error::Error;
use crate::linalg::{cholesky, solve_lower};
use faer::Mat;

/// By how much observations would reduce the variance of one functional vᵀs of the unknowns s = (x, c), as the errors of a
/// method with covariance P go together:
///
/// ```text
/// observation hᵀs + ε, Var ε = r         vᵀ P h (hᵀ P h + r)⁻¹ hᵀ P v
/// several, H s + ε, R = diag(r)          vᵀ P Hᵀ (H P Hᵀ + R)⁻¹ H P v
/// ```
///
/// what the analysis of a Kalman filter takes off vᵀ P v, whatever the value that is observed (Berliner, Lu and Snyder 1999, J.
/// Atmos. Sci. 56; Bishop and Toth 1999, J. Atmos. Sci. 56, on adaptive observations). P v is found once; each observation costs
/// what [`JointErrors::covariance_between`] does.
pub struct Advice<'a> {
    errors: &'a dyn JointErrors,
    /// P v.
    with_functional: CovarianceColumn,
    /// vᵀ P v.
    variance: f64,
}

impl<'a> Advice<'a> {
    /// Of a functional, by the unknowns of which it is a combination; `None` if the method does not estimate one of them.
    pub fn new(errors: &'a dyn JointErrors, functional: &[(Unknown, f64)]) -> Option<Self> {
        let with_functional = errors.covariance_with(functional)?;
        let variance = with_functional.with_combination(functional);
        Some(Self { errors, with_functional, variance })
    }

    /// vᵀ P v, the variance of the functional now.
    pub fn variance(&self) -> f64 {
        self.variance
    }

    /// What observations with these combinations of unknowns and error variances, made together, would take off the variance
    /// of the functional; 0 for none, and for one of what is known exactly. `None` if the method does not estimate an unknown of theirs.
    ///
    /// # Errors
    /// [`Error::NotPositiveDefinite`] for several of which one follows from the others without error.
    pub fn reduction(&self, rows: &[(Vec<(Unknown, f64)>, f64)]) -> Result<Option<f64>, Error> {
        let seen: Vec<f64> = rows.iter().map(|(h, _)| self.with_functional.with_combination(h)).collect();
        if rows.is_empty() {
            return Ok(Some(0.0));
        }
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
        let root = cholesky(system, || "the covariance of the observations that are proposed".into())?;
        let mut whitened = Mat::from_fn(k, 1, |i, _| seen[i]);
        solve_lower(root.as_ref(), whitened.as_mut());
        Ok(Some(whitened.col_as_slice(0).iter().map(|value| value * value).sum()))
    }
}
