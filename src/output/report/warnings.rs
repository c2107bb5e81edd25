//! Warnings on the page: reliability diagrams, and scores by lead time.

use super::figures::Drawing;
use crate::event::RunInfo;
use crate::output::netcdf::coordinates::safe_name;
use crate::plot::colors::of_method_on_paper;
use crate::plot::{Curve, CurvePlot, Dash};
use crate::scores::{Summary, WarningScores};
use crate::tables::warnings;
use crate::threshold_warning::PlacedWarning;

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
                 over all lead times after the analysis. On the broken line if probabilities are right; below it they are too \
                 large."
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
