//! The scores of forecasts ahead by lead time: on the terminal at the end of a run, and on its page.

use super::terminal::sentences;
use super::{Cell, Table};
use crate::plot;
use crate::scores::Summary;
use crate::scores::forecast::{
    ANOMALY_CORRELATION, DEPARTURE, ForecastScores, LeadScores, RMSE, SPREAD, SPREAD_PER_ERROR, STANDARDISED_DEPARTURE,
    VerifiedBy,
};

/// The most lead times that a table shows; between the first and the last some are left out.
const MOST_LEADS: usize = 11;

/// What the terminal shows: error and spread of each variable, a row for each method and figure, a column for each lead time;
/// `None` without forecasts.
pub fn on_terminal(summary: &Summary, variables: &[(&str, &str)], width: usize) -> Option<String> {
    let shown = match all(summary).next()?.1.verified_by {
        VerifiedBy::Truth => "root-mean-square error",
        VerifiedBy::PassiveObservations => "root-mean-square departure of passive observations",
        VerifiedBy::UsedObservations => "root-mean-square departure of observations, at 0 h those that it has used",
    };
    let title = format!("Forecasts ahead by lead time: {shown}, and claimed spread; {}", cases(summary));
    let rows = [("", RMSE), ("", DEPARTURE), (" spread", SPREAD)];
    let tables = variables.iter().filter_map(|&variable| Some(table(summary, variable, &rows)?.terminal(width)));
    let failed = failed(summary).into_iter().map(|text| sentences(&text, width));
    Some(std::iter::once(sentences(&title, width)).chain(tables).chain(failed).collect::<Vec<_>>().join("\n"))
}

/// The tables of the page, one for each variable, with all scores and their intervals.
pub fn on_page(summary: &Summary, variables: &[(&str, &str)]) -> Vec<Table> {
    let rows = [
        (", error", RMSE),
        (", departure", DEPARTURE),
        (", spread", SPREAD),
        (", spread/error", SPREAD_PER_ERROR),
        (", anomaly correlation", ANOMALY_CORRELATION),
        (", standardised departure", STANDARDISED_DEPARTURE),
    ];
    variables.iter().filter_map(|&variable| table(summary, variable, &rows)).collect()
}

/// How many forecasts there are, in words.
pub fn cases(summary: &Summary) -> String {
    let most = all(summary).map(|(_, forecasts)| forecasts).max_by_key(|forecasts| forecasts.leads.len());
    let Some((first, last)) = most.and_then(|it| it.leads.first().zip(it.leads.last())) else {
        return "no forecast could be made".into();
    };
    let (at_first, at_last) = (plot::number(first.lead_hours), plot::number(last.lead_hours));
    format!("{} cases at {at_first} h, {} at {at_last} h", first.cases, last.cases)
}

/// Which methods could not make all forecasts.
pub fn failed(summary: &Summary) -> Vec<String> {
    let with_failed = all(summary).filter(|(_, forecasts)| forecasts.failed > 0);
    let in_words = |(name, it): (&str, &ForecastScores)| {
        format!(
            "{name}: {} forecasts could not be made to their end; those are not in the scores after that",
            it.failed
        )
    };
    with_failed.map(in_words).collect()
}

/// The methods with forecasts.
fn all(summary: &Summary) -> impl Iterator<Item = (&str, &ForecastScores)> {
    summary.methods.iter().filter_map(|(name, scores)| Some((name.as_str(), scores.forecasts.as_ref()?)))
}

/// A row for each method and score, named by the method and what is added to it; `None` if there are no figures.
fn table(summary: &Summary, (variable, udunits): (&str, &str), scores: &[(&str, &str)]) -> Option<Table> {
    let mut hours: Vec<f64> = all(summary).flat_map(|(_, it)| it.leads.iter().map(|lead| lead.lead_hours)).collect();
    hours.sort_by(f64::total_cmp);
    hours.dedup();
    let hours = thinned(&hours);
    let mut header = vec![format!("{variable} [{}]", plot::unit(udunits))];
    header.extend(hours.iter().map(|&hours| format!("{}\u{a0}h", plot::number(hours))));
    let row = |name: String, forecasts: &ForecastScores, score: &str| -> Option<Vec<Cell>> {
        let at = |hours: &f64| forecasts.at(*hours).and_then(|lead: &LeadScores| lead.score(score, variable));
        if !hours.iter().any(|hours| at(hours).is_some()) {
            return None;
        }
        let cell = |hours: &f64| {
            let known = at(hours);
            Cell::known(known.map(|known| known.value), known.and_then(|known| known.interval.as_ref()))
        };
        Some(std::iter::once(name.into()).chain(hours.iter().map(cell)).collect())
    };
    let of_method = |(name, forecasts): (&str, &ForecastScores)| {
        let rows = scores.iter().filter_map(|(added, score)| row(format!("{name}{added}"), forecasts, score));
        rows.collect::<Vec<_>>()
    };
    Table { header, rows: all(summary).flat_map(of_method).collect() }.filled()
}

/// At most [`MOST_LEADS`] of the lead times, evenly, with the first and the last.
fn thinned(hours: &[f64]) -> Vec<f64> {
    let last = hours.len().saturating_sub(1);
    if hours.len() <= MOST_LEADS {
        return hours.to_vec();
    }
    (0..MOST_LEADS).map(|number| hours[(number * last + (MOST_LEADS - 1) / 2) / (MOST_LEADS - 1)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_many_lead_times_some_are_shown_with_the_first_and_the_last() {
        let hours: Vec<f64> = (0..=40).map(|number| 3.0 * f64::from(number)).collect();
        let shown = thinned(&hours);
        assert_eq!((shown.len(), shown[0], shown[1], shown[10]), (MOST_LEADS, 0.0, 12.0, 120.0));
        assert_eq!(thinned(&hours[..11]), hours[..11]);
        assert!(thinned(&[]).is_empty());
    }
}
