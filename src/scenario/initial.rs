//! `[initial]`: the background at the start.

use super::model::{Dynamics, ModelSettings};
use crate::reader::fields;
use crate::reader::{Field, Kind, Limits, Read, Section};
use crate::text::clean;
use isobar_model::{Boundary, Grid};

/// The state from which every method starts, and the truth at a draw of the background error from it; or that of the truth.
///
/// `mean_depth_m` is that of the model where the model is linear, and else given in the file. Fractions are of the
/// domain's extent, from the west and from the south.
#[derive(Clone, Debug, PartialEq)]
pub enum Initial {
    /// Still water.
    Rest {
        /// Depth \[m\].
        mean_depth_m: f64,
    },
    /// An eastward jet in geostrophic balance.
    Jet {
        /// Mean depth \[m\].
        mean_depth_m: f64,
        /// Speed on the axis \[m/s\].
        speed_m_per_s: f64,
        /// Half width of the jet \[m\].
        width_m: f64,
        /// The axis' y.
        center_y_fraction: f64,
        /// Height of the bump that sets off the jet's instability \[m\].
        perturbation_height_m: f64,
        /// Its half width in both directions; the bump stands in the middle of the jet's axis \[m\].
        perturbation_width_m: f64,
    },
    /// Balanced vortices at random places, of both signs.
    Vortices {
        /// Mean depth \[m\].
        mean_depth_m: f64,
        /// Number of vortices.
        count: usize,
        /// Height of each, positive or negative \[m\].
        height_m: f64,
        /// Radius (standard deviation of the Gaussian) \[m\].
        radius_m: f64,
    },
    /// A random height field with the wind in geostrophic balance.
    RandomBalanced {
        /// Mean depth \[m\].
        mean_depth_m: f64,
        /// Standard deviation of height \[m\].
        sigma_height_m: f64,
        /// Correlation length \[m\].
        length_m: f64,
    },
    /// A Gaussian hill of tracer.
    GaussianHill {
        /// Tracer on the top, above the zero around.
        amplitude: f64,
        /// Standard deviation of the Gaussian \[m\].
        width_m: f64,
        /// The top's x.
        center_x_fraction: f64,
        /// The top's y.
        center_y_fraction: f64,
    },
    /// A cosine wave of tracer.
    CosineWave {
        /// Mean of the tracer.
        mean: f64,
        /// Amplitude.
        amplitude: f64,
        /// Waves along x.
        waves_x: i32,
        /// Waves along y.
        waves_y: i32,
        /// Phase in the south-west corner \[degrees\].
        phase_deg: f64,
    },
    /// The values of a file, `[variable, y, x]`.
    File(Vec<f64>),
}

#[derive(Clone, Copy)]
enum Shape {
    Rest,
    Jet,
    Vortices,
    RandomBalanced,
    GaussianHill,
    CosineWave,
    File,
}

const SHALLOW_WATER: &[Kind<Shape>] = &[
    ("rest", Shape::Rest, &["mean_depth_m"]),
    (
        "jet",
        Shape::Jet,
        &[
            "mean_depth_m",
            "speed_m_per_s",
            "width_km",
            "center_y_fraction",
            "perturbation_height_m",
            "perturbation_width_km",
        ],
    ),
    ("vortices", Shape::Vortices, &["mean_depth_m", "count", "height_m", "radius_km"]),
    ("random_balanced", Shape::RandomBalanced, &["mean_depth_m", "sigma_height_m", "length_km"]),
    ("file", Shape::File, &["file"]),
];

const TRACER: &[Kind<Shape>] = &[
    ("gaussian_hill", Shape::GaussianHill, &["amplitude", "width_km", "center_x_fraction", "center_y_fraction"]),
    ("cosine_wave", Shape::CosineWave, &["mean", "amplitude", "waves_x", "waves_y", "phase_deg"]),
    ("file", Shape::File, &["file"]),
];

/// The most columns of a file of states.
const MOST_COLUMNS: usize = 100;

const FRACTION: Limits = Limits::Between(0.0, 1.0);

/// Reads `[initial]` or `[truth.initial]`: the kinds are those that fit the model.
pub(super) fn read(field: &Field<'_>, model: &ModelSettings, grid: &Grid) -> Read<Initial> {
    let (shape, section) = field.section_of_kind(if model.is_shallow_water() { SHALLOW_WATER } else { TRACER })?;
    if matches!(shape, Shape::Jet | Shape::Vortices | Shape::RandomBalanced) && !model.is_rotating() {
        let kind = section.required("kind")?;
        let message = "a balanced initial state needs rotation, but model.coriolis_per_s is 0".to_string();
        return Err(kind.invalid(message, "must be \"rest\", or model.coriolis_per_s other than 0"));
    }
    let number = |key: &str| section.number(key, Limits::Any);
    let length_m = |key: &str| Ok(section.number(key, Limits::Between(1e-3, 1e5))? * 1e3);
    let fraction = |key: &str| section.number_or(key, 0.5, FRACTION);
    let waves =
        |key: &str, default| section.optional(key).map_or(Ok(default), |field| Ok(field.integer(-2048, 2048)? as i32));
    Ok(match shape {
        Shape::Rest => Initial::Rest { mean_depth_m: mean_depth_m(&section, model)? },
        Shape::Jet => Initial::Jet {
            mean_depth_m: mean_depth_m(&section, model)?,
            speed_m_per_s: section.number("speed_m_per_s", Limits::Between(-300.0, 300.0))?,
            width_m: length_m("width_km")?,
            center_y_fraction: fraction("center_y_fraction")?,
            perturbation_height_m: section.number_or("perturbation_height_m", 0.0, Limits::Any)?,
            perturbation_width_m: length_m(match section.optional("perturbation_width_km") {
                Some(_) => "perturbation_width_km",
                None => "width_km",
            })?,
        },
        Shape::Vortices => Initial::Vortices {
            mean_depth_m: mean_depth_m(&section, model)?,
            count: section.required("count")?.whole(1, 1000)?,
            height_m: number("height_m")?,
            radius_m: length_m("radius_km")?,
        },
        Shape::RandomBalanced => Initial::RandomBalanced {
            mean_depth_m: mean_depth_m(&section, model)?,
            sigma_height_m: section.number("sigma_height_m", Limits::Positive)?,
            length_m: length_m("length_km")?,
        },
        Shape::GaussianHill => Initial::GaussianHill {
            amplitude: number("amplitude")?,
            width_m: length_m("width_km")?,
            center_x_fraction: fraction("center_x_fraction")?,
            center_y_fraction: fraction("center_y_fraction")?,
        },
        Shape::CosineWave => Initial::CosineWave {
            mean: section.number_or("mean", 0.0, Limits::Any)?,
            amplitude: number("amplitude")?,
            waves_x: waves("waves_x", 1)?,
            waves_y: waves("waves_y", 0)?,
            phase_deg: section.number_or("phase_deg", 0.0, Limits::Between(-360.0, 360.0))?,
        },
        Shape::File => Initial::File(values(&section.required("file")?, model, grid)?),
    })
}

/// The mean depth: a linear model has its own, which the file must not contradict.
fn mean_depth_m(section: &Section<'_>, model: &ModelSettings) -> Read<f64> {
    match (&model.dynamics, section.optional("mean_depth_m")) {
        (Dynamics::LinearShallowWater { mean_depth_m, .. }, None) => Ok(*mean_depth_m),
        (Dynamics::LinearShallowWater { .. }, Some(field)) => {
            Err(field.misplaced("the linear model has its own mean_depth_m".into(), "leave it out here"))
        }
        _ => section.number("mean_depth_m", Limits::Positive),
    }
}

/// The state of a file that has a column for each of the model's variables.
fn values(field: &Field<'_>, model: &ModelSettings, grid: &Grid) -> Read<Vec<f64>> {
    let variables = model.variables();
    let fields = fields::read(field, grid, MOST_COLUMNS)?;
    let names = fields.names.unwrap_or_default();
    let mut values = Vec::with_capacity(variables.len() * grid.cells());
    for &(name, _) in variables {
        let mut columns = names.iter().zip(&fields.columns).filter(|(column, _)| column.eq_ignore_ascii_case(name));
        match (columns.next(), columns.next()) {
            (Some((_, column)), None) => values.extend_from_slice(column),
            (found, _) => {
                let count = if found.is_some() { "two columns" } else { "no column" };
                let all: Vec<&str> = variables.iter().map(|variable| variable.0).collect();
                let message = format!("{} has {count} `{name}` in its header", clean(&field.text()?));
                return Err(field.invalid(message, &format!("needs the columns {}", all.join(", "))));
            }
        }
    }
    if model.is_shallow_water() {
        let (h, v) = (&values[..grid.cells()], &values[2 * grid.cells()..]);
        if let Some(cell) = h.iter().position(|depth| *depth <= 0.0) {
            let message = format!("the depth h is {} in row {} of the numbers", h[cell], cell + 1);
            return Err(field.invalid(message, "must be greater than 0 everywhere"));
        }
        if let (Boundary::Channel, Some(cell)) = (grid.boundary, v[..grid.nx].iter().position(|v| *v != 0.0)) {
            let message =
                format!("v is {} in row {} of the numbers, which lies on the southern wall", v[cell], cell + 1);
            return Err(field.invalid(message, "must be 0 in the first nx rows"));
        }
    }
    Ok(values)
}
