//! `isobar advise`.

use super::advise_arguments::AdviseArguments;
use super::console::{print, print_json, width};
use super::threads::workers;
use super::{launch, lookup};
use crate::advice::{AdviceError, Advised, Functional, Request, advise, tables};
use crate::calendar::utc;
use crate::plot;
use crate::run::RunError;
use crate::scenario::Scenario;
use crate::tables::figure;
use crate::tables::terminal::sentences;
use crate::text::shown_path;
use crate::threshold_warning::Area;
use miette::{Report, miette};
use serde_json::json;
use std::process::ExitCode;

/// Prints what would be worth observing next.
pub fn run(arguments: &AdviseArguments) -> Result<ExitCode, Report> {
    let scenario = lookup::load(&arguments.end.scenario)?;
    launch::check_method(&arguments.end.method, &scenario)?;
    let functional = match (&arguments.of.bias, &arguments.of.mean) {
        (Some(bias), _) => Functional::Bias(bias.clone()),
        (None, Some(variable)) => Functional::Mean { variable: variable.clone(), at: area(&arguments.at, &scenario)? },
        (None, None) => return Err(miette!("say what is to be known better: --bias or --mean")),
    };
    let request = Request {
        method: arguments.end.method.clone(),
        functional,
        lead_hours: arguments.lead_hours,
        grid: arguments.grid,
        sigmas: arguments.sigma.iter().cloned().collect(),
        comparison_sigma: arguments.comparison_sigma,
    };
    let advised = workers(arguments.threads)?.install(|| advise(&scenario, &arguments.end.from, &request));
    let advised = advised.map_err(|error| report(error, &scenario))?;
    if arguments.json {
        print_json(&document(arguments, &scenario, &advised))?;
    } else {
        print(&text(arguments, &advised))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn report(error: AdviceError, scenario: &Scenario) -> Report {
    match error {
        AdviceError::Run(RunError::Experiment(error)) => error.locate(scenario).into(),
        error => miette!("{}: {error}", scenario.name),
    }
}

/// The area that the user means: `anywhere`, `network/station`, `x,y` or `x:x,y:y` in km.
fn area(text: &str, scenario: &Scenario) -> Result<Area, Report> {
    if text == "anywhere" {
        return Ok(Area::Anywhere);
    }
    if text.contains('/') {
        return Ok(Area::Station(text.to_string()));
    }
    let wanted = "anywhere, a station NETWORK/NAME, a place X,Y or a box X:X,Y:Y in km";
    let refuse = || miette!(help = format!("it must be {wanted}"), "`--at {text}` is not a place");
    let sides: Vec<Vec<f64>> = text
        .split(',')
        .map(|side| side.split(':').map(|end| end.trim().parse::<f64>().map(|km| km * 1e3)).collect())
        .collect::<Result<_, _>>()
        .map_err(|_| refuse())?;
    let grid = &scenario.grid.grid;
    let extents = [grid.width_m(), grid.height_m()];
    let [x, y] = &sides[..] else { return Err(refuse()) };
    let is_inside = |(side, extent_m): (&Vec<f64>, f64)| side.iter().all(|m| (0.0..=extent_m).contains(m));
    if ![x, y].into_iter().zip(extents).all(is_inside) {
        let [x, y] = extents.map(|m| m / 1e3);
        return Err(miette!("`--at {text}` is outside of the domain, which is {x} × {y} km"));
    }
    match (&x[..], &y[..]) {
        (&[x_m], &[y_m]) if grid.contains(x_m, y_m) => Ok(Area::Place { x_m, y_m }),
        (&[west, east], &[south, north]) if west < east && south < north => {
            Ok(Area::Box { x_m: [west, east], y_m: [south, north] })
        }
        _ => Err(refuse()),
    }
}

fn text(arguments: &AdviseArguments, advised: &Advised) -> String {
    let title = format!(
        "{}, as {} knows it before the analysis of {}: σ = {} {}",
        advised.functional,
        arguments.end.method,
        utc(advised.time),
        figure(advised.sigma),
        plot::unit(&advised.unit)
    );
    let mut parts = vec![sentences(&title, width())];
    for (title, count, table) in tables(advised, arguments.top as usize) {
        let shown = if count > table.rows.len() {
            format!(", the best {} of {count}", table.rows.len())
        } else {
            String::new()
        };
        parts.push(format!("{title}{shown}\n{}", table.terminal(width())));
    }
    parts.extend((!advised.notes.is_empty()).then(|| sentences(&advised.notes.join(" "), width())));
    parts.join("\n\n")
}

fn document(arguments: &AdviseArguments, scenario: &Scenario, advised: &Advised) -> serde_json::Value {
    json!({
        "scenario": scenario.name,
        "directory": shown_path(&arguments.end.from),
        "method": arguments.end.method,
        "functional": advised.functional,
        "unit": advised.unit,
        "time": utc(advised.time),
        "sigma": advised.sigma,
        "candidates": advised.candidates,
        "notes": advised.notes,
    })
}
