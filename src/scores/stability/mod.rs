//! The stability monitor: which of a method's bias estimates can be relied on, and what would make the others so.
//!
//! An optimal filter is stable where its system is uniformly observable and controllable (Kalman 1960; Jazwinski 1970,
//! section 7.6): its claimed variances are then bounded, and it forgets where it started. Where its model and covariances are
//! right as well, its innovations are white with the covariance that it claims. Each of that can be looked at from within,
//! without the truth:
//!
//! - *observability*: the posterior covariance of the biases against the prior (see [`isobar_assim::observability`]);
//! - *growth* of the forecast variances between observations;
//! - *whiteness* of the innovations, by their lagged covariance (Daley 1992, MWR 120, 178);
//! - *size* of the innovations, by χ².

mod doubt;
mod freezing;
mod judge;
mod needs;
mod verdicts;
mod watch;

pub use freezing::{Freezing, Hysteresis};
pub use judge::judge;
pub use needs::{ComparisonNeed, ParameterNeeds};
pub use verdicts::Verdicts;
pub use watch::Watch;

use crate::verdict::in_words;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

/// What the monitor says of a method at the end of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stability {
    /// Normalised innovation squared per observation; 1 if the claimed covariances are right.
    pub innovation_chi2: Option<Expected>,
    /// Correlation of the innovations of a station with those of its report before; 0 if the filter is optimal.
    pub lag_correlation: Option<Expected>,
    /// How the claimed variances of the state go, by variable; empty for a method that claims none.
    pub variances: IndexMap<String, VarianceGrowth>,
    /// Every bias parameter, in the order of the calibration.
    pub parameters: Vec<ParameterStability>,
    /// What the observations do not determine.
    pub undetermined: Vec<Undetermined>,
    /// The parameters whose exact knowledge would leave nothing undetermined, the most effective first.
    pub references: Vec<String>,
}

/// A figure whose value is known for a filter that is right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Expected {
    /// The figure.
    pub value: f64,
    /// What it should be.
    pub expected: f64,
    /// Half of the 95 % interval about that for a figure from this number of observations.
    pub tolerance: f64,
}

impl Expected {
    /// Whether the figure can be what it should be.
    pub fn holds(&self) -> bool {
        (self.value - self.expected).abs() <= self.tolerance
    }
}

/// How the claimed variance of a variable goes on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VarianceGrowth {
    /// The factor by which a forecast multiplies it from one analysis to the next observations, the geometric mean.
    pub per_cycle: f64,
    /// That of the backgrounds in the last third of the cycles over that in the middle third: near 1 once it is steady.
    pub trend: f64,
}

/// A bias parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterStability {
    /// Its name.
    pub name: String,
    /// Its unit, in UDUNITS spelling.
    pub unit: String,
    /// How many observations and comparisons had it.
    pub observations: usize,
    /// The share of its prior variance that it still has; of one that is frozen by [`Hysteresis`], that an update would leave.
    pub variance_ratio: f64,
    /// Correlation of what successive innovations say of it.
    pub lag_correlation: Option<Expected>,
    /// Whether it has a stable update.
    pub stable: bool,
    /// Whether it is adjusted no more.
    pub frozen: bool,
    /// Why it is not stable; empty if it is.
    pub why: Vec<String>,
    /// What would make it stable; `None` if it is.
    pub needs: Option<ParameterNeeds>,
}

impl ParameterStability {
    /// The verdict, in words.
    pub fn verdict(&self) -> &'static str {
        in_words(self.stable, self.frozen)
    }
}

/// A combination of biases that the observations do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Undetermined {
    /// How the parameters change along it, in units of their prior standard deviations; small parts are left out.
    pub direction: IndexMap<String, f64>,
    /// The share of its prior variance that it still has.
    pub variance_ratio: f64,
    /// The mean over the domain from which it cannot be told.
    pub mean: Option<InseparableMean>,
}

/// A mean over the domain that goes together with biases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InseparableMean {
    /// The variable.
    pub variable: String,
    /// Its unit.
    pub unit: String,
    /// The correlation of the errors.
    pub correlation: f64,
    /// The largest standard deviation of an unbiased observation of it that would tell them apart.
    pub sigma_needed: f64,
}
