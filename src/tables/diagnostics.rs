//! Diagnostics as tables, for the report and for the terminal.

use super::stability::in_short;
use super::{Cell, MOST_PARAMETERS, Table, Titled, figure};
use crate::scores::diagnostics::{BiasDiagnostics, Departures, Diagnostics, ObservationDiagnostics, StateDiagnostics};
use crate::scores::{MethodScores, RejectedObservation, Summary, TypeCounts};

/// A claimed spread between these multiples of the error is called right.
pub const RIGHT: [f64; 2] = [0.9, 1.1];

/// All tables that have rows.
pub fn all(summary: &Summary) -> Vec<Titled> {
    let tables = [
        Titled {
            title: "Claimed distributions",
            text: "Over grid points and cycles. Spread/error: 1 if the claimed spread is right. CRPS: continuous ranked \
                   probability score of N(analysis, spread²), or the mean absolute error without a spread; the less the \
                   better. Coverage: the share of truths within the central 95 % of the claim. Slope: of squared errors on \
                   claimed variances, 1 if the spread tells where errors are large, 0 if it tells nothing.",
            table: distributions(summary),
        },
        Titled {
            title: "Departures",
            text: "Per type of observations: number, mean and root mean square of O−B, observation minus background, and O−A, \
                   observation minus analysis. Passive observations take no part in any analysis: theirs are an \
                   independent score.",
            table: plain_departures(summary),
        },
        Titled {
            title: "What departures tell",
            text: "Per type of observations: innovations y − h(background), residuals y − h(analysis); the standard \
                   deviation of the observation error as assumed, and those of observation, background and analysis as \
                   the departures have them (Desroziers et al. 2005); the correlation of successive innovations of a \
                   place, 0 for an optimal filter; degrees of freedom for signal per cycle as the departures have them \
                   and, with [diagnostics], as probes of the analysis have them.",
            table: departures(summary),
        },
        Titled {
            title: "Impact of observations",
            text: "What each type takes off the mean square error in an analysis, per variable, in the square of its unit: \
                   below zero it does harm. Together they are what the analysis takes off, if it is linear and has no \
                   memory of earlier observations.",
            table: impact(summary),
        },
        Titled {
            title: "Calibration of bias errors",
            text: "All parameters together, each divided by the standard deviation of its prior. Error/σ: root-mean-square of \
                   the error divided by the claimed σ, 1 if that is right. Errors of a parameter hardly change from cycle \
                   to cycle: few parameters tell little.",
            table: all_biases(summary),
        },
        Titled {
            title: "Error of each bias",
            text: "Root-mean-square error over cycles with mean error, claimed σ, and error/σ.",
            table: biases(summary),
        },
        Titled {
            title: "Quality control",
            text: "Observations by type and by what became of them.",
            table: quality(summary),
        },
        Titled {
            title: "Rejected observations",
            text: "The first of those that failed quality control. Predicted: what a forecast without observations and the \
                   neighbours say; z: value minus prediction, in standard deviations of that difference. \
                   observations.nc has all of them (quality_code above 0), with the departures of every method.",
            table: rejected(summary),
        },
    ];
    tables.into_iter().filter(|it| !it.table.rows.is_empty()).collect()
}

/// For each method whether its claimed spread is right, and what the stability monitor says of its biases.
pub fn in_words(summary: &Summary) -> Vec<String> {
    let of_method = |(name, scores, own): (&String, &MethodScores, &Diagnostics)| {
        let ratios = own.state.iter().filter_map(|(variable, own)| Some((variable, own.spread_over_error?)));
        let [mut small, mut right, mut large] = [const { Vec::new() }; 3];
        for (variable, ratio) in ratios {
            let group = match ratio {
                it if it < RIGHT[0] => &mut small,
                it if it > RIGHT[1] => &mut large,
                _ => &mut right,
            };
            group.push(format!("{variable} ({} of the error)", figure(ratio)));
        }
        let groups = [("too small", small), ("right", right), ("too large", large)];
        let groups = groups.into_iter().filter(|(_, all)| !all.is_empty());
        let spread: Vec<String> = groups.map(|(verdict, all)| format!("{verdict} in {}", all.join(", "))).collect();
        let spread = match (spread.is_empty(), own.state.is_empty()) {
            (false, _) => Some(format!("its claimed spread is {}", spread.join(", "))),
            (true, false) => Some("it claims no spread".to_string()),
            (true, true) => None,
        };
        let stability = scores.stability.as_ref().filter(|own| !own.parameters.is_empty());
        let biases = stability.map(|own| format!("of its biases {}", in_short(own)));
        let parts: Vec<String> = spread.into_iter().chain(biases).collect();
        (!parts.is_empty()).then(|| format!("{name}: {}", parts.join("; ")))
    };
    each(summary).filter_map(of_method).collect()
}

fn each(summary: &Summary) -> impl Iterator<Item = (&String, &MethodScores, &Diagnostics)> {
    summary.methods.iter().filter_map(|(name, scores)| Some((name, scores, scores.diagnostics.as_ref()?)))
}

fn distributions(summary: &Summary) -> Table {
    let row = |method: &str, scores: &MethodScores, variable: &str, own: &StateDiagnostics| -> Vec<Cell> {
        let [rmse, spread] = ["rmse_analysis", "spread_analysis"].map(|kind| format!("{kind}.{variable}"));
        let value = |key: &str| scores.values.get(key).copied();
        vec![
            format!("{method} {variable}").into(),
            Cell::known(value(&rmse), scores.intervals.get(&rmse)),
            Cell::known(value(&spread), own.spread_interval.as_ref()),
            Cell::figure(own.spread_over_error),
            Cell::known(Some(own.crps), own.crps_interval.as_ref()),
            Cell::percent(own.coverage_95),
            Cell::figure(own.reliability_slope),
        ]
    };
    let rows = each(summary).flat_map(|(name, scores, diagnostics)| {
        diagnostics.state.iter().map(move |(variable, own)| row(name, scores, variable, own))
    });
    Table::new(&["analysis of", "RMSE", "spread", "spread/error", "CRPS", "coverage", "slope"], rows.collect())
}

fn plain_departures(summary: &Summary) -> Table {
    let row = |method: &str, kind: &str, role: &str, own: &Departures| -> Vec<Cell> {
        let figures = [own.background_mean, own.background_rms, own.analysis_mean, own.analysis_rms];
        let mut row: Vec<Cell> = vec![format!("{method} {kind}").into(), role.into(), own.count.to_string().into()];
        row.extend(figures.map(|value| Cell::figure(Some(value))));
        row
    };
    let rows = each(summary).flat_map(|(name, _, diagnostics)| {
        let used = diagnostics.used.iter().map(move |(kind, own)| row(name, kind, "used", own));
        used.chain(diagnostics.passive.iter().map(move |(kind, own)| row(name, kind, "passive", own)))
    });
    Table::new(&["observations of", "role", "number", "O−B mean", "O−B rms", "O−A mean", "O−A rms"], rows.collect())
}

fn rejected(summary: &Summary) -> Table {
    let row = |own: &RejectedObservation| -> Vec<Cell> {
        vec![
            format!("{} {}", own.network, own.platform).into(),
            own.cycle.into(),
            own.variable.as_str().into(),
            own.reason.as_str().into(),
            Cell::exact(own.value),
            Cell::exact(own.predicted),
            Cell::figure(own.z),
            own.neighbours.map_or(Cell::figure(None), Cell::from),
        ]
    };
    let header = ["station", "cycle", "variable", "rejected as", "value", "predicted", "z", "neighbours"];
    Table::new(&header, summary.observations.first_rejected.iter().map(row).collect())
}

fn departures(summary: &Summary) -> Table {
    let row = |method: &str, kind: &str, own: &ObservationDiagnostics| -> Vec<Cell> {
        vec![
            format!("{method} {kind}").into(),
            own.count.to_string().into(),
            Cell::known(Some(own.innovation_mean), own.innovation_mean_interval.as_ref()),
            Cell::figure(Some(own.innovation_rms)),
            Cell::figure(Some(own.residual_mean)),
            Cell::figure(Some(own.sigma_assumed)),
            Cell::figure(own.sigma_observation),
            Cell::figure(own.sigma_background),
            Cell::figure(own.sigma_analysis),
            Cell::figure(own.lagged_correlation),
            Cell::figure(Some(own.signal_from_departures)),
            Cell::figure(own.signal),
        ]
    };
    let rows = each(summary).flat_map(|(name, _, diagnostics)| {
        diagnostics.observations.iter().map(move |(kind, own)| row(name, kind, own))
    });
    let columns = [
        "observations of",
        "number",
        "innovation mean",
        "rms",
        "residual mean",
        "σ assumed",
        "σ found",
        "background σ",
        "analysis σ",
        "lagged correlation",
        "signal, departures",
        "signal, probed",
    ];
    Table::new(&columns, rows.collect())
}

fn impact(summary: &Summary) -> Table {
    let variables: Vec<&String> =
        each(summary).find_map(|(_, _, own)| own.error_reduction.as_ref()).map_or(Vec::new(), |it| it.keys().collect());
    let mut rows = Vec::new();
    for (name, _, diagnostics) in each(summary) {
        let Some(reduction) = &diagnostics.error_reduction else { continue };
        for (kind, own) in &diagnostics.observations {
            let Some(impact) = &own.impact else { continue };
            let mut row: Vec<Cell> = vec![format!("{name} {kind}").into()];
            row.extend(variables.iter().map(|variable| {
                let (value, all) = (impact.get(*variable).copied(), reduction.get(*variable).copied());
                let share = value.zip(all).map(|(value, all)| 100.0 * value / all).filter(|share| share.is_finite());
                Cell { note: share.map_or_else(String::new, |share| format!("{share:.0} %")), ..Cell::figure(value) }
            }));
            rows.push(row);
        }
        let mut row: Vec<Cell> = vec![format!("{name} analysis").into()];
        row.extend(variables.iter().map(|variable| Cell::figure(reduction.get(*variable).copied())));
        rows.push(row);
    }
    let columns = variables.iter().map(|variable| format!("mean square error of {variable}"));
    Table { header: std::iter::once("taken off by".to_string()).chain(columns).collect(), rows }
}

fn all_biases(summary: &Summary) -> Table {
    let row = |(name, _, diagnostics): (&String, &MethodScores, &Diagnostics)| {
        let own = diagnostics.all_biases.as_ref()?;
        Some(vec![
            name.as_str().into(),
            Cell::figure(Some(own.rmse)),
            Cell::figure(own.spread),
            Cell::figure(own.normalised_rmse),
            Cell::percent(own.within_2_sigma),
        ])
    };
    let columns = ["method", "RMSE/prior σ", "claimed σ/prior σ", "error/σ", "within 2σ"];
    Table::new(&columns, each(summary).filter_map(row).collect())
}

fn biases(summary: &Summary) -> Table {
    let methods: Vec<(&String, &Diagnostics)> =
        each(summary).filter(|(_, _, own)| !own.biases.is_empty()).map(|(name, _, own)| (name, own)).collect();
    let Some((_, first)) = methods.first() else { return Table::default() };
    let cell = |own: &BiasDiagnostics| {
        let claimed = own.spread.zip(own.normalised_rmse);
        let claimed =
            claimed.map_or_else(String::new, |(spread, it)| format!("; σ {}, {}", figure(spread), figure(it)));
        Cell { note: format!("mean {}{claimed}", figure(own.mean_error)), ..Cell::figure(Some(own.rmse)) }
    };
    let row = |parameter: &String| -> Vec<Cell> {
        let of = |own: &Diagnostics| own.biases.get(parameter).map_or(Cell::figure(None), cell);
        std::iter::once(parameter.as_str().into()).chain(methods.iter().map(|(_, own)| of(own))).collect()
    };
    let names = methods.iter().map(|(name, _)| name.to_string());
    Table {
        header: std::iter::once("parameter".to_string()).chain(names).collect(),
        rows: first.biases.keys().take(MOST_PARAMETERS).map(row).collect(),
    }
}

/// The biases whose errors are largest beside their claimed σ, of all methods, the worst first.
pub fn worst_biases(summary: &Summary, count: usize) -> Table {
    let mut rows: Vec<(f64, Vec<Cell>)> = Vec::new();
    for (method, _, diagnostics) in each(summary) {
        for (parameter, own) in &diagnostics.biases {
            let Some(normalised) = own.normalised_rmse.filter(|it| it.is_finite()) else { continue };
            let figures = [Some(own.rmse), own.spread, Some(normalised)].map(Cell::figure);
            let names = [parameter, method].map(|name| Cell::from(name.as_str()));
            rows.push((normalised, names.into_iter().chain(figures).collect()));
        }
    }
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    let rows = rows.into_iter().take(count).map(|(_, row)| row).collect();
    Table::new(&["parameter", "method", "RMSE", "claimed σ", "error/σ"], rows)
}

fn quality(summary: &Summary) -> Table {
    let types = &summary.observations.by_type;
    let reasons: Vec<&String> = summary.observations.rejected.keys().collect();
    let has_passive = summary.observations.passive > 0;
    let row = |(kind, own): (&String, &TypeCounts)| -> Vec<Cell> {
        let rejected = reasons.iter().map(|reason| own.rejected.get(*reason).copied().unwrap_or(0).to_string().into());
        let passive = has_passive.then(|| own.passive.to_string().into());
        [kind.as_str().into(), own.used.to_string().into()].into_iter().chain(passive).chain(rejected).collect()
    };
    let columns = reasons.iter().map(|reason| reason.to_string());
    let passive = has_passive.then(|| "passive".to_string());
    Table {
        header: ["observations of", "used"].map(String::from).into_iter().chain(passive).chain(columns).collect(),
        rows: types.iter().map(row).collect(),
    }
}
