//! Ensemble Kalman filters: the covariance of the errors is that of N members.
//!
//! | file | what |
//! |---|---|
//! | `cycle` | what the methods share but for their analyses |
//! | `filter` | such a cycle with an analysis is a method |
//! | `moments` | their mean and perturbations |
//! | `members` | [`Ensemble`]: the members, their forecast and their moments |
//! | `first_members` | their draw |
//! | `parts_of_draws` | draws, a share of them made on each rank |
//! | `model_error` | what a cycle adds to the members: draws of Q, or the square root that has no sampling error |
//! | `transform` | the analysis in the space of the ensemble |
//! | `principal` | its directions where some observations are far more accurate than others |
//! | `inflation` | multiplicative, adaptive, relaxation to the prior spread and perturbations |
//! | `batch`, `near` | analyses of neighbouring places, each with the observations around it |
//! | `band` | what they make of the members in some rows of cells |
//! | `perturbations` | the perturbations in such rows, before and after |
//! | `weights` | where they are made, and the interpolation between |
//! | `buckets` | observations found by where they are |
//! | `products` | products for several places at a time, one in each lane of vectors (`crate::lanes`) |
//! | `localization` | the taper of Gaspari and Cohn on a plane |
//! | `tapered` | innovations with a tapered covariance of state and shared biases |
//! | `etkf` | [`EnsembleTransformKalmanFilter`] |
//! | `own` | [`EnsembleTransform`]: the analysis made elsewhere |
//! | `fixed_lag` | their smoother, the EnKS |
//! | `letkf` | [`LocalEnsembleTransformKalmanFilter`] |
//! | `stochastic` | [`StochasticEnsembleKalmanFilter`] |
//!
//! Biases are estimated by augmentation: a member is (x, c).

mod band;
mod batch;
mod buckets;
mod cycle;
mod etkf;
mod filter;
mod first_members;
mod fixed_lag;
mod inflation;
mod letkf;
mod localization;
mod members;
mod model_error;
mod moments;
mod near;
mod observed;
mod own;
mod parts_of_draws;
mod perturbations;
mod principal;
mod products;
mod stochastic;
mod tapered;
mod transform;
mod weights;

pub use etkf::EnsembleTransformKalmanFilter;
pub use filter::EnsembleFilter;
pub use inflation::{BackgroundInflation, Inflation};
pub use letkf::{LocalEnsembleTransformKalmanFilter, LocalSettings};
pub use members::Ensemble;
pub use own::{By, EnsembleTransform, EnsembleWeights};
pub use stochastic::StochasticEnsembleKalmanFilter;

/// How the first members are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InitialMembers {
    /// Independent draws from B and the priors of the biases, shifted to have the background as their mean.
    Random,
    /// The N − 1 leading factors of B and the priors, rotated at random (Pham 2001): no sampling error but what is cut.
    SecondOrderExact,
}

/// What the members get of the model error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelErrorTreatment {
    /// Each member gets a draw of Q; the draws are shifted to have mean zero.
    Random,
    /// The square root of the ensemble's covariance and Q within the ensemble's span, draws beyond it (Raanes, Carrassi
    /// and Bertino 2015, "Sqrt-Add-Z").
    SquareRoot,
}

/// What all ensemble methods have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnsembleSettings {
    /// Number of members, N ≥ 2.
    pub members: usize,
    /// How the first members are made.
    pub initial_members: InitialMembers,
    /// What they get of the model error.
    pub model_error: ModelErrorTreatment,
    /// The remedy for the spread that a small ensemble loses.
    pub inflation: Inflation,
    /// The seed of the method's own random stream.
    pub seed: u64,
}

impl EnsembleSettings {
    /// So many members, drawn at random with seed 1, whose perturbations are multiplied by `inflation` before each analysis.
    pub fn new(members: usize, inflation: f64) -> Self {
        Self {
            members,
            initial_members: InitialMembers::Random,
            model_error: ModelErrorTreatment::Random,
            inflation: Inflation { background: BackgroundInflation::Factor(inflation), ..Inflation::NONE },
            seed: 1,
        }
    }
}
