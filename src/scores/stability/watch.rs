//! What the monitor gathers, cycle by cycle.

use super::needs::Information;
use super::{Expected, VarianceGrowth};
use crate::outcome::Outcome;
use indexmap::IndexMap;
use isobar_model::Layout;
use isobar_obs::{ObservationWindow, SensorComparison};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The fewest pairs of cycles from which a correlation is worked out.
const FEWEST_PAIRS: usize = 5;

/// Of the normal distribution, for 95 %.
const TWO_SIDED: f64 = 1.96;

/// Products of successive values of a series that should be white.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Lagged {
    squares: f64,
    products: f64,
    /// Sum of the squares of the products of each pair of cycles: their variance, as they have mean zero.
    squared_products: f64,
    pairs: usize,
}

impl Lagged {
    /// A cycle's squares, and products with the cycle before.
    fn add(&mut self, squares: f64, products: Option<f64>) {
        self.squares += squares;
        if let Some(products) = products {
            self.products += products;
            self.squared_products += products * products;
            self.pairs += 1;
        }
    }

    /// Σ d_t d_{t−1} / Σ d_t², and how large it may be for a white series.
    fn correlation(&self) -> Option<Expected> {
        (self.pairs >= FEWEST_PAIRS && self.squares > 0.0).then(|| Expected {
            value: self.products / self.squares,
            expected: 0.0,
            tolerance: TWO_SIDED * self.squared_products.sqrt() / self.squares,
        })
    }
}

/// What the innovations say of a parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct OfParameter {
    observations: usize,
    last: Option<f64>,
    lagged: Lagged,
    information: Information,
}

/// A station's series: network, platform, variable.
type Series = (Arc<str>, Arc<str>, usize);

/// What the monitor remembers of a method; all of it is in a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Watch {
    from_cycle: usize,
    observations: usize,
    chi2: Option<f64>,
    lagged: Lagged,
    /// The last normalised innovation of each station.
    stations: BTreeMap<Series, f64>,
    parameters: Vec<OfParameter>,
    /// Mean claimed variance of each variable in the last analysis, sums of the logarithms of growth, and their number.
    last_variances: Option<Vec<f64>>,
    growth: Vec<f64>,
    forecasts: usize,
    /// Mean claimed variances of all backgrounds, cycle by cycle.
    backgrounds: Vec<Vec<f64>>,
}

impl Watch {
    /// A watch that leaves out what is before a cycle, while the method still finds its way.
    pub fn new(from_cycle: usize) -> Self {
        Self { from_cycle, ..Self::default() }
    }

    /// Takes in a cycle, with the comparisons that the method took.
    pub fn add(&mut self, observed: &ObservationWindow, compared: &[SensorComparison], outcome: &Outcome) {
        self.add_parameters(observed, compared, outcome);
        if observed.cycle < self.from_cycle {
            return;
        }
        self.observations += observed.len();
        if let Some(chi2) = outcome.analysis.innovation_chi2 {
            *self.chi2.get_or_insert(0.0) += chi2;
        }
        self.add_stations(observed, &outcome.analysis.background_departures);
        self.add_variances(outcome);
    }

    /// Only stations report from one place again and again.
    fn add_stations(&mut self, observed: &ObservationWindow, departures: &[f64]) {
        let (mut squares, mut products, mut pairs) = (0.0, 0.0, 0);
        for ((report, departure), sigma) in observed.reports.iter().zip(departures).zip(&observed.sigma) {
            if report.scan.is_some() {
                continue;
            }
            let value = departure / sigma;
            squares += value * value;
            let series = (Arc::clone(&report.network), Arc::clone(&report.platform), report.variable);
            if let Some(last) = self.stations.insert(series, value) {
                products += value * last;
                pairs += 1;
            }
        }
        self.lagged.add(squares, (pairs > 0).then_some(products));
    }

    /// z = Σ G d/σ² / √(Σ G²/σ²) of each parameter: what the innovations of the cycle say that it should change.
    fn add_parameters(&mut self, observed: &ObservationWindow, compared: &[SensorComparison], outcome: &Outcome) {
        let calibration = &outcome.background.calibration;
        self.parameters.resize(calibration.len(), OfParameter::default());
        for (parameter, _) in compared.iter().flat_map(SensorComparison::row) {
            self.parameters[parameter].observations += 1;
        }
        if calibration.is_empty() || observed.is_empty() {
            return;
        }
        let rows = observed.operator.linearize(&outcome.background.state, calibration).calibration;
        let mut sums = vec![(0, 0.0, 0.0); calibration.len()];
        for (row, (departure, sigma)) in outcome.analysis.background_departures.iter().zip(&observed.sigma).enumerate()
        {
            for &(parameter, weight) in rows.row(row) {
                let (count, signal, information) = &mut sums[parameter];
                *count += 1;
                *signal += weight * departure / (sigma * sigma);
                *information += weight * weight / (sigma * sigma);
            }
        }
        for (own, (count, signal, information)) in self.parameters.iter_mut().zip(sums) {
            own.observations += count;
            if information > 0.0 && observed.cycle >= self.from_cycle {
                let value: f64 = signal / f64::sqrt(information);
                own.lagged.add(value * value, own.last.map(|last| last * value));
                own.last = Some(value);
            }
        }
    }

    fn add_variances(&mut self, outcome: &Outcome) {
        let layout = outcome.background.state.layout();
        let Some(background) = &outcome.background.state_spread else { return };
        let background = mean_squares(layout, background);
        if let Some(last) = &self.last_variances {
            self.growth.resize(background.len(), 0.0);
            let pairs = background.iter().zip(last);
            self.growth.iter_mut().zip(pairs).for_each(|(sum, (new, old))| *sum += (new / old).ln());
            self.forecasts += 1;
        }
        self.backgrounds.push(background);
        self.last_variances =
            outcome.analysis.estimate.state_spread.as_ref().map(|spread| mean_squares(layout, spread));
    }

    /// How many observations and comparisons had a parameter.
    pub(super) fn observations_of(&self, parameter: usize) -> usize {
        self.parameters.get(parameter).map_or(0, |own| own.observations)
    }

    /// Correlation of what successive innovations say of a parameter.
    pub(super) fn lag_correlation_of(&self, parameter: usize) -> Option<Expected> {
        self.parameters.get(parameter)?.lagged.correlation()
    }

    /// Takes in the share of its prior variance that a parameter keeps after a cycle, which [`Watch::add`] has taken in.
    pub(super) fn add_variance_ratio(&mut self, parameter: usize, variance_ratio: f64) {
        if let Some(own) = self.parameters.get_mut(parameter) {
            own.information.add(variance_ratio);
        }
    }

    /// How much observations have said of a parameter.
    pub(super) fn information_of(&self, parameter: usize) -> Information {
        self.parameters.get(parameter).map_or_else(Information::default, |own| own.information)
    }

    /// Gathers what successive innovations say of a parameter anew.
    pub(super) fn forget_correlation_of(&mut self, parameter: usize) {
        if let Some(own) = self.parameters.get_mut(parameter) {
            (own.last, own.lagged) = (None, Lagged::default());
        }
    }

    /// Correlation of a station's successive innovations.
    pub(super) fn lag_correlation(&self) -> Option<Expected> {
        self.lagged.correlation()
    }

    /// χ²/n, of which the variance is 2/n.
    pub(super) fn innovation_chi2(&self) -> Option<Expected> {
        let n = self.observations as f64;
        let value = self.chi2.filter(|_| n > 0.0)? / n;
        Some(Expected { value, expected: 1.0, tolerance: TWO_SIDED * (2.0 / n).sqrt() })
    }

    /// How the claimed variances go.
    pub(super) fn variances(&self, layout: &Layout) -> IndexMap<String, VarianceGrowth> {
        let cycles = self.backgrounds.len();
        if cycles < 3 || self.forecasts == 0 {
            return IndexMap::new();
        }
        let mean = |range: std::ops::Range<usize>, variable: usize| {
            let count = range.len() as f64;
            self.backgrounds[range].iter().map(|variances| variances[variable]).sum::<f64>() / count
        };
        let growth = |variable: usize| VarianceGrowth {
            per_cycle: (self.growth[variable] / self.forecasts as f64).exp(),
            trend: mean(cycles - cycles / 3..cycles, variable) / mean(cycles / 3..cycles - cycles / 3, variable),
        };
        let finite = |own: &VarianceGrowth| own.per_cycle.is_finite() && own.trend.is_finite();
        let named = layout.variables.iter().enumerate().map(|(number, it)| (it.name.to_string(), growth(number)));
        named.filter(|(_, own)| finite(own)).collect()
    }

    /// Whether it is of states of this layout; one that was read from a file may not be.
    pub fn fits(&self, layout: &Layout) -> bool {
        let variables = layout.variables.len();
        self.last_variances.iter().chain(&self.backgrounds).all(|own| own.len() == variables)
            && (self.growth.is_empty() || self.growth.len() == variables)
            && (self.forecasts == 0 || self.growth.len() == variables)
    }
}

fn mean_squares(layout: &Layout, spread: &[f64]) -> Vec<f64> {
    let cells = layout.grid.cells();
    let of_field = |field: &[f64]| field.iter().map(|sigma| sigma * sigma).sum::<f64>() / cells as f64;
    spread.chunks_exact(cells).map(of_field).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::{standard_normals, stream};

    #[test]
    fn a_white_series_is_within_its_tolerance_and_a_red_one_is_not() {
        let noise = standard_normals(&mut stream(1, "whiteness"), 40_000);
        let mut inside = 0;
        for series in noise.chunks_exact(200) {
            let mut lagged = Lagged::default();
            for (number, value) in series.iter().enumerate() {
                lagged.add(value * value, (number > 0).then(|| value * series[number - 1]));
            }
            inside += usize::from(lagged.correlation().unwrap().holds());
        }
        // 95 % of 200 series, within three standard deviations of the binomial distribution.
        assert!((180..=199).contains(&inside), "{inside}");
        let (mut lagged, mut last) = (Lagged::default(), 0.0);
        for value in &noise[..200] {
            let red = 0.6 * last + value;
            lagged.add(red * red, Some(red * last));
            last = red;
        }
        let found = lagged.correlation().unwrap();
        assert!(!found.holds() && (found.value - 0.6).abs() < 0.15, "{found:?}");
        assert_eq!(Lagged::default().correlation(), None);
    }
}
