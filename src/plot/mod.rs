//! Figures of this project's kind: curves as SVG, maps as PNG. The only place that knows the plotting crate.
//!
//! | module | what it holds |
//! |---|---|
//! | [`curves`] | curves and bands over one axis |
//! | [`map`] | a field with colour bar, contour lines and marks |
//! | [`colors`] | scales for maps, colours for methods; all safe for colour-blind eyes |
//! | [`parts`] | colours for the parts of a partition |
//! | [`range`] | round ranges for colours and axes |
//! | [`thin`] | fields at reduced resolution |

pub mod colors;
pub mod curves;
pub mod map;
mod number;
mod palette;
pub mod parts;
pub mod range;
pub mod thin;

pub use curves::{Curve, CurvePlot, Dash};
pub use map::{FieldMap, Mark};
pub use number::{number, unit, with_unit};
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
