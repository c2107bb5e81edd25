//! What every initial state can do, and what those of shallow water share.

use crate::kinds::Domain;
use crate::reader::{Absent, Key, Limits, Read, Section};
use isobar_model::{Boundary, Layout, ModelError, ShallowWater, State};
use std::fmt::Debug;
use std::sync::Arc;

/// The state from which every method starts, with the truth at a draw of the background error from it; or that of the truth.
pub trait InitialState: Debug + Send + Sync {
    /// The state, of a model on a plane; `seed` is that of the run.
    ///
    /// # Errors
    /// If there is no such state, such as one with a negative depth.
    fn build(&self, domain: &Domain, seed: u64) -> Result<State, ModelError>;

    /// The heights that its winds balance, if they do.
    fn balance(&self) -> Option<BalancedHeights> {
        None
    }
}

/// Heights that geostrophic winds balance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BalancedHeights {
    /// What has them, in words.
    pub what: &'static str,
    /// Amplitude, or standard deviation of a random draw \[m\].
    pub height_m: f64,
    /// Their radius or correlation length \[m\].
    pub length_m: f64,
    /// Whether they are a random draw.
    pub is_random: bool,
}

/// The values of a state that a file has, `[variable, y, x]`.
#[derive(Debug)]
pub(super) struct Values(pub Vec<f64>);

impl InitialState for Values {
    fn build(&self, domain: &Domain, _: u64) -> Result<State, ModelError> {
        Ok(State::from_values(&layout(domain), self.0.clone()))
    }
}

/// The grid and the variables of the model's states.
pub(crate) fn layout(domain: &Domain) -> Arc<Layout> {
    domain.model.equations.layout(&domain.grid)
}

/// Refuses values, `[variable, y, x]`, that are not a state of the model: depths must be positive, and nothing flows through a
/// wall.
///
/// # Errors
/// What is wrong, and what would be right.
pub(super) fn check_values(values: &[f64], domain: &Domain) -> Result<(), (String, &'static str)> {
    let grid = &domain.grid;
    if !domain.model.is_shallow_water() {
        return Ok(());
    }
    let (h, v) = (&values[..grid.cells()], &values[2 * grid.cells()..]);
    if let Some(cell) = h.iter().position(|depth| *depth <= 0.0) {
        let message = format!("the depth h is {} in row {} of the numbers", h[cell], cell + 1);
        return Err((message, "must be greater than 0 everywhere"));
    }
    if let (Boundary::Channel, Some(cell)) = (grid.boundary, v[..grid.nx].iter().position(|v| *v != 0.0)) {
        let message = format!("v is {} in row {} of the numbers, which lies on the southern wall", v[cell], cell + 1);
        return Err((message, "must be 0 in the first nx rows"));
    }
    Ok(())
}

pub(super) const MEAN_DEPTH_M: Key<Limits> = Key::absent(
    "mean_depth_m",
    "m",
    Limits::Positive,
    Absent::Explained("that of the model if it is linear; else it must be given"),
    "mean depth, which a linear model has already",
);

/// A length \[km\].
pub(super) const LENGTH: Limits = Limits::Between(1e-3, 1e5);

/// The middle of the domain unless it is given.
pub(super) const fn fraction(name: &'static str, meaning: &'static str) -> Key<Limits> {
    Key::absent(name, "", Limits::Between(0.0, 1.0), Absent::Means(0.5), meaning)
}

/// The mean depth \[m\]: a linear model has its own, which the file must not contradict.
pub(super) fn mean_depth_m(section: &Section<'_>, domain: &Domain) -> Read<f64> {
    match (domain.model.equations.basic_state(), section.optional(MEAN_DEPTH_M.name)) {
        (Some(basic), None) => Ok(basic.mean_depth_m),
        (Some(_), Some(field)) => {
            Err(field.misplaced("the linear model has its own mean_depth_m".into(), "leave it out here"))
        }
        (None, _) => section.get(&MEAN_DEPTH_M),
    }
}

/// Refuses a state in geostrophic balance where there is no Coriolis force.
pub(super) fn check_rotation(section: &Section<'_>, domain: &Domain) -> Read<()> {
    if domain.model.is_rotating() {
        return Ok(());
    }
    let message = "a balanced initial state needs rotation, but model.coriolis_per_s is 0".to_string();
    let allowed = "must be \"rest\", or model.coriolis_per_s other than 0";
    Err(section.required("kind")?.invalid(message, allowed))
}

/// A state of shallow water: in a model that is linearised about a flow, a deviation from that flow.
pub(super) fn on_water(
    domain: &Domain,
    state: impl FnOnce(&ShallowWater) -> Result<State, ModelError>,
) -> Result<State, ModelError> {
    let equations = &domain.model.equations;
    let water = equations.water().expect("the scenario's reader refuses shallow water for a tracer");
    let mut state = state(&water.tendency(&domain.grid)?)?;
    if let Some(basic) = equations.basic_state() {
        for (name, speed) in [("u", basic.u_m_per_s), ("v", basic.v_m_per_s)] {
            let variable = state.layout().variable(name).expect("shallow water has winds");
            state.field_mut(variable).iter_mut().for_each(|value| *value += speed);
        }
    }
    Ok(state)
}
