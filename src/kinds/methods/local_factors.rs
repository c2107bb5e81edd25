//! `local_factors`: factors of tiles instead of the whole domain, in a Fast Kalman Filter.

use super::common_factors::{CommonFactors, FACTORS, storage};
use super::work::probes;
use super::{Sizes, Surroundings, Work};
use crate::reader::{Absent, AnyKey, Choice, Key, Limits, Read, Section, Table, Whole};
use isobar_assim::fast_kalman::{FastKalmanSettings, Residual};
use isobar_assim::local_factors::{LeftOver, LocalFactorSettings};

/// The width of a tile in correlation lengths of the model error, unless the scenario gives it.
const TILE_LENGTHS: f64 = 2.0;

/// Factors of each tile, and how many of them are mixed, with a linear model and with any other.
const LINEAR: (usize, usize) = (8, 0);
const NONLINEAR: (usize, usize) = (12, 2);

/// The width of the support of factors in tiles: a margin of 1.5 tiles, 3 lengths, on either side of a tile.
const SUPPORT_TILES: usize = 4;

pub(super) const LOCAL_FACTORS: Key<Table> = Key::absent(
    "local_factors",
    "",
    Table(KEYS),
    Absent::Explained("factors of the whole domain"),
    "common factors of tiles, whose number does not grow with the domain; in place of `factors`",
);

const KEYS: &[&dyn AnyKey] = &[&PER_TILE, &TILE_KM, &SUPPORT_KM, &MODEL_ERROR_PER_TILE, &MIXED, &LEFT_OVER];

const PER_TILE: Key<Whole> =
    Key::absent("per_tile", "", Whole(1, 1000), Absent::Means(8), "factors of each tile; 12 for a nonlinear model");

const TILE_KM: Key<Limits> = Key::absent(
    "tile_km",
    "km",
    Limits::Between(1e-3, 1e6),
    Absent::Explained("twice the shortest correlation length of the model error"),
    "width of a tile",
);

const SUPPORT_KM: Key<Limits> = Key::absent(
    "support_km",
    "km",
    Limits::Between(1e-3, 1e6),
    Absent::Explained("four tiles"),
    "width of the square about a tile beyond which its factors are cut off: what errors travel in a cycle must stay in it",
);

const MODEL_ERROR_PER_TILE: Key<Whole> = Key::absent(
    "model_error_per_tile",
    "",
    Whole(1, 1000),
    Absent::Explained("twice `per_tile`"),
    "directions of the model error that join the factors of each tile in a forecast",
);

const MIXED: Key<Whole> = Key::absent(
    "mixed",
    "",
    Whole(0, 999),
    Absent::Means(0),
    "factors of each tile that are random sums of what a compression leaves over; 2 for a nonlinear model",
);

const LEFT_OVER: Key<Choice<LeftOver>> = Key::absent(
    "left_over",
    "",
    Choice(&[("factors", LeftOver::Factors), ("blocks", LeftOver::Blocks)]),
    Absent::Means(LeftOver::Factors),
    "where the variance goes that a compression leaves over: to the factors that are kept, or to the blocks, as if it had no \
     correlations",
);

/// Keys that belong to factors of the whole domain.
const OF_WHOLE_DOMAIN: [&str; 2] = ["bias_coupling", "separator_factors"];

/// The settings of local factors, if the method has any, and of its blocks.
pub(super) fn read(
    section: &Section<'_>,
    surroundings: &Surroundings,
    filter: &FastKalmanSettings,
    factors: CommonFactors,
) -> Read<Option<LocalFactorSettings>> {
    let mut of_whole_domain = OF_WHOLE_DOMAIN.iter().filter_map(|key| section.optional(key));
    let Some(field) = section.optional(LOCAL_FACTORS.name) else {
        let may_be_local = of_whole_domain.next().is_none() && filter.residual != Residual::Exact;
        return Ok(in_place_of(factors, surroundings, filter).filter(|_| may_be_local));
    };
    if let Some(excluded) = section.optional(FACTORS.name).into_iter().chain(of_whole_domain).next() {
        let message =
            format!("`{}` belongs to factors of the whole domain, and this method has local ones", excluded.title());
        return Err(excluded.misplaced(message, "leave out this key or `local_factors`"));
    }
    if let (Some(field), Residual::Exact) = (section.optional("residual"), filter.residual) {
        let message = "local factors leave a residual that no exact forecast is worth".to_string();
        return Err(field.invalid(message, "must be \"probe\" or \"persist\" with `local_factors`"));
    }
    let own = field.section_with(KEYS)?;
    let per_tile = own.get(&PER_TILE)?;
    let tile_m = match (own.find(&TILE_KM)?, surroundings.error_length_m) {
        (Some(tile_km), _) => tile_km * 1e3,
        (None, Some(length_m)) => TILE_LENGTHS * length_m,
        (None, None) => {
            let message = "no correlation length says how wide a tile should be".to_string();
            return Err(field.invalid(message, "needs `tile_km`"));
        }
    };
    let support_tiles = match own.find(&SUPPORT_KM)? {
        Some(support_km) if support_km * 1e3 < tile_m => {
            let message = format!("a support of {support_km} km is narrower than a tile, {} km", tile_m / 1e3);
            return Err(own.required(SUPPORT_KM.name)?.invalid(message, "must be at least as wide as a tile"));
        }
        Some(support_km) => (support_km * 1e3 / tile_m).round() as usize,
        None => SUPPORT_TILES,
    };
    let mixed = own.get(&MIXED)?;
    if mixed >= per_tile {
        let message = format!("{mixed} of {per_tile} factors of a tile cannot be sums of what is left over");
        return Err(own.required(MIXED.name)?.invalid(message, "must be less than `per_tile`"));
    }
    Ok(Some(LocalFactorSettings {
        blocks: filter.blocks,
        per_tile,
        model_error_per_tile: own.find(&MODEL_ERROR_PER_TILE)?.unwrap_or(2 * per_tile),
        tile_m,
        support_tiles,
        mixed,
        left_over: own.get(&LEFT_OVER)?,
        factor_precision: filter.factor_precision,
        largest_component: filter.largest_component,
        residual: filter.residual,
    }))
}

/// As many factors of the whole domain as this are never replaced by local ones.
const FEW: usize = 175;

/// Local factors in place of as many for the whole domain as the spectra of B and Q ask for, where these are many, the columns
/// that the tangent-linear model propagates are fewer, and what travels fastest stays in the supports for a cycle: what leaves
/// them is lost.
fn in_place_of(
    factors: CommonFactors,
    surroundings: &Surroundings,
    filter: &FastKalmanSettings,
) -> Option<LocalFactorSettings> {
    let asked_for = factors.asked_for.filter(|number| *number > FEW)?;
    let length_m = surroundings.error_length_m?;
    let (per_tile, mixed) = if surroundings.domain.model.equations.is_linear() { LINEAR } else { NONLINEAR };
    let settings = LocalFactorSettings {
        blocks: filter.blocks,
        per_tile,
        model_error_per_tile: 2 * per_tile,
        tile_m: TILE_LENGTHS * length_m,
        support_tiles: SUPPORT_TILES,
        mixed,
        left_over: LeftOver::Factors,
        factor_precision: filter.factor_precision,
        largest_component: filter.largest_component,
        residual: filter.residual,
    };
    let margin_m = 0.5 * SUPPORT_TILES as f64 * settings.tile_m - length_m;
    let fits = settings.packed_columns(&surroundings.domain.grid) < asked_for && margin_m >= reach_m(surroundings);
    fits.then_some(settings)
}

/// How far anything travels in a cycle \[m\]; what cannot be built is refused by the run, in its own words.
fn reach_m(surroundings: &Surroundings) -> f64 {
    let Surroundings { domain, initial, cycle, .. } = surroundings;
    let fastest = |state| domain.model.equations.fastest_m_per_s(&domain.grid, &state);
    initial.build(domain, 0).map_or(0.0, fastest) * cycle.seconds() as f64
}

/// The work of a filter with factors of tiles: the factors with those of Q on their supports, three times, the packed columns,
/// the blocks and the border; the packed columns go through the tangent-linear model, and each support is compressed.
pub(super) fn work(settings: &LocalFactorSettings, sizes: &Sizes) -> Work {
    let Sizes { values: m, shared_biases: p, .. } = *sizes;
    let packed = settings.packed_columns(&sizes.grid) as f64;
    let tiles = (sizes.grid.width_m() / settings.tile_m).ceil() * (sizes.grid.height_m() / settings.tile_m).ceil();
    let support = (m / tiles * (settings.support_tiles as f64).powi(2)).min(m);
    let columns = (settings.per_tile + settings.model_error_per_tile) as f64;
    let held = tiles * support;
    let probes = probes(settings.residual);
    Work {
        numbers: held * (3.0 * columns + 2.0) + m * (packed + 3.0 * p + 9.0 * sizes.variables),
        tangent_steps: (packed + p + probes) * sizes.steps,
        multiplications: held * columns * (4.0 * columns + p) + sizes.observations * (columns + p).powi(2),
        ..Work::forecast(sizes)
    }
}

/// The settings in words; `factors` are those of the whole domain in whose place they are, and `factor_grid` as many cells on a
/// side as those are wide on which they are propagated.
pub(super) fn describe(settings: &LocalFactorSettings, factors: CommonFactors, factor_grid: usize) -> String {
    let LocalFactorSettings { per_tile, tile_m, support_tiles, mixed, left_over, .. } = settings;
    let mut words =
        format!("{per_tile} factors on each tile of {} km, cut off beyond {support_tiles} tiles", tile_m / 1e3);
    if *mixed > 0 {
        words += &format!(", {mixed} of them mixed");
    }
    if *left_over == LeftOver::Blocks {
        words += ", what they leave over in the blocks";
    }
    words += &storage(settings.factor_precision, factor_grid);
    if let Some(number) = factors.asked_for {
        words += &format!(", in place of {number} for the whole domain that B and Q ask for");
    }
    words
}
