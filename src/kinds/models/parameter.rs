//! Parameters of models that an assimilation may correct, and the flows among them.

use crate::reader::{Absent, Key, Limits, Read, Section};
use isobar_model::{Boundary, Grid};

/// A uniform state about which equations are linearised.
#[derive(Clone, Copy, Debug)]
pub struct BasicState {
    /// Depth \[m\].
    pub mean_depth_m: f64,
    /// Eastward flow \[m/s\].
    pub u_m_per_s: f64,
    /// Northward flow \[m/s\].
    pub v_m_per_s: f64,
}

/// A parameter of a model that an assimilation may correct.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Its name, with the unit.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// A change that is small for any atmosphere, and large against the rounding of a forecast.
    pub step: f64,
}

pub(super) const ADVECTION_X: Parameter = Parameter { name: "advection_x_m_per_s", unit: "m s-1", step: 0.1 };
pub(super) const ADVECTION_Y: Parameter = Parameter { name: "advection_y_m_per_s", unit: "m s-1", step: 0.1 };

/// The components of a uniform flow as parameters; walls admit no northward one.
pub(super) fn flow<'a>(u_m_per_s: &'a mut f64, v_m_per_s: &'a mut f64, grid: &Grid) -> Vec<(Parameter, &'a mut f64)> {
    let mut parameters = vec![(ADVECTION_X, u_m_per_s)];
    if grid.boundary == Boundary::Periodic {
        parameters.push((ADVECTION_Y, v_m_per_s));
    }
    parameters
}

pub(super) const SPEED: Limits = Limits::Between(-300.0, 300.0);

/// A uniform northward flow \[m/s\], which must be 0 where walls stand in its way.
pub(super) fn northward(section: &Section<'_>, key: &Key<Limits>, grid: &Grid) -> Read<f64> {
    let speed = section.get(key)?;
    if grid.boundary == Boundary::Channel && speed != 0.0 {
        let message = "a uniform wind cannot blow through the walls of a channel".to_string();
        return Err(section.required(key.name)?.invalid(message, "must be 0, or grid.boundary = \"periodic\""));
    }
    Ok(speed)
}

/// A speed \[m/s\] that is 0 if it is not given.
pub(super) const fn speed_or_zero(name: &'static str, meaning: &'static str) -> Key<Limits> {
    Key::absent(name, "m/s", SPEED, Absent::Means(0.0), meaning)
}
