//! The parameters of the model that a time volume may correct.

use crate::kinds::Domain;
use crate::reader::{Absent, AnyKey, Described, Field, Form, Key, Limits, Read};
use crate::text::listed;
use isobar_assim::Error;
use isobar_assim::time_volume::{Candidate, Corrections};
use isobar_model::{Duration, ModelError, State, TangentLinear, check_time_step};
use std::sync::Arc;

const CANDIDATE: Key<Described> = Key::required(
    "candidate",
    "",
    Described(
        "one of advection_x_m_per_s, advection_y_m_per_s, mean_depth_m, gravity_m_per_s2, drag_per_s, coriolis_per_s, where the model has it",
        Form::text,
    ),
    "the parameter that may be wrong",
);

const SIGMA: Key<Limits> = Key::absent(
    "sigma",
    "of the parameter",
    Limits::Positive,
    Absent::Explained("no prior"),
    "standard deviation of a prior",
);

/// The keys of a correction.
pub(super) const KEYS: &[&dyn AnyKey] = &[&CANDIDATE, &SIGMA];

/// Reads a parameter of the model that may be wrong.
pub(super) fn read(field: &Field<'_>, domain: &Domain) -> Read<Candidate> {
    let section = field.section_with(KEYS)?;
    let name_field = section.required(CANDIDATE.name)?;
    let name = name_field.text()?;
    let mut equations = domain.model.equations.boxed_clone();
    let parameters: Vec<_> = equations.parameters(&domain.grid).into_iter().map(|(parameter, _)| parameter).collect();
    let Some(parameter) = parameters.iter().find(|parameter| parameter.name == name) else {
        let message = format!("`{}` is no parameter of this model on this domain", name_field.title());
        let possible = listed(parameters.iter().map(|parameter| parameter.name));
        return Err(name_field.invalid(message, &format!("possible here: {possible}")));
    };
    Ok(Candidate { name, unit: parameter.unit.into(), step: parameter.step, sigma_prior: section.find(&SIGMA)? })
}

/// The scenario's model with other parameters.
pub(super) struct ModelCorrections {
    pub domain: Domain,
    /// Length of a cycle.
    pub cycle: Duration,
    /// The state for which a corrected model must be stable.
    pub background: State,
    pub candidates: Vec<Candidate>,
}

impl Corrections for ModelCorrections {
    fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    fn model(&self, corrections: &[f64]) -> Result<Arc<dyn TangentLinear>, Error> {
        let Domain { grid, model, .. } = &self.domain;
        let changes = self.candidates.iter().map(|candidate| candidate.name.as_str()).zip(corrections.iter().copied());
        let fault = |error: ModelError| Error::Setting(format!("the corrected model: {error}"));
        let model = model.corrected(grid, &changes.collect::<Vec<_>>()).build(grid, self.cycle).map_err(fault)?;
        check_time_step(&*model, &self.background).map_err(fault)?;
        Ok(model)
    }
}
