//! How the random errors of a network's observations are correlated within its reports.

use crate::error::{ObservationError, require};
use crate::error_regression::ErrorRegression;
use crate::observation::{Observation, Reading};
use isobar_model::{Boundary, Duration, Grid};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// The most observations of one variable in a report with correlated errors: its matrix takes 32 MB, and its factors some
/// seconds.
pub const MOST_IN_REPORT: usize = 2000;

/// The least share of an error's variance that the other errors do not explain: observations at one place differ.
const LEAST_SHARE: f64 = 1e-6;

/// Random errors of one variable that are correlated within a report of a network; those of different reports, variables and
/// networks are independent, so that R is block-diagonal:
///
/// ```text
/// R_ij = σ_i σ_j exp(−d_ij/L)
/// ```
///
/// The exponential is positive definite for any places in a plane; and along a line, where it makes the errors a first-order
/// autoregressive process, each depends only on the error before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorCorrelation {
    /// What a report is, and the distance d within it.
    pub kind: ErrorCorrelationKind,
    /// L of the errors that are drawn \[m\], at least 0, which means independent errors. Recorded observations have theirs
    /// already.
    pub length_m: f64,
    /// L that methods assume \[m\].
    pub assumed_length_m: f64,
}

/// What a report is, and what distance within it means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorCorrelationKind {
    /// All observations of a variable at one time that have the same [report number](Observation::report_number). d is the
    /// distance on the plane; in a periodic direction it is the chord (W/π) sin(π Δx/W), which keeps R positive definite.
    ByDistance,
    /// The footprints of a [scan line](crate::observation::ScanLine). d is the distance along the line.
    ScanLine,
}

impl ErrorCorrelation {
    pub(crate) fn validate(&self, network: &str, has_scan_lines: bool) -> Result<(), ObservationError> {
        if self.kind == ErrorCorrelationKind::ScanLine && !has_scan_lines {
            let problem = "error_correlation is along scan lines, which its observations do not have";
            return Err(ObservationError::in_setting(network, "error_correlation", problem));
        }
        let lengths =
            [("error_correlation.length", self.length_m), ("error_correlation.assumed_length", self.assumed_length_m)];
        lengths.into_iter().try_for_each(|(setting, length_m)| {
            require(length_m >= 0.0 && length_m.is_finite(), network, setting, length_m, "a length of at least 0 m")
        })
    }

    /// Refuses reports whose matrix would be too large; the largest has this many observations.
    pub(crate) fn check_size(&self, network: &str, most_in_report: usize) -> Result<(), ObservationError> {
        if self.kind == ErrorCorrelationKind::ScanLine || most_in_report <= MOST_IN_REPORT {
            return Ok(());
        }
        let problem = format!(
            "error_correlation is by distance among {most_in_report} observations of a report, of at most {MOST_IN_REPORT}: \
             divide them into reports, or give the correlation along scan lines"
        );
        Err(ObservationError::in_setting(network, "error_correlation", problem))
    }

    /// Correlates random errors that were drawn independently.
    pub(crate) fn correlate(&self, observations: &mut [Observation], grid: &Grid) {
        if !observations.iter().any(|it| matches!(it.reading, Reading::Error(_))) {
            return;
        }
        let regression = regression(&[Some((self.kind, self.length_m))], observations.iter().map(|it| (it, 0)), grid);
        if regression.is_independent() {
            return;
        }
        let sigma: Vec<f64> = observations.iter().map(|observation| observation.sigma).collect();
        let own = regression.whitened_sigma(&sigma);
        let drawn = observations.iter().zip(sigma.iter().zip(&own));
        let mut errors: Vec<f64> = drawn.map(|(it, (sigma, own))| it.reading.value() / sigma * own).collect();
        regression.correlate(&sigma, &mut errors);
        for (observation, error) in observations.iter_mut().zip(errors) {
            if matches!(observation.reading, Reading::Error(_)) {
                observation.reading.set_value(error);
            }
        }
    }
}

/// The regression of the errors of observations, each with the number of its network, given the kind of correlation and L of
/// each network whose errors are correlated.
pub(crate) fn regression<'a>(
    of_networks: &[Option<(ErrorCorrelationKind, f64)>],
    observations: impl Iterator<Item = (&'a Observation, usize)>,
    grid: &Grid,
) -> ErrorRegression {
    if of_networks.iter().all(Option::is_none) {
        return ErrorRegression::default();
    }
    let mut rows = Regression::new();
    let mut reports: BTreeMap<Report, Vec<(usize, Place)>> = BTreeMap::new();
    for (row, (observation, network)) in observations.enumerate() {
        rows.push((Vec::new(), 1.0));
        let Some((kind, _)) = of_networks[network].filter(|(_, length_m)| *length_m > 0.0) else { continue };
        let report = &observation.report;
        let (number, place) = match (kind, observation.scan_line) {
            (ErrorCorrelationKind::ByDistance, _) => {
                (observation.report_number, Place { x_m: report.x_m, y_m: report.y_m })
            }
            (ErrorCorrelationKind::ScanLine, Some(line)) => (line.number, Place { x_m: line.across_m, y_m: 0.0 }),
            (ErrorCorrelationKind::ScanLine, None) => continue,
        };
        reports.entry((network, report.variable, number, observation.lag)).or_default().push((row, place));
    }
    for ((network, ..), members) in reports {
        let Some((kind, length_m)) = of_networks[network] else { continue };
        let places: Vec<Place> = members.iter().map(|member| member.1).collect();
        let found = match kind {
            ErrorCorrelationKind::ByDistance => {
                by_correlation(places.len(), |i, j| (-places[i].chord_m(places[j], grid) / length_m).exp())
            }
            ErrorCorrelationKind::ScanLine => along_line(&places, length_m),
        };
        for ((row, _), (weights, share)) in members.iter().zip(found) {
            let numbered = weights.into_iter().map(|(before, weight)| (members[before].0, weight));
            rows[*row] = (numbered.collect(), share);
        }
    }
    let mut regression = ErrorRegression::default();
    rows.into_iter().for_each(|(weights, share)| regression.push(weights, share));
    regression
}

/// A report: its network, its variable, its number, and how long before the end of the window it is valid.
type Report = (usize, usize, usize, Duration);

/// b and v of the errors of a report.
type Regression = Vec<(Vec<(usize, f64)>, f64)>;

#[derive(Clone, Copy)]
struct Place {
    x_m: f64,
    y_m: f64,
}

impl Place {
    fn chord_m(self, other: Self, grid: &Grid) -> f64 {
        let chord = |distance: f64, around: f64| around / PI * (PI * distance / around).sin();
        let dx = chord(self.x_m - other.x_m, grid.width_m());
        let dy = match grid.boundary {
            Boundary::Periodic => chord(self.y_m - other.y_m, grid.height_m()),
            Boundary::Channel => self.y_m - other.y_m,
        };
        dx.hypot(dy)
    }
}

/// Along a line each error depends on the one before it: b = e^(−d/L) and v = 1 − e^(−2 d/L).
fn along_line(places: &[Place], length_m: f64) -> Regression {
    let of = |i: usize| {
        let Some(before) = i.checked_sub(1) else { return (Vec::new(), 1.0) };
        let steps = (places[i].x_m - places[before].x_m).abs() / length_m;
        let weight = (-steps).exp();
        let share = (-(-2.0 * steps).exp_m1()).max(LEAST_SHARE);
        (if weight == 0.0 { Vec::new() } else { vec![(before, weight)] }, share)
    };
    (0..places.len()).map(of).collect()
}

/// From the Cholesky factor K of the correlations C and its inverse M: b_i = Σ_j K_ij M_j and √v_i = K_ii.
fn by_correlation(n: usize, correlation: impl Fn(usize, usize) -> f64) -> Regression {
    let mut factor: Vec<Vec<f64>> = Vec::with_capacity(n);
    let mut inverse: Vec<Vec<f64>> = Vec::with_capacity(n);
    let mut rows = Vec::with_capacity(n);
    for i in 0..n {
        let mut own: Vec<f64> = Vec::with_capacity(i + 1);
        for (j, other) in factor.iter().enumerate() {
            let known: f64 = own.iter().zip(other).map(|(a, b)| a * b).sum();
            own.push((correlation(i, j) - known) / other[j]);
        }
        let explained: f64 = own.iter().map(|value| value * value).sum();
        let share = (1.0 - explained).max(LEAST_SHARE);
        let mut weights = vec![0.0; i];
        for (of, row) in own.iter().zip(&inverse).filter(|(of, _)| **of != 0.0) {
            weights.iter_mut().zip(row).for_each(|(weight, value)| *weight += of * value);
        }
        let root = share.sqrt();
        inverse.push(weights.iter().map(|weight| -weight / root).chain([1.0 / root]).collect());
        own.push(root);
        factor.push(own);
        rows.push((weights.into_iter().enumerate().filter(|(_, weight)| *weight != 0.0).collect(), share));
    }
    rows
}
