//! Warnings on the page: reliability diagrams, scores by lead time, and maps of probability.

use super::maps::{self, Maps};
use super::section::{Drawing, Folded};
use crate::calendar::utc;
use crate::event::{Forecast, RunInfo};
use crate::output::history::History;
use crate::output::netcdf::coordinates::safe_name;
use crate::plot::colors::{Scale, of_method_on_paper};
use crate::plot::{Curve, CurvePlot, Dash, FieldMap, number};
use crate::scores::{MethodScores, Summary, WarningScores};
use crate::tables::warnings;
use crate::threshold_warning::{PlacedWarning, ThresholdWarning};
use std::collections::BTreeMap;

/// The probabilities of events at all grid points at the longest lead time of the last forecasts that reach it within the run.
#[derive(Debug, Default)]
pub struct ProbabilityFields {
    /// Thinned as all maps, by warning and method.
    fields: BTreeMap<(usize, usize), Vec<f32>>,
}

impl ProbabilityFields {
    /// Takes a forecast, if it is one of those.
    pub fn add(&mut self, history: &History, forecast: &Forecast<'_>) {
        let info = &history.info;
        let Some(times) = info.lead_times else { return };
        let lead = forecast.cycle - forecast.from_cycle;
        if (forecast.from_cycle, lead) != (info.last_complete_start(times), times.longest_cycles) {
            return;
        }
        for (number, placed) in info.warnings.iter().enumerate() {
            let field = history.thinning.apply(&placed.field(&forecast.estimate));
            self.fields.insert((number, forecast.method), field);
        }
    }

    /// The maps of a warning.
    pub fn maps(&self, info: &RunInfo, maps: &Maps<'_>, warning: usize) -> Vec<maps::Drawing> {
        let Some(times) = info.lead_times else { return Vec::new() };
        let time = utc(info.time(info.last_complete_start(times) + times.longest_cycles));
        let hours = number(info.lead_hours(times.longest_cycles));
        let ThresholdWarning { name, variable, .. } = &info.warnings[warning].warning;
        let map = |(&(_, place), field): (&(usize, usize), &Vec<f32>)| {
            let method = &info.methods[place].name;
            let title = format!("{method}: probability of {name}");
            let map = maps.map(*variable, title, field.clone(), Scale::Spread, [0.0, 1.0]);
            let caption = format!(
                "Probability of the event at each grid point at {time}, in the forecast of {method} {hours} h before. Lines: 0.1, \
                 0.5 and 0.9."
            );
            let stem = format!("warning_{}_map_{:02}_{}", safe_name(name, "_-"), place + 1, safe_name(method, "_-"));
            Drawing { stem, caption, plot: FieldMap { unit: "1".into(), contours: vec![0.1, 0.5, 0.9], ..map } }
        };
        self.fields.range((warning, 0)..=(warning, usize::MAX)).map(map).collect()
    }
}

/// What there is to know of the warnings; `None` without any.
pub fn text(info: &RunInfo, summary: &Summary) -> Option<String> {
    if warnings::names(summary).is_empty() {
        return None;
    }
    let of_warning = |placed: &PlacedWarning| {
        let warning = &placed.warning;
        format!(
            " {}: {}, issued from {:.0} % on; {}.",
            warning.name,
            warning.describe(&info.layout),
            100.0 * warning.issued_from,
            warnings::frequency(summary, &warning.name)
        )
    };
    let mut text = "The probability of an event, from mean and spread of a forecast as a normal distribution; in an area the \
                    largest of a single grid point, which is a lower bound. The Brier score is the mean square of probability \
                    minus outcome; the skill compares it with that of always forecasting the event's frequency in these cases."
        .to_string();
    text.extend(info.warnings.iter().map(of_warning));
    text.extend(warnings::deterministic(summary).map(|note| format!(" {note}.")));
    Some(text)
}

/// For each warning its scores, and the probabilities in the last forecasts.
pub fn tables(summary: &Summary) -> Vec<Folded> {
    let of_warning = |name: &String| {
        let outlook = warnings::outlook(summary, name).map(|(from_cycle, outlook)| {
            (format!("Probability of {name} ahead of the analysis of cycle {from_cycle}"), outlook)
        });
        let scores = [
            (format!("Scores of {name}"), warnings::table(summary, name)),
            (format!("Scores of {name} by lead time"), warnings::by_lead(summary, name)),
        ];
        let titled = scores.into_iter().chain(outlook);
        titled.map(|(title, table)| Folded { title, tables: vec![table], ..Folded::default() }).collect::<Vec<_>>()
    };
    warnings::names(summary).iter().flat_map(of_warning).collect()
}

/// The curves, with a mark at each of their points.
fn with_points(mut curves: Vec<Curve>) -> Vec<Curve> {
    let points: Vec<Curve> = curves.iter().map(|curve| curve.clone().unnamed(Dash::Points)).collect();
    curves.extend(points);
    curves
}

/// For each warning its reliability diagram, how often each probability was forecast, and the Brier score by lead time.
pub fn drawings(info: &RunInfo, summary: &Summary) -> Vec<Drawing<CurvePlot>> {
    let of_warning = |placed: &PlacedWarning| {
        let name = &placed.warning.name;
        let both = |pick: fn(&WarningScores) -> Vec<[f64; 2]>| -> Vec<Curve> {
            let methods = summary.methods.iter().enumerate();
            let curve = |(number, (method, scores)): (usize, (&String, &MethodScores))| {
                let own = scores.warnings.iter().find(|it| it.name == *name)?;
                Some(Curve::new(method, of_method_on_paper(number), pick(own))).filter(|curve| !curve.points.is_empty())
            };
            methods.filter_map(curve).collect()
        };
        let diagram =
            |scores: &WarningScores| scores.bins.iter().map(|bin| [bin.probability, bin.frequency]).collect::<Vec<_>>();
        let by_lead = |scores: &WarningScores| {
            let leads = scores.leads.iter();
            leads.filter_map(|lead| Some([lead.lead_hours, lead.scores.brier?.score.value])).collect::<Vec<_>>()
        };
        let share = |scores: &WarningScores| {
            let all = scores.bins.iter().map(|bin| bin.cases).sum::<usize>() as f64;
            scores.bins.iter().map(|bin| [bin.probability, bin.cases as f64 / all]).collect::<Vec<_>>()
        };
        let mut curves = with_points(both(diagram));
        // Closer to the frequency of the event than to the right one, a probability makes the Brier score worse than that of a
        // forecast that is always this frequency (Murphy 1973).
        if !curves.is_empty() {
            curves.push(Curve::reference("right", vec![[0.0, 0.0], [1.0, 1.0]]));
        }
        let own = summary.methods.values().flat_map(|scores| &scores.warnings).filter(|own| own.name == *name);
        if let Some(ahead) = own.map(|own| &own.ahead).find(|ahead| ahead.occurred > 0 && ahead.occurred < ahead.cases)
        {
            let frequency = ahead.occurred as f64 / ahead.cases as f64;
            curves.push(Curve::reference("no skill", vec![[0.0, 0.5 * frequency], [1.0, 0.5 * (1.0 + frequency)]]));
        }
        let described = placed.warning.describe(&info.layout);
        let reliability = Drawing {
            stem: format!("warning_{}_reliability", safe_name(name, "_-")),
            caption: format!(
                "Reliability of {name}, {described}: how often the event came about where its probability was about the same, \
                 over all lead times after the analysis. On the line named \"right\" probabilities are right; above it they are \
                 too small, below it too large. Beyond the line \"no skill\" they are worse than always forecasting the event's \
                 frequency."
            ),
            plot: CurvePlot::new(
                format!("reliability of {name}"),
                "forecast probability [1]".into(),
                "frequency of the event [1]".into(),
                curves,
            ),
        };
        let brier = Drawing {
            stem: format!("warning_{}_brier", safe_name(name, "_-")),
            caption: format!("Brier score of {name} by lead time: 0 is perfect."),
            plot: CurvePlot::new(format!("Brier score of {name}"), "lead time [h]".into(), "[1]".into(), both(by_lead)),
        };
        // All probabilities have a place, whichever were forecast.
        let axis = Curve::reference("", vec![[0.0, 0.0], [1.0, 0.0]]).unnamed(Dash::Solid);
        let sharpness = Drawing {
            stem: format!("warning_{}_sharpness", safe_name(name, "_-")),
            caption: format!(
                "How often each probability of {name} was forecast: sharp forecasts are near 0 and 1. Where there are few, the \
                 reliability is uncertain."
            ),
            plot: CurvePlot::new(
                format!("sharpness of {name}"),
                "forecast probability [1]".into(),
                "share of forecasts [1]".into(),
                with_points(both(share)).into_iter().chain([axis]).collect(),
            ),
        };
        [reliability, sharpness, brier]
    };
    let drawn = info.warnings.iter().flat_map(of_warning);
    drawn.filter(|drawing| drawing.plot.curves.iter().any(|curve| curve.name.is_some())).collect()
}
