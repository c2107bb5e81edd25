//! The time volume's memory from cycle to cycle, for a checkpoint.

use super::super::saved as filter_memory;
use super::TimeVolume;
use super::window::{Information, Posterior};
use crate::error::Error;
use crate::saved::{Matrix, from_bytes, to_bytes, unfit};
use crate::tall_matrix::TallMatrix;
use isobar_model::Time;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
struct Saved {
    filter: Vec<u8>,
    /// U: state, local and shared rows.
    state: Vec<f64>,
    local: Vec<f64>,
    shared: Matrix,
    reference: Vec<f64>,
    active: Vec<bool>,
    /// What is known from before the window, then each of its cycles.
    information: Vec<(Matrix, Vec<f64>)>,
    root: Matrix,
    undetermined: Vec<Vec<f64>>,
    seconds: i64,
    /// Of AR(1) amplitudes and others, the last drift of each.
    drift: Vec<f64>,
}

pub(super) fn save(volume: &TimeVolume) -> Result<Vec<u8>, Error> {
    let columns =
        |matrix: &TallMatrix| (0..matrix.columns()).flat_map(|k| matrix.column(k).into_owned()).collect::<Vec<f64>>();
    let cycles = std::iter::once(&volume.window.before).chain(&volume.window.cycles);
    to_bytes(&Saved {
        filter: filter_memory::save(&volume.filter)?,
        state: columns(&volume.sensitivity.state),
        local: columns(&volume.sensitivity.local),
        shared: (&volume.sensitivity.shared).into(),
        reference: volume.reference.clone(),
        active: volume.active.clone(),
        information: cycles.map(|it| ((&it.matrix).into(), it.vector.clone())).collect(),
        root: (&volume.posterior.root).into(),
        undetermined: volume.posterior.undetermined.clone(),
        seconds: volume.time.seconds(),
        drift: (volume.filter.problem.calibration.parameters.iter()).map(|it| it.sigma_drift_per_sqrt_day).collect(),
    })
}

pub(super) fn restore(volume: &mut TimeVolume, bytes: &[u8]) -> Result<(), Error> {
    let saved: Saved = from_bytes(bytes)?;
    let q = volume.unknowns();
    filter_memory::restore(&mut volume.filter, &saved.filter)?;
    let tall = |like: &TallMatrix, values: Vec<f64>| match values.len() == like.rows() * q {
        true => Ok(TallMatrix::from_values(like.rows(), q, values)),
        false => Err(unfit("the sensitivities to the unknowns of the time volume")),
    };
    let own = &volume.sensitivity;
    let (state, local) = (tall(&own.state, saved.state)?, tall(&own.local, saved.local)?);
    let shared = saved.shared.restored(own.shared.nrows(), Some(q), "the sensitivities of the parameters")?;
    volume.sensitivity = super::Factors { state, local, shared };
    let parameters = &mut volume.filter.problem.calibration.parameters;
    let fits = saved.reference.len() == q
        && saved.active.len() == q
        && saved.undetermined.iter().all(|it| it.len() == q)
        && saved.drift.len() == parameters.len()
        && (1..=volume.settings.cycles + 1).contains(&saved.information.len());
    if !fits {
        return Err(unfit("the time volume"));
    }
    parameters.iter_mut().zip(saved.drift).for_each(|(it, drift)| it.sigma_drift_per_sqrt_day = drift);
    let mut information = Vec::new();
    for (matrix, vector) in saved.information {
        if vector.len() != q {
            return Err(unfit("the information of a cycle"));
        }
        information.push(Information { matrix: matrix.restored(q, Some(q), "the information of a cycle")?, vector });
    }
    volume.window.before = information.remove(0);
    volume.window.cycles = information.into();
    let root = saved.root.restored(q, None, "the covariance of the unknowns")?;
    volume.posterior = Posterior { estimate: vec![0.0; q], root, undetermined: saved.undetermined };
    (volume.reference, volume.active) = (saved.reference, saved.active);
    volume.time = Time::from_seconds(saved.seconds);
    if let Some(family) = &volume.corrections {
        volume.filter.problem.model = family.model(&volume.reference[volume.constant.len()..])?;
    }
    Ok(())
}
