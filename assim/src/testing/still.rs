//! A model for tests in which nothing must move.

use isobar_model::{Duration, Layout, Model, State, TangentLinear};
use std::sync::Arc;

/// A model that does nothing, in steps of a minute.
pub struct Still(pub Arc<Layout>);

impl Model for Still {
    fn layout(&self) -> &Arc<Layout> {
        &self.0
    }
    fn time_step(&self) -> Duration {
        Duration::from_seconds(60)
    }
    fn largest_time_step_s(&self, _: &State) -> f64 {
        f64::INFINITY
    }
    fn step(&self, _: &mut State) {}
}

impl TangentLinear for Still {
    fn step_tl(&self, _: &State, _: &mut [f64]) {}
}
