//! Figures of this project's kind, as SVG. The only place that knows the plotting crate.
//!
//! | module | what it holds |
//! |---|---|
//! | [`curves`] | curves and bands over one axis |
//! | `ends` | names at the ends of curves |
//! | [`graticule`] | parallels and meridians |
//! | [`heat`] | numbers over two axes |
//! | [`map`] | a field with colour bar, contour lines, coast and marks |
//! | [`intervals`] | values with intervals, row by row |
//! | [`coast`] | coastlines |
//! | [`colors`] | scales for maps, colours for methods; all safe for colour-blind eyes |
//! | [`parts`] | colours for the parts of a partition |
//! | [`range`] | round ranges for colours and axes |
//! | [`thin`] | fields at reduced resolution |

pub mod coast;
pub mod colors;
mod contours;
pub mod curves;
mod ends;
pub mod graticule;
pub mod heat;
pub mod intervals;
pub mod map;
mod number;
pub mod parts;
pub mod range;
mod svg;
pub mod thin;

pub use curves::{Curve, CurvePlot, Dash};
pub use heat::{HeatCell, HeatMap};
pub use intervals::IntervalPlot;
pub use map::{FieldMap, Mark};
pub use number::{number, unit, with_unit};
pub use svg::Svg;
pub use thin::Thinning;

/// Why a figure cannot be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot draw {figure}: {reason}")]
pub struct PlotError {
    /// The figure's title.
    pub figure: String,
    /// Why not.
    pub reason: String,
}
