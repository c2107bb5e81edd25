//! Whether geostrophic balance means anything where f is small.

use super::ExperimentError;
use crate::scenario::{Dynamics, Initial, ModelSettings, Scenario};
use isobar_model::State;

/// Part of the speed of gravity waves that the standard deviation of balanced winds may have: four of them are then as fast as
/// the waves, and a draw of the errors is a shock.
const LARGEST_FROUDE_NUMBER: f64 = 0.25;

/// A balanced height field: its standard deviation or amplitude and its length \[m\].
struct Balance {
    what: &'static str,
    /// The largest wind over the speed of gravity waves.
    largest: f64,
    height_m: f64,
    length_m: f64,
}

/// Refuses balanced errors and states whose geostrophic wind
///
/// ```text
/// σ_u = g σ_h / (|f| L)
/// ```
///
/// is not small beside the gravity waves' speed √(g h), and balanced covariances where f changes its sign in the domain: their
/// heights are f ψ/g for the same streamfunction ψ everywhere, so that they vanish where f does.
///
/// # Errors
/// [`ExperimentError::Balance`], which names f and σ_u.
pub(super) fn check(scenario: &Scenario, background: &State) -> Result<(), ExperimentError> {
    let (Dynamics::ShallowWater(settings) | Dynamics::LinearShallowWater { settings, .. }) = &scenario.model.dynamics
    else {
        return Ok(());
    };
    let (f, gravity) = (settings.coriolis_per_s, settings.gravity_m_per_s2);
    let components = scenario.background_error.iter().chain(&scenario.model_error);
    let errors: Vec<Balance> = components
        .filter_map(|component| component.balance())
        .map(|it| Balance {
            what: "balanced errors",
            largest: LARGEST_FROUDE_NUMBER,
            height_m: it.sigma_height_m,
            length_m: it.length_m,
        })
        .collect();
    let state = match scenario.initial {
        Initial::Vortices { height_m, radius_m, .. } => {
            Some(Balance { what: "vortices", largest: 1.0, height_m: height_m.abs(), length_m: radius_m })
        }
        Initial::RandomBalanced { sigma_height_m, length_m, .. } => Some(Balance {
            what: "a random balanced state",
            largest: LARGEST_FROUDE_NUMBER,
            height_m: sigma_height_m,
            length_m,
        }),
        _ => None,
    };
    let half_m = 0.5 * scenario.grid.grid.height_m();
    let [south, north] = [-half_m, half_m].map(|y_m| f + settings.beta_per_m_per_s * y_m);
    let wave_speed = (gravity * mean_depth_m(&scenario.model, background)).sqrt();
    let wind = |it: &Balance| gravity * it.height_m / (f.abs() * it.length_m);
    if let Some(balance) = errors.iter().find(|_| south * north <= 0.0) {
        return Err(ExperimentError::Balance(format!(
            "{} need rotation: f runs from {south:.1e} to {north:.1e} s-1 and is 0 within the domain, where their heights \
             vanish; their winds have a standard deviation of {:.3} m/s with f = {f:.1e} s-1 in mid-domain",
            balance.what,
            wind(balance)
        )));
    }
    let too_fast = |it: &&Balance| wind(it) > it.largest * wave_speed;
    match errors.iter().chain(&state).find(too_fast) {
        None => Ok(()),
        Some(balance) => Err(ExperimentError::Balance(format!(
            "{} need rotation: with f = {f:.1e} s-1, heights of {} m over a length of {} km are balanced by winds of \
             {:.3} m/s, which is not small beside gravity waves of {wave_speed:.3} m/s",
            balance.what,
            balance.height_m,
            balance.length_m / 1e3,
            wind(balance)
        ))),
    }
}

/// The depth at rest \[m\].
fn mean_depth_m(model: &ModelSettings, background: &State) -> f64 {
    match (&model.dynamics, background.layout().variable("h")) {
        (&Dynamics::LinearShallowWater { mean_depth_m, .. }, _) => mean_depth_m,
        (_, Some(h)) => background.field(h).mean().unwrap_or(0.0).max(0.0),
        _ => 0.0,
    }
}
