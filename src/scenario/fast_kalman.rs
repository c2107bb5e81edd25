//! The settings of the Fast Kalman Filter.

use super::method::Surroundings;
use crate::reader::{Field, Limits, Read, Section};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanSettings, Precision, Residual};
use isobar_model::Grid;
use toml::de::DeValue;

/// Draws that show how much of the residual blocks a forecast keeps, unless the scenario says how many.
const DEFAULT_PROBES: usize = 8;

/// The most common factors.
const MOST_FACTORS: usize = 100_000;

/// Variables up to which blocks that observations link are merged, unless the scenario says how many: more are dearer,
/// and no more accurate.
const DEFAULT_LARGEST_COMPONENT: usize = 500;

/// Large blocks are merged up to so many all the same: as a separator is at least a block, cutting them is dearer.
const DEFAULT_MERGED_BLOCKS: usize = 4;

/// Factors that the separators of larger components may add for an analysis, unless the scenario says how many.
const DEFAULT_SEPARATOR_FACTORS: usize = 100;

/// Reads the settings that `fkf` and `time_volume` share, and the precision of the factors, which is no key of the latter.
pub(super) fn read(section: &Section<'_>, surroundings: &Surroundings<'_>) -> Read<FastKalmanSettings> {
    let &Surroundings { grid, model, .. } = surroundings;
    const COUPLINGS: &[(&str, BiasCoupling)] = &[("carry", BiasCoupling::Carry), ("drop", BiasCoupling::Drop)];
    const PRECISIONS: &[(&str, Precision)] = &[("double", Precision::Double), ("single", Precision::Single)];
    let (factors, retained_energy) = section.optional("factors").map_or(Ok((0, 1.0)), |field| factors(&field))?;
    let probe = Residual::Probe { count: section.whole_or("probes", DEFAULT_PROBES, 1, 1000)? };
    let residuals = [("exact", Residual::Exact), ("persist", Residual::Persist), ("probe", probe)];
    // Without factors the blocks hold all there is, and only the exact forecast does them justice.
    let default = if factors == 0 { Residual::Exact } else { probe };
    let bias_coupling =
        section.optional("bias_coupling").map_or(Ok(BiasCoupling::Carry), |field| field.choice(COUPLINGS))?;
    if let (Some(field), true, BiasCoupling::Drop) = (section.optional("factors"), factors > 0, bias_coupling) {
        let message = "bias_coupling = \"drop\" is the printed formula, which has no factors".to_string();
        return Err(field.invalid(message, "must be 0 with bias_coupling = \"drop\""));
    }
    let blocks = section.optional("blocks").map_or(Ok(BlockShape::Cell), |field| blocks(&field, grid))?;
    let (nx, ny) = blocks.cells(grid);
    let merged_blocks = DEFAULT_MERGED_BLOCKS * nx * ny * model.variables().len();
    let largest_component = DEFAULT_LARGEST_COMPONENT.max(merged_blocks);
    Ok(FastKalmanSettings {
        blocks,
        bias_coupling,
        factors,
        retained_energy,
        factor_precision: section
            .optional("factor_precision")
            .map_or(Ok(Precision::Double), |field| field.choice(PRECISIONS))?,
        residual: section.optional("residual").map_or(Ok(default), |field| field.choice(&residuals))?,
        largest_component: section.whole_or("largest_component", largest_component, 1, 1_000_000)?,
        separator_factors: section.whole_or("separator_factors", DEFAULT_SEPARATOR_FACTORS, 0, 100_000)?,
    })
}

/// The grids on which factors can be propagated, by the cells on a side of theirs.
const FACTOR_GRIDS: [usize; 4] = [1, 2, 4, 8];

/// The fewest cells on a side of a grid of factors.
const FEWEST_CELLS: usize = 4;

/// Reads how many cells wide those are on which the factors are propagated.
pub(super) fn factor_grid(section: &Section<'_>, grid: &Grid, settings: FastKalmanSettings) -> Read<usize> {
    let Some(field) = section.optional("factor_grid") else { return Ok(1) };
    let cells = field.whole(1, 8)?;
    let fits = |n: usize| n.is_multiple_of(cells) && n / cells >= FEWEST_CELLS;
    if !FACTOR_GRIDS.contains(&cells) || !(cells == 1 || fits(grid.nx) && fits(grid.ny)) {
        let message = format!("cells of {cells} × {cells} do not make a grid of {} × {}", grid.nx, grid.ny);
        return Err(
            field.invalid(message, "must be 1, 2, 4 or 8, divide both sides and leave at least 4 cells on each")
        );
    }
    if cells > 1 && (settings.residual == Residual::Exact || settings.factors == 0) {
        let message = "without factors, or with an exact forecast of the blocks, nothing can be coarser".to_string();
        return Err(field.invalid(message, "needs `factors`, and residual = \"probe\" or \"persist\""));
    }
    Ok(cells)
}

/// A number of factors, or how many there may be and the share of their energy that is kept.
fn factors(field: &Field<'_>) -> Read<(usize, f64)> {
    if !matches!(field.value.get_ref(), DeValue::Table(_)) {
        return Ok((field.whole(0, MOST_FACTORS)?, 1.0));
    }
    let section = field.section(&["retained", "at_most"])?;
    let retained = section.required("retained")?.number(Limits::Between(0.01, 1.0))?;
    Ok((section.required("at_most")?.whole(1, MOST_FACTORS)?, retained))
}

fn blocks(field: &Field<'_>, grid: &Grid) -> Read<BlockShape> {
    if !matches!(field.value.get_ref(), DeValue::Table(_)) {
        return field.choice(&[("cell", BlockShape::Cell), ("domain", BlockShape::Domain)]);
    }
    let tile = field.section(&["tile"])?.required("tile")?;
    let numbers = tile.elements(2)?;
    let [nx, ny] = numbers.as_slice() else {
        return Err(tile.invalid(format!("`{}` needs two numbers", tile.title()), "must be [cells in x, cells in y]"));
    };
    Ok(BlockShape::Tile { nx: nx.whole(1, grid.nx)?, ny: ny.whole(1, grid.ny)? })
}
