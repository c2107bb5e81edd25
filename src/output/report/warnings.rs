//! Warnings on the page: reliability diagrams, scores by lead time, and maps of probability.

use super::figures::Drawing;
use super::maps;
use crate::calendar::utc;
use crate::event::{Forecast, RunInfo};
use crate::output::netcdf::coordinates::safe_name;
use crate::plot::colors::Scale;
use crate::plot::colors::of_method_on_paper;
use crate::plot::{Curve, CurvePlot, Dash, FieldMap, Thinning, number};
use crate::scores::{Summary, WarningScores};
use crate::tables::warnings;
use crate::threshold_warning::PlacedWarning;
use std::collections::BTreeMap;

/// The probabilities of events at all grid points at the longest lead time of the last forecasts that reach it within the run.
#[derive(Debug)]
pub struct ProbabilityFields {
    thinning: Thinning,
    /// By warning and method.
    fields: BTreeMap<(usize, usize), Vec<f32>>,
}

impl ProbabilityFields {
    /// Nothing yet.
    pub fn new(thinning: Thinning) -> Self {
        Self { thinning, fields: BTreeMap::new() }
    }

    /// Takes a forecast, if it is one of those.
    pub fn add(&mut self, info: &RunInfo, forecast: &Forecast<'_>) {
        let Some(times) = info.lead_times else { return };
        let start = times.last_complete_start(times.first_start(info.score_from_cycle, info.done), info.cycles);
        if (forecast.from_cycle, forecast.cycle - forecast.from_cycle) != (start, times.longest_cycles) {
            return;
        }
        for (number, placed) in info.warnings.iter().enumerate() {
            let field = self.thinning.apply(&placed.field(&forecast.estimate));
            self.fields.insert((number, forecast.method), field);
        }
    }

    /// The maps of a warning.
    pub fn maps(&self, info: &RunInfo, warning: usize) -> Vec<maps::Drawing> {
        let Some(times) = info.lead_times else { return Vec::new() };
        let start = times.last_complete_start(times.first_start(info.score_from_cycle, info.done), info.cycles);
        let grid = self.thinning.grid(&info.layout.grid);
        let name = &info.warnings[warning].warning.name;
        let map = |(&(_, place), field): (&(usize, usize), &Vec<f32>)| {
            let method = &info.methods[place].name;
            let hours = number(info.lead_hours(times.longest_cycles));
            let map = FieldMap {
                title: format!("{method}: probability of {name}"),
                unit: "1".into(),
                field: field.clone(),
                size: self.thinning.size(),
                extent_m: [grid.width_m(), grid.height_m()],
                scale: Scale::Spread,
                range: [0.0, 1.0],
                steps: Vec::new(),
                contours: vec![0.1, 0.5, 0.9],
                coast: maps::coastlines(info),
                marks: Vec::new(),
            };
            let time = utc(info.time(start + times.longest_cycles));
            let caption = format!(
                "Probability of the event at each grid point at {time}, in the forecast of {method} {hours} h before. Lines: 0.1, \
                 0.5 and 0.9."
            );
            maps::Drawing {
                stem: format!("warning_{}_map_{:02}_{}", safe_name(name, "_-"), place + 1, safe_name(method, "_-")),
                caption,
                map,
            }
        };
        self.fields.range((warning, 0)..=(warning, usize::MAX)).map(map).collect()
    }
}

/// What there is to know of the warnings; `None` without any.
pub fn text(info: &RunInfo, summary: &Summary) -> Option<String> {
    let names = warnings::names(summary);
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
    if names.is_empty() {
        return None;
    }
    let mut text = "The probability of an event, from mean and spread of a forecast as a normal distribution; in an area the \
                    largest of a single grid point, which is a lower bound. The Brier score is the mean square of probability \
                    minus outcome, its skill that beside the event's frequency in these cases."
        .to_string();
    text.extend(info.warnings.iter().map(of_warning));
    text.extend(warnings::deterministic(summary).map(|note| format!(" {note}.")));
    Some(text)
}

/// For each warning its reliability diagram, and the Brier score by lead time.
pub fn drawings(info: &RunInfo, summary: &Summary) -> Vec<Drawing> {
    let of_warning = |placed: &PlacedWarning| {
        let name = &placed.warning.name;
        let both = |pick: fn(&WarningScores) -> Vec<[f64; 2]>| -> Vec<Curve> {
            let methods = summary.methods.iter().enumerate();
            let curve = |(number, (method, scores)): (usize, (&String, &crate::scores::MethodScores))| {
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
        let mut curves = both(diagram);
        let points: Vec<Curve> = curves.iter().map(|curve| curve.clone().unnamed(Dash::Points)).collect();
        curves.extend(points);
        if !curves.is_empty() {
            let right = Curve::new("right", [0; 3], vec![[0.0, 0.0], [1.0, 1.0]]);
            curves.push(Curve { color: None, dash: Dash::Dashed, ..right });
        }
        let described = placed.warning.describe(&info.layout);
        let reliability = Drawing {
            stem: format!("warning_{}_reliability", safe_name(name, "_-")),
            caption: format!(
                "Reliability of {name}, {described}: how often the event came about where its probability was about the same, \
                 over all lead times after the analysis. On the broken line if probabilities are right; above it they are too \
                 small, below it too large."
            ),
            plot: CurvePlot::new(
                format!("reliability of {name}"),
                "probability that was said [1]".into(),
                "frequency of the event [1]".into(),
                curves,
            ),
        };
        let brier = Drawing {
            stem: format!("warning_{}_brier", safe_name(name, "_-")),
            caption: format!("Brier score of {name} by lead time: 0 is perfect."),
            plot: CurvePlot::new(format!("Brier score of {name}"), "lead time [h]".into(), "[1]".into(), both(by_lead)),
        };
        [reliability, brier]
    };
    let drawn = info.warnings.iter().flat_map(of_warning);
    drawn.filter(|drawing| !drawing.plot.curves.is_empty()).collect()
}
