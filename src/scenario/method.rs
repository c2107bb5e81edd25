//! `[methods.NAME]`: the data-assimilation methods that run side by side.

use super::expected::TOLERANCE_KEY;
use super::network::check_name;
use super::reader::{Field, Kind, Limits, Read, Section};
use indexmap::IndexMap;
use isobar_assim::BiasTreatment;
use isobar_model::Grid;
use toml::de::DeValue;

/// A method with its settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Method {
    /// How it treats the observations' biases.
    pub bias: BiasTreatment,
    /// What it does.
    pub algorithm: Algorithm,
}

/// What a method does.
#[derive(Clone, Debug, PartialEq)]
pub enum Algorithm {
    /// A forecast that never sees an observation.
    Free,
    /// Three-dimensional variational assimilation.
    ThreeDVar {
        /// Factor on the variance of `[background_error]`.
        covariance_scale: f64,
        /// Most iterations of the minimiser.
        max_iterations: usize,
        /// Relative decrease of the gradient's norm at which the minimiser stops.
        tolerance: f64,
    },
    /// The full Kalman filter (extended, for a nonlinear model).
    Kalman {
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
    /// Lange's Fast Kalman Filter.
    FastKalman {
        /// Into which blocks the state is divided.
        blocks: Blocks,
        /// What becomes of the covariance of state and bias parameters between cycles.
        bias_coupling: BiasCoupling,
        /// Memory that it may use.
        memory_limit_bytes: u64,
    },
}

/// The blocks of the Fast Kalman Filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blocks {
    /// One block for each cell.
    Cell,
    /// One block for the whole domain.
    Domain,
    /// One block for each tile.
    Tile {
        /// Cells of a tile in x.
        nx: usize,
        /// Cells of a tile in y.
        ny: usize,
    },
}

/// What becomes of the forecast's covariance between state and bias parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BiasCoupling {
    /// It is carried from cycle to cycle.
    Carry,
    /// It is dropped.
    Drop,
}

#[derive(Clone, Copy)]
enum Which {
    Free,
    ThreeDVar,
    Kalman,
    FastKalman,
}

const KINDS: &[Kind<Which>] = &[
    ("free", Which::Free, &[]),
    ("3dvar", Which::ThreeDVar, &["bias", "covariance_scale", "max_iterations", "tolerance"]),
    ("kf", Which::Kalman, &["bias", "memory_limit_gb"]),
    ("fkf", Which::FastKalman, &["bias", "blocks", "bias_coupling", "memory_limit_gb"]),
];

/// Reads `[methods]`, in the order of the file.
pub(super) fn read(root: &Section<'_>, grid: &Grid) -> Read<IndexMap<String, Method>> {
    let mut methods: IndexMap<String, Method> = IndexMap::new();
    let field = root.required("methods")?;
    for (name, field) in field.any_section()?.fields() {
        check_name(name, &field, "method")?;
        if name == TOLERANCE_KEY {
            return Err(
                field.misplaced(format!("a method cannot be called {name}"), "[expected] has a key of that name")
            );
        }
        // Their files would be one and the same on a file system that does not distinguish case.
        if let Some(other) = methods.keys().find(|other| other.eq_ignore_ascii_case(name)) {
            let message = format!("the methods `{other}` and `{name}` differ in case only");
            return Err(field.misplaced(message, "choose another name"));
        }
        methods.insert(name.to_string(), method(&field, grid)?);
    }
    if methods.is_empty() {
        return Err(field.misplaced("[methods] is empty".into(), "add a table such as [methods.fkf]"));
    }
    Ok(methods)
}

fn method(field: &Field<'_>, grid: &Grid) -> Read<Method> {
    const TREATMENTS: &[(&str, BiasTreatment)] =
        &[("estimate", BiasTreatment::Estimate), ("ignore", BiasTreatment::Ignore), ("known", BiasTreatment::Known)];
    let (which, section) = field.section_of_kind(KINDS)?;
    let default = if matches!(which, Which::Free) { BiasTreatment::Ignore } else { BiasTreatment::Estimate };
    let bias = section.optional("bias").map_or(Ok(default), |field| field.choice(TREATMENTS))?;
    let memory_limit_bytes =
        || Ok((section.number_or("memory_limit_gb", 2.0, Limits::Between(0.001, 10_000.0))? * 1e9) as u64);
    let algorithm = match which {
        Which::Free => Algorithm::Free,
        Which::ThreeDVar => Algorithm::ThreeDVar {
            covariance_scale: section.number_or("covariance_scale", 1.0, Limits::Positive)?,
            max_iterations: section.whole_or("max_iterations", 100, 1, 100_000)?,
            tolerance: section.number_or("tolerance", 1e-6, Limits::Between(1e-15, 0.5))?,
        },
        Which::Kalman => Algorithm::Kalman { memory_limit_bytes: memory_limit_bytes()? },
        Which::FastKalman => Algorithm::FastKalman {
            blocks: section.optional("blocks").map_or(Ok(Blocks::Cell), |field| blocks(&field, grid))?,
            bias_coupling: section.optional("bias_coupling").map_or(Ok(BiasCoupling::Carry), |field| {
                field.choice(&[("carry", BiasCoupling::Carry), ("drop", BiasCoupling::Drop)])
            })?,
            memory_limit_bytes: memory_limit_bytes()?,
        },
    };
    Ok(Method { bias, algorithm })
}

fn blocks(field: &Field<'_>, grid: &Grid) -> Read<Blocks> {
    if !matches!(field.value.get_ref(), DeValue::Table(_)) {
        return field.choice(&[("cell", Blocks::Cell), ("domain", Blocks::Domain)]);
    }
    let tile = field.section(&["tile"])?.required("tile")?;
    let numbers = tile.elements(2)?;
    let [nx, ny] = numbers.as_slice() else {
        return Err(tile.invalid(format!("`{}` needs two numbers", tile.title()), "must be [cells in x, cells in y]"));
    };
    Ok(Blocks::Tile { nx: nx.whole(1, grid.nx)?, ny: ny.whole(1, grid.ny)? })
}
