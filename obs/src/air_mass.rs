//! Air-mass predictors: biases that depend on the state.

use crate::bias::BiasProcess;
use crate::error::{ObservationError, require};
use crate::jacobian::Jacobian;
use crate::operator::{LinearOperator, ObservationOperator};
use crate::predictor::Predictor;
use crate::sparse::SparseRows;
use isobar_model::{Layout, State};

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

/// Observations some of whose biases depend on the state:
///
/// ```text
/// h(x, c) = X x + (G + P(x)) c,     P_ij(x) = p_j(x) of observation i
/// ```
///
/// It is bilinear in x and c. A method gets it [anchored](ObservationOperator::anchored) at its background.
#[derive(Clone, Debug)]
pub(crate) struct AirMassOperator {
    /// X and G.
    linear: LinearOperator,
    /// P: the predictors of each observation.
    predictors: Vec<Vec<Predictor>>,
}

impl AirMassOperator {
    /// The operator of X and G, and of the predictors of each observation.
    pub fn new(linear: LinearOperator, predictors: Vec<Vec<Predictor>>) -> Self {
        Self { linear, predictors }
    }

    /// G + P(x).
    fn calibration_rows(&self, x: &State) -> SparseRows {
        let mut rows = SparseRows::new();
        for (number, predictors) in self.predictors.iter().enumerate() {
            let fixed = self.linear.jacobian.calibration.row(number).iter().copied();
            rows.push_row(fixed.chain(predictors.iter().map(|predictor| predictor.entry(x))));
        }
        rows
    }
}

impl ObservationOperator for AirMassOperator {
    fn len(&self) -> usize {
        self.linear.len()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        let mut simulated = self.linear.simulate(x, calibration);
        for (value, predictors) in simulated.iter_mut().zip(&self.predictors) {
            *value += predictors.iter().map(|predictor| predictor.bias(x, calibration)).sum::<f64>();
        }
        simulated
    }

    /// ∂h/∂x = X + Σ_j c_j ∂p_j/∂x and ∂h/∂c = G + P(x).
    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian {
        let mut state = SparseRows::new();
        for (number, predictors) in self.predictors.iter().enumerate() {
            let mut row = self.linear.jacobian.state.row(number).to_vec();
            for predictor in predictors {
                let coefficient = calibration[predictor.parameter];
                for &(column, weight) in &predictor.row {
                    match row.iter_mut().find(|entry| entry.0 == column) {
                        Some(entry) => entry.1 += coefficient * weight,
                        None => row.push((column, coefficient * weight)),
                    }
                }
            }
            state.push_row(row);
        }
        Jacobian { state, calibration: self.calibration_rows(x) }
    }

    fn anchored(&self, background: &State) -> Option<LinearOperator> {
        let (state, calibration) = (self.linear.jacobian.state.clone(), self.calibration_rows(background));
        Some(LinearOperator { jacobian: Jacobian { state, calibration } })
    }
}
