//! What a run tells of its methods beyond their errors: whether the distributions that they claim are right, what each type
//! of observations says of the assumed covariances and is worth, and how well every bias is known.
//!
//! Sums are gathered cycle by cycle in [`DiagnosticSums`], and come to [`Diagnostics`].

mod bias;
mod departures;
mod normal;
mod observations;
mod state;

pub use bias::BiasDiagnostics;
pub use departures::Departures;
pub use normal::{crps, probability_below};
pub use observations::ObservationDiagnostics;
pub use state::{BINS, StateDiagnostics};

use crate::outcome::{Influence, Outcome, TypeInfluence};
use crate::scores::PerVariable;
use crate::scores::TrueValues;
use crate::scores::statistics::{self, Interval};
use bias::BiasSums;
use departures::DepartureSums;
use indexmap::IndexMap;
use isobar_model::Layout;
use isobar_obs::{Calibration, ObservationType, ObservationWindow};
use observations::ObservationSums;
use serde::{Deserialize, Serialize};
use state::StateSums;
use std::collections::BTreeMap;

/// What is gathered of one method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticSums {
    /// By number of the variable.
    state: Vec<StateSums>,
    observations: BTreeMap<ObservationType, ObservationSums>,
    /// Departures of the observations that are used, and of passive ones.
    used: BTreeMap<ObservationType, DepartureSums>,
    passive: BTreeMap<ObservationType, DepartureSums>,
    /// The last background departure of each platform and type.
    last: BTreeMap<(ObservationType, String), f64>,
    /// By number of the parameter.
    biases: Vec<BiasSums>,
    /// χ²/n of each cycle.
    chi2: Vec<f64>,
    /// Cycles that were probed, and what their analyses took off the mean square error of each variable.
    probed: (u64, Vec<f64>),
}

/// What a run tells of one method beyond its errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Diagnostics {
    /// Of the analysis of each variable.
    pub state: IndexMap<String, StateDiagnostics>,
    /// Of each type of observations, `network/variable`.
    pub observations: IndexMap<String, ObservationDiagnostics>,
    /// Departures of each type of observations that are used.
    #[serde(default)]
    pub used: IndexMap<String, Departures>,
    /// The same of passive observations, which are independent of the estimates.
    #[serde(default)]
    pub passive: IndexMap<String, Departures>,
    /// What the probed analyses took off the mean square error of each variable, in the square of its unit.
    pub error_reduction: Option<PerVariable>,
    /// 95 % interval of the mean over cycles of χ²/n.
    pub innovation_chi2_interval: Option<Interval>,
    /// Of all bias parameters whose truth is known together, each divided by its prior's standard deviation.
    pub all_biases: Option<BiasDiagnostics>,
    /// Of each bias parameter whose truth is known.
    pub biases: IndexMap<String, BiasDiagnostics>,
}

impl DiagnosticSums {
    /// Those of one cycle: without a truth those alone that need none. The biases count only if the method estimates or
    /// ignores them.
    pub fn of_cycle(
        truth: Option<TrueValues<'_>>,
        outcome: &Outcome,
        observed: &ObservationWindow,
        calibration: &Calibration,
        scores_bias: bool,
    ) -> Self {
        let mut sums = Self::default();
        sums.take_departures(outcome, observed);
        let Some(truth) = truth else {
            let types = outcome.influence.iter().flat_map(|influence| &influence.types);
            types.for_each(|own| sums.probe(own, &[]));
            return sums;
        };
        let (background, analysis) = (&outcome.background, &outcome.analysis.estimate);
        let (layout, cells) = (truth.state.layout(), truth.state.layout().grid.cells());
        let errors = |values: &[f64]| -> Vec<f64> {
            values.iter().zip(truth.state.values()).map(|(value, truth)| value - truth).collect()
        };
        let analysis_errors = errors(analysis.state.values());
        for (variable, own) in analysis_errors.chunks_exact(cells).enumerate() {
            let spread = analysis.state_spread.as_ref().map(|spread| &spread[variable * cells..][..cells]);
            sums.state.push(StateSums::of_cycle(own, spread));
        }
        if scores_bias {
            let spread = analysis.calibration_spread.as_ref();
            for (number, truth) in truth.calibration.iter().enumerate().take(calibration.len()) {
                let sigma = spread.and_then(|spread| spread.get(number).copied());
                let error = truth.map(|truth| analysis.calibration[number] - truth);
                sums.biases.push(error.map_or_else(BiasSums::default, |error| BiasSums::of_cycle(error, sigma)));
            }
        }
        if let Some(influence) = &outcome.influence {
            let background_errors = errors(background.state.values());
            sums.take_influence(layout, influence, &background_errors, &analysis_errors);
        }
        sums
    }

    /// Takes what a probe shows of the observations of one type.
    fn probe(&mut self, own: &TypeInfluence, reduction: &[f64]) {
        self.observations.entry(own.observation_type.clone()).or_default().probe(own.signal, reduction);
    }

    fn take_departures(&mut self, outcome: &Outcome, observed: &ObservationWindow) {
        let analysis = &outcome.analysis;
        let departures = analysis.background_departures.iter().zip(&analysis.analysis_departures);
        for ((report, sigma), (&background, &after)) in observed.reports.iter().zip(&observed.sigma).zip(departures) {
            let kind = report.observation_type();
            self.used.entry(kind.clone()).or_default().add([background, after]);
            self.observations.entry(kind.clone()).or_default().observe(background, after, sigma * sigma);
            self.last.insert((kind, report.platform.to_string()), background);
        }
        self.observations.values_mut().for_each(ObservationSums::end_cycle);
        for (at, it) in observed.aside.passive() {
            if let (Some(background), Some(after)) = (outcome.unused.background[at], outcome.unused.analysis[at]) {
                self.passive.entry(it.report.observation_type()).or_default().add([background, after]);
            }
        }
        let n = analysis.background_departures.len();
        self.chi2.extend(analysis.innovation_chi2.filter(|_| n > 0).map(|chi2| chi2 / n as f64));
    }

    /// The part of each type of observations in what the analysis takes off the mean square error of each variable,
    ///
    /// ```text
    /// |e_b|² − |e_a|² = −(e_b + e_a)ᵀ (e_a − e_b) = −Σ_t (e_b + e_a)ᵀ K d_t
    /// ```
    ///
    /// with errors e of background and analysis, gain K, and innovations d_t of one type alone: Langland and Baker 2004
    /// (Tellus 56A, eqs. 8–10) at a lead of zero, where their estimate is exact, with the truth for the verifying analysis
    /// and, for their adjoint, the analysis itself.
    fn take_influence(&mut self, layout: &Layout, influence: &Influence, before: &[f64], after: &[f64]) {
        let cells = layout.grid.cells();
        let sums: Vec<f64> = before.iter().zip(after).map(|(before, after)| before + after).collect();
        // Σ over the cells of each variable, divided by their number.
        let reduction = |increment: &[f64]| -> Vec<f64> {
            let of_variable = |(sums, own): (&[f64], &[f64])| sums.iter().zip(own).map(|(sum, own)| sum * own).sum();
            let pairs = sums.chunks_exact(cells).zip(increment.chunks_exact(cells));
            pairs.map(of_variable).map(|sum: f64| (0.0 - sum) / cells as f64).collect()
        };
        for own in &influence.types {
            self.probe(own, &reduction(&own.increment));
        }
        let increment: Vec<f64> = before.iter().zip(after).map(|(before, after)| after - before).collect();
        self.probed = (1, reduction(&increment));
    }

    /// Takes in the next cycle's.
    pub fn add(&mut self, cycle: &Self) {
        self.state.resize(self.state.len().max(cycle.state.len()), StateSums::default());
        self.state.iter_mut().zip(&cycle.state).for_each(|(own, other)| own.add(other));
        for (kind, other) in &cycle.observations {
            self.observations.entry(kind.clone()).or_default().add(other);
        }
        for (own, other) in [(&mut self.used, &cycle.used), (&mut self.passive, &cycle.passive)] {
            for (kind, other) in other {
                own.entry(kind.clone()).or_default().take(other);
            }
        }
        for (place, &now) in &cycle.last {
            if let Some(before) = self.last.insert(place.clone(), now)
                && let Some(sums) = self.observations.get_mut(&place.0)
            {
                sums.follow(before, now);
            }
        }
        self.biases.resize(self.biases.len().max(cycle.biases.len()), BiasSums::default());
        self.biases.iter_mut().zip(&cycle.biases).for_each(|(own, other)| own.add(other));
        self.chi2.extend_from_slice(&cycle.chi2);
        self.probed.0 += cycle.probed.0;
        self.probed.1.resize(self.probed.1.len().max(cycle.probed.1.len()), 0.0);
        self.probed.1.iter_mut().zip(&cycle.probed.1).for_each(|(own, other)| *own += other);
    }

    /// What they come to.
    pub fn diagnostics(&self, layout: &Layout, calibration: &Calibration) -> Diagnostics {
        let names = || layout.variables.iter().map(|variable| variable.name);
        let state = names().zip(&self.state);
        let of_type =
            |(kind, sums): (&ObservationType, &ObservationSums)| (kind.name(layout), sums.diagnostics(names()));
        let parameters = calibration.parameters.iter().zip(&self.biases);
        let mut together: Option<BiasSums> = None;
        for (parameter, sums) in parameters.clone() {
            together.get_or_insert_default().add(&sums.scaled(1.0 / parameter.sigma_prior));
        }
        let departures = |all: &BTreeMap<ObservationType, DepartureSums>| {
            all.iter().map(|(kind, sums)| (kind.name(layout), sums.departures())).collect()
        };
        let (probed, reduction) = &self.probed;
        let reduction = names().zip(reduction).map(|(name, sum)| (name.to_string(), sum / *probed as f64));
        Diagnostics {
            state: state.filter_map(|(name, sums)| Some((name.to_string(), sums.diagnostics()?))).collect(),
            observations: self.observations.iter().filter(|(_, sums)| !sums.is_empty()).map(of_type).collect(),
            used: departures(&self.used),
            passive: departures(&self.passive),
            error_reduction: (*probed > 0).then(|| reduction.collect()),
            innovation_chi2_interval: statistics::mean(&self.chi2).and_then(|mean| mean.interval()),
            all_biases: together.and_then(|sums| sums.diagnostics()),
            biases: parameters
                .filter_map(|(parameter, sums)| Some((parameter.name.clone(), sums.diagnostics()?)))
                .collect(),
        }
    }
}
