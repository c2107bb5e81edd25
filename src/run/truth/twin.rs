//! A truth that is a model run of its own, with stochastic model error.

use crate::run::through_window::ThroughWindow;
use isobar_assim::{Covariance, covariance};
use isobar_model::{ForecastError, State};
use isobar_obs::WindowStates;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// A true world that follows a model.
pub struct Twin {
    /// Its state at the end of a window has the random errors.
    run: ThroughWindow,
    /// Covariance of what a cycle adds, and the factor on its standard deviation.
    model_error: Option<(Arc<dyn Covariance>, f64)>,
    random: ChaCha8Rng,
    /// What its variability may come to without being a fault: root mean squares of each variable about its mean at the start,
    /// with the model errors of all cycles.
    scales: Vec<f64>,
}

/// A truth that has left all that its start and its model errors account for.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the model is unstable: the root mean square of {variable} about its mean has grown from {from:.3e} to {to:.3e} {unit}, and \
     that of all other variables as much; shorten time_step_s, or add damping"
)]
pub struct Growth {
    /// The variable that has grown least.
    pub variable: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// What its variability was, with model errors.
    pub from: f64,
    /// What it is.
    pub to: f64,
}

impl Twin {
    /// A world that follows a model run for this number of cycles, with random errors of the given covariance and factor on
    /// the standard deviation.
    pub fn new(
        run: ThroughWindow,
        cycles: usize,
        model_error: Option<(Arc<dyn Covariance>, f64)>,
        random: ChaCha8Rng,
    ) -> Self {
        let scales =
            scales(run.state(), model_error.as_ref().map(|(covariance, factor)| (&**covariance, *factor)), cycles);
        Self { run, model_error, random, scales }
    }

    /// Says whether the truth has grown by orders of magnitude, in every variable that varied at the start: a model that gains
    /// energy from nowhere does not stop at what is finite. Instabilities of a flow feed on what varies already.
    ///
    /// # Errors
    /// [`Growth`].
    pub fn check_growth(&self) -> Result<(), Growth> {
        /// Orders of magnitude that no experiment needs.
        const LARGEST: f64 = 1e3;
        let layout = self.state().layout();
        let factors = self.scales.iter().enumerate().filter(|(_, scale)| **scale > 0.0).map(|(number, &from)| {
            let to = self.state().variability(number);
            (
                to / from,
                Growth { variable: layout.variables[number].name, unit: layout.variables[number].unit, from, to },
            )
        });
        match factors.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((factor, growth)) if factor > LARGEST => Err(growth),
            _ => Ok(()),
        }
    }

    /// The true state now.
    pub fn state(&self) -> &State {
        self.run.state()
    }

    /// The true states through the last window.
    pub fn window(&self) -> WindowStates<'_> {
        self.run.window()
    }

    /// Everything that the next cycles depend on and the scenario does not determine: its state, and the numbers drawn so far,
    /// in words of 32 bits.
    pub fn save(&self) -> (State, u128) {
        (self.state().clone(), self.random.get_word_pos())
    }

    /// Takes back what [`Twin::save`] gave; whether it fits.
    pub fn restore(&mut self, state: State, random: u128) -> bool {
        let fits = self.run.restore(state);
        if fits {
            self.random.set_word_pos(random);
        }
        fits
    }

    /// Goes on by one cycle.
    ///
    /// # Errors
    /// If the true state leaves the finite numbers.
    pub fn advance(&mut self) -> Result<(), ForecastError> {
        self.run.advance()?;
        if let Some((covariance, factor)) = &self.model_error {
            let error = covariance::randomize(&**covariance, &mut self.random);
            self.run.add(error.iter().map(|error| factor * error));
        }
        Ok(())
    }
}

/// What each variable varies by at the start, and by the model errors of so many cycles, at most 16 places of which are asked.
fn scales(state: &State, model_error: Option<(&dyn Covariance, f64)>, cycles: usize) -> Vec<f64> {
    let cells = state.layout().grid.cells();
    let of_errors = |variable: usize| {
        model_error.map_or(0.0, |(covariance, factor)| {
            let places = (0..cells).step_by(cells.div_ceil(16)).map(|cell| variable * cells + cell);
            let largest = places.map(|index| covariance.covariance(index, index)).fold(0.0, f64::max);
            factor * (cycles as f64 * largest).sqrt()
        })
    };
    (0..state.layout().variables.len()).map(|it| state.variability(it).hypot(of_errors(it))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::stream;
    use isobar_model::{Boundary, Duration, Grid, Layout, Model, advection};

    /// Multiplies all values by a factor in a step.
    struct Growing {
        layout: Arc<Layout>,
        factor: f64,
    }

    impl Model for Growing {
        fn layout(&self) -> &Arc<Layout> {
            &self.layout
        }
        fn time_step(&self) -> Duration {
            Duration::from_seconds(1)
        }
        fn largest_time_step_s(&self, _: &State) -> f64 {
            f64::INFINITY
        }
        fn step(&self, x: &mut State) {
            x.values_mut().iter_mut().for_each(|value| *value *= self.factor);
        }
    }

    #[test]
    fn a_truth_that_grows_a_thousandfold_is_named_and_one_that_does_not_is_not() {
        let layout = advection::layout(Grid { nx: 4, ny: 3, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic });
        let start = State::from_values(&layout, (0..12).map(|i| 10.0 + f64::from(i)).collect());
        let growth = |factor: f64| {
            let model = Arc::new(Growing { layout: Arc::clone(&layout), factor });
            let mut truth =
                Twin::new(ThroughWindow::new(model, 10, start.clone(), false), 30, None, stream(1, "truth"));
            (1..=30).find_map(|cycle| {
                truth.advance().unwrap();
                truth.check_growth().err().map(|growth| (cycle, growth.to_string()))
            })
        };
        assert_eq!(growth(1.0), None);
        assert_eq!(growth(1.02), None);
        // 1.1^(10 n) > 1000 from n = 8 on.
        let (cycle, message) = growth(1.1).unwrap();
        assert!(cycle == 8 && message.contains("tracer") && message.contains("time_step_s"), "{cycle}: {message}");
    }
}
