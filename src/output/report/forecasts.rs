//! Forecasts ahead on the page: curves by lead time.

use super::section::Drawing;
use crate::event::RunInfo;
use crate::plot::colors::of_method_on_paper;
use crate::plot::{Curve, CurvePlot, Dash, unit};
use crate::scores::forecast::{ANOMALY_CORRELATION, DEPARTURE, ForecastScores, Known, RMSE, SPREAD, VerifiedBy};
use crate::scores::{MethodScores, Summary};
use crate::tables::forecasts;

/// What there is to know of the curves; `None` without forecasts.
pub fn text(summary: &Summary) -> Option<String> {
    let by = summary.methods.values().find_map(|scores| Some(scores.forecasts.as_ref()?.verified_by))?;
    let against = match by {
        VerifiedBy::Truth => "with the truth of their valid time",
        VerifiedBy::PassiveObservations => "with the passive observations of their valid time",
        VerifiedBy::UsedObservations => {
            "with the observations of their valid time, which the analysis, lead time 0, has used"
        }
    };
    let mut text = format!(
        "After some analyses a copy of each method goes on without observations. Its forecasts are compared {against}: \
         {}. Bands are 95 % intervals over the forecasts. Time that they take is not in the time of a cycle. Anomalies are \
         counted from the first background.",
        forecasts::cases(summary)
    );
    forecasts::failed(summary).iter().for_each(|failed| text += &format!(" {failed}."));
    Some(text)
}

/// Errors and claims of each variable by lead time, and the correlations of anomalies.
pub fn drawings(info: &RunInfo, summary: &Summary) -> Vec<Drawing<CurvePlot>> {
    let mut drawings = Vec::new();
    for variable in &info.layout.variables {
        let (name, long_name) = (variable.name, &variable.long_name);
        let error = if info.has_truth { RMSE } else { DEPARTURE };
        let label = format!("[{}]", unit(variable.unit));
        let both = |score: &str, dash: Dash| curves(summary, name, score, dash);
        let mut all = both(error, Dash::Solid);
        all.extend(both(SPREAD, Dash::Dashed));
        if !all.is_empty() {
            let measured = if info.has_truth { "error" } else { "departure of the observations" };
            let caption = format!(
                "Forecasts of {long_name} by lead time: root-mean-square {measured} (solid) and claimed spread (broken)."
            );
            let title =
                format!("{} and spread of {name} by lead time", if info.has_truth { "RMSE" } else { "departure" });
            let plot = CurvePlot::new(title, "lead time [h]".into(), label, all);
            drawings.push(Drawing { stem: format!("forecast_{name}"), caption, plot });
        }
        let all = both(ANOMALY_CORRELATION, Dash::Solid);
        if !all.is_empty() {
            let caption = format!(
                "Correlation of the anomalies of forecast and true {long_name} from the first background: 1 for a perfect \
                 forecast, 0 for one without skill."
            );
            let title = format!("anomaly correlation of {name}");
            let plot = CurvePlot::new(title, "lead time [h]".into(), "[1]".into(), all);
            drawings.push(Drawing { stem: format!("forecast_anomaly_{name}"), caption, plot });
        }
    }
    drawings
}

/// A score of all methods that have it.
fn curves(summary: &Summary, variable: &str, score: &str, dash: Dash) -> Vec<Curve> {
    let curve = |(number, (name, scores)): (usize, (&String, &MethodScores))| {
        let forecasts: &ForecastScores = scores.forecasts.as_ref()?;
        let leads = forecasts.leads.iter();
        let known: Vec<(f64, &Known)> =
            leads.filter_map(|lead| Some((lead.lead_hours, lead.score(score, variable)?))).collect();
        let points = known.iter().map(|(hours, known)| [*hours, known.value]).collect();
        let curve = Curve::new(name, of_method_on_paper(number), points);
        // Bands of claims would hide those of errors.
        let intervals: Option<Vec<[f64; 2]>> =
            known.iter().map(|(_, known)| known.interval.map(|it| [it.low, it.high])).collect();
        let curve = match intervals.filter(|_| dash == Dash::Solid) {
            Some(band) => curve.with_band(band),
            None => curve,
        };
        (!known.is_empty()).then(|| if dash == Dash::Solid { curve } else { curve.unnamed(dash) })
    };
    summary.methods.iter().enumerate().filter_map(curve).collect()
}
