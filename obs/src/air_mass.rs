//! Air-mass predictors: biases that depend on the state.

use crate::bias::BiasProcess;
use crate::error::{ObservationError, require};
use isobar_model::Layout;

/// A part of a bias that is proportional to an air-mass predictor,
///
/// ```text
/// bias = β p(x),   p(x) = (H_v x − mean) / scale
/// ```
///
/// where H_v sees one variable as the instrument sees what it observes, with the same footprint (Harris and Kelly 2001,
/// Q. J. R. Meteorol. Soc. 127, 1453–1468; Dee 2005, Q. J. R. Meteorol. Soc. 131, 3323–3343). p has no unit, and β has that of
/// the observed variable: the change of the bias where the predictor changes by `scale`.
#[derive(Clone, Debug, PartialEq)]
pub struct AirMassBias {
    /// The predictor's variable; each at most once.
    pub variable: String,
    /// What is subtracted from it, in its unit; near its mean, so that β is not taken for an offset.
    pub mean: f64,
    /// What it is divided by, in its unit; above 0.
    pub scale: f64,
    /// How β behaves.
    pub process: BiasProcess,
}

impl AirMassBias {
    /// Its name in that of the parameter: `polar/air_mass_h`.
    pub(crate) fn name(&self) -> String {
        format!("air_mass_{}", self.variable)
    }

    /// The number of the predictor's variable in the layout.
    pub(crate) fn find(&self, layout: &Layout, network: &str) -> Result<usize, ObservationError> {
        let expected = "above 0, in the unit of the predictor's variable";
        require(self.scale > 0.0, network, "biases.scale", self.scale, expected)?;
        require(true, network, "biases.mean", self.mean, "finite")?;
        layout.variable(&self.variable).ok_or_else(|| {
            let valid = layout.variables.iter().map(|variable| variable.name);
            ObservationError::unknown_name(network, "biases.variable", &self.variable, valid)
        })
    }
}
