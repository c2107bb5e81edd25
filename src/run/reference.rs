//! The reference of quality control: a forecast that no observation and no truth ever touches.

use super::through_window::ThroughWindow;
use isobar_assim::covariance::Covariance;
use isobar_model::{Model, State};
use isobar_obs::{QualityControl, quality};
use std::sync::Arc;

/// A forecast from the first background, and how observations are compared with it.
pub struct Reference {
    control: QualityControl,
    run: ThroughWindow,
    /// What is assumed of its errors: the variances of the variables at the start, what each cycle adds to them, and the
    /// standard deviations now.
    variances: Vec<f64>,
    sigma: Vec<f64>,
    growth: Vec<f64>,
}

impl Reference {
    /// The forecast that begins at `state`, with the covariances of its error then and of what each cycle adds; `keeps_window`:
    /// with its states within a window.
    pub fn new(
        control: QualityControl,
        model: Arc<dyn Model>,
        steps_per_cycle: usize,
        state: State,
        keeps_window: bool,
        background_error: &dyn Covariance,
        model_error: Option<&dyn Covariance>,
    ) -> Self {
        let variances = mean_variances(background_error, &state);
        let sigma = variances.iter().map(|variance| variance.sqrt()).collect();
        let growth = match model_error {
            Some(covariance) => mean_variances(covariance, &state),
            None => vec![0.0; state.layout().variables.len()],
        };
        let run = ThroughWindow::new(model, steps_per_cycle, state, keeps_window);
        Self { control, run, variances, sigma, growth }
    }

    /// How observations are compared, and with which state.
    pub fn now(&self) -> (&QualityControl, quality::Reference<'_>) {
        (&self.control, quality::Reference { states: self.run.window(), sigma: &self.sigma })
    }

    /// Goes on by one cycle, to the end of the given one. A forecast that blows up leaves the reference as it is: an old one is
    /// better than nothing.
    pub fn advance(&mut self, cycle: usize) {
        let variances = self.variances.iter().zip(&self.growth);
        self.sigma = variances.map(|(start, growth)| (start + cycle as f64 * growth).sqrt()).collect();
        let _ = self.run.advance();
    }

    /// Its state, for a checkpoint.
    pub fn state(&self) -> &State {
        self.run.state()
    }

    /// Takes back what [`Reference::state`] gave; whether it fits.
    pub fn restore(&mut self, saved: State) -> bool {
        self.run.restore(saved)
    }
}

/// The mean variance of each variable of a covariance, from at most 16 places spread over the domain.
pub fn mean_variances(covariance: &dyn Covariance, state: &State) -> Vec<f64> {
    let cells = state.layout().grid.cells();
    let places: Vec<usize> = (0..16.min(cells)).map(|place| (2 * place + 1) * cells / (2 * 16.min(cells))).collect();
    let of_variable = |variable: usize| {
        let variances = places.iter().map(|place| {
            let index = variable * cells + place;
            covariance.covariance(index, index)
        });
        variances.sum::<f64>() / places.len() as f64
    };
    (0..state.layout().variables.len()).map(of_variable).collect()
}
