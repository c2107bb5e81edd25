//! A decorator that turns observations with correlated errors into observations with independent errors.

use crate::assimilator::{Adjustments, Assimilator, Views};
use crate::error::Error;
use crate::estimate::{Analysis, Background};
use crate::structure::{BlockStructure, Structure};
use isobar_model::{Duration, State};
use isobar_obs::{ErrorRegression, Jacobian, ObservationOperator, ObservationWindow, SparseRows, WithinWindow};
use std::borrow::Cow;
use std::io::{Read, Write};
use std::sync::Arc;

/// Any method, on observations with correlated errors. Methods assume independent errors; with R = U D Uᵀ from a window's
/// [`ErrorRegression`] and T = U⁻¹, the method is given
///
/// ```text
/// T y = T h(x, c) + T ε,    T ε ~ N(0, D),    D diagonal
/// ```
///
/// which is the same problem: (y − h)ᵀ R⁻¹ (y − h) = |D^-½ T (y − h)|², so that gain, χ², gradients and claimed errors are those
/// of the full R. T h has the Jacobian T (X, G): beside its own footprint and biases, an observation reads those of the
/// observations of its report on whose errors its error depends. The method's departures are transformed back by U; a window
/// without correlated errors is passed on as it is.
///
/// A row has the place of its own observation. A method that localises by places does not solve the problem with the full R:
/// where an observation is near, and the one before it in its report is not, the localised analysis uses their difference, but
/// not what the two have in common.
#[derive(Clone)]
pub struct Whitened {
    method: Box<dyn Assimilator>,
}

impl Whitened {
    /// The method, on any observations.
    pub fn new(method: Box<dyn Assimilator>) -> Self {
        Self { method }
    }
}

/// T h(x, c).
struct WhitenedOperator {
    whole: Arc<dyn ObservationOperator>,
    regression: ErrorRegression,
    /// σ of the errors before T.
    sigma: Vec<f64>,
}

impl ObservationOperator for WhitenedOperator {
    fn len(&self) -> usize {
        self.whole.len()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        let mut simulated = self.whole.simulate(x, calibration);
        self.regression.whiten(&self.sigma, &mut simulated);
        simulated
    }

    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian {
        let whole = self.whole.linearize(x, calibration);
        Jacobian {
            state: self.regression.whiten_rows(&self.sigma, &whole.state),
            calibration: self.regression.whiten_rows(&self.sigma, &whole.calibration),
        }
    }

    fn linearize_calibration(&self, x: &State, calibration: &[f64]) -> SparseRows {
        self.regression.whiten_rows(&self.sigma, &self.whole.linearize_calibration(x, calibration))
    }

    fn anchored(&self, background: &State) -> Option<Arc<dyn ObservationOperator>> {
        let whole = self.whole.anchored(background)?;
        Some(Arc::new(Self { whole, regression: self.regression.clone(), sigma: self.sigma.clone() }))
    }
}

/// The same observations with independent errors.
fn whitened(observed: &ObservationWindow) -> Cow<'_, ObservationWindow> {
    let regression = &observed.error_regression;
    if regression.is_independent() {
        return Cow::Borrowed(observed);
    }
    let mut values = observed.values.clone();
    regression.whiten(&observed.sigma, &mut values);
    let whitened = |whole: &Arc<dyn ObservationOperator>| -> Arc<dyn ObservationOperator> {
        let (whole, regression, sigma) = (Arc::clone(whole), regression.clone(), observed.sigma.clone());
        Arc::new(WhitenedOperator { whole, regression, sigma })
    };
    // The observations of a report have one time, so that T mixes none of different times.
    let operator = match observed.operator.within_window() {
        None => whitened(&observed.operator),
        Some(within) => {
            let mut shift = within.shift.to_vec();
            regression.whiten(&observed.sigma, &mut shift);
            Arc::new(WithinWindow::new(whitened(within.whole), within.lags.to_vec(), shift))
        }
    };
    Cow::Owned(ObservationWindow {
        values,
        sigma: regression.whitened_sigma(&observed.sigma),
        error_regression: ErrorRegression::default(),
        operator,
        ..observed.clone()
    })
}

impl Assimilator for Whitened {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.method.forecast(window)
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        let given = whitened(observed);
        let mut analysis = self.method.analyse(from, &given)?;
        if let Cow::Owned(_) = given {
            for departures in [&mut analysis.background_departures, &mut analysis.analysis_departures] {
                observed.error_regression.correlate(&observed.sigma, departures);
            }
        }
        Ok(analysis)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        self.method.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        self.method.recall(from)
    }

    fn can(&self) -> Views<'_> {
        let views = self.method.can();
        Views { blocks: views.blocks.map(|_| self as &dyn BlockStructure), ..views }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        self.method.adjust()
    }
}

impl BlockStructure for Whitened {
    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Structure {
        let blocks = self.method.can().blocks.expect("a view of a method with blocks");
        blocks.structure(&whitened(observed), factors)
    }
}
