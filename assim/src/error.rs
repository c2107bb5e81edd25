//! What can go wrong in a method.

use isobar_model::ForecastError;

/// Why a method cannot go on, or cannot be set up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The forecast failed.
    #[error(transparent)]
    Forecast(#[from] ForecastError),
    /// A matrix that must be positive definite is not.
    #[error("{matrix} is not positive definite (pivot {pivot} of {size})")]
    NotPositiveDefinite {
        /// What the matrix is, in words.
        matrix: String,
        /// The pivot at which the Cholesky factorisation failed.
        pivot: usize,
        /// Rows of the matrix.
        size: usize,
    },
    /// A variance is negative: the matrix is no longer a covariance.
    #[error("{covariance} is not positive semidefinite: the variance of {place} is {variance}, the largest {largest}")]
    NegativeVariance {
        /// What the matrix is, in words.
        covariance: String,
        /// The value or parameter whose variance it is.
        place: String,
        /// The variance.
        variance: f64,
        /// The largest variance of the matrix.
        largest: f64,
    },
    /// A system of equations does not determine its unknowns.
    #[error("{what} is not determined by the data: rank {rank} of {size}")]
    RankDeficient {
        /// What is not determined, in words.
        what: String,
        /// Numerical rank.
        rank: usize,
        /// Number of unknowns.
        size: usize,
    },
    /// A method would need more memory than it may use.
    #[error("{what} would need {}, more than the limit of {}", in_words(*needed_bytes), in_words(*limit_bytes))]
    TooLarge {
        /// What needs the memory, in words.
        what: String,
        /// Bytes it would need.
        needed_bytes: u64,
        /// Bytes it may use.
        limit_bytes: u64,
    },
    /// A value that is not finite arose.
    #[error("{what} is not finite")]
    NotFinite {
        /// The value, in words.
        what: String,
    },
    /// Observations that contradict each other are too accurate for double precision.
    #[error(
        "the analysis cannot be computed in double precision: it departs by {departure:e} from the observation {observation}, \
         which contradicts others and has the standard deviation {sigma:e}, beside {spread:e} of the background there"
    )]
    Unresolved {
        /// The network and platform of the observation.
        observation: String,
        /// y − h(analysis).
        departure: f64,
        /// σ of the observation's error.
        sigma: f64,
        /// Standard deviation of the background's error there.
        spread: f64,
    },
    /// A memory cannot be recalled.
    #[error("the saved state of the method cannot be used: {reason}")]
    Memory {
        /// Why not.
        reason: String,
    },
    /// A setting does not fit the experiment.
    #[error("{0}")]
    Setting(String),
}

/// A number of bytes with a unit: `138.2 MB`, `22.5 TB`.
fn in_words(bytes: u64) -> String {
    match bytes as f64 {
        bytes if bytes >= 1e12 => format!("{:.1} TB", bytes / 1e12),
        bytes if bytes >= 1e10 => format!("{:.1} GB", bytes / 1e9),
        bytes => format!("{:.1} MB", bytes / 1e6),
    }
}
