//! `kind = "cosine_wave"`.

use super::state::InitialState;
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, AnyKey, Integer, Key, Limits, Read, Section};
use isobar_model::initial::{CosineWave, cosine_wave};
use isobar_model::{ModelError, State, advection};

const MEAN: Key<Limits> = Key::absent("mean", "1", Limits::Any, Absent::Means(0.0), "mean of the wave");

const AMPLITUDE: Key<Limits> = Key::required("amplitude", "1", Limits::Any, "amplitude");

const WAVES_X: Key<Integer> = waves("waves_x", 1, "number of waves along x");

const WAVES_Y: Key<Integer> = waves("waves_y", 0, "number of waves along y");

const PHASE_DEG: Key<Limits> = Key::absent(
    "phase_deg",
    "degrees",
    Limits::Between(-360.0, 360.0),
    Absent::Means(0.0),
    "phase in the south-west corner",
);

const fn waves(name: &'static str, default: i64, meaning: &'static str) -> Key<Integer> {
    Key::absent(name, "", Integer(-2048, 2048), Absent::Means(default), meaning)
}

pub(super) const KIND: Kind<dyn InitialState, Domain> = Kind::<dyn InitialState, Domain>::new(
    "cosine_wave",
    "A cosine wave of tracer",
    &[&[&AMPLITUDE], WAVE],
    |section, _| Ok(Box::new(wave(section, section.get(&AMPLITUDE)?)?)),
)
.only_if(|domain| !domain.model.is_shallow_water());

/// The keys of a wave but for its amplitude.
pub(crate) const WAVE: &[&dyn AnyKey] = &[&MEAN, &WAVES_X, &WAVES_Y, &PHASE_DEG];

/// Reads a wave of this amplitude.
pub(crate) fn wave(section: &Section<'_>, amplitude: f64) -> Read<CosineWave> {
    Ok(CosineWave {
        mean: section.get(&MEAN)?,
        amplitude,
        waves_x: section.get(&WAVES_X)? as i32,
        waves_y: section.get(&WAVES_Y)? as i32,
        phase: section.get(&PHASE_DEG)?.to_radians(),
    })
}

impl InitialState for CosineWave {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        cosine_wave(&advection::layout(domain.grid.clone()), self)
    }
}
