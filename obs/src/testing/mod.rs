//! The contract batteries that every observation operator and every instrument must pass.

mod instrument;
mod operator;

pub use instrument::{InstrumentViolation, check_instrument};
pub use operator::{ContractViolation, check_operator};

#[cfg(test)]
use isobar_model::{Boundary, Grid, Layout, Location, Variable};
#[cfg(test)]
use std::sync::Arc;

/// The domain of the batteries' own tests.
#[cfg(test)]
fn layout(boundary: Boundary) -> Arc<Layout> {
    let variable = |name, unit, location| Variable { name, long_name: name, standard_name: None, unit, location };
    let grid = Grid { nx: 24, ny: 18, dx_m: 1e5, dy_m: 8e4, boundary };
    let variables = vec![
        variable("h", "m", Location::Center),
        variable("u", "m s-1", Location::XFace),
        variable("v", "m s-1", Location::YFace),
    ];
    Arc::new(Layout { grid, variables })
}
