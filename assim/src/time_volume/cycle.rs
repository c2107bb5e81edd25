//! The cycle of a time volume: forecast and analysis.

use super::factor::Target;
use super::history::History;
use super::observed::Coefficients;
use super::window::Information;
use super::{Amplitude, Memory, TimeVolume};
use crate::assimilator::{
    Adjustments, Assimilator, CalibrationAdjustment, ReplaceCalibration, Smoother, Views, WidenCalibration,
};
use crate::block_angular::PartitionReport;
use crate::calibration_accuracy::CalibrationErrors;
use crate::error::Error;
use crate::errors::blocks::Increments;
use crate::estimate::{Analysis, Background};
use crate::filter::{Cycle, ErrorBlocks, Errors};
use crate::memory::{Matrix, read, require, write};
use crate::problem::{Innovations, steps};
use crate::structure::{BlockStructure, Structure};
use faer::{Mat, MatRef};
use isobar_model::Duration;
use isobar_model::vector::{add, axpy, scale};
use isobar_obs::{ObservationWindow, SparseRows};
use std::io::{Read, Write};
use std::sync::Arc;

impl TimeVolume {
    /// What F^s adds to the forecast of a cycle.
    fn add_model_factors(&mut self) {
        let (p, first) = (self.parameters(), self.first_evolving());
        let Memory { s, sensitivity, reference, time, .. } = &mut self.memory;
        let cells = s.state.layout().grid.cells();
        // What adds the effect of an amplitude of some size to a field.
        let effect = |amplitude: &Amplitude| {
            let factor = &self.settings.factors[amplitude.factor];
            let Target::Forecast(variable) = factor.target else { return None };
            let height = factor.shape.value(amplitude.function, *time);
            let pattern = amplitude.pattern.map(|pattern| factor.patterns[pattern].as_slice());
            Some(move |field: &mut [f64], size: f64| {
                let field = &mut field[variable * cells..][..cells];
                field.iter_mut().enumerate().for_each(|(i, v)| *v += size * height * pattern.map_or(1.0, |it| it[i]));
            })
        };
        for (k, amplitude) in self.constant.iter().enumerate() {
            if let Some(add_effect) = effect(amplitude) {
                add_effect(s.state.values_mut(), reference[k]);
                sensitivity.state.edit_column(k, |column| add_effect(column, 1.0));
            }
        }
        // An evolving amplitude is an unknown of each cycle: whatever changes it changes the forecast.
        for (k, amplitude) in self.evolving.iter().enumerate() {
            let Some(add_effect) = effect(amplitude) else { continue };
            add_effect(s.state.values_mut(), s.bias[p + k]);
            for columns in [self.errors.factors_mut(), &mut *sensitivity] {
                for j in 0..columns.columns() {
                    let size = columns.shared[(first + k, j)];
                    columns.state.edit_column(j, |column| add_effect(column, size));
                }
            }
        }
    }

    /// Lets biases and amplitudes decay that are AR(1) processes.
    fn decay(&mut self, kept: &[f64]) {
        self.memory.s.decay(kept);
        self.errors.decay(kept);
        self.errors.decay_factors(kept, &mut self.memory.sensitivity);
    }

    /// Moves C_0, and with it state and parameters; a correction for which there is no model goes half the way, or less.
    fn move_reference(&mut self, shift: &[f64]) -> Result<(), Error> {
        let first = self.constant.len();
        let mut step = 1.0;
        if let Some(transition) = &mut self.corrections {
            loop {
                let mut moved = self.memory.reference[first..].to_vec();
                axpy(step, &shift[first..], &mut moved);
                match transition.set(&moved) {
                    Ok(()) => break self.model = transition.model(),
                    Err(error) if step < 1e-3 => return Err(error),
                    Err(_) => step *= 0.5,
                }
            }
        }
        let mut shift = shift.to_vec();
        scale(&mut shift, step);
        self.shift_reference(&shift);
        Ok(())
    }

    /// Refers what is believed to another C_0, with the model as it is.
    pub(super) fn shift_reference(&mut self, shift: &[f64]) {
        let Memory { s, sensitivity, reference, window, .. } = &mut self.memory;
        let mut of_blocks = vec![0.0; self.errors.block_variables()];
        let of_shared = sensitivity.increments(shift, &mut of_blocks);
        self.errors.add_increments(s, &Increments { of_blocks, of_shared });
        self.errors.shift_past(sensitivity, shift);
        add(reference, shift);
        window.shift(shift);
    }

    /// Solves the window and moves C_0 there; by how much it should have moved.
    pub(super) fn solve_and_move(&mut self) -> Result<Vec<f64>, Error> {
        let (posterior, shift) = self.solve_window();
        self.memory.posterior = posterior;
        self.move_reference(&shift)?;
        Ok(shift)
    }

    /// The forecast of state, errors and sensitivities.
    pub(super) fn advance(&mut self, window: Duration) -> Result<(), Error> {
        let first = self.constant.len();
        if let Some(transition) = &mut self.corrections {
            let Memory { moved_m, s, reference, .. } = &mut self.memory;
            transition.move_patterns(moved_m, &s.state, window, &reference[first..])?;
            self.model = transition.model();
        }
        let (model, calibration) = (Arc::clone(&self.model), self.calibration.clone());
        let steps = steps(&*model, window)?;
        let cycle = Cycle { model: &*model, calibration: &calibration, window, steps, error_factor: 1.0 };
        let transitions = self.corrections.as_ref().map(|it| it.columns(&self.memory.s.state, steps)).transpose()?;
        self.memory.time = self.memory.time + window;
        let ones = vec![1.0; self.unknowns()];
        self.errors.factors_mut().prepend(&self.memory.sensitivity, &ones);
        self.errors.propagate(&mut self.memory.s.state, &cycle)?;
        self.memory.sensitivity = self.errors.factors_mut().take_front(&ones);
        self.drop_past_times();
        self.add_model_factors();
        if let Some(kept) = cycle.kept() {
            self.decay(&kept);
        }
        for (k, columns) in transitions.iter().flat_map(|it| (0..it.columns()).map(move |k| (k, it.column(k)))) {
            self.memory.sensitivity.state.edit_column(first + k, |own| add(own, &columns));
        }
        self.errors.add_errors(&cycle)
    }

    /// Fails if a memory is not one of such a time volume: it has been read from a file.
    fn require_own(&self, memory: &Memory) -> Result<(), Error> {
        let (q, own) = (self.unknowns(), &self.memory.sensitivity);
        memory.s.require_like(&self.memory.s)?;
        let fits = memory.sensitivity.columns() == q
            && memory.sensitivity.has_rows(own.state.rows(), own.local.rows(), own.shared.nrows())
            && memory.sensitivity.past.len() == memory.past_times.len();
        require(fits, "the sensitivities to the unknowns of the time volume")?;
        let fits = memory.reference.len() == q
            && memory.active.len() == q
            && memory.precisions.len() == q
            && memory.posterior.has_unknowns(q)
            && memory.window.cycles.len() <= self.settings.cycles
            && memory.window.has_unknowns(q);
        require(fits, "the time volume")
    }

    /// The analysis given C, and what it says of C, which joins the window.
    pub(super) fn update(
        &mut self,
        innovations: &Innovations,
        coefficients: &[Coefficients],
    ) -> Result<Updated, Error> {
        let (p, q) = (self.errors.shared().len(), self.unknowns());
        let mut rows = self.errors.split_rows(innovations);
        let mut shared = SparseRows::new();
        for (row, own) in coefficients.iter().enumerate() {
            let of_constant = own.constant.iter().map(|&(k, value)| (p + k, value));
            shared.push_row(rows.shared.row(row).iter().copied().chain(of_constant));
        }
        rows.shared = shared;
        let scales = self.scales(&rows, &innovations.variance);
        // The columns of U come before the factors, and the rows of C itself after those of the parameters.
        let factors = self.errors.factors_mut();
        factors.prepend(&self.memory.sensitivity, &scales);
        let above = &factors.shared;
        factors.shared = Matrix(Mat::from_fn(p + q, above.ncols(), |i, j| {
            if i < p {
                above[(i, j)]
            } else if i - p == j {
                scales[j]
            } else {
                0.0
            }
        }));
        let analysis = self.errors.analyse_rows(&rows, innovations, q)?;
        let factors = self.errors.factors_mut();
        factors.shared = Matrix(factors.shared.as_ref().get(..p, ..).to_owned());
        self.memory.sensitivity = factors.take_front(&scales);
        self.errors.add_increments(&mut self.memory.s, &analysis.increments);
        let mut chi2 = analysis.chi2;
        let mut cycle = Information::none(q);
        if let Some(found) = analysis.found {
            let entry = |i: usize, j: usize| found.matrix[(i, j)] / (scales[i] * scales[j]);
            cycle.matrix = Matrix(Mat::from_fn(q, q, entry));
            cycle.vector = found.vector.iter().zip(&scales).map(|(value, scale)| value / scale).collect();
            chi2 += found.chi2_of_zero;
        }
        self.memory.window.make_room(self.settings.cycles, self.settings.keep_before);
        let before = self.memory.window.total();
        self.memory.window.cycles.push_back(cycle);
        Ok(Updated { partition: analysis.partition, chi2, before })
    }
}

/// What an analysis given C came to.
pub(super) struct Updated {
    partition: PartitionReport,
    /// dᵀ Cov(d)⁻¹ d for C as it was believed.
    chi2: f64,
    /// What was known of C before.
    before: Information,
}

impl Assimilator for TimeVolume {
    fn forecast(&mut self, window: Duration) -> Result<Background, Error> {
        self.keep_forecast(window);
        self.advance(window)?;
        Ok(Background { estimate: self.estimate()?, window })
    }

    fn analyse(&mut self, _: &Background, observed: &ObservationWindow) -> Result<Analysis, Error> {
        self.memory.time = observed.time;
        let coefficients = self.coefficients(observed);
        let innovations = self.innovations(observed, &coefficients)?;
        self.keep_observations(&innovations, &coefficients);
        let Updated { partition, chi2, before } = self.update(&innovations, &coefficients)?;
        self.select();
        // What the best C of before and the best one of now leave of the sum of squares.
        let before = self.with_priors(&before, &self.memory.precisions);
        let innovation_chi2 = chi2 + (self.explained(&before) - self.explained(&self.known()));
        let shift = self.solve_and_move()?;
        self.settle(shift)?;
        self.remember();
        let estimate = self.estimate()?;
        let analysis_departures = self.innovations(observed, &coefficients)?.departures;
        Ok(Analysis {
            estimate,
            background_departures: innovations.departures,
            analysis_departures,
            innovation_chi2: Some(innovation_chi2.max(0.0)),
            partition: Some(partition),
            warnings: Vec::new(),
        })
    }

    fn boxed_clone(&self) -> Box<dyn Assimilator> {
        Box::new(self.clone())
    }

    fn save(&self, to: &mut dyn Write) -> Result<(), Error> {
        write(&self.memory, to)?;
        self.errors.save(to)
    }

    fn recall(&mut self, from: &mut dyn Read) -> Result<(), Error> {
        let memory: Memory = read(from)?;
        std::iter::once(&memory).chain(memory.history.memories()).try_for_each(|it| self.require_own(it))?;
        memory.history.require(&self.memory.s, self.unknowns())?;
        let errors = self.errors.read(from)?;
        self.errors.recall(errors, &memory.s)?;
        let past = self.errors.factors().past.len();
        require(memory.past_times.len() == past, "the smoother")?;
        self.memory = memory;
        if let Some(transition) = &mut self.corrections {
            transition.set(&self.memory.reference[self.constant.len()..])?;
            self.model = transition.model();
        }
        Ok(())
    }

    fn can(&self) -> Views<'_> {
        Views {
            joint_errors: Some(self),
            root: None,
            calibration: (self.parameters() > 0).then_some(self as &dyn CalibrationErrors),
            smoother: self.errors.smoother().map(|_| self as &dyn Smoother),
            parameters: Some(self),
            blocks: Some(self),
        }
    }

    fn adjust(&mut self) -> Adjustments<'_> {
        let calibration = (self.parameters() > 0).then_some(CalibrationAdjustment::Replace(self));
        Adjustments { calibration, error_factor: None }
    }
}

impl WidenCalibration for TimeVolume {
    /// What is added to the covariance given C is independent of C, and of what the cycles of the window have said of it.
    fn widen_calibration(&mut self, covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let (p, all) = (self.parameters(), self.calibration.len());
        let joint = Mat::from_fn(all, all, |i, j| if i < p && j < p { covariance[(i, j)] } else { 0.0 });
        self.memory.history = History::default();
        self.errors.widen_calibration(joint.as_ref());
        Ok(())
    }
}

impl ReplaceCalibration for TimeVolume {
    /// The sensitivities to C stay: the new calibration is independent of C, as the priors were.
    fn replace_calibration(&mut self, estimate: &[f64], covariance: MatRef<'_, f64>) -> Result<(), Error> {
        let (p, all) = (self.parameters(), self.calibration.len());
        let prior = |number: usize| self.calibration.parameters[number].sigma_prior.powi(2);
        let joint = Mat::from_fn(all, all, |i, j| match (i < p && j < p, i == j) {
            (true, _) => covariance[(i, j)],
            (false, true) => prior(i),
            (false, false) => 0.0,
        });
        self.memory.s.bias.fill(0.0);
        self.memory.s.bias[..p].copy_from_slice(estimate);
        self.forget();
        self.errors.replace_calibration(joint.as_ref())
    }
}

impl BlockStructure for TimeVolume {
    fn structure(&self, observed: &ObservationWindow, factors: usize) -> Structure {
        let mut structure = self.errors.structure(&self.memory.s, observed, factors);
        structure.factors.iter_mut().for_each(|factor| factor.calibration.truncate(self.parameters()));
        structure
    }
}
