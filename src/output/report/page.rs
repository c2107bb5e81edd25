//! The page: its sections, put together by a template that escapes what it is given.

pub use super::section::{Drawing, Figure, Folded, Page, Section};

use super::biases;
use super::facts;
use super::figures::Figures;
use super::forecasts;
use super::headline;
use super::maps::{self, Maps};
use super::scans;
use super::tables;
use super::verdicts;
use super::warnings::{self, ProbabilityFields};
use crate::event::RunInfo;
use crate::output::history::History;
use crate::plot::colors::{hex, of_method_on_paper};
use crate::plot::{CurvePlot, IntervalPlot, PlotError, Svg};
use crate::scores::Summary;
use crate::tables::{MOST_PARAMETERS, diagnostics, scores, stability};
use crate::text::on_page;
use minijinja::syntax::SyntaxConfig;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, UndefinedBehavior, context, escape_formatter};

/// Figures of what else is estimated that are shown at once; the others are folded.
const OPEN_FIGURES: usize = 8;

/// The script of every page, and its hash: browsers run this script and no other.
const SCRIPT: &str = include_str!("script.js");
const SCRIPT_HASH: &str = "sha256-bkpFYMB97s0DlQnZn6HwsPLn5wkFcQs2aADBU/DHbgc=";

/// Why a page cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// A figure.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// The template.
    #[error("the page cannot be put together: {0}")]
    Template(#[from] minijinja::Error),
}

/// Puts a page together.
///
/// # Errors
/// If the template fails, which would be a fault of this program.
pub fn render(page: &Page) -> Result<String, PageError> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_template("page.html", include_str!("page.html"))?;
    environment.set_formatter(|output, state, value| match value.as_str() {
        Some(text) if !value.is_safe() => escape_formatter(output, state, &Value::from(on_page(text))),
        _ => escape_formatter(output, state, value),
    });
    let (style, script, script_hash) = (include_str!("style.css"), SCRIPT, SCRIPT_HASH);
    let values = context! { page => Value::from(Serde(page)), style, script, script_hash };
    Ok(environment.get_template("page.html")?.render(values)?)
}

/// The report of a run: the page, and the files of its figures.
pub struct Report {
    page: Page,
    files: Vec<(String, Vec<u8>)>,
}

impl Report {
    /// Draws everything.
    pub fn new(history: &History, probabilities: &ProbabilityFields, summary: &Summary) -> Result<Self, PageError> {
        let info = &history.info;
        let mut report = Self { page: Page::default(), files: Vec::new() };
        let figures = Figures { info, history };
        report.page.title.clone_from(&info.title);
        report.page.subtitle =
            format!("{}, seed {}: {} methods side by side", info.scenario, info.seed, info.methods.len());
        report.page.headline = headline::sentences(info, summary);
        let methods = info.methods.iter().enumerate();
        report.page.methods =
            methods.map(|(number, method)| (method.name.clone(), hex(of_method_on_paper(number)))).collect();
        report.page.facts = facts::facts(info, summary);
        let glance = headline::drawing(info, summary, history.mapped).map(|it| report.intervals(it, "curves"));
        let scores = report.scores(info, summary);
        let (title, text) = if info.has_truth {
            let text = "A method whose claimed spread (broken line) lies on its error (solid line) knows what it does not know. Shaded: the \
                        cycles that count.";
            ("Error over time", text)
        } else {
            let text = "Departures hold the observations' own errors, so that they stay above the claimed spread.";
            ("Departures over time", text)
        };
        let errors = Section {
            title: title.into(),
            text: text.into(),
            figures: report.curves(figures.errors()),
            ..Section::default()
        };
        let maps = Maps::new(info, history);
        let structures = report.structures(maps.structures())?;
        let correlations = report.correlations(maps.correlations(), history.mapped)?;
        let of_stations = biases::stations(info, history, &maps);
        let at_a_glance = report.maps(info, maps.all(), maps.other_variables(), glance)?;
        let biases = report.biases(info, history, &figures, of_stations)?;
        let parameters = report.parameters(info, history, &figures);
        let stability = stability(summary, history);
        let ahead = report.ahead(info, summary);
        let warnings = report.warnings(info, &maps, probabilities, summary)?;
        let reliability = Section {
            title: "Is the claimed spread right?".into(),
            text: "For the methods that claim one, over all grid points of the cycles that count.".into(),
            figures: report.curves(figures.reliability().into_iter().chain(figures.histograms(summary)).collect()),
            ..Section::default()
        };
        let innovations = Section {
            title: "What the observations say".into(),
            text: "Departures of the observations from the background, which need no truth.".into(),
            figures: report.curves(figures.innovations()),
            ..Section::default()
        };
        let folded = diagnostics::all(summary).into_iter().map(|titled| Folded {
            title: titled.title.into(),
            text: titled.text.into(),
            tables: vec![titled.table],
            ..Folded::default()
        });
        let diagnostics = Section {
            title: "Diagnostics".into(),
            text: "Over the cycles that count, with 95 % intervals below.".into(),
            folded: folded.collect(),
            ..Section::default()
        };
        let cost = Section {
            title: "Partition and cost".into(),
            text:
                "Blocks that observations link are merged; below, the cycle whose largest component was the largest. \
                   Times are of the machine that ran it."
                    .into(),
            tables: tables::partitions(summary).into_iter().chain([scores::costs(summary)]).collect(),
            ..structures
        };
        let scenario = Section::of_scenario(&info.scenario, &info.scenario_text);
        let first = [Some(at_a_glance), Some(scores), Some(errors), ahead, warnings, biases, parameters, stability];
        let last = [reliability, correlations, innovations, diagnostics, cost, scenario];
        let all = first.into_iter().flatten().chain(last);
        report.page.sections = all.filter(|section| !section.is_empty()).collect();
        Ok(report)
    }

    /// The figures' names and bytes.
    pub fn files(&self) -> &[(String, Vec<u8>)] {
        &self.files
    }

    /// The page.
    pub fn html(&self) -> Result<String, PageError> {
        render(&self.page)
    }

    fn scores(&self, info: &RunInfo, summary: &Summary) -> Section {
        let smoothed = scores::smoothed(summary, &info.variables());
        let about_them = match smoothed {
            Some(_) => " Smoothed is the estimate of the same cycles once later observations have revised it.",
            None => "",
        };
        let passive = if info.networks.iter().any(|network| network.has_passive) {
            " Passive observations take no part in any analysis: their departures are an independent score."
        } else {
            ""
        };
        Section {
            title: "Scores".into(),
            text: format!(
                "{} over cycles {} to {}; below each its 95 % interval, for which successive cycles \
                 count the less the more they resemble each other. No interval: the cycles are worth fewer than three \
                 independent ones. Spread is what a method claims its analysis error to be.{about_them}{passive}",
                if info.has_truth {
                    "Root-mean-square errors"
                } else {
                    "Root-mean-square departures of the observations"
                },
                summary.scored_from_cycle,
                summary.cycles
            ),
            tables: tables::failures(summary)
                .into_iter()
                .chain([scores::errors(summary, &info.variables())])
                .chain(smoothed)
                .chain([tables::methods(info)])
                .collect(),
            ..Section::default()
        }
    }

    /// Forecasts ahead, by lead time.
    fn ahead(&mut self, info: &RunInfo, summary: &Summary) -> Option<Section> {
        let text = forecasts::text(summary)?;
        let tables = crate::tables::forecasts::on_page(summary, &info.variables());
        let folded = vec![Folded { title: "All scores by lead time".into(), tables, ..Folded::default() }];
        let figures = self.curves(forecasts::drawings(info, summary));
        Some(Section { title: "Forecasts ahead".into(), text, figures, folded, ..Section::default() })
    }

    /// Warnings of forecasts ahead.
    fn warnings(
        &mut self,
        info: &RunInfo,
        maps: &Maps<'_>,
        probabilities: &ProbabilityFields,
        summary: &Summary,
    ) -> Result<Option<Section>, PageError> {
        let Some(text) = warnings::text(info, summary) else { return Ok(None) };
        let mut folded = warnings::tables(summary);
        let figures = self.curves(warnings::drawings(info, summary));
        for (number, placed) in info.warnings.iter().enumerate() {
            let figures = self.draw(probabilities.maps(info, maps, number))?;
            if !figures.is_empty() {
                let title = format!("Maps of the probability of {}", placed.warning.name);
                folded.push(Folded { title, figures, ..Folded::default() });
            }
        }
        Ok(Some(Section { title: "Warnings".into(), text, figures, folded, ..Section::default() }))
    }

    fn biases(
        &mut self,
        info: &RunInfo,
        history: &History,
        figures: &Figures<'_>,
        of_stations: Vec<maps::Drawing>,
    ) -> Result<Option<Section>, PageError> {
        let Some(table) = tables::biases(info, history) else { return Ok(None) };
        let mut all: Vec<Figure> =
            biases::last_estimates(info, history).map(|it| self.intervals(it, "wide curves")).into_iter().collect();
        all.extend(self.curves(scans::drawings(info, history)));
        all.extend(self.draw(of_stations)?);
        let over_time = self.curves(figures.biases());
        let mut folded = vec![Folded { title: "Every bias over time".into(), figures: over_time, ..Folded::default() }];
        let which = match info.calibration.len() {
            0..=MOST_PARAMETERS => "every bias".to_string(),
            all => format!("the first {MOST_PARAMETERS} of {all} biases"),
        };
        let truth = if history.knows_biases() { ", and the truth (broken) where it is known" } else { "" };
        let title = format!("The last estimate of {which}, with ± 2σ where claimed");
        folded.push(Folded { title, tables: vec![table], ..Folded::default() });
        if let Some(table) = tables::comparisons(info, history) {
            let title = "Comparisons of sensors and test points".to_string();
            let text = "What was found, ± 2σ, and what each method says of the same difference in the analysis that took it in.".into();
            folded.push(Folded { title, text, tables: vec![table], ..Folded::default() });
        }
        Ok(Some(Section {
            title: "Biases".into(),
            text: format!("Estimates with the ±2σ that the method claims{truth}."),
            figures: all,
            folded,
            ..Section::default()
        }))
    }

    fn parameters(&mut self, info: &RunInfo, history: &History, figures: &Figures<'_>) -> Option<Section> {
        let table = tables::parameters(info, history)?;
        let mut all = self.curves(figures.parameters());
        let rest = all.split_off(all.len().min(OPEN_FIGURES));
        let title = "The last estimates, with ± 2σ or why there is none".to_string();
        let mut folded = vec![Folded { title, tables: vec![table], ..Folded::default() }];
        if !rest.is_empty() {
            folded.push(Folded { title: format!("{} more", rest.len()), figures: rest, ..Folded::default() });
        }
        Some(Section {
            title: "What else is estimated".into(),
            text: "What methods estimate beside state and biases, such as factors on the variances of errors \
                   (adapt/…), with the band of ±2σ that they claim; parameters.csv has all cycles."
                .into(),
            figures: all,
            folded,
            ..Section::default()
        })
    }

    /// The blocks of the methods that have them, and folded their common factors.
    fn structures(&mut self, all: Vec<maps::StructureMaps>) -> Result<Section, PageError> {
        let mut section = Section::default();
        for maps::StructureMaps { method, parts, factors } in all {
            section.figures.push(self.map(parts)?);
            if !factors.is_empty() {
                let title = format!("{method}: the leading common factors after the last analysis");
                let text =
                    "What the errors of all blocks have in common. The factors are orthogonal where each value is \
                            divided by its standard deviation in B; the share is that of the variance that the method \
                            claims for all values."
                        .into();
                let figures = self.draw(factors)?;
                section.folded.push(Folded { title, text, figures, ..Folded::default() });
            }
        }
        Ok(section)
    }

    /// The correlations of the variable that is shown first, and folded those of the others.
    fn correlations(&mut self, all: Vec<(String, Vec<maps::Drawing>)>, first: usize) -> Result<Section, PageError> {
        let mut section = Section {
            title: "Which errors go together".into(),
            text: "For the methods that have a covariance, after the last analysis: how far the error in the middle of the \
                   domain tells of the errors elsewhere, as the method believes."
                .into(),
            ..Section::default()
        };
        for (number, (variable, drawings)) in all.into_iter().enumerate() {
            let figures = self.draw(drawings)?;
            if number == first {
                section.figures = figures;
            } else if !figures.is_empty() {
                let title = format!("Correlation with {variable}");
                section.folded.push(Folded { title, figures, ..Folded::default() });
            }
        }
        Ok(section)
    }

    /// Draws curves, for the page and as files.
    fn curves(&mut self, drawings: Vec<Drawing<CurvePlot>>) -> Vec<Figure> {
        let draw = |Drawing { stem, caption, plot }: Drawing<CurvePlot>| {
            let svg = plot.svg(&self.next_id());
            self.keep(&stem, caption, svg, "curves")
        };
        drawings.into_iter().map(draw).collect()
    }

    /// Draws values with intervals, for the page and as a file.
    fn intervals(&mut self, drawing: Drawing<IntervalPlot>, class: &'static str) -> Figure {
        let Drawing { stem, caption, plot } = drawing;
        self.keep(&stem, caption, plot.svg(), class)
    }

    /// Draws maps, for the page and as files.
    pub(super) fn draw(&mut self, drawings: impl IntoIterator<Item = maps::Drawing>) -> Result<Vec<Figure>, PageError> {
        drawings.into_iter().map(|drawing| self.map(drawing)).collect()
    }

    /// Draws a map, or a line where the plane is one, for the page and as a file.
    pub(super) fn map(&mut self, drawing: maps::Drawing) -> Result<Figure, PageError> {
        let (Drawing { stem, caption, plot }, id) = (drawing, self.next_id());
        let svg = match plot.line() {
            Some(line) => line.svg(&id),
            None => plot.svg(&id)?,
        };
        for element in svg.shared.iter().filter(|element| !self.page.shared.contains(element)).collect::<Vec<_>>() {
            self.page.shared.push(element.clone());
        }
        Ok(self.keep(&stem, caption, svg, ""))
    }

    /// The word by which the next figure is known on the page.
    fn next_id(&self) -> String {
        format!("f{}", self.files.len())
    }

    /// A figure for the page, and its file.
    fn keep(&mut self, stem: &str, caption: String, svg: Svg, class: &'static str) -> Figure {
        self.files.push((format!("{stem}.svg"), svg.file.into_bytes()));
        Figure { caption, svg: svg.page, class, choice: None }
    }
}

/// The stability monitor's verdicts; what it found of each method is folded.
fn stability(summary: &Summary, history: &History) -> Option<Section> {
    let folded = summary.methods.iter().filter_map(|(name, scores)| {
        let own = scores.stability.as_ref().filter(|own| !own.parameters.is_empty())?;
        let findings = stability::findings(own).join(". ");
        let text = if findings.is_empty() { "Every bias has a stable update.".to_string() } else { findings + "." };
        Some(Folded { title: format!("{name}: {}", stability::in_short(own)), text, ..Folded::default() })
    });
    let verdicts = verdicts::verdicts(history, summary)?;
    let text = "Which biases the observations determine, whether innovations are white and as large as the method claims, and \
                what would help.";
    let exceptions = match &verdicts.exceptions {
        Some(_) => "The table has the biases without a stable update all along (verdicts.csv has all changes).",
        None => "",
    };
    let sentences = [text, exceptions, &verdicts.others].into_iter().filter(|text| !text.is_empty());
    Some(Section {
        title: "Stability of the bias estimates".into(),
        text: sentences.collect::<Vec<_>>().join(" "),
        tables: verdicts.exceptions.into_iter().collect(),
        folded: folded.collect(),
        ..Section::default()
    })
}
