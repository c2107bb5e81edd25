//! `kind = "fkf"`: Lange's Fast Kalman Filter, and the settings that it shares with the time volume.

use super::adapt::ADAPT;
use super::common_factors::{self, CommonFactors, FACTORS, storage};
use super::local_factors::{self, LOCAL_FACTORS};
use super::work::probes;
use super::{
    BIAS, COMPARISONS, ERROR_CORRELATION, FIRST_GUESS, MEMORY_LIMIT_GB, MethodSettings, SMOOTHER_LAG_CYCLES, Setup,
    Sizes, Surroundings, Work,
};
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, AnyKey, Choice, Described, Field, Form, Key, OrTable, Read, Section, Whole};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanFilter, FastKalmanSettings, Precision, Residual};
use isobar_assim::local_factors::{LocalFactorSettings, LocalFastKalmanFilter};
use isobar_assim::{Assimilator, Error};
use isobar_model::Grid;
use toml::de::DeValue;

/// Variables up to which blocks that observations link are merged unless the scenario says otherwise: merging more costs
/// more, and is no more accurate.
const LARGEST_COMPONENT: usize = 500;

/// This number of large blocks is merged in any case: as a separator is at least a block, cutting them would cost more.
const MERGED_BLOCKS: usize = 4;

const BLOCKS: Key<OrTable<Choice<BlockShape>>> = Key::absent(
    "blocks",
    "",
    OrTable(Choice(&[("cell", BlockShape::Cell), ("domain", BlockShape::Domain)]), &[&TILE]),
    Absent::Means(BlockShape::Cell),
    "the blocks of the covariance: cells, tiles or the whole domain",
);

const TILE: Key<Described> = Key::required(
    "tile",
    "cells",
    Described("[cells in x, cells in y]", || Form::list(Form::Whole(1, 4096))),
    "sides of a tile",
);

const BIAS_COUPLING: Key<Choice<BiasCoupling>> = Key::absent(
    "bias_coupling",
    "",
    Choice(&[("carry", BiasCoupling::Carry), ("drop", BiasCoupling::Drop)]),
    Absent::Means(BiasCoupling::Carry),
    "whether the covariance of biases with the state is carried from cycle to cycle; drop is the printed formula",
);

const FACTOR_GRID: Key<Whole> = Key::absent(
    "factor_grid",
    "cells",
    Whole(1, 8),
    Absent::Means(1),
    "width of the cells on which factors are propagated: 1, 2, 4 or 8",
);

pub(super) const FACTOR_PRECISION: Key<Choice<Precision>> = Key::absent(
    "factor_precision",
    "",
    Choice(&[("double", Precision::Double), ("single", Precision::Single)]),
    Absent::Means(Precision::Double),
    "the numbers in which factors are kept and forecast",
);

const RESIDUAL: Key<Choice<Residual>> = Key::absent(
    "residual",
    "",
    // Probes are counted by a key of their own.
    Choice(&[("exact", Residual::Exact), ("persist", Residual::Persist), ("probe", Residual::Probe { count: 0 })]),
    Absent::Explained("\"probe\" with factors or local factors, else \"exact\""),
    "how the blocks are forecast",
);

const PROBES: Key<Whole> = Key::absent(
    "probes",
    "",
    Whole(1, 1000),
    Absent::Means(8),
    "draws that show how much of the residual blocks a forecast keeps",
);

const LARGEST: Key<Whole> = Key::absent(
    "largest_component",
    "",
    Whole(1, 1_000_000),
    Absent::Explained("500, or four blocks if they are larger"),
    "variables up to which blocks that observations link are merged",
);

const SEPARATOR_FACTORS: Key<Whole> = Key::absent(
    "separator_factors",
    "",
    Whole(0, 100_000),
    Absent::Means(100),
    "factors that the separators of larger components may add for an analysis",
);

/// The keys that the time volume and the federated filter have as well.
pub(super) const SHARED_KEYS: &[&dyn AnyKey] =
    &[&BLOCKS, &FACTORS, &RESIDUAL, &PROBES, &LARGEST, &SEPARATOR_FACTORS, &MEMORY_LIMIT_GB];

pub(super) const KIND: Kind<dyn MethodSettings, Surroundings> = Kind::new(
    "fkf",
    "Lange's Fast Kalman Filter: blocks, and the common factors that link them",
    &[
        &[
            &BIAS,
            &ERROR_CORRELATION,
            &FIRST_GUESS,
            &COMPARISONS,
            &ADAPT,
            &BIAS_COUPLING,
            &FACTOR_GRID,
            &FACTOR_PRECISION,
            &LOCAL_FACTORS,
            &SMOOTHER_LAG_CYCLES,
        ],
        SHARED_KEYS,
    ],
    |section, surroundings| {
        let Settings { filter, factors } = read(section, surroundings)?;
        let local = local_factors::read(section, surroundings, &filter, factors)?;
        let has_factors = filter.factors > 0 || local.is_some();
        let factor_grid = factor_grid(section, &surroundings.domain.grid, filter.residual, has_factors)?;
        check_smoother(section, has_factors)?;
        Ok(Box::new(FastKalman { settings: Settings { filter, factors }, factor_grid, local }))
    },
);

#[derive(Debug)]
struct FastKalman {
    settings: Settings,
    /// Cells on a side of those on which the factors are propagated: 1 on the grid of the state.
    factor_grid: usize,
    /// Factors of tiles instead of the whole domain.
    local: Option<LocalFactorSettings>,
}

impl MethodSettings for FastKalman {
    fn build(&self, setup: Setup<'_>) -> Result<Box<dyn Assimilator>, Error> {
        let (Domain { grid, model, .. }, cycle) = (setup.domain, setup.cycle);
        let fault = |reason: String| Error::Setting(format!("factor_grid = {}: {reason}", self.factor_grid));
        let coarse = || model.build_coarser(grid, cycle, self.factor_grid).map_err(fault);
        let coarse = (self.factor_grid > 1).then(coarse).transpose()?;
        if let Some(local) = self.local {
            let filter = |problem| LocalFastKalmanFilter::with_local_factors(problem, local);
            let filter = setup.smoothed(filter, LocalFastKalmanFilter::smoothing)?;
            return Ok(match coarse {
                None => Box::new(filter),
                Some(model) => Box::new(filter.with_factors_on(model)?),
            });
        }
        let filter = |problem| FastKalmanFilter::new(problem, self.settings.filter);
        let filter = setup.smoothed(filter, FastKalmanFilter::smoothing)?;
        Ok(match coarse {
            None => Box::new(filter),
            Some(model) => Box::new(filter.with_factors_on(model)?),
        })
    }

    fn work(&self, sizes: &Sizes) -> Work {
        match &self.local {
            Some(local) => local_factors::work(local, sizes),
            None => work(&self.settings, self.factor_grid, sizes),
        }
    }

    fn describe(&self) -> String {
        let settings = match &self.local {
            Some(local) => local_factors::describe(local, self.settings.factors, self.factor_grid),
            None => describe(&self.settings, self.factor_grid),
        };
        format!("Fast Kalman Filter, {settings}")
    }

    fn in_bands(&self) -> bool {
        true
    }

    fn fixed_gain(&self) -> Result<(), &'static str> {
        Ok(())
    }

    fn carries_bias_covariance(&self) -> bool {
        true
    }
}

/// Fails if there is to be a smoother without the factors that it needs.
pub(super) fn check_smoother(section: &Section<'_>, has_factors: bool) -> Read<()> {
    let Some(field) = section.optional(SMOOTHER_LAG_CYCLES.name) else { return Ok(()) };
    if !has_factors {
        let message = "the smoother revises what common factors link, and there are no factors".to_string();
        return Err(field.misplaced(message, "leave out this key, or add `factors`"));
    }
    Ok(())
}

/// The settings of the filter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settings {
    pub filter: FastKalmanSettings,
    /// How many factors it has, and why.
    pub factors: CommonFactors,
}

/// Reads the settings of the filter; keys that the time volume or the federated filter do not have are absent there.
pub(super) fn read(section: &Section<'_>, surroundings: &Surroundings) -> Read<Settings> {
    let domain = &surroundings.domain;
    let asked = section.find(&RESIDUAL)?;
    let bias_coupling = section.get(&BIAS_COUPLING)?;
    let blocks = section.optional(BLOCKS.name).map_or(Ok(BlockShape::Cell), |field| blocks(&field, &domain.grid))?;
    let has_local_factors = section.optional(LOCAL_FACTORS.name).is_some();
    let none_by_default = has_local_factors
        || blocks != BlockShape::Cell
        || asked == Some(Residual::Exact)
        || bias_coupling == BiasCoupling::Drop;
    let common = common_factors::read(section, surroundings, none_by_default)?;
    let factors = common.at_most;
    let probe = Residual::Probe { count: section.get(&PROBES)? };
    let residual = match asked {
        Some(Residual::Probe { .. }) => probe,
        Some(residual) => residual,
        // Without factors the blocks hold all there is, and only the exact forecast does them justice.
        None if factors == 0 && !has_local_factors => Residual::Exact,
        None => probe,
    };
    if let (Some(field), true, BiasCoupling::Drop) = (section.optional(FACTORS.name), factors > 0, bias_coupling) {
        let message = "bias_coupling = \"drop\" is the printed formula, which has no factors".to_string();
        return Err(field.invalid(message, "must be 0 with bias_coupling = \"drop\""));
    }
    if let (Some(field), false, BiasCoupling::Drop) =
        (section.optional(RESIDUAL.name), residual == Residual::Exact, bias_coupling)
    {
        let message = "bias_coupling = \"drop\" is the printed formula, which forecasts the blocks exactly".to_string();
        return Err(field.invalid(message, "must be \"exact\" with bias_coupling = \"drop\""));
    }
    let (nx, ny) = blocks.cells(&domain.grid);
    let merged_blocks = MERGED_BLOCKS * nx * ny * domain.model.variables().len();
    let filter = FastKalmanSettings {
        blocks,
        bias_coupling,
        factors,
        retained_energy: common.retained_energy,
        factor_precision: section.get(&FACTOR_PRECISION)?,
        residual,
        largest_component: section.find(&LARGEST)?.unwrap_or(LARGEST_COMPONENT.max(merged_blocks)),
        separator_factors: section.get(&SEPARATOR_FACTORS)?,
    };
    Ok(Settings { filter, factors: common })
}

/// The grids on which factors can be propagated, by the cells on a side of theirs.
const FACTOR_GRIDS: [usize; 4] = [1, 2, 4, 8];

/// The fewest cells on a side of a grid of factors.
const FEWEST_CELLS: usize = 4;

/// Reads how many cells wide those are on which the factors are propagated.
fn factor_grid(section: &Section<'_>, grid: &Grid, residual: Residual, has_factors: bool) -> Read<usize> {
    let cells = section.get(&FACTOR_GRID)?;
    if cells == 1 {
        return Ok(cells);
    }
    let field = section.required(FACTOR_GRID.name)?;
    let fits = |n: usize| n.is_multiple_of(cells) && n / cells >= FEWEST_CELLS;
    if !FACTOR_GRIDS.contains(&cells) || !fits(grid.nx) || !fits(grid.ny) {
        let message = format!("cells of {cells} × {cells} do not make a grid of {} × {}", grid.nx, grid.ny);
        return Err(
            field.invalid(message, "must be 1, 2, 4 or 8, divide both sides and leave at least 4 cells on each")
        );
    }
    if residual == Residual::Exact || !has_factors {
        let message = "without factors, or with an exact forecast of the blocks, nothing can be coarser".to_string();
        return Err(field.invalid(message, "needs `factors`, and residual = \"probe\" or \"persist\""));
    }
    Ok(cells)
}

fn blocks(field: &Field<'_>, grid: &Grid) -> Read<BlockShape> {
    if !matches!(field.value.get_ref(), DeValue::Table(_)) {
        return BLOCKS.allowed.read_plain(field);
    }
    let tile = field.section(&[TILE.name])?.required(TILE.name)?;
    let numbers = tile.elements(2)?;
    let [nx, ny] = numbers.as_slice() else {
        return Err(tile.invalid(format!("`{}` needs two numbers", tile.title()), "must be [cells in x, cells in y]"));
    };
    Ok(BlockShape::Tile { nx: nx.whole(1, grid.nx)?, ny: ny.whole(1, grid.ny)? })
}

/// The work of a filter with factors of the whole domain: blocks, those of Q and their roots; Φ with one column for each bias
/// and for probes, twice, and the factors of Q; their tangent-linear forecast, and the products that compress them and take
/// them into an analysis.
pub(super) fn work(Settings { filter, .. }: &Settings, factor_grid: usize, sizes: &Sizes) -> Work {
    let Sizes { values: m, shared_biases: p, observations: n, .. } = *sizes;
    let r = filter.factors as f64;
    let (nx, ny) = filter.blocks.cells(&sizes.grid);
    let block = (nx * ny) as f64 * sizes.variables;
    let (of_blocks, probes) = (m * block, probes(filter.residual));
    let is_exact = filter.residual == Residual::Exact;
    let columns = if is_exact { m } else { r + p + probes };
    let exact = if is_exact { m * m + 2.0 * m * block.min(m) } else { 0.0 };
    let all = 2.0 * r + p + probes;
    let width = width(filter.factor_precision);
    // Blocks that observations link are merged, up to this limit: whether any are is not known here.
    let component = (filter.largest_component as f64).min(m);
    // The factors of Q join those of the state, and all of them are compressed by the products of their columns.
    let compression = m * all * all + 10.0 * all.powi(3);
    let analysis = n * (r + p) * (r + p) + m * (r + p) * (r + p) + of_blocks * (block + r + p);
    Work {
        numbers: 3.0 * of_blocks
            + width * m * (all + r)
            + 6.0 * all * all
            + exact
            + component * component
            + 2.0 * n * (r + p)
            + 4.0 * (r + p).powi(2),
        tangent_steps: columns * sizes.steps / (factor_grid as f64).powi(3),
        multiplications: compression + analysis + if is_exact { 2.0 * m * m * block } else { 0.0 },
        ..Work::forecast(sizes)
    }
}

/// The memory of a number of the factors, in numbers in double precision.
pub(super) fn width(precision: Precision) -> f64 {
    match precision {
        Precision::Double => 1.0,
        Precision::Single => 0.5,
    }
}

/// A filter's settings in words.
pub(super) fn describe(Settings { filter: settings, factors }: &Settings, factor_grid: usize) -> String {
    let blocks = match settings.blocks {
        BlockShape::Cell => "blocks of one cell".to_string(),
        BlockShape::Tile { nx, ny } => format!("blocks of {nx} × {ny} cells"),
        BlockShape::Domain => "one block".to_string(),
    };
    let residual = match settings.residual {
        Residual::Exact => "forecast exactly".to_string(),
        Residual::Persist => "that persist".to_string(),
        Residual::Probe { count } => format!("forecast by {count} probes"),
    };
    let coupling = match settings.bias_coupling {
        BiasCoupling::Carry => "carried",
        BiasCoupling::Drop => "dropped",
    };
    let asked_for = |number: usize| format!(" (B and Q ask for {number})");
    let chosen = factors.asked_for.map_or(String::new(), asked_for);
    let mut factors = match settings.retained_energy {
        retained if retained < 1.0 && settings.factors > 0 => {
            format!(
                "up to {} common factors{chosen}, which hold {} % of their energy",
                settings.factors,
                100.0 * retained
            )
        }
        _ => format!("{} common factors{chosen}", settings.factors),
    };
    factors += &storage(settings.factor_precision, factor_grid);
    format!("{factors}, {blocks} {residual}, covariance with biases {coupling}")
}
