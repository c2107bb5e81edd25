//! What a page is made of: sections of text, tables and figures.

use crate::plot::CurvePlot;
use crate::tables::Table;
use serde::Serialize;

/// A figure on a page.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// What it shows, in words.
    pub caption: String,
    /// Its SVG element, already escaped; empty for a picture.
    pub svg: String,
    /// The picture's bytes in base64; empty for an SVG.
    pub png: String,
}

impl Figure {
    /// Curves as the figure of this number on its page; `None` if there are none.
    pub fn of_curves(plot: &CurvePlot, number: usize, caption: String) -> Option<Self> {
        let svg = || plot.svg(&format!("f{number}")).page;
        (!plot.curves.is_empty()).then(|| Self { caption, svg: svg(), png: String::new() })
    }
}

/// A part of the page.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Section {
    /// Its heading.
    pub title: String,
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
    /// Facts by name.
    pub facts: Vec<(String, String)>,
    /// The parts.
    pub sections: Vec<Section>,
}
