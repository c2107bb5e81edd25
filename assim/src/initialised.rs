//! A method whose calibration comes from its first observations, by Lange's High-pass Filter.

use crate::assimilator::{Analysis, Assimilator, Estimate};
use crate::error::Error;
use crate::estimated::EstimatedParameter;
use crate::high_pass::{HighPassFilter, HighPassSettings, HighPassSolution, in_words};
use crate::problem::Problem;
use crate::saved::{Matrix, from_bytes, to_bytes, unfit};
use faer::{Mat, MatRef};
use isobar_model::{Duration, State};
use isobar_obs::ObservationWindow;
use serde::{Deserialize, Serialize};

/// In the first cycles but one of the batch it only forecasts, from the background with its covariance, while their
/// observations go to the [`HighPassFilter`]. In the last of them the method is given ĉ and Cov(ĉ) in place of the
/// parameters' priors and analyses for the first time. So no observation is used twice, and the errors of ĉ, for which no
/// background was believed, are independent of the state's.
pub struct Initialised {
    inner: Box<dyn Assimilator>,
    problem: Problem,
    filter: HighPassFilter,
    cycles: usize,
    /// Analyses so far, up to the batch's last.
    done: usize,
    /// The last forecast within the batch.
    background: Option<Estimate>,
    solution: Option<HighPassSolution>,
    /// Whether a cycle has begun since the solution was found.
    told: bool,
}

#[derive(Serialize, Deserialize)]
struct Saved {
    inner: Vec<u8>,
    done: usize,
    triangle: Matrix,
}

impl Initialised {
    /// A method of `problem` that starts from its first `settings.cycles` cycles.
    ///
    /// # Errors
    /// [`Error::Setting`] for less than two cycles, and if there is nothing to calibrate.
    pub fn new(inner: Box<dyn Assimilator>, problem: Problem, settings: HighPassSettings) -> Result<Self, Error> {
        if settings.cycles < 2 {
            return Err(Error::Setting("a high-pass initialisation needs two cycles at least".into()));
        }
        let calibration = problem.estimated_calibration();
        if calibration.is_empty() {
            return Err(Error::Setting("there is no calibration parameter that this method could initialise".into()));
        }
        let filter = HighPassFilter::new(calibration, problem.background_error.clone(), settings);
        Ok(Self {
            inner,
            problem,
            filter,
            cycles: settings.cycles,
            done: 0,
            background: None,
            solution: None,
            told: false,
        })
    }

    /// What the batch came to, once it is complete.
    pub fn solution(&self) -> Option<&HighPassSolution> {
        self.solution.as_ref()
    }

    fn batch_state(&self) -> Result<&State, Error> {
        let background = self.background.as_ref();
        background.map(|it| &it.state).ok_or_else(|| Error::Setting("an analysis needs a forecast before it".into()))
    }
}

impl Assimilator for Initialised {
    fn forecast(&mut self, window: Duration) -> Result<Estimate, Error> {
        let estimate = self.inner.forecast(window)?;
        if self.done < self.cycles {
            self.background = Some(estimate.clone());
        }
        self.told = self.done == self.cycles;
        Ok(estimate)
    }

    fn analyse(&mut self, observed: &ObservationWindow) -> Result<Analysis, Error> {
        if self.done >= self.cycles {
            return self.inner.analyse(observed);
        }
        self.done += 1;
        if self.done == self.cycles {
            let solution = self.filter.solve();
            self.inner.set_calibration(&solution.estimate, solution.covariance.as_ref())?;
            self.solution = Some(solution);
            self.background = None;
            return self.inner.analyse(observed);
        }
        let state = self.batch_state()?.clone();
        self.filter.observe(observed, &state)?;
        let background = self.background.clone().expect("there is its state");
        let departures = self.problem.departures(observed, &background.state, &background.calibration);
        Ok(Analysis {
            estimate: background,
            analysis_departures: departures.clone(),
            background_departures: departures,
            innovation_chi2: None,
            partition: None,
            warnings: Vec::new(),
        })
    }

    fn inner(&self) -> Option<&dyn Assimilator> {
        Some(&*self.inner)
    }

    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        if self.done < self.cycles {
            let message = "a recalibration within the cycles of [initialise] is none that their batch could take up";
            return Err(Error::Setting(message.into()));
        }
        self.inner.widen_calibration(covariance)
    }

    fn parameters(&self) -> Vec<EstimatedParameter> {
        let mut parameters = self.inner.parameters();
        // Told once, in the cycle in which it is found out.
        if let (Some(solution), false) = (&self.solution, self.told) {
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

    fn save(&self) -> Result<Vec<u8>, Error> {
        to_bytes(&Saved { inner: self.inner.save()?, done: self.done, triangle: self.filter.triangle().into() })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        let Saved { inner, done, triangle } = from_bytes(saved)?;
        self.inner.restore(&inner)?;
        if done > self.cycles {
            return Err(unfit("the number of cycles of the batch"));
        }
        let p = self.problem.calibration.len();
        let rows = triangle.rows();
        let triangle: Mat<f64> = triangle.restored(rows.min(p + 1), Some(p + 1), "what the batch came to")?;
        self.filter.restore(triangle);
        self.done = done;
        Ok(())
    }
}
