//! Which views there are: a tab that compares all methods, and one for each method.

use super::blueprint::{Arrangement, Blueprint, Part};
use super::frame::Frame;
use super::names::{Names, Result};
use super::ranges::Ranges;
use super::series::{DEPARTURE, PARAMETERS_PER_PAGE, compared, shown_parameters};
use crate::event::RunInfo;
use crate::output::history::{History, MethodCycle};
use crate::plot::number as number_text;
use crate::scores::{Score, ScoreKind};
use ::rerun::RecordingStream;

/// Sends the layout of the run's views.
pub fn send(recording: &RecordingStream, info: &RunInfo, history: &History, names: &Names, ranges: &Ranges) -> Result {
    let mut views = Views { blueprint: Blueprint::new()?, info, history, names, ranges };
    let mut tabs = vec![views.overview()?];
    for method in 0..info.methods.len() {
        tabs.push(views.method(method)?);
    }
    views.blueprint.send(recording, &tabs)
}

struct Views<'a> {
    blueprint: Blueprint,
    info: &'a RunInfo,
    history: &'a History,
    names: &'a Names,
    ranges: &'a Ranges,
}

impl Views<'_> {
    /// All methods: their errors in one plot for each variable, the scores, and the scenario.
    fn overview(&mut self) -> Result<Part> {
        let mut plots = Vec::new();
        for (variable, range) in self.info.layout.variables.iter().zip(&self.ranges.variables) {
            let measured = compared(self.info).map_or("score", ScoreKind::measured);
            let name = format!("{measured} of {} [{}]", variable.name, variable.unit);
            let contents = [format!("comparison/{}/**", variable.name)];
            let highest = range.score.iter().copied().fold(0.0, f64::max);
            plots.push(self.blueprint.curves(&name, &contents, Some([0.0, highest]), true)?);
        }
        let plots = self.blueprint.container("errors", Arrangement::Horizontal, &plots)?;
        let mapped = &self.info.layout.variables[self.history.mapped];
        let departure = format!("mean background departure of {} [{}]", mapped.name, mapped.unit);
        let others = self.info.drawn(false).map(|(kind, _)| (Score { kind, variable: ("", "") }.subject(), kind.name));
        let others: Vec<_> = others.chain([(departure, DEPARTURE)]).collect();
        let curves =
            |(name, what): (String, &str)| self.blueprint.curves(&name, &[format!("comparison/{what}/**")], None, true);
        let others = others.into_iter().map(curves).collect::<Result<Vec<_>>>()?;
        let others = self.blueprint.container("innovations", Arrangement::Horizontal, &others)?;
        let texts = [("scores", "text/scores"), ("stability", "text/stability"), ("scenario", "text/scenario")];
        let texts = texts.map(|(name, contents)| self.blueprint.document(name, contents));
        let mut texts = texts.into_iter().collect::<Result<Vec<_>>>()?;
        let estimating = (0..self.info.methods.len()).filter(|&method| self.info.methods[method].estimates_biases);
        let logs: Vec<String> = estimating.map(|method| self.names.map(method, "verdicts")).collect();
        if !logs.is_empty() {
            texts.insert(2, self.blueprint.log("verdicts on biases", &logs)?);
        }
        let texts = self.blueprint.container("texts", Arrangement::Horizontal, &texts)?;
        self.blueprint.container("overview", Arrangement::Vertical(&[1.0, 0.8, 1.0]), &[plots, others, texts])
    }

    /// One method: a tab of maps and errors for each variable, one of its blocks and common factors, and its biases.
    fn method(&mut self, method: usize) -> Result<Part> {
        let mapped = self.history.mapped;
        let others = (0..self.info.layout.variables.len()).filter(|&number| number != mapped);
        let mut tabs = Vec::new();
        for number in std::iter::once(mapped).chain(others) {
            tabs.push(self.maps(method, number)?);
        }
        tabs.extend(self.structure(method)?);
        let maps = self.blueprint.container("maps", Arrangement::Tabs, &tabs)?;
        let name = &self.info.methods[method].name;
        match self.biases(method)? {
            None => self.blueprint.container(name, Arrangement::Vertical(&[1.0]), &[maps]),
            Some(biases) => self.blueprint.container(name, Arrangement::Vertical(&[2.6, 1.0]), &[maps, biases]),
        }
    }

    /// The maps of a variable, and its errors over time.
    fn maps(&mut self, method: usize, number: usize) -> Result<Part> {
        let variable = &self.info.layout.variables[number];
        let (name, unit, ranges) = (variable.name, variable.unit, &self.ranges.variables[number]);
        let [low, high] = ranges.state.map(number_text);
        let state = format!("{low} to {high} {unit}");
        let difference = format!("±{} {unit}", number_text(ranges.difference));
        let has_spread = self.history.maps(method).any(|(_, maps)| maps.spread.is_some());
        let spread = format!("0 to {} {unit}", number_text(ranges.spread));
        let own = |part: &str| self.names.field(method, name, part);
        let observations = own("observations/**");
        let wind = self.names.map(method, "wind");
        let mut maps = vec![
            (format!("truth · {state}"), "state", vec![format!("truth/{name}"), "truth/wind".into()]),
            ("background, observations".into(), "state", vec![own("background"), observations.clone()]),
            (format!("analysis · {state}"), "state", vec![own("analysis"), wind]),
            (format!("increment · {difference}"), "difference", vec![own("increment"), observations]),
            (format!("background error · {difference}"), "difference", vec![own("background_error")]),
            (format!("analysis error · {difference}"), "difference", vec![own("analysis_error")]),
        ];
        if !self.info.has_truth {
            maps = maps.split_off(1);
            maps.truncate(3);
        }
        if has_spread {
            maps.push((format!("claimed spread · {spread}"), "spread", vec![own("spread")]));
        }
        let bounds = Frame::new(&self.info.layout).bounds(false);
        let mut parts = Vec::new();
        for (title, bar, mut contents) in maps {
            contents.push(format!("color_bars/{name}/{bar}/**"));
            parts.push(self.blueprint.map(&title, &contents, bounds)?);
        }
        let contents = [self.names.score(method, name, "**")];
        let title = format!("{} and spread [{unit}]", if self.info.has_truth { "RMSE" } else { "departures" });
        parts.push(self.blueprint.curves(&title, &contents, Some([0.0, ranges.score[method]]), true)?);
        let title = format!("{name} [{unit}]");
        self.blueprint.container(&title, Arrangement::Grid(4), &parts)
    }

    /// The blocks, and the leading common factors.
    fn structure(&mut self, method: usize) -> Result<Option<Part>> {
        let structures = self.history.maps(method).filter_map(|(_, maps)| maps.structure.as_ref());
        let Some(factors) = structures.map(|it| it.factors.len()).max() else { return Ok(None) };
        let variable = self.info.layout.variables[self.history.mapped].name;
        let bounds = Frame::new(&self.info.layout).bounds(true);
        let own = |part: &str| self.names.structure(method, part);
        let observations = self.names.field(method, variable, "observations/**");
        let title = "blocks that observations merge";
        let mut parts = vec![self.blueprint.map(title, &[own("parts/**"), observations], bounds)?];
        for number in 1..=factors {
            let contents = [own(&format!("factor_{number}/**"))];
            parts.push(self.blueprint.map(&format!("common factor {number} in {variable}"), &contents, bounds)?);
        }
        let title = if factors > 0 { "blocks and common factors" } else { "blocks" };
        self.blueprint.container(title, Arrangement::Grid(3), &parts).map(Some)
    }

    /// The calibration parameters, one plot for each; in tabs if they are many.
    fn biases(&mut self, method: usize) -> Result<Option<Part>> {
        // A method that leaves them alone has zeros, and claims nothing.
        let estimates =
            |own: &MethodCycle| own.calibration_spread.is_some() || own.calibration.iter().any(|&it| it != 0.0);
        if !self.history.of_method(method).any(|(_, own)| estimates(own)) {
            return Ok(None);
        }
        let mut plots = Vec::new();
        for number in shown_parameters(&self.info.calibration) {
            let parameter = &self.info.calibration.parameters[number];
            let name = format!("{} [{}]", parameter.name, parameter.unit);
            plots.push(self.blueprint.curves(
                &name,
                &[self.names.parameter(method, number, "**")],
                None,
                plots.len() % PARAMETERS_PER_PAGE == 0,
            )?);
        }
        if plots.len() <= PARAMETERS_PER_PAGE {
            return self.blueprint.container("biases", Arrangement::Horizontal, &plots).map(Some);
        }
        let mut pages = Vec::new();
        let total = self.info.calibration.len();
        for (page, plots) in plots.chunks(PARAMETERS_PER_PAGE).enumerate() {
            let first = page * PARAMETERS_PER_PAGE + 1;
            let name = match plots.len() {
                1 => format!("bias {first} of {total}"),
                count => format!("biases {first}–{} of {total}", first + count - 1),
            };
            pages.push(self.blueprint.container(&name, Arrangement::Horizontal, plots)?);
        }
        self.blueprint.container("biases", Arrangement::Tabs, &pages).map(Some)
    }
}
