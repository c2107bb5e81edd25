//! The state of an experiment after a cycle: what a checkpoint and the final state of a run have in common.

use crate::run::ahead::Ahead;
use crate::run::cycle::Progress;
use crate::run::experiment::{Competitor, Experiment};
use crate::run::truth::{SavedTruth, Truth};
use crate::scores::Failure;
use crate::sealed::Memories;
use isobar_model::State;
use isobar_obs::SavedSystem;
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Seek, Write};

/// Truth, quality control, observing systems and methods after a cycle, but for the methods' own memory, which follows in the
/// file.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved {
    /// After which cycle.
    pub cycle: usize,
    truth: Option<SavedTruth>,
    reference: Option<State>,
    observing: SavedSystem,
    /// The methods, in the order of their memories.
    pub methods: Vec<SavedMethod>,
}

/// What is kept of a method beside its own memory.
#[derive(Debug, Serialize, Deserialize)]
pub struct SavedMethod {
    /// Its name.
    pub name: String,
    /// `None` once it has failed.
    pub progress: Option<Progress>,
    failure: Option<Failure>,
    ahead: Ahead,
}

impl Saved {
    /// The state of an experiment after a cycle.
    pub fn of(cycle: usize, experiment: &mut Experiment) -> Self {
        let Experiment { info, truth, reference, observing, methods, .. } = experiment;
        let methods =
            info.methods.iter().zip(methods).map(|(own, Competitor { runner, failure, ahead, .. })| SavedMethod {
                name: own.name.clone(),
                progress: failure.is_none().then(|| runner.progress().clone()),
                failure: failure.clone(),
                ahead: ahead.clone(),
            });
        Self {
            cycle,
            methods: methods.collect(),
            truth: truth.as_ref().map(Truth::save),
            reference: reference.as_ref().map(|reference| reference.state().clone()),
            observing: observing.save(),
        }
    }

    /// Sets an experiment that has just been built to this state. It may have some of the methods only.
    ///
    /// # Errors
    /// In words, if it is the state of another experiment.
    pub fn restore<F: Read + Seek>(
        self,
        memories: &mut Memories<F>,
        experiment: &mut Experiment,
    ) -> Result<(), String> {
        let Experiment { info, truth, reference, observing, methods, .. } = experiment;
        let fits = self.observing.cycle() == self.cycle && (1..=info.cycles).contains(&self.cycle);
        let fits = fits && memories.count() == self.methods.len();
        let reference_fits = match (reference, self.reference) {
            (Some(reference), Some(saved)) => reference.restore(saved),
            (reference, saved) => reference.is_none() && saved.is_none(),
        };
        if !fits || !reference_fits || truth.is_some() != self.truth.is_some() {
            return Err("it is not one of this experiment".into());
        }
        truth.iter_mut().zip(self.truth).try_for_each(|(truth, saved)| truth.restore(saved))?;
        observing.restore(&self.observing).map_err(|error| error.to_string())?;
        let mut saved: Vec<(usize, SavedMethod)> = self.methods.into_iter().enumerate().collect();
        for (own, competitor) in info.methods.iter().zip(methods) {
            let place = saved.iter().position(|(_, saved)| saved.name == own.name);
            let (number, saved) = saved.swap_remove(place.ok_or("it is not one of this experiment")?);
            if saved.progress.is_some() == saved.failure.is_some() || !saved.ahead.fits(self.cycle, info) {
                return Err("a method has neither memory nor a failure, or forecasts of another run".into());
            }
            if let Some(progress) = saved.progress {
                let mut memory = memories.open(number).map_err(|error| error.to_string())?;
                let restored = competitor.runner.restore(&mut memory, progress, &info.layout);
                restored.map_err(|error| error.to_string())?;
            }
            competitor.ahead = saved.ahead;
            competitor.failure = saved.failure;
        }
        Ok(())
    }
}

/// Writes the memory of a method; nothing of one that has failed.
///
/// # Errors
/// Those of the method.
pub fn save(experiment: &Experiment, method: usize, to: &mut dyn Write) -> io::Result<()> {
    let Competitor { runner, failure, .. } = &experiment.methods[method];
    if failure.is_some() { Ok(()) } else { runner.method().save(to).map_err(io::Error::other) }
}

/// Gives what rank 0 needs to write all memories, on another rank.
///
/// # Errors
/// Those of the methods.
pub fn take_part(experiment: &Experiment) -> io::Result<()> {
    (0..experiment.methods.len()).try_for_each(|method| save(experiment, method, &mut io::sink()))
}
