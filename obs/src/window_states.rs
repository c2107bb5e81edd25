//! The states of a window, at whose times instruments observe.

use isobar_model::{Duration, State};

/// The states of a model run through a window, at equal intervals from its start to its end; or the state at its end alone,
/// which then stands for the whole window.
///
/// Between two of them values are interpolated linearly in time: with `t_k ≤ t ≤ t_{k+1}`,
///
/// ```text
/// h(t) = h(x_k) + (t − t_k) / (t_{k+1} − t_k) (h(x_{k+1}) − h(x_k))
/// ```
///
/// which is exact at the times of the states. Its error within a time step is that of the step squared.
#[derive(Clone, Copy, Debug)]
pub struct WindowStates<'a> {
    states: &'a [State],
    window: Duration,
}

impl<'a> From<&'a State> for WindowStates<'a> {
    fn from(end: &'a State) -> Self {
        Self { states: std::slice::from_ref(end), window: Duration::from_seconds(0) }
    }
}

impl<'a> WindowStates<'a> {
    /// The states at the start of a window of this length, after each of equal steps, and at its end.
    ///
    /// # Panics
    /// If `states` is empty.
    pub fn new(states: &'a [State], window: Duration) -> Self {
        assert!(!states.is_empty(), "a window has a state at its end");
        Self { states, window }
    }

    /// The state at the end.
    pub fn end(&self) -> &'a State {
        &self.states[self.states.len() - 1]
    }

    /// A value at the time that is this long before the end.
    pub fn value(&self, lag: Duration, mut of: impl FnMut(&State) -> f64) -> f64 {
        let (first, part) = place(lag, self.window, self.states.len() - 1);
        if part == 0.0 {
            return of(&self.states[first]);
        }
        let before = of(&self.states[first]);
        before + part * (of(&self.states[first + 1]) - before)
    }
}

/// Where the time `lag` before the end of a window is among its time steps: the number of the step at or before it, and the
/// fraction of a step since then, from 0 to below 1. Times outside the window count as its start or end.
pub fn place(lag: Duration, window: Duration, steps: usize) -> (usize, f64) {
    let (lag, window) = (lag.seconds().clamp(0, window.seconds()), window.seconds());
    if lag == 0 || steps == 0 {
        return (steps, 0.0);
    }
    // In whole numbers: a time of a state is exactly that.
    let elapsed = i128::from(window - lag) * steps as i128;
    let (whole, rest) = (elapsed / i128::from(window), elapsed % i128::from(window));
    (whole as usize, rest as f64 / window as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::{Boundary, Grid, Layout, Location, Variable};
    use std::sync::Arc;

    fn states(values: &[f64]) -> Vec<State> {
        let grid = Grid { nx: 1, ny: 1, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let h = Variable { name: "h", long_name: "height", standard_name: None, unit: "m", location: Location::Center };
        let layout = Arc::new(Layout { grid, variables: vec![h] });
        values.iter().map(|&value| State::from_values(&layout, vec![value])).collect()
    }

    #[test]
    fn a_state_is_met_exactly_and_times_between_are_interpolated() {
        let states = states(&[1.0, 0.1, 7.0, -3.0]);
        let window = WindowStates::new(&states, Duration::from_seconds(300));
        let at = |lag| window.value(Duration::from_seconds(lag), |state| state.values()[0]);
        assert_eq!([at(0), at(100), at(200), at(300)], [-3.0, 7.0, 0.1, 1.0]);
        assert!((at(50) - 2.0).abs() < 1e-14 && (at(175) - 1.825).abs() < 1e-14);
        assert_eq!(window.end().values(), [-3.0]);
    }

    #[test]
    fn one_state_stands_for_the_whole_window() {
        let states = states(&[5.0]);
        let window = WindowStates::from(&states[0]);
        assert_eq!(window.value(Duration::from_seconds(3600), |state| state.values()[0]), 5.0);
    }

    #[test]
    fn times_out_of_the_window_are_its_ends() {
        let seconds = Duration::from_seconds;
        assert_eq!(place(seconds(-5), seconds(60), 6), (6, 0.0));
        assert_eq!(place(seconds(61), seconds(60), 6), (0, 0.0));
        assert_eq!(place(seconds(25), seconds(60), 6), (3, 0.5));
    }
}
