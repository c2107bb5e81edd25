//! Why a scenario cannot become an experiment.

use crate::calendar::utc;
use crate::run::comparisons::Misplaced;
use crate::sensors::SensorError;
use isobar_model::communicator::RankFailure;
use isobar_model::{ModelError, Time};
use isobar_obs::ObservationError;

/// Why a scenario cannot become an experiment.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// The model, or a state of it.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The time step of the methods' model.
    #[error("{0}")]
    TimeStep(ModelError),
    /// The truth's model, or the state from which it starts.
    #[error("the truth: {0}")]
    TrueModel(ModelError),
    /// The time step of the truth's model.
    #[error("the truth: {0}")]
    TrueTimeStep(ModelError),
    /// A source whose table does not reach over the run.
    #[error(
        "the table of source {} of {} goes from {} to {}, but the run needs it from {} to {}",
        number + 1,
        if *of_truth { "[[truth.forcing]]" } else { "[[forcing]]" },
        utc(known.0),
        utc(known.1),
        utc(needed.0),
        utc(needed.1)
    )]
    Forcing {
        /// Whether it is one of the truth's own.
        of_truth: bool,
        /// Its number, from 0.
        number: usize,
        /// From when to when it is needed.
        needed: (Time, Time),
        /// From when to when it is known.
        known: (Time, Time),
    },
    /// The truth of a file.
    #[error("{0}")]
    Truth(String),
    /// An observing system.
    #[error(transparent)]
    Observations(#[from] ObservationError),
    /// A covariance.
    #[error("{0}")]
    Covariance(isobar_assim::Error),
    /// Geostrophic balance where f is too small for it.
    #[error("{0}")]
    Balance(String),
    /// A method.
    #[error("method {name}: {error}")]
    Method {
        /// The method's name.
        name: String,
        /// Why it cannot be set up.
        error: isobar_assim::Error,
    },
    /// A method that is to be given the true biases, where they are not known.
    #[error(
        "method {name} has `bias = \"known\"`, but nothing is known of the true bias {parameter}, since its observations were \
         made elsewhere"
    )]
    UnknownBias {
        /// The method's name.
        name: String,
        /// Name of the parameter.
        parameter: String,
    },
    /// A warning that has no place in the domain.
    #[error("warning {name}: {reason}")]
    Warning {
        /// Its name.
        name: String,
        /// Why.
        reason: String,
    },
    /// A comparison of sensors that are not there.
    #[error("comparison {} of [[comparisons]]: {}", .0.number + 1, .0.reason)]
    Comparison(Misplaced),
    /// The database of sensors.
    #[error(transparent)]
    Sensors(#[from] SensorError),
    /// Something failed on a rank of the run.
    #[error("rank {}: {}", .0.rank, .0.reason)]
    Rank(#[from] RankFailure),
}
