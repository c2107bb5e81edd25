//! `[initial]`: the background at the start.

use super::model::{Dynamics, ModelSettings};
use super::reader::{Kind, Limits, Read, Section};

/// The state from which every method starts; the truth starts at a draw of the background error from it.
///
/// `mean_depth_m` is that of the model where the model is linear, and else given in the file. Fractions are of the
/// domain's extent, from the west and from the south.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    },
}

#[derive(Clone, Copy)]
enum Shape {
    Rest,
    Jet,
    Vortices,
    RandomBalanced,
    GaussianHill,
    CosineWave,
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
];

const TRACER: &[Kind<Shape>] = &[
    ("gaussian_hill", Shape::GaussianHill, &["amplitude", "width_km", "center_x_fraction", "center_y_fraction"]),
    ("cosine_wave", Shape::CosineWave, &["mean", "amplitude", "waves_x", "waves_y"]),
];

const FRACTION: Limits = Limits::Between(0.0, 1.0);

/// Reads `[initial]`: the kinds are those that fit the model.
pub(super) fn read(root: &Section<'_>, model: &ModelSettings) -> Read<Initial> {
    let field = root.required("initial")?;
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
        },
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
