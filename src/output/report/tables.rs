//! The tables of a run's page beside its scores.

use crate::event::RunInfo;
use crate::output::history::{Cycle, History, ParameterHistory};
use crate::plot::unit;
use crate::scores::{Failure, MethodScores, Summary};
use crate::tables::scores::factors;
use crate::tables::{Cell, MOST_PARAMETERS, NONE, Table, figure};
use isobar_obs::SensorComparison;

/// The methods' names and settings.
pub fn methods(info: &RunInfo) -> Table {
    let rows = info.methods.iter().map(|it| vec![it.name.as_str().into(), it.description.as_str().into()]);
    Table::new(&["method", "how it is set up"], rows.collect())
}

/// When and why methods failed.
pub fn failures(summary: &Summary) -> Option<Table> {
    let row =
        |(name, it): (&str, &Failure)| -> Vec<Cell> { vec![name.into(), it.cycle.into(), it.reason.as_str().into()] };
    Table::new(&["method", "failed in cycle", "because"], summary.failures().map(row).collect()).filled()
}

/// The last estimate of every bias, up to [`MOST_PARAMETERS`], by every method that estimates them, against the truth if any is known.
pub fn biases(info: &RunInfo, history: &History) -> Option<Table> {
    let last: &Cycle = history.cycles.last().filter(|_| !info.calibration.is_empty())?;
    let has_truth = history.knows_biases();
    let mut header = vec!["parameter".to_string(), "unit".into()];
    header.extend(has_truth.then(|| "truth".to_string()));
    let estimating = || info.methods.iter().zip(&last.methods).filter(|(method, _)| method.estimates_biases);
    header.extend(estimating().map(|(method, _)| method.name.clone()));
    let row = |(number, parameter): (usize, &isobar_obs::Parameter)| {
        let mut row: Vec<Cell> = vec![parameter.name.as_str().into(), unit(&parameter.unit).into()];
        row.extend(has_truth.then(|| Cell::figure(last.true_bias(number))));
        row.extend(estimating().map(|(_, own)| {
            let Some(own) = own else { return NONE.into() };
            let note = own.bias_spread(number).map_or_else(String::new, |sigma| format!("± {}", figure(2.0 * sigma)));
            Cell { note, ..Cell::figure(own.bias(number)) }
        }));
        row
    };
    Some(Table {
        header,
        rows: info.calibration.parameters.iter().take(MOST_PARAMETERS).enumerate().map(row).collect(),
    })
}

/// Every comparison of sensors and test point, up to [`MOST_PARAMETERS`], beside what the methods that estimate biases make of the
/// same difference in the analysis of that cycle.
pub fn comparisons(info: &RunInfo, history: &History) -> Option<Table> {
    let estimating = || info.methods.iter().enumerate().filter(|(_, method)| method.estimates_biases);
    let mut header: Vec<String> = ["biases", "cycle", "unit", "found"].map(String::from).into();
    header.extend(estimating().map(|(_, method)| method.name.clone()));
    let row = |(cycle, own): (&Cycle, &SensorComparison)| -> Vec<Cell> {
        let parameters = &info.calibration.parameters;
        let name = |number: usize| parameters[number].name.as_str();
        let names = own
            .other
            .map_or(name(own.parameter).to_string(), |other| format!("{} − {}", name(own.parameter), name(other)));
        let found = Cell { note: format!("± {}", figure(2.0 * own.sigma)), ..Cell::figure(Some(own.value)) };
        let unit = unit(&parameters[own.parameter].unit);
        let mut row: Vec<Cell> = vec![names.into(), cycle.number.into(), unit.into(), found];
        row.extend(estimating().map(|(number, _)| {
            Cell::figure(cycle.methods[number].as_ref().map(|method| own.simulate(&method.calibration)))
        }));
        row
    };
    let all = history.cycles.iter().flat_map(|cycle| cycle.comparisons.iter().map(move |own| (cycle, own)));
    Table { header, rows: all.take(MOST_PARAMETERS).map(row).collect() }.filled()
}

/// The last estimate of every parameter beside state and biases, up to [`MOST_PARAMETERS`], by the methods that have some.
pub fn parameters(info: &RunInfo, history: &History) -> Option<Table> {
    let all = &history.parameters;
    let has_some = |&(number, _): &(usize, _)| all.values().any(|own| own[number].is_some());
    let methods: Vec<_> = info.methods.iter().enumerate().filter(has_some).collect();
    let mut header = vec!["parameter".to_string(), "unit".into()];
    header.extend(methods.iter().map(|(_, method)| method.name.clone()));
    let row = |(name, own): (&String, &Vec<Option<ParameterHistory>>)| -> Vec<Cell> {
        let udunits = own.iter().flatten().next().map_or("", |it| it.last.unit.as_str());
        let cells = methods.iter().map(|&(number, _)| {
            let Some(ParameterHistory { last, .. }) = &own[number] else { return NONE.into() };
            let note = match last.sigma {
                Some(sigma) => format!("± {}", figure(2.0 * sigma)),
                None => last.verdict.clone(),
            };
            Cell { text: figure(last.value), note, class: if last.sigma.is_some() { "" } else { "open" } }
        });
        [name.as_str().into(), unit(udunits).into()].into_iter().chain(cells).collect()
    };
    Table { header, rows: all.iter().take(MOST_PARAMETERS).map(row).collect() }.filled()
}

/// How observations linked blocks, in the cycle with the largest component.
pub fn partitions(summary: &Summary) -> Option<Table> {
    let header = [
        "method",
        "blocks",
        "components",
        "of several blocks",
        "blocks of the largest",
        "its variables",
        "blocks unobserved",
        "factors",
        "separators",
        "their unknowns",
        "border unknowns",
    ];
    let row = |(name, scores): (&String, &MethodScores)| {
        let it = scores.partition.as_ref()?;
        let mut row: Vec<Cell> = vec![name.as_str().into()];
        row.extend([it.blocks, it.components, it.merged_components].map(Cell::from));
        row.extend([it.largest_component_blocks, it.largest_component_variables, it.unobserved_blocks].map(Cell::from));
        row.push(factors(it).into());
        row.push(it.separators.into());
        let place = match it.separators {
            0 => "",
            _ if it.nested => "nested",
            _ => "in the border",
        };
        row.push(Cell { note: place.into(), ..it.separator_unknowns.into() });
        row.push(it.border.into());
        Some(row)
    };
    Table::new(&header, summary.methods.iter().filter_map(row).collect()).filled()
}
