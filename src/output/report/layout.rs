//! What a page is made of, and the template that puts it together.

use crate::plot::{CurvePlot, IntervalPlot, PlotError};
use crate::tables::Table;
use crate::text::on_page;
use minijinja::syntax::SyntaxConfig;
use minijinja::value::{Serde, Value};
use minijinja::{Environment, UndefinedBehavior, context, escape_formatter};
use serde::Serialize;

/// The script of every page, and its hash: browsers run this script and no other.
const SCRIPT: &str = include_str!("script.js");
const SCRIPT_HASH: &str = "sha256-e0sZpOUDkzyYZLgyL0bOHQOewRY68RyrTfU0qxUn/hc=";

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

/// A figure on a page.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// What it shows, in words.
    pub caption: String,
    /// Its SVG element, already escaped.
    pub svg: String,
    /// Class of its style: `curves` for what has a colour for each method, `wide`, both, or empty.
    pub class: &'static str,
}

impl Figure {
    /// Values with intervals; `None` if there are none.
    pub fn of_intervals(plot: &IntervalPlot, caption: String) -> Option<Self> {
        (!plot.rows.is_empty()).then(|| Self { caption, svg: plot.svg().page, class: "curves" })
    }

    /// Curves as the figure of this number on its page; `None` if there are none.
    pub fn of_curves(plot: &CurvePlot, number: usize, caption: String) -> Option<Self> {
        let svg = || plot.svg(&format!("f{number}")).page;
        (!plot.curves.is_empty()).then(|| Self { caption, svg: svg(), class: "curves" })
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
