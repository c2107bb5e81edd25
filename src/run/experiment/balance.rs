//! Whether geostrophic balance means anything where f is small.

use super::ExperimentError;
use crate::kinds::initial::BalancedHeights;
use crate::kinds::models::Model;
use crate::scenario::Scenario;
use isobar_model::State;

/// Part of the speed of gravity waves that the standard deviation of balanced winds may have: four of them are then as fast as
/// the waves, and a draw of the errors is a shock.
const LARGEST_FROUDE_NUMBER: f64 = 0.25;

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
    let Some(water) = scenario.model.equations.water() else { return Ok(()) };
    let (f, gravity) = (water.parameters.coriolis_per_s, water.parameters.gravity_m_per_s2);
    let components = scenario.background_error.iter().chain(&scenario.model_error);
    let errors: Vec<BalancedHeights> = components
        .filter_map(|component| component.balance())
        .map(|it| BalancedHeights {
            what: "balanced errors",
            height_m: it.sigma_height_m,
            length_m: it.length_m,
            is_random: true,
        })
        .collect();
    let state = scenario.initial.balance();
    let half_m = 0.5 * scenario.grid.grid.height_m();
    let [south, north] = [-half_m, half_m].map(|y_m| f + water.parameters.beta_per_m_per_s * y_m);
    let wave_speed = (gravity * mean_depth_m(&scenario.model, background)).sqrt();
    let wind = |it: &BalancedHeights| gravity * it.height_m / (f.abs() * it.length_m);
    if let Some(balance) = errors.iter().find(|_| south * north <= 0.0) {
        return Err(ExperimentError::Balance(format!(
            "{} need rotation: f runs from {south:.1e} to {north:.1e} s-1 and is 0 within the domain, where their heights \
             vanish; their winds have a standard deviation of {:.3} m/s with f = {f:.1e} s-1 in mid-domain",
            balance.what,
            wind(balance)
        )));
    }
    let too_fast =
        |it: &&BalancedHeights| wind(it) > if it.is_random { LARGEST_FROUDE_NUMBER * wave_speed } else { wave_speed };
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
fn mean_depth_m(model: &Model, background: &State) -> f64 {
    match (model.equations.basic_state(), background.layout().variable("h")) {
        (Some(basic), _) => basic.mean_depth_m,
        (None, Some(h)) => background.field(h).mean().unwrap_or(0.0).max(0.0),
        (None, None) => 0.0,
    }
}
