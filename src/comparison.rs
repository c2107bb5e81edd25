//! Several runs side by side: their scores, the differences, and whether these are more than chance.
//!
//! Two methods are compared cycle by cycle over the cycles that count in both (see [`crate::scores::statistics::difference`]). The
//! cycles are paired by their numbers: that is the more telling the more the runs have in common, as the truth of the same
//! scenario and seed, and right even if they have nothing in common.

use crate::output::recorded::{MethodSeries, SavedRun, SavedRunError, Scores};
use crate::output::report::page::{Figure, Page, PageError, Section, render};
use crate::plot::colors::of_method_on_paper;
use crate::plot::{Curve, CurvePlot, Dash};
use crate::scores::statistics::{Difference, difference, root_interval};
use crate::scores::{Against, Score, Values};
use crate::tables::{Cell, NONE, Table, figure};
use crate::text::shown_path;
use serde_json::{Value, json};
use std::path::Path;

/// Curves that a figure shows at most.
const MOST_CURVES: usize = 14;

/// Runs with their scores.
pub struct Comparison {
    runs: Vec<(SavedRun, Scores)>,
}

/// Differences of methods.
pub struct Differences {
    /// What there is to say, a sentence for each pair of methods.
    pub words: Vec<String>,
    /// All of them.
    pub table: Table,
}

/// A method of a run.
#[derive(Clone, Copy)]
struct Entry<'a> {
    run: usize,
    name: &'a str,
    series: &'a MethodSeries,
}

impl Comparison {
    /// Reads the runs' scores.
    ///
    /// # Errors
    /// If one is not readable.
    pub fn new(runs: Vec<SavedRun>) -> Result<Self, SavedRunError> {
        let read = |run: SavedRun| run.scores().map(|scores| (run, scores));
        Ok(Self::of(runs.into_iter().map(read).collect::<Result<_, _>>()?))
    }

    /// Of runs whose scores have been read.
    pub fn of(runs: Vec<(SavedRun, Scores)>) -> Self {
        Self { runs }
    }

    /// Which run each letter stands for.
    pub fn legend(&self) -> Vec<String> {
        let of_run = |(number, (run, _)): (usize, &(SavedRun, Scores))| {
            let (directory, it) = (shown_path(&run.directory), &run.summary);
            format!("{}: {directory}, scenario {}, seed {}", label(number), it.scenario, it.seed)
        };
        self.runs.iter().enumerate().map(of_run).collect()
    }

    /// Whether two runs are known to have different truths, so that a difference of their scores is not that of methods.
    fn differ_in_truth(&self, first: Entry<'_>, second: Entry<'_>) -> bool {
        let [a, b] = [first, second].map(|entry| &self.runs[entry.run].0);
        let has_truth = a.summary.has_truth() || b.summary.has_truth();
        // Of one seed, a changed scenario may have another truth.
        has_truth && (a.summary.seed != b.summary.seed || a.truth_checksum != b.truth_checksum)
    }

    /// The differences of every run from the first, method by method.
    pub fn between_runs(&self) -> Differences {
        let pairs = self.pairs_between_runs();
        let words = pairs.iter().filter_map(|&(first, second)| self.in_words(first, second)).collect();
        Differences { words, table: self.differences(pairs) }
    }

    /// The differences of every method from the best one of its run.
    pub fn within_runs(&self) -> Differences {
        let pairs = self.pairs_within_runs();
        let words = pairs.iter().filter_map(|&(best, other)| self.in_words(other, best)).collect();
        Differences { words, table: self.differences(pairs) }
    }

    /// All differences for a program, without rounding; `page` is where the page is.
    pub fn json(&self, page: &Path) -> Value {
        let run = |(number, (run, _)): (usize, &(SavedRun, Scores))| {
            let it = &run.summary;
            json!({ "run": label(number), "directory": shown_path(&run.directory), "scenario": it.scenario, "seed": it.seed })
        };
        let columns = self.columns();
        let entry = |entry: Entry<'_>| json!({ "run": label(entry.run), "method": entry.name });
        let mut differences = Vec::new();
        for (first, second) in self.pairs_between_runs().into_iter().chain(self.pairs_within_runs()) {
            for score in &columns {
                let Some(it) = self.difference(first, second, &score.key()) else { continue };
                let variable = Some(score.variable.0).filter(|name| !name.is_empty());
                differences.push(json!({
                    "of": entry(second),
                    "from": entry(first),
                    "score": score.kind.name,
                    "variable": variable,
                    "unit": score.unit(),
                    "difference": it.difference,
                    "low": it.interval.map(|it| it.low),
                    "high": it.interval.map(|it| it.high),
                    "significant": it.is_significant().filter(|_| !self.differ_in_truth(first, second)),
                }));
            }
        }
        let runs: Vec<Value> = self.runs.iter().enumerate().map(run).collect();
        json!({ "runs": runs, "differences": differences, "page": shown_path(page) })
    }

    /// Each method of the first run with those of the same name in the others.
    fn pairs_between_runs(&self) -> Vec<(Entry<'_>, Entry<'_>)> {
        self.entries()
            .filter(|entry| entry.run > 0)
            .filter_map(|entry| Some((self.entries().find(|first| first.run == 0 && first.name == entry.name)?, entry)))
            .collect()
    }

    /// The best method of each run with the others.
    fn pairs_within_runs(&self) -> Vec<(Entry<'_>, Entry<'_>)> {
        let mut pairs = Vec::new();
        for run in 0..self.runs.len() {
            let own = || self.entries().filter(move |entry| entry.run == run);
            let has = |key: &String| own().any(|entry| squares(&entry, key, self.scored_from(run)).is_some());
            let Some(first) = self.columns().iter().map(Score::key).find(has) else { continue };
            let error = |entry: &Entry<'_>| {
                let squares = squares(entry, &first, self.scored_from(run));
                squares.map_or(f64::INFINITY, |it| it.iter().map(|it| it.1).sum::<f64>() / it.len() as f64)
            };
            let Some(best) = own().min_by(|a, b| error(a).total_cmp(&error(b))) else { continue };
            pairs.extend(own().filter(|entry| entry.name != best.name).map(|entry| (best, entry)));
        }
        pairs
    }

    /// The page.
    ///
    /// # Errors
    /// As [`render`].
    pub fn html(&self) -> Result<String, PageError> {
        let names: Vec<&str> = self.runs.iter().map(|(run, _)| run.summary.scenario.as_str()).collect();
        let facts = self.runs.iter().enumerate().map(|(number, (run, _))| {
            let it = &run.summary;
            let from = it.scored_from_cycle;
            let text = format!(
                "{}: scenario {}, seed {}, scores of cycles {from} to {}, isobar {}",
                shown_path(&run.directory),
                it.scenario,
                it.seed,
                it.cycles,
                it.version
            );
            (label(number), text)
        });
        let mut sections = vec![Section {
            title: "Scores".into(),
            text: "Root-mean-square analysis errors, or departures of observations where there is no truth (O−B: from the \
                   background, O−A passive: of passive observations from the analysis), over the cycles that count in each \
                   run, with their 95 % intervals."
                .into(),
            tables: vec![self.scores()],
            ..Section::default()
        }];
        let explanation = "Differences of root-mean-square analysis errors or departures, with their 95 % intervals from cycle by cycle \
                           differences. Coloured and with a star: significant at the level of 5 %, smaller is better. Of twenty comparisons \
                           without any real difference one looks significant. Runs of different seeds, or of scenarios whose \
                           worlds differ, have different truths: a difference between them holds for these two stretches \
                           of weather, and not for the next seed, and is not marked.";
        for (title, Differences { table, .. }) in [
            ("Differences from run A", self.between_runs()),
            ("Differences from each run's best method", self.within_runs()),
        ] {
            if !table.rows.is_empty() {
                let (title, text) = (title.to_string(), explanation.to_string());
                sections.push(Section { title, text, tables: vec![table], ..Section::default() });
            }
        }
        sections.push(Section { title: "Over time".into(), figures: self.figures(), ..Section::default() });
        let mut distinct = names.clone();
        distinct.dedup();
        render(&Page {
            title: format!("Comparison: {}", distinct.join(", ")),
            subtitle: format!("{} runs side by side", self.runs.len()),
            facts: facts.collect(),
            sections,
            ..Page::default()
        })
    }

    fn entries(&self) -> impl Iterator<Item = Entry<'_>> + Clone {
        self.runs
            .iter()
            .enumerate()
            .flat_map(|(run, (_, scores))| scores.methods.iter().map(move |(name, series)| Entry { run, name, series }))
    }

    /// The scores that are compared: of all variables of all runs, then of the biases; without a truth departures instead.
    fn columns(&self) -> Vec<Score<'_>> {
        let mut variables: Vec<(&str, &str)> = Vec::new();
        for (name, unit) in self.runs.iter().flat_map(|(_, scores)| &scores.variables) {
            if variables.iter().all(|(known, _)| known != name) {
                variables.push((name, unit));
            }
        }
        let mut columns = Score::all(&variables, |kind| kind.compared);
        columns.retain(|score| {
            let key = score.key();
            score.kind.against == Against::Truth && self.has_truth()
                || self.entries().any(|entry| entry.series.values().any(|values| values.contains_key(&key)))
        });
        columns
    }

    /// Whether methods were compared with a truth in any run.
    fn has_truth(&self) -> bool {
        self.runs.iter().any(|(run, _)| run.summary.has_truth())
    }

    /// The heading of a score's column.
    fn heading(score: &Score<'_>) -> String {
        match score.kind.against {
            Against::Used | Against::Passive => format!("{} {}", score.subject(), score.kind.title),
            Against::Truth | Against::Nothing => score.subject(),
        }
    }

    fn scored_from(&self, run: usize) -> usize {
        self.runs[run].0.summary.scored_from_cycle
    }

    fn scores(&self) -> Table {
        let columns = self.columns();
        let header = ["run".to_string(), "method".into()].into_iter().chain(columns.iter().map(Self::heading));
        let row = |entry: Entry<'_>| {
            let mut row: Vec<Cell> = vec![label(entry.run).into(), entry.name.into()];
            row.extend(columns.iter().map(|score| {
                let Some(squares) = squares(&entry, &score.key(), self.scored_from(entry.run)) else {
                    return NONE.into();
                };
                let squares: Vec<f64> = squares.into_iter().map(|it| it.1).collect();
                let root = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
                Cell::known(Some(root), root_interval(&squares).as_ref())
            }));
            row
        };
        Table { header: header.collect(), rows: self.entries().map(row).collect() }
    }

    fn differences(&self, pairs: Vec<(Entry<'_>, Entry<'_>)>) -> Table {
        let columns = self.columns();
        let header = std::iter::once("difference".to_string()).chain(columns.iter().map(Self::heading)).collect();
        let row = |(first, second): (Entry<'_>, Entry<'_>)| {
            let name = format!("{} {} − {} {}", label(second.run), second.name, label(first.run), first.name);
            let is_marked = !self.differ_in_truth(first, second);
            let difference = |score: &Score<'_>| self.difference(first, second, &score.key());
            let cells = columns.iter().map(|score| difference(score).map_or(NONE.into(), |it| cell(it, is_marked)));
            std::iter::once(name.into()).chain(cells).collect()
        };
        Table { header, rows: pairs.into_iter().map(row).collect() }
    }

    /// Whether and by how much a method is better than another, in percent of the other's score with half the 95 % interval.
    fn in_words(&self, other: Entry<'_>, own: Entry<'_>) -> Option<String> {
        let shown = |entry: Entry<'_>| format!("{} {}", label(entry.run), entry.name);
        if self.differ_in_truth(other, own) {
            let (own, other) = (shown(own), shown(other));
            return Some(format!(
                "{own} and {other} have different truths, as their seeds or scenarios differ: --seeds compares methods"
            ));
        }
        let [mut better, mut worse, mut open, mut unknown] = [const { Vec::new() }; 4];
        for score in self.columns() {
            let Some((a, b)) = self.paired(other, own, &score.key()) else { continue };
            let Some(it) = difference(&a, &b) else { continue };
            let percent = 100.0 / (a.iter().sum::<f64>() / a.len() as f64).sqrt();
            let name = match (score.kind.against, score.variable.0) {
                (Against::Truth | Against::Nothing, "") => "biases".to_string(),
                (Against::Truth | Against::Nothing, name) => name.to_string(),
                (_, name) => format!("{} of {name}", score.kind.title),
            };
            match it.interval.filter(|interval| interval.excludes_zero() && percent.is_finite()) {
                Some(interval) => {
                    let half = percent * 0.5 * (interval.high - interval.low);
                    let decimals = usize::from(half < 1.0);
                    let size = percent * it.difference.abs();
                    let text = format!("by {size:.decimals$}\u{a0}±\u{a0}{half:.decimals$}\u{a0}% in {name}");
                    if it.difference < 0.0 { better.push(text) } else { worse.push(text) }
                }
                None if it.interval.is_some() => open.push(name),
                None => unknown.push(name),
            }
        }
        let parts = [
            ("better than", "", better),
            ("worse than", "", worse),
            ("not significantly different from", "in ", open),
            ("for want of independent cycles not comparable with", "in ", unknown),
        ];
        let parts = parts.into_iter().filter(|(_, _, all)| !all.is_empty());
        let parts =
            parts.map(|(verdict, before, all)| format!("{verdict} {} {before}{}", shown(other), all.join(", ")));
        let text = parts.collect::<Vec<_>>().join("; ");
        (!text.is_empty()).then(|| format!("{} is {text}", shown(own)))
    }

    fn difference(&self, first: Entry<'_>, second: Entry<'_>, key: &str) -> Option<Difference> {
        let (a, b) = self.paired(first, second, key)?;
        difference(&a, &b)
    }

    /// The squares of a score in the cycles that count in both.
    fn paired(&self, first: Entry<'_>, second: Entry<'_>, key: &str) -> Option<(Vec<f64>, Vec<f64>)> {
        let from = self.scored_from(first.run).max(self.scored_from(second.run));
        let (a, b) = (squares(&first, key, from)?, squares(&second, key, from)?);
        let other = |cycle: usize| b.binary_search_by_key(&cycle, |it| it.0).ok().map(|place| b[place].1);
        Some(a.iter().filter_map(|&(cycle, a)| Some((a, other(cycle)?))).unzip())
    }

    fn figures(&self) -> Vec<Figure> {
        let columns = self.columns();
        let drawn = columns.iter().enumerate().filter_map(|(number, score)| {
            let (key, title) = (score.key(), score.subject());
            let curve = |(place, entry): (usize, Entry<'_>)| {
                let squares = squares(&entry, &key, 0)?;
                let points = squares.into_iter().map(|(cycle, square)| [cycle as f64, square.sqrt()]).collect();
                let dash = [Dash::Solid, Dash::Dashed, Dash::Dotted][entry.run % 3];
                let color = of_method_on_paper(self.color(entry, place));
                Some(Curve { dash, ..Curve::new(&format!("{} {}", label(entry.run), entry.name), color, points) })
            };
            let curves: Vec<Curve> = self.entries().enumerate().filter_map(curve).take(MOST_CURVES).collect();
            let heading = format!("{} of {title}", score.kind.measured());
            let caption = format!("{heading}; a colour for each method, a style of line for each run.");
            Figure::of_curves(&CurvePlot::new(heading, "cycle [1]".into(), title, curves), number, caption)
        });
        drawn.collect()
    }

    /// The same colour for methods of the same name.
    fn color(&self, entry: Entry<'_>, place: usize) -> usize {
        self.entries().position(|other| other.name == entry.name).unwrap_or(place)
    }
}

/// The squares of a score by cycle, from a cycle on; `None` if there are none.
fn squares(entry: &Entry<'_>, key: &str, from: usize) -> Option<Vec<(usize, f64)>> {
    let of_cycle = |(&cycle, values): (&usize, &Values)| Some((cycle, values.get(key)?.powi(2)));
    let squares: Vec<(usize, f64)> = entry.series.range(from..).filter_map(of_cycle).collect();
    (!squares.is_empty()).then_some(squares)
}

/// A difference with its interval; a star marks significance, where that `is_marked`.
fn cell(it: Difference, is_marked: bool) -> Cell {
    let signed = |value: f64| format!("{}{}", if value > 0.0 { "+" } else { "" }, figure(value));
    let note = it.interval.map_or("too few cycles".into(), |at| format!("{} … {}", signed(at.low), signed(at.high)));
    let class = match it.is_significant().filter(|_| is_marked) {
        Some(true) if it.difference < 0.0 => "better",
        Some(true) => "worse",
        _ => "open",
    };
    let star = if class == "open" { "" } else { " *" };
    Cell { text: format!("{}{star}", signed(it.difference)), note, class }
}

/// A, B, …, Z, then numbers.
fn label(run: usize) -> String {
    match u8::try_from(run) {
        Ok(number @ 0..26) => char::from(b'A' + number).to_string(),
        _ => (run + 1).to_string(),
    }
}
