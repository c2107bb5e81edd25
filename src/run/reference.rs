//! The reference of quality control: a forecast that no observation and no truth ever touches.

use isobar_assim::covariance::Covariance;
use isobar_model::{ForecastError, Model, State, forecast};
use isobar_obs::{QualityControl, WindowStates, quality};
use std::sync::Arc;

/// A forecast from the first background, and how observations are compared with it.
pub struct Reference {
    control: QualityControl,
    model: Arc<dyn Model>,
    steps_per_cycle: usize,
    /// The states through the last window, or the last one alone where nothing is observed before it.
    states: Vec<State>,
    keeps_window: bool,
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
        Self { control, model, steps_per_cycle, states: vec![state], keeps_window, variances, sigma, growth }
    }

    /// How observations are compared, and with which state.
    pub fn now(&self) -> (&QualityControl, quality::Reference<'_>) {
        let window = self.model.time_step() * self.steps_per_cycle;
        let states = WindowStates::new(&self.states, window);
        (&self.control, quality::Reference { states, sigma: &self.sigma })
    }

    /// Goes on by one cycle, to the end of the given one. A forecast that blows up leaves the reference as it is: an old one is better than none.
    pub fn advance(&mut self, cycle: usize) {
        let variances = self.variances.iter().zip(&self.growth);
        self.sigma = variances.map(|(start, growth)| (start + cycle as f64 * growth).sqrt()).collect();
        if let Ok(states) = through_window(&*self.model, self.state(), self.steps_per_cycle, self.keeps_window) {
            self.states = states;
        }
    }

    /// Its state, for a checkpoint.
    pub fn state(&self) -> &State {
        self.states.last().expect("there is always a state")
    }

    /// Takes back what [`Reference::state`] gave; whether it fits.
    pub fn restore(&mut self, saved: State) -> bool {
        let fits = saved.layout() == self.state().layout();
        if fits {
            self.states = vec![saved];
        }
        fits
    }
}

/// The states of a forecast from its start to its end, or the one at its end alone.
///
/// # Errors
/// If it leaves the finite numbers.
pub(super) fn through_window(
    model: &dyn Model,
    start: &State,
    steps: usize,
    keeps_window: bool,
) -> Result<Vec<State>, ForecastError> {
    if keeps_window {
        return forecast::trajectory(model, start, steps);
    }
    let mut end = start.clone();
    forecast::forecast(model, &mut end, steps)?;
    Ok(vec![end])
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
