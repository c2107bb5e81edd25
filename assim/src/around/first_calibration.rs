//! A method whose calibration comes from its first observations, by Lange's High-pass Filter.

use crate::assimilator::{Adjustments, Assimilator, CalibrationAdjustment, Views, WidenCalibration};
use crate::error::Error;
use crate::estimate::{Analysis, Background};
use crate::estimated::{EstimatedParameter, EstimatesParameters};
use crate::high_pass::{self, HighPassFilter, HighPassSettings, HighPassSolution, in_words};
use crate::memory::{Matrix, read, require, write};
use crate::problem::Problem;
use faer::MatRef;
use isobar_model::{Duration, Model};
use isobar_obs::ObservationWindow;
use std::io::{Read, Write};

/// In the first cycles but one of the batch it only forecasts, from the background with its covariance, while their
/// observations go to the [`HighPassFilter`]. In the last of them the method is given ĉ and Cov(ĉ) in place of the
/// parameters' priors and analyses for the first time. So no observation is used twice, and the errors of ĉ, for which no
/// background was believed, are independent of the state's.
#[derive(Clone)]
pub struct Initialised {
    inner: Box<dyn Assimilator>,
    problem: Problem<dyn Model>,
    filter: HighPassFilter,
    cycles: usize,
    /// Analyses so far, up to the batch's last.
    done: usize,
    solution: Option<HighPassSolution>,
    /// Whether a cycle has begun since the solution was found.
    is_reported: bool,
}

impl Initialised {
    /// A method of `problem` that starts from its first `settings.cycles` cycles.
    ///
    /// # Errors
    /// [`Error::Setting`] for less than two cycles, and if there is nothing to calibrate, or the method cannot start from
    /// another calibration.
    pub fn new(
        mut inner: Box<dyn Assimilator>,
        problem: impl Into<Problem<dyn Model>>,
        settings: HighPassSettings,
    ) -> Result<Self, Error> {
        let (problem, refuse) = (problem.into(), |message: &str| Err(Error::Setting(message.into())));
        if settings.cycles < 2 {
            return refuse("a high-pass initialisation needs two cycles at least");
        }
        let calibration = problem.estimated_calibration();
        if calibration.is_empty() {
            return refuse("there is no calibration parameter that this method could initialise");
        }
        if inner.adjust().replace().is_none() {
            return refuse("this method cannot start from another calibration than the parameters' priors");
        }
        // As if the observations lay evenly over the boxes; those of a cycle are counted when they come.
        let grid = &problem.background.layout().grid;
        let boxes = [grid.width_m(), grid.height_m()].map(|side_m| (side_m / settings.box_m).ceil().max(1.0));
        let (boxes, observations) = ((boxes[0] * boxes[1]).min(1e6) as usize, problem.most_observations);
        let numbers = high_pass::numbers((0..boxes).map(|_| observations / boxes), calibration.len());
        problem.require_memory(numbers, || in_words_of_size(observations, calibration.len()))?;
        let filter = HighPassFilter::new(calibration, problem.background_error.clone(), settings);
        Ok(Self { inner, problem, filter, cycles: settings.cycles, done: 0, solution: None, is_reported: false })
    }

    /// What the batch came to, once it is complete.
    pub fn solution(&self) -> Option<&HighPassSolution> {
        self.solution.as_ref()
    }
}

fn in_words_of_size(observations: usize, parameters: usize) -> String {
    format!(
        "the first calibration of {parameters} biases from {observations} observations, with the square of those in each box,"
    )
}

impl Assimilator for Initialised {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.is_reported = self.done == self.cycles;
        self.inner.forecast(window)
    }

    fn analyse(&mut self, from: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        if self.done >= self.cycles {
            return self.inner.analyse(from, observed);
        }
        self.done += 1;
        if self.done < self.cycles {
            let (numbers, p) = (self.filter.numbers(observed), self.problem.calibration.len());
            self.problem.require_memory(numbers, || in_words_of_size(observed.len(), p))?;
            self.filter.observe(observed, &from.estimate.state)?;
            return Ok(self.problem.unchanged(observed, from.estimate.clone()));
        }
        let solution = self.filter.solve();
        if let Some(calibration) = self.inner.adjust().replace() {
            calibration.replace_calibration(&solution.estimate, solution.covariance.as_ref())?;
        }
        self.solution = Some(solution);
        self.inner.analyse(from, observed)
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&(self.done, Matrix(self.filter.triangle().clone())), to)?;
        self.inner.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let (done, Matrix(triangle)): (usize, Matrix) = read(from)?;
        require(done <= self.cycles, "the number of cycles of the batch")?;
        let columns = self.problem.calibration.len() + 1;
        require(triangle.ncols() == columns && triangle.nrows() <= columns, "what the batch came to")?;
        self.filter.restore(triangle);
        self.done = done;
        self.inner.recall(from)
    }

    fn can(&self) -> Views<'_> {
        Views { parameters: Some(self), ..self.inner.can() }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        if self.done < self.cycles {
            return Adjustments { calibration: Some(CalibrationAdjustment::Widen(self)), error_factor: None };
        }
        self.inner.adjust()
    }
}

impl WidenCalibration for Initialised {
    /// Within the batch, whose observations are all of one calibration.
    fn widen_calibration(&mut self, _: MatRef<'_, f64>) -> Result<(), Error> {
        let message =
            "a recalibration within the cycles of [initialise] cannot be taken up: their batch has one calibration";
        Err(Error::Setting(message.into()))
    }
}

impl EstimatesParameters for Initialised {
    fn estimated_parameters(&self) -> Vec<EstimatedParameter> {
        let mut parameters = self.inner.can().parameters.map_or_else(Vec::new, |it| it.estimated_parameters());
        // Reported once, in the cycle in which it is found out.
        if let (Some(solution), false) = (&self.solution, self.is_reported) {
            let own = self.problem.calibration.parameters.iter().enumerate().map(|(number, parameter)| {
                let is_in = |it: &&Vec<(f64, String)>| it.iter().any(|term| term.1 == parameter.name);
                let undetermined: Vec<String> =
                    solution.undetermined.iter().filter(is_in).map(|it| in_words(it)).collect();
                let verdict = match undetermined.as_slice() {
                    [] => "determined".to_string(),
                    combinations => format!("not determined: {}", combinations.join("; ")),
                };
                EstimatedParameter {
                    name: format!("high-pass/{}", parameter.name),
                    unit: parameter.unit.clone(),
                    value: solution.estimate[number],
                    sigma: Some(solution.covariance[(number, number)].sqrt()),
                    verdict,
                }
            });
            parameters.extend(own);
        }
        parameters
    }
}
