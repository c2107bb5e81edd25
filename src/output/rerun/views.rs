//! Which views there are: two tabs that compare all methods, and one for each method.

use super::biases;
use super::blueprint::{Arrangement, Blueprint, Part};
use super::frame::Frame;
use super::names::{self, Names, Result};
use super::ranges::Ranges;
use super::series::{DEPARTURE, PARAMETERS_PER_PAGE, compared, shown_parameters};
use crate::event::RunInfo;
use crate::output::history::History;
use crate::plot::number as number_text;
use crate::scores::{Score, ScoreKind};
use re_sdk::RecordingStream;

/// Sends the layout of the run's views, which show the coast if there is one.
pub fn send(
    recording: &RecordingStream,
    info: &RunInfo,
    history: &History,
    (names, ranges): (&Names, &Ranges),
    has_coast: bool,
) -> Result {
    let mut views = Views { blueprint: Blueprint::new()?, info, history, names, ranges, has_coast };
    let mut tabs = vec![views.overview()?, views.scores()?];
    for method in 0..info.methods.len() {
        tabs.push(views.method(method)?);
    }
    views.blueprint.send(recording, &tabs, CYCLES_PER_SECOND * info.window.seconds() as f64)
}

/// How fast the viewer plays a run.
const CYCLES_PER_SECOND: f64 = 4.0;

struct Views<'a> {
    blueprint: Blueprint,
    info: &'a RunInfo,
    history: &'a History,
    names: &'a Names,
    ranges: &'a Ranges,
    has_coast: bool,
}

impl Views<'_> {
    /// All methods: the truth and the error of each in one variable, or the increments without a truth, and under these the
    /// errors over time of each variable.
    fn overview(&mut self) -> Result<Part> {
        let mapped = self.history.mapped;
        let (variable, range) = (&self.info.layout.variables[mapped], &self.ranges.variables[mapped]);
        let (name, unit) = (variable.name, variable.unit);
        let (what, part) =
            if self.info.has_truth { ("analysis error", "analysis_error") } else { ("increment", "increment") };
        let mut maps = Vec::new();
        if self.info.has_truth {
            let [low, high] = range.state.map(number_text);
            let title = format!("truth of {name} · {low} to {high} {unit}");
            maps.push(self.map(&title, vec![format!("truth/{name}"), "truth/wind".into()])?);
        }
        let limit = number_text(range.difference);
        for (number, method) in self.info.methods.iter().enumerate() {
            let title = format!("{} · {what} of {name} · ±{limit} {unit}", method.name);
            maps.push(self.map(&title, vec![self.names.field(number, name, &format!("{part}/**"))])?);
        }
        let rows = if maps.len() > 4 { 2 } else { 1 };
        let columns = maps.len().div_ceil(rows) as u32;
        let maps = self.blueprint.container("maps", Arrangement::Grid(columns), &maps)?;
        let errors = self.errors()?;
        self.blueprint.container("overview", Arrangement::Vertical(&[1.8, 1.0]), &[maps, errors])
    }

    /// The errors of all methods over time, one plot for each variable.
    fn errors(&mut self) -> Result<Part> {
        let mut plots = Vec::new();
        for (variable, range) in self.info.layout.variables.iter().zip(&self.ranges.variables) {
            let measured = compared(self.info).map_or("score", ScoreKind::measured);
            let name = format!("{measured} of {} [{}]", variable.name, variable.unit);
            let contents = [format!("comparison/{}/**", variable.name)];
            let highest = range.score.iter().copied().fold(0.0, f64::max);
            plots.push(self.blueprint.curves(&name, &contents, Some([0.0, highest]), true)?);
        }
        self.blueprint.container("errors", Arrangement::Horizontal, &plots)
    }

    /// All methods: innovations over time, the scores, and the scenario.
    fn scores(&mut self) -> Result<Part> {
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
        self.blueprint.container("scores", Arrangement::Vertical(&[0.7, 1.0]), &[others, texts])
    }

    /// A map of fields or marks, on it the coast.
    fn map(&mut self, title: &str, mut contents: Vec<String>) -> Result<Part> {
        if self.has_coast {
            contents.push(names::COAST.into());
        }
        self.blueprint.map(title, &contents, Frame::new(&self.info.layout).bounds(false))
    }

    /// One method: a tab of maps and errors for each variable, one of its blocks and common factors, and its biases.
    fn method(&mut self, method: usize) -> Result<Part> {
        let mapped = self.history.mapped;
        let others = (0..self.info.layout.variables.len()).filter(|&number| number != mapped);
        let mut tabs = Vec::new();
        for number in std::iter::once(mapped).chain(others) {
            tabs.push(self.maps(method, number)?);
        }
        tabs.extend(self.all_biases(method)?);
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
        let is_smoothed = self.history.maps(method).any(|(_, maps)| maps.smoothed.is_some());
        let has_spread = self.history.maps(method).any(|(_, maps)| maps.spread.is_some());
        let spread = format!("0 to {} {unit}", number_text(ranges.spread));
        let own = |part: &str| self.names.field(method, name, part);
        let observations = own("observations/**");
        let [background_wind, wind] = ["background_wind", "wind"].map(|part| self.names.map(method, part));
        let mut maps = vec![
            (format!("truth · {state}"), "state", vec![format!("truth/{name}"), "truth/wind".into()]),
            (
                "background, observations".into(),
                "state",
                vec![own("background"), background_wind, observations.clone()],
            ),
            (format!("analysis · {state}"), "state", vec![own("analysis"), wind]),
            (format!("increment · {difference}"), "difference", vec![own("increment/**"), observations]),
            (format!("background error · {difference}"), "difference", vec![own("background_error/**")]),
            (format!("analysis error · {difference}"), "difference", vec![own("analysis_error/**")]),
        ];
        if !self.info.has_truth {
            maps = maps.split_off(1);
            maps.truncate(3);
        }
        if is_smoothed {
            maps.push((format!("smoothed · {state}"), "state", vec![own("smoothed")]));
        }
        if is_smoothed && self.info.has_truth {
            maps.push((format!("smoothed error · {difference}"), "difference", vec![own("smoothed_error/**")]));
        }
        if has_spread {
            maps.push((format!("claimed spread · {spread}"), "spread", vec![own("spread")]));
        }
        let mut parts = Vec::new();
        for (title, bar, mut contents) in maps {
            contents.push(format!("color_bars/{name}/{bar}/**"));
            parts.push(self.map(&title, contents)?);
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

    /// All biases of the method in one figure, and maps of its stations in the colour of theirs.
    fn all_biases(&mut self, method: usize) -> Result<Option<Part>> {
        if self.info.calibration.is_empty() || !self.info.methods[method].estimates_biases {
            return Ok(None);
        }
        let what = if self.history.knows_biases() { "errors of biases" } else { "biases" };
        let contents = [format!("{}/**", biases::FRAME), self.names.map(method, "biases/**")];
        let title = format!("{what} in σ of the prior, with ±2σ of the method");
        let mut parts = vec![self.blueprint.map(&title, &contents, biases::bounds(self.info))?];
        for (number, variable) in self.info.layout.variables.iter().enumerate() {
            if self.history.station_biases[number].is_empty() {
                continue;
            }
            let limit = number_text(self.ranges.variables[number].station_bias);
            let title = format!("stations: {what} of {} · ±{limit} {}", variable.name, variable.unit);
            let stations = format!("{}/**", self.names.stations(method, variable.name));
            parts.push(self.map(&title, vec![stations, format!("color_bars/{}/station_bias/**", variable.name)])?);
        }
        self.blueprint.container("all biases", Arrangement::Horizontal, &parts).map(Some)
    }

    /// What the method estimates beside the state, one plot for each; in tabs if there are many.
    fn biases(&mut self, method: usize) -> Result<Option<Part>> {
        let mut plots = Vec::new();
        let estimated = self.history.parameters.iter().filter_map(|(name, methods)| {
            let own = methods[method].as_ref().filter(|own| !own.determined.is_empty())?;
            Some((format!("{name} [{}]", own.last.unit), self.names.estimated(method, name, "**")))
        });
        let estimates_biases = self.info.methods[method].estimates_biases;
        let numbers = shown_parameters(&self.info.calibration).into_iter().filter(|_| estimates_biases);
        let biases = numbers.map(|number| {
            let parameter = &self.info.calibration.parameters[number];
            let title = format!("{} [{}]", parameter.name, parameter.unit);
            (title, self.names.parameter(method, number, "**"))
        });
        for (title, contents) in estimated.chain(biases) {
            let has_legend = plots.len() % PARAMETERS_PER_PAGE == 0;
            plots.push(self.blueprint.curves(&title, &[contents], None, has_legend)?);
        }
        if plots.is_empty() {
            return Ok(None);
        }
        if plots.len() <= PARAMETERS_PER_PAGE {
            return self.blueprint.container("biases", Arrangement::Horizontal, &plots).map(Some);
        }
        let mut pages = Vec::new();
        let total = plots.len();
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
