//! What is measured of a method in one cycle. Only here do estimate and truth meet.

use isobar_assim::{Analysis, Estimate};
use isobar_model::Layout;
use serde::{Deserialize, Serialize};

/// The estimates of one method and the truth of the same time.
#[derive(Clone, Copy)]
pub struct Verified<'a> {
    /// Grid and variables.
    pub layout: &'a Layout,
    /// The true state, in the order of [`isobar_model::State::values`].
    pub true_state: &'a [f64],
    /// The true calibration parameters; empty if they are not scored, since the method is given them.
    pub true_calibration: &'a [f64],
    /// The estimate before the observations of the cycle; `None` where a smoothed one is verified, as the next.
    pub background: Option<&'a Estimate>,
    /// That after them.
    pub analysis: Option<&'a Estimate>,
    /// The departures of the analysis.
    pub departures: Option<&'a Analysis>,
    /// The estimate that later observations have revised; `None` where an analysis is verified.
    pub smoothed: Option<&'a Estimate>,
}

/// A measure that is averaged over cycles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sum {
    /// What is summed: a mean square over grid points, or a sum over observations.
    pub total: f64,
    /// The number by which the sum over cycles is divided: of cycles, or of observations.
    pub weight: f64,
}

/// The mean square error of each variable of an estimate.
pub fn error(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    let errors = estimate?.state.values().iter().zip(it.true_state).map(|(value, truth)| value - truth);
    Some(mean_squares(it.layout, errors))
}

/// The mean claimed variance of each variable of an estimate; `None` if it claims none.
pub fn spread(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    Some(mean_squares(it.layout, estimate?.state_spread.as_ref()?.iter().copied()))
}

/// The mean square error of the bias parameters; `None` if there are none that are scored.
pub fn bias_error(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    let errors = estimate?.calibration.iter().zip(it.true_calibration).map(|(value, truth)| value - truth);
    mean_square(errors, it.true_calibration.len())
}

/// The mean claimed variance of the bias parameters; `None` as for [`bias_error`], or without a claim.
pub fn bias_spread(it: &Verified<'_>, estimate: Option<&Estimate>) -> Option<Vec<Sum>> {
    let spread = estimate?.calibration_spread.as_ref()?;
    mean_square(spread.iter().copied(), it.true_calibration.len())
}

/// The normalised innovation squared, χ² of the n observations of the cycle; its average is that per observation.
pub fn chi2(it: &Verified<'_>) -> Option<Vec<Sum>> {
    let analysis = it.departures?;
    let weight = analysis.background_departures.len() as f64;
    Some(vec![Sum { total: analysis.innovation_chi2?, weight }])
}

fn mean_square(values: impl Iterator<Item = f64>, count: usize) -> Option<Vec<Sum>> {
    let total = values.map(|value| value * value).sum::<f64>() / count as f64;
    (count > 0).then(|| vec![Sum { total, weight: 1.0 }])
}

/// The mean of the squares of each variable's values.
fn mean_squares(layout: &Layout, values: impl Iterator<Item = f64>) -> Vec<Sum> {
    let cells = layout.grid.cells();
    let mut sums = vec![Sum { total: 0.0, weight: 1.0 }; layout.variables.len()];
    for (index, value) in values.enumerate() {
        sums[index / cells].total += value * value;
    }
    sums.iter_mut().for_each(|sum| sum.total /= cells as f64);
    sums
}
