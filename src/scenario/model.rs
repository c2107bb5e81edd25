//! `[model]`: the equations and their time step.

use crate::reader::{Field, Limits, Read, Section};
use isobar_model::{Boundary, Duration, Grid};
use toml::de::{DeTable, DeValue};

/// The forecast model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelSettings {
    /// The time step.
    pub time_step: Duration,
    /// The equations.
    pub dynamics: Dynamics,
}

/// The equations of a model.
#[derive(Clone, Debug, PartialEq)]
pub enum Dynamics {
    /// The nonlinear rotating shallow-water equations for h, u and v.
    ShallowWater(ShallowWaterSettings),
    /// The same, linearised at a uniform depth and flow.
    LinearShallowWater {
        /// What both have in common.
        settings: ShallowWaterSettings,
        /// Depth at which the equations are linearised \[m\].
        mean_depth_m: f64,
        /// Eastward flow at which the equations are linearised \[m/s\].
        mean_flow_m_per_s: f64,
        /// Northward flow at which they are linearised \[m/s\].
        mean_flow_y_m_per_s: f64,
    },
    /// Advection of a tracer by a given wind.
    Advection {
        /// The wind.
        wind: Wind,
        /// How it is discretised in space.
        scheme: AdvectionScheme,
        /// How it is integrated in time.
        time_scheme: TimeScheme,
    },
    /// A tracer that moves by a whole number of cells each step: the model without any numerical error.
    ExactShift {
        /// Cells eastward per step.
        columns_per_step: i64,
        /// Cells northward per step.
        rows_per_step: i64,
    },
}

/// The parameters of the shallow-water equations.
#[derive(Clone, Debug, PartialEq)]
pub struct ShallowWaterSettings {
    /// Gravity g, or a reduced one \[m/s²\].
    pub gravity_m_per_s2: f64,
    /// Coriolis parameter f at the middle of the domain \[1/s\].
    pub coriolis_per_s: f64,
    /// Its change with y \[1/(m s)\].
    pub beta_per_m_per_s: f64,
    /// Linear drag \[1/s\].
    pub drag_per_s: f64,
    /// Biharmonic diffusion \[m⁴/s\].
    pub hyperdiffusion_m4_per_s: f64,
    /// Which invariant the discretised vorticity term conserves.
    pub conserves: Conserved,
    /// How the equations are integrated in time.
    pub time_scheme: TimeScheme,
}

/// What the discretised vorticity term of shallow water conserves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Conserved {
    /// Potential enstrophy.
    Enstrophy,
    /// Energy.
    Energy,
}

/// How advection is discretised in space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdvectionScheme {
    /// First order: damping, monotone.
    FirstOrderUpwind,
    /// Third order, biased upwind.
    ThirdOrderUpwind,
    /// Fourth order, centred: no damping.
    FourthOrderCentred,
}

/// How a model is integrated in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeScheme {
    /// The classical Runge–Kutta scheme of fourth order.
    RungeKutta4,
    /// The strong-stability-preserving Runge–Kutta scheme of third order.
    SspRungeKutta3,
    /// Leapfrog, begun anew with an Euler step in every cycle.
    Leapfrog {
        /// α of Robert's filter.
        robert_filter: f64,
    },
}

/// The wind of an advection model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wind {
    /// The same everywhere.
    Uniform {
        /// Eastward component \[m/s\].
        u_m_per_s: f64,
        /// Northward component \[m/s\].
        v_m_per_s: f64,
    },
    /// A vortex about the middle of the domain, at rest at its edges; clockwise if positive.
    Vortex {
        /// The largest eastward wind \[m/s\].
        speed_m_per_s: f64,
    },
}

#[derive(Clone, Copy)]
enum Kind {
    ShallowWater,
    Linear,
    Advection,
    ExactShift,
}

macro_rules! shallow_water_keys {
    ($($more:literal),*) => {
        &["time_step_s", "gravity_m_per_s2", "coriolis_per_s", "beta_per_m_per_s", "drag_per_s",
            "hyperdiffusion_m4_per_s",
            "conserves", "time_scheme", "robert_filter", $($more),*]
    };
}

const KINDS: &[crate::reader::Kind<Kind>] = &[
    ("shallow_water", Kind::ShallowWater, shallow_water_keys!()),
    (
        "linear_shallow_water",
        Kind::Linear,
        shallow_water_keys!("mean_depth_m", "mean_flow_m_per_s", "mean_flow_y_m_per_s"),
    ),
    ("advection", Kind::Advection, &["time_step_s", "wind", "scheme", "time_scheme", "robert_filter"]),
    ("exact_shift", Kind::ExactShift, &["time_step_s", "columns_per_step", "rows_per_step"]),
];

impl ModelSettings {
    /// The prognostic variables: name and unit, in the order in which a state holds them.
    pub fn variables(&self) -> &'static [(&'static str, &'static str)] {
        match self.dynamics {
            Dynamics::ShallowWater(_) | Dynamics::LinearShallowWater { .. } => {
                &[("h", "m"), ("u", "m/s"), ("v", "m/s")]
            }
            Dynamics::Advection { .. } | Dynamics::ExactShift { .. } => &[("tracer", "1")],
        }
    }

    /// Whether the model has a height that winds can balance.
    pub fn is_shallow_water(&self) -> bool {
        matches!(self.dynamics, Dynamics::ShallowWater(_) | Dynamics::LinearShallowWater { .. })
    }

    /// Whether there is a Coriolis force, without which nothing is in balance.
    pub fn is_rotating(&self) -> bool {
        match &self.dynamics {
            Dynamics::ShallowWater(settings) | Dynamics::LinearShallowWater { settings, .. } => {
                settings.coriolis_per_s != 0.0
            }
            _ => false,
        }
    }
}

/// Whether the file asks for exact shifts, the only model that needs no neighbours and may have a ring of points for its grid.
pub(super) fn is_exact_shift(root: &Section<'_>) -> bool {
    let kind = root.optional("model").and_then(|field| field.any_section().ok()?.optional("kind"));
    kind.is_some_and(|kind| kind.value.get_ref().as_str() == Some("exact_shift"))
}

/// Reads `[model]`.
pub(super) fn read(field: &Field<'_>, grid: &Grid) -> Read<ModelSettings> {
    let (kind, section) = field.section_of_kind(KINDS)?;
    let time_step = Duration::from_seconds(section.required("time_step_s")?.integer(1, 86_400)?);
    let dynamics = match kind {
        Kind::ShallowWater => Dynamics::ShallowWater(shallow_water(&section, grid)?),
        Kind::Linear => Dynamics::LinearShallowWater {
            settings: shallow_water(&section, grid)?,
            mean_depth_m: section.number("mean_depth_m", Limits::Positive)?,
            mean_flow_m_per_s: section.number_or("mean_flow_m_per_s", 0.0, Limits::Between(-300.0, 300.0))?,
            mean_flow_y_m_per_s: northward(&section, "mean_flow_y_m_per_s", grid)?,
        },
        Kind::Advection => Dynamics::Advection {
            wind: wind(&section, grid)?,
            scheme: section
                .optional("scheme")
                .map_or(Ok(AdvectionScheme::ThirdOrderUpwind), |field| field.choice(ADVECTION_SCHEMES))?,
            time_scheme: time_scheme(&section)?,
        },
        Kind::ExactShift => {
            if grid.boundary == Boundary::Channel {
                let message = "exact shifts need a doubly periodic domain, but grid.boundary is \"channel\"";
                return Err(section.required("kind")?.invalid(message.into(), "needs grid.boundary = \"periodic\""));
            }
            let columns_per_step = section.required("columns_per_step")?.integer(-4096, 4096)?;
            let rows_per_step = section.optional("rows_per_step").map_or(Ok(0), |rows| rows.integer(-4096, 4096))?;
            Dynamics::ExactShift { columns_per_step, rows_per_step }
        }
    };
    Ok(ModelSettings { time_step, dynamics })
}

/// The truth's model: `[model]` with single keys replaced by those of `overrides`.
pub(super) fn read_with_overrides(model: &Field<'_>, overrides: &Field<'_>, grid: &Grid) -> Read<ModelSettings> {
    let (DeValue::Table(table), DeValue::Table(changes)) = (model.value.get_ref(), overrides.value.get_ref()) else {
        overrides.any_section()?;
        return read(model, grid);
    };
    for (key, field) in overrides.any_section()?.fields() {
        if key == "kind" {
            let help = "truth.model replaces single keys of [model]; leave `kind` out";
            return Err(field.misplaced("the truth must be of the model's kind".into(), help));
        }
    }
    let mut merged: DeTable<'_> = table.clone();
    for (key, value) in changes {
        // The key is removed first, so that messages point at the overriding one.
        merged.remove(key.get_ref().as_ref());
        merged.insert(key.clone(), value.clone());
    }
    let value = toml::Spanned::new(overrides.value.span(), DeValue::Table(merged));
    read(
        &Field {
            file: overrides.file,
            name: overrides.name.clone(),
            key_span: overrides.key_span.clone(),
            value: &value,
        },
        grid,
    )
}

fn shallow_water(section: &Section<'_>, grid: &Grid) -> Read<ShallowWaterSettings> {
    const CONSERVED: &[(&str, Conserved)] = &[("enstrophy", Conserved::Enstrophy), ("energy", Conserved::Energy)];
    let beta_per_m_per_s = section.number_or("beta_per_m_per_s", 0.0, Limits::Between(-1e-6, 1e-6))?;
    if let (Some(beta), Boundary::Periodic, true) =
        (section.optional("beta_per_m_per_s"), grid.boundary, beta_per_m_per_s != 0.0)
    {
        let message = "the Coriolis parameter cannot change with y where y is periodic".to_string();
        return Err(beta.invalid(message, "must be 0, or grid.boundary = \"channel\""));
    }
    Ok(ShallowWaterSettings {
        gravity_m_per_s2: section.number_or("gravity_m_per_s2", 9.80665, Limits::Positive)?,
        coriolis_per_s: section.number("coriolis_per_s", Limits::Between(-1.0, 1.0))?,
        beta_per_m_per_s,
        drag_per_s: section.number_or("drag_per_s", 0.0, Limits::NonNegative)?,
        hyperdiffusion_m4_per_s: section.number_or("hyperdiffusion_m4_per_s", 0.0, Limits::NonNegative)?,
        conserves: section.optional("conserves").map_or(Ok(Conserved::Enstrophy), |field| field.choice(CONSERVED))?,
        time_scheme: time_scheme(section)?,
    })
}

const ADVECTION_SCHEMES: &[(&str, AdvectionScheme)] = &[
    ("first_order_upwind", AdvectionScheme::FirstOrderUpwind),
    ("third_order_upwind", AdvectionScheme::ThirdOrderUpwind),
    ("fourth_order_centred", AdvectionScheme::FourthOrderCentred),
];

fn time_scheme(section: &Section<'_>) -> Read<TimeScheme> {
    let robert_filter = section.number_or("robert_filter", 0.01, Limits::Between(0.0, 0.5))?;
    let schemes = [
        ("rk4", TimeScheme::RungeKutta4),
        ("ssp_rk3", TimeScheme::SspRungeKutta3),
        ("leapfrog", TimeScheme::Leapfrog { robert_filter }),
    ];
    let scheme = section.optional("time_scheme").map_or(Ok(TimeScheme::RungeKutta4), |field| field.choice(&schemes))?;
    match (section.optional("robert_filter"), scheme) {
        (Some(field), TimeScheme::RungeKutta4 | TimeScheme::SspRungeKutta3) => {
            Err(field
                .misplaced("only leapfrog has this filter".into(), "add time_scheme = \"leapfrog\", or leave it out"))
        }
        _ => Ok(scheme),
    }
}

fn wind(section: &Section<'_>, grid: &Grid) -> Read<Wind> {
    const KINDS: &[crate::reader::Kind<bool>] =
        &[("uniform", false, &["u_m_per_s", "v_m_per_s"]), ("vortex", true, &["speed_m_per_s"])];
    let (vortex, section) = section.required("wind")?.section_of_kind(KINDS)?;
    if vortex {
        return Ok(Wind::Vortex { speed_m_per_s: section.number("speed_m_per_s", SPEED)? });
    }
    let v_m_per_s = northward(&section, "v_m_per_s", grid)?;
    Ok(Wind::Uniform { u_m_per_s: section.number("u_m_per_s", SPEED)?, v_m_per_s })
}

const SPEED: Limits = Limits::Between(-300.0, 300.0);

/// A uniform northward wind, if any.
fn northward(section: &Section<'_>, key: &str, grid: &Grid) -> Read<f64> {
    let field = section.optional(key);
    let speed = field.as_ref().map_or(Ok(0.0), |field| field.number(SPEED))?;
    if let (Some(field), Boundary::Channel, true) = (field, grid.boundary, speed != 0.0) {
        let message = "a uniform wind cannot blow through the walls of a channel".to_string();
        return Err(field.invalid(message, "must be 0, or grid.boundary = \"periodic\""));
    }
    Ok(speed)
}
