//! Which views there are: a tab that compares all methods, and one for each method.

use super::blueprint::{Arrangement, Blueprint, Part};
use super::frame::Frame;
use super::history::History;
use super::ranges::Ranges;
use super::recording::{Names, Result};
use crate::event::RunInfo;
use crate::plot::number;
use ::rerun::RecordingStream;

/// Plots of calibration parameters on one page, and the most pages that a method has.
const PARAMETERS_PER_PAGE: usize = 4;
const PAGES: usize = 8;

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
        for (variable, &range) in self.info.layout.variables.iter().zip(&self.ranges.score) {
            let name = format!("analysis RMSE of {} [{}]", variable.name, variable.unit);
            let contents = [format!("comparison/{}/**", variable.name)];
            plots.push(self.blueprint.curves(&name, &contents, Some([0.0, range]), true)?);
        }
        let plots = self.blueprint.container("errors", Arrangement::Horizontal, &plots)?;
        let mapped = &self.info.layout.variables[self.history.mapped];
        let departure = format!("mean background departure of {} [{}]", mapped.name, mapped.unit);
        let innovations = [("innovation χ²/n [1]", "innovation/chi2/**"), (&departure, "innovation/departure/**")];
        let innovations =
            innovations.map(|(name, contents)| self.blueprint.curves(name, &[contents.into()], None, true));
        let innovations = innovations.into_iter().collect::<Result<Vec<_>>>()?;
        let innovations = self.blueprint.container("innovations", Arrangement::Horizontal, &innovations)?;
        let texts =
            [self.blueprint.document("scores", "text/scores")?, self.blueprint.document("scenario", "text/scenario")?];
        let texts = self.blueprint.container("texts", Arrangement::Horizontal, &texts)?;
        self.blueprint.container("overview", Arrangement::Vertical(&[1.0, 0.8, 1.0]), &[plots, innovations, texts])
    }

    /// One method: its maps above its curves.
    fn method(&mut self, method: usize) -> Result<Part> {
        let mut maps = self.maps(method)?;
        let mut curves = Vec::new();
        for (number, variable) in self.info.layout.variables.iter().enumerate() {
            let mapped = number == self.history.mapped;
            let name =
                format!("{} of {} [{}]", if mapped { "RMSE and spread" } else { "RMSE" }, variable.name, variable.unit);
            let contents = [self.names.score(method, variable.name, "**")];
            let plot = self.blueprint.curves(&name, &contents, Some([0.0, self.ranges.score[number]]), mapped)?;
            if mapped { maps.push(plot) } else { curves.push(plot) }
        }
        curves.extend(self.biases(method)?);
        let columns = if maps.len() > 6 { 4 } else { 3 };
        let maps = self.blueprint.container("maps", Arrangement::Grid(columns), &maps)?;
        let name = &self.info.methods[method].name;
        if curves.is_empty() {
            return self.blueprint.container(name, Arrangement::Vertical(&[1.0]), &[maps]);
        }
        let curves = self.blueprint.container("curves", Arrangement::Horizontal, &curves)?;
        self.blueprint.container(name, Arrangement::Vertical(&[3.0, 1.0]), &[maps, curves])
    }

    fn maps(&mut self, method: usize) -> Result<Vec<Part>> {
        let variable = &self.info.layout.variables[self.history.mapped];
        let (name, unit) = (variable.name, variable.unit);
        let [low, high] = self.ranges.state.map(number::<f32>);
        let state = format!("{low} to {high} {unit}");
        let difference = format!("±{} {unit}", number(self.ranges.difference));
        let has_spread = self.history.methods[method].values().any(|it| it.spread.is_some());
        let spread = format!("0 to {} {unit}", number(self.ranges.spread));
        let own = |part: &str| self.names.map(method, part);
        let observations = own("observations/**");
        let mut maps = vec![
            (format!("truth {name} · {state}"), "state", vec!["truth/**".into()]),
            (
                format!("background {name} · observations by departure"),
                "state",
                vec![own("background"), observations.clone()],
            ),
            (format!("analysis {name} · {state}"), "state", vec![own("analysis/**")]),
            (format!("increment · {difference}"), "difference", vec![own("increment"), observations]),
            (format!("background error · {difference}"), "difference", vec![own("background_error")]),
            (format!("analysis error · {difference}"), "difference", vec![own("analysis_error")]),
        ];
        if has_spread {
            maps.push((format!("claimed spread of analysis · {spread}"), "spread", vec![own("spread")]));
        }
        let bounds = Frame::new(&self.info.layout).bounds();
        let blueprint = &mut self.blueprint;
        let views = maps.into_iter().map(|(title, bar, mut contents)| {
            contents.push(format!("color_bars/{bar}/**"));
            blueprint.map(&title, &contents, bounds)
        });
        views.collect()
    }

    /// The calibration parameters, one plot for each; in tabs if they are many.
    fn biases(&mut self, method: usize) -> Result<Vec<Part>> {
        let mut plots = Vec::new();
        for (number, parameter) in self.info.calibration.parameters.iter().enumerate().take(PAGES * PARAMETERS_PER_PAGE)
        {
            let name = format!("{} [{}]", parameter.name, parameter.unit);
            plots.push(self.blueprint.curves(
                &name,
                &[self.names.parameter(method, number, "**")],
                None,
                number % PARAMETERS_PER_PAGE == 0,
            )?);
        }
        if plots.len() <= PARAMETERS_PER_PAGE {
            return Ok(plots);
        }
        let mut pages = Vec::new();
        let total = self.info.calibration.len();
        for (page, plots) in plots.chunks(PARAMETERS_PER_PAGE).enumerate() {
            let first = page * PARAMETERS_PER_PAGE + 1;
            let name = format!("biases {first}–{} of {total}", first + plots.len() - 1);
            pages.push(self.blueprint.container(&name, Arrangement::Horizontal, plots)?);
        }
        Ok(vec![self.blueprint.container("biases", Arrangement::Tabs, &pages)?])
    }
}
