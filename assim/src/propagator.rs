//! The propagator A of one cycle as a matrix.

use crate::error::Error;
use isobar_model::{State, TangentLinear, forecast};

/// Forecasts `state` by `steps` steps and returns the tangent-linear propagator along that trajectory, column-major
/// `[m, m]`.
///
/// # Errors
/// If the forecast leaves the finite numbers.
pub(crate) fn propagator(model: &dyn TangentLinear, state: &mut State, steps: usize) -> Result<Vec<f64>, Error> {
    let m = state.values().len();
    let mut columns = vec![0.0; m * m];
    columns.iter_mut().step_by(m + 1).for_each(|diagonal| *diagonal = 1.0);
    forecast::forecast_tl(model, state, &mut columns, steps)?;
    Ok(columns)
}
