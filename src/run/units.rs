//! Whether observations can be of the quantity and in the unit that they are taken for.

use super::reference::mean_variances;
use isobar_assim::Covariance;
use isobar_model::State;
use isobar_obs::{Calibration, ObservationWindow, Rejection, Report};
use std::collections::HashSet;

/// All observations of a type must miss the background by more than this number of standard deviations, all to the same side.
const LEAST_DEPARTURE: f64 = 5.0;

/// One wrong value is a gross error, two may be so by chance.
const LEAST_OBSERVATIONS: usize = 3;

/// Looks for observations that are all wrong: quality control compares them with each other, and assimilation believes
/// them.
///
/// An observation may differ from a background by the background's error, by the variability of the state (a forecast that
/// nothing corrects is in the end as wrong as another state of the climate), by the prior of its biases and by its own
/// error. Where every single observation of a network and variable is beyond five times the root of the sum of their
/// variances, all on the same side, it is the data that are wrong: another unit, another datum.
#[derive(Clone, Debug)]
pub struct UnitCheck {
    /// The first background, which is as good as any where nothing else is known: a later one has met the observations.
    background: State,
    /// Variances of its error, of each variable.
    variances: Vec<f64>,
    /// The types of which it has been said.
    said: HashSet<(String, usize)>,
}

/// One observation beside the background.
struct Compared<'a> {
    report: &'a Report,
    departure: f64,
    variance: f64,
}

impl UnitCheck {
    /// A check with the first background and the covariance of its error.
    pub fn new(background_error: &dyn Covariance, background: &State) -> Self {
        let variances = mean_variances(background_error, background);
        Self { background: background.clone(), variances, said: HashSet::new() }
    }

    /// What there is to say of the observations of a cycle, those among them that quality control rejected for their values,
    /// beside the background: of each type once.
    pub fn check(&mut self, observed: &ObservationWindow, calibration: &Calibration) -> Vec<String> {
        let all = self.compared(observed, calibration);
        let mut types: Vec<(String, usize)> =
            all.iter().map(|it| (it.report.network.to_string(), it.report.variable)).collect();
        types.sort();
        types.dedup();
        let mut warnings = Vec::new();
        for of_type in types {
            let own: Vec<&Compared<'_>> =
                all.iter().filter(|it| *it.report.network == *of_type.0 && it.report.variable == of_type.1).collect();
            let n = own.len() as f64;
            let mean = own.iter().map(|it| it.departure).sum::<f64>() / n;
            let is_beyond = |it: &&Compared<'_>| it.departure * mean.signum() > LEAST_DEPARTURE * it.variance.sqrt();
            if own.len() < LEAST_OBSERVATIONS || !own.iter().all(is_beyond) || !self.said.insert(of_type.clone()) {
                continue;
            }
            let chi2 = own.iter().map(|it| it.departure * it.departure / it.variance).sum::<f64>() / n;
            let variable = &self.background.layout().variables[of_type.1];
            warnings.push(format!(
                "cycle {}, {}/{}: all {} observations are beyond what is possible: their mean departure from the background is \
                 {mean:.5} {unit}, with χ²/n {chi2:.3}; at most {:.3} {unit} are expected of any of them: is it another unit?",
                observed.cycle,
                of_type.0,
                variable.name,
                own.len(),
                own.iter().map(|it| it.variance.sqrt()).fold(0.0, f64::max),
                unit = variable.unit,
            ));
        }
        warnings
    }

    fn compared<'a>(&self, observed: &'a ObservationWindow, calibration: &Calibration) -> Vec<Compared<'a>> {
        let background = &self.background;
        let variability: Vec<f64> = (0..self.variances.len()).map(|it| background.variability(it).powi(2)).collect();
        let of_state = |variable: usize| self.variances[variable] + variability[variable];
        let jacobian = observed.operator.linearize(background, &vec![0.0; calibration.len()]);
        let used = observed.reports.iter().enumerate().map(|(row, report)| {
            let of_biases = jacobian.calibration.row(row).iter();
            let of_biases =
                of_biases.map(|&(number, weight)| weight * weight * calibration.prior_covariance(number, number));
            Compared {
                report,
                departure: observed.values[row] - jacobian.state.row_dot(row, background.values()),
                variance: of_state(report.variable) + of_biases.sum::<f64>() + observed.sigma[row].powi(2),
            }
        });
        let by_value = |rejection| matches!(rejection, Rejection::Absurd | Rejection::GrossError);
        let rejected = observed.aside.rejected().filter(|(_, rejection)| by_value(*rejection)).map(|(it, _)| {
            let grid = &background.layout().grid;
            let cell = it.report.variable * grid.cells() + grid.cell_at(it.report.x_m, it.report.y_m);
            Compared {
                report: &it.report,
                departure: it.value - background.values()[cell],
                variance: of_state(it.report.variable) + it.sigma.powi(2),
            }
        });
        used.chain(rejected).collect()
    }
}
