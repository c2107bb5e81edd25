//! The first guess at appropriate time: observations of a window, each compared with the background at its time.

use crate::jacobian::Jacobian;
use crate::operator::{ObservationOperator, TimedObservations};
use crate::sparse::SparseRows;
use isobar_model::{Duration, State};
use std::sync::Arc;

/// h(x, c) of observations that are valid before the end of their window, where x is the state at its end, t_a. With the
/// trajectory x_b(t) of the background through the window
///
/// ```text
/// h_i(x, c) = H_i x + G_i c + δ_i,      δ_i = H_i x_b(t_i) − H_i x_b(t_a)
/// ```
///
/// so that the innovation is the one at appropriate time, and increments are seen as if they were those at t_a:
///
/// ```text
/// d_i = y_i − H_i x_b(t_i) − G_i c,     y_i − h_i(x_b + δx, c) = d_i − H_i δx
/// ```
///
/// This is FGAT (Lawless 2010, ICIAM 2007 proceedings; Massart, Pajot, Piacentini and Pannekoucke 2010, Mon. Wea. Rev. 138,
/// 3082–3087): 4D-Var with a tangent-linear model that is the identity. What it leaves out is that an error of the background
/// has been elsewhere at t_i, (M_{t_a←t_i} − I) e. δ does not depend on x and c: the Jacobians are those of H at t_a, and
/// every method that takes an observation operator takes this one.
///
/// Until the background is known δ is 0.
#[derive(Clone)]
pub struct WithinWindow {
    /// The observations as if they were valid at the end of the window.
    whole: Arc<dyn ObservationOperator>,
    /// How long before the end of the window each is valid.
    lags: Arc<[Duration]>,
    /// δ.
    shift: Arc<[f64]>,
}

impl WithinWindow {
    /// Observations with the time by which each precedes the end of the window; `whole` itself if all are valid at the end.
    ///
    /// # Panics
    /// As [`WithinWindow::new`].
    pub fn around(whole: Arc<dyn ObservationOperator>, lags: Vec<Duration>) -> Arc<dyn ObservationOperator> {
        if lags.iter().all(|lag| lag.seconds() == 0) {
            return whole;
        }
        let shift = vec![0.0; lags.len()];
        Arc::new(Self::new(whole, lags, shift))
    }

    /// Observations with the time by which each precedes the end of the window, and δ.
    ///
    /// # Panics
    /// Unless `lags` and `shift` have one entry for each observation.
    pub fn new(whole: Arc<dyn ObservationOperator>, lags: Vec<Duration>, shift: Vec<f64>) -> Self {
        assert_eq!([whole.len(); 2], [lags.len(), shift.len()], "each observation has its time and its shift");
        Self { whole, lags: lags.into(), shift: shift.into() }
    }
}

impl ObservationOperator for WithinWindow {
    fn len(&self) -> usize {
        self.whole.len()
    }

    fn simulate(&self, x: &State, calibration: &[f64]) -> Vec<f64> {
        let mut simulated = self.whole.simulate(x, calibration);
        simulated.iter_mut().zip(&*self.shift).for_each(|(value, shift)| *value += shift);
        simulated
    }

    fn linearize(&self, x: &State, calibration: &[f64]) -> Jacobian {
        self.whole.linearize(x, calibration)
    }

    fn linearize_calibration(&self, x: &State, calibration: &[f64]) -> SparseRows {
        self.whole.linearize_calibration(x, calibration)
    }

    fn anchored(&self, background: &State) -> Option<Arc<dyn ObservationOperator>> {
        let whole = self.whole.anchored(background)?;
        Some(Arc::new(Self { whole, ..self.clone() }))
    }

    fn within_window(&self) -> Option<TimedObservations<'_>> {
        Some(TimedObservations { whole: &self.whole, lags: &self.lags, shift: &self.shift })
    }
}
