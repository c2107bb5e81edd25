//! The shallow-water equations: what the nonlinear and the linear ones share.

use super::integration::{self, Integration, TIME_STEP_S};
use super::parameter::Parameter;
use crate::reader::{Absent, AnyKey, Choice, Key, Limits, Read, Section};
use isobar_model::{Boundary, Grid, ModelError, ShallowWater, ShallowWaterParameters, VectorInvariant};

const GRAVITY: Key<Limits> =
    Key::absent("gravity_m_per_s2", "m/s²", Limits::Positive, Absent::Means(9.80665), "gravity, or a reduced one");

const CORIOLIS: Key<Limits> = Key::required(
    "coriolis_per_s",
    "1/s",
    Limits::Between(-1.0, 1.0),
    "Coriolis parameter at the middle of the domain",
);

const BETA: Key<Limits> = Key::absent(
    "beta_per_m_per_s",
    "1/(m s)",
    Limits::Between(-1e-6, 1e-6),
    Absent::Means(0.0),
    "change of the Coriolis parameter with y; 0 on a periodic domain",
);

const DRAG: Key<Limits> = Key::absent("drag_per_s", "1/s", Limits::NonNegative, Absent::Means(0.0), "linear drag");

const HYPERDIFFUSION: Key<Limits> =
    Key::absent("hyperdiffusion_m4_per_s", "m⁴/s", Limits::NonNegative, Absent::Means(0.0), "biharmonic diffusion");

const CONSERVES: Key<Choice<VectorInvariant>> = Key::absent(
    "conserves",
    "",
    Choice(&[("enstrophy", VectorInvariant::PotentialEnstrophy), ("energy", VectorInvariant::Energy)]),
    Absent::Means(VectorInvariant::PotentialEnstrophy),
    "the invariant that the discretised vorticity term conserves",
);

/// The keys that the nonlinear and the linear equations share, beside those of the integration.
pub(super) const KEYS: &[&dyn AnyKey] = &[&TIME_STEP_S, &GRAVITY, &CORIOLIS, &BETA, &DRAG, &HYPERDIFFUSION, &CONSERVES];

/// The shallow-water equations with their parameters.
#[derive(Clone, Debug)]
pub struct Water {
    /// The parameters.
    pub parameters: ShallowWaterParameters,
    form: VectorInvariant,
    pub(super) integration: Integration,
}

/// Reads what the nonlinear and the linear equations share.
pub(super) fn read(section: &Section<'_>, grid: &Grid) -> Read<Water> {
    let beta_per_m_per_s = section.get(&BETA)?;
    if grid.boundary == Boundary::Periodic && beta_per_m_per_s != 0.0 {
        let message = "the Coriolis parameter cannot change with y where y is periodic".to_string();
        return Err(section.required(BETA.name)?.invalid(message, "must be 0, or grid.boundary = \"channel\""));
    }
    Ok(Water {
        parameters: ShallowWaterParameters {
            gravity_m_per_s2: section.get(&GRAVITY)?,
            coriolis_per_s: section.get(&CORIOLIS)?,
            beta_per_m_per_s,
            drag_per_s: section.get(&DRAG)?,
            hyperdiffusion_m4_per_s: section.get(&HYPERDIFFUSION)?,
        },
        form: section.get(&CONSERVES)?,
        integration: integration::read(section)?,
    })
}

impl Water {
    /// The nonlinear equations on a grid.
    ///
    /// # Errors
    /// If grid and parameters do not fit.
    pub fn tendency(&self, grid: &Grid) -> Result<ShallowWater, ModelError> {
        ShallowWater::new(grid.clone(), self.parameters, self.form)
    }

    /// The parameters that an assimilation may correct.
    pub(super) fn parameters_mut(&mut self) -> Vec<(Parameter, &mut f64)> {
        let own = &mut self.parameters;
        vec![
            (Parameter { name: GRAVITY.name, unit: "m s-2", step: 0.01 }, &mut own.gravity_m_per_s2),
            (Parameter { name: DRAG.name, unit: "s-1", step: 1e-7 }, &mut own.drag_per_s),
            (Parameter { name: CORIOLIS.name, unit: "s-1", step: 1e-7 }, &mut own.coriolis_per_s),
        ]
    }
}

/// The variables of shallow water.
pub(super) const VARIABLES: &[(&str, &str)] = &[("h", "m"), ("u", "m s-1"), ("v", "m s-1")];
