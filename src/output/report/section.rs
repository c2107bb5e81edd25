//! What a page is made of: sections of text, tables and figures.

use crate::plot::{CurvePlot, HeatMap, IntervalPlot};
use crate::tables::Table;
use serde::Serialize;

/// A figure to be drawn: curves, values with intervals, numbers over two axes, or a map.
pub struct Drawing<P> {
    /// The stem of its file's name.
    pub stem: String,
    /// What it shows, in words.
    pub caption: String,
    /// The figure.
    pub plot: P,
}

/// A figure on a page.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// What it shows, in words.
    pub caption: String,
    /// Its SVG element, already escaped.
    pub svg: String,
    /// Class of its style: `curves` for what has a colour for each method, `wide`, both, or empty.
    pub class: &'static str,
    /// What it is a map of, if it is one of those among which a reader may choose.
    pub choice: Option<Choice>,
}

/// What a map is of, for the script that shows those of one cycle.
#[derive(Clone, Debug, Serialize)]
pub struct Choice {
    /// The number of the cycle.
    pub cycle: usize,
    /// The cycle in words.
    pub when: String,
    /// The method; none for the truth.
    pub method: Option<String>,
    /// `truth`, `error`, `background`, `analysis` or `spread`.
    pub kind: &'static str,
}

impl Figure {
    /// Values with intervals; `None` without any.
    pub fn of_intervals(plot: &IntervalPlot, caption: String) -> Option<Self> {
        (!plot.rows.is_empty()).then(|| Self { caption, svg: plot.svg().page, class: "curves", choice: None })
    }

    /// Numbers over two axes; `None` without any.
    pub fn of_heat(plot: &HeatMap, caption: String) -> Option<Self> {
        let has_some = plot.cells.iter().any(|cell| cell.value.is_some());
        has_some.then(|| Self { caption, svg: plot.svg().page, class: "", choice: None })
    }

    /// Curves as the figure of this number on its page; `None` without any.
    pub fn of_curves(plot: &CurvePlot, number: usize, caption: String) -> Option<Self> {
        let svg = || plot.svg(&format!("f{number}")).page;
        (!plot.curves.is_empty()).then(|| Self { caption, svg: svg(), class: "curves", choice: None })
    }
}

/// A part of the page.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Section {
    /// Its heading.
    pub title: String,
    /// Its heading in the table of contents; empty: the same.
    pub short: String,
    /// What there is to know before looking.
    pub text: String,
    /// Tables.
    pub tables: Vec<Table>,
    /// Figures.
    pub figures: Vec<Figure>,
    /// Further parts, each under a line that opens it.
    pub folded: Vec<Folded>,
}

impl Section {
    /// The text of a scenario file, to be opened.
    pub fn of_scenario(name: &str, text: &str) -> Self {
        let folded = Folded { title: format!("{name}.toml"), verbatim: text.to_string(), ..Folded::default() };
        Self { title: "Scenario".into(), folded: vec![folded], ..Self::default() }
    }

    /// Whether there is nothing to look at.
    pub fn is_empty(&self) -> bool {
        self.figures.is_empty() && self.tables.is_empty() && self.folded.is_empty()
    }
}

/// Something that the reader has to open.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Folded {
    /// The line that is always seen.
    pub title: String,
    /// What there is to know before looking.
    pub text: String,
    /// A text, to the letter.
    pub verbatim: String,
    /// Tables.
    pub tables: Vec<Table>,
    /// Figures.
    pub figures: Vec<Figure>,
}

/// A page.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Page {
    /// The heading.
    pub title: String,
    /// The line below it.
    pub subtitle: String,
    /// What was found, in a few sentences.
    pub headline: Vec<String>,
    /// Names and colours of methods that can be switched off in charts.
    pub methods: Vec<(String, String)>,
    /// Facts by name, at the end.
    pub facts: Vec<(String, String)>,
    /// The parts.
    pub sections: Vec<Section>,
    /// SVG elements that several figures use.
    pub shared: Vec<String>,
}
