//! A model of one's own: the 40 variables of Lorenz (1996) on a ring, with tangent-linear and adjoint, through the
//! contract battery in one call.
//!
//! ```text
//! dx_i/dt = (x_{i+1} − x_{i−2}) x_{i−1} − x_i + 8
//! ```
//!
//! A [`Tendency`] says what the equations are; the time schemes, their tangent-linear and adjoint, and the loops over
//! steps and columns come with it. E. N. Lorenz (1996): Predictability – a problem partly solved. ECMWF Seminar.
//!
//! `cargo run --release -p isobar-model --example own_model`

use isobar_model::forecast::forecast;
use isobar_model::testing::check_contract;
use isobar_model::{
    Boundary, Duration, Grid, Layout, Leapfrog, Location, SpectralBounds, State, Stepped, Tendency, TimeScheme,
    Variable,
};
use std::sync::Arc;

/// The unit of time, five days, in seconds.
const UNIT_S: f64 = 5.0 * 86_400.0;

struct Lorenz96 {
    layout: Arc<Layout>,
    forcing: f64,
}

impl Lorenz96 {
    fn new(variables: usize, forcing: f64) -> Self {
        let grid = Grid { nx: variables, ny: 1, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
        let x = Variable {
            name: "x",
            long_name: "some quantity on a latitude circle",
            standard_name: None,
            unit: "1",
            location: Location::Center,
        };
        Self { layout: Arc::new(Layout { grid, variables: vec![x] }), forcing }
    }

    /// Numbers of the neighbours i − 2, i − 1, i + 1.
    fn neighbours(&self, i: usize) -> [usize; 3] {
        let n = self.layout.grid.nx;
        [(i + n - 2) % n, (i + n - 1) % n, (i + 1) % n]
    }
}

impl Tendency for Lorenz96 {
    /// The derivative needs the state itself.
    type Linearisation = Vec<f64>;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn scratch_len(&self) -> usize {
        0
    }

    fn tendency(&self, x: &[f64], out: &mut [f64], _scratch: &mut [f64]) {
        for i in 0..x.len() {
            let [second, west, east] = self.neighbours(i);
            out[i] = ((x[east] - x[second]) * x[west] - x[i] + self.forcing) / UNIT_S;
        }
    }

    fn linearise(&self, at: &[f64]) -> Vec<f64> {
        at.to_vec()
    }

    fn tendency_tl(&self, at: &Vec<f64>, dx: &[f64], out: &mut [f64], _scratch: &mut [f64]) {
        for i in 0..dx.len() {
            let [second, west, east] = self.neighbours(i);
            out[i] = ((dx[east] - dx[second]) * at[west] + (at[east] - at[second]) * dx[west] - dx[i]) / UNIT_S;
        }
    }

    fn tendency_ad(&self, at: &Vec<f64>, dy: &[f64], out_add: &mut [f64], _scratch: &mut [f64]) {
        for i in 0..dy.len() {
            let [second, west, east] = self.neighbours(i);
            let y = dy[i] / UNIT_S;
            out_add[east] += at[west] * y;
            out_add[second] -= at[west] * y;
            out_add[west] += (at[east] - at[second]) * y;
            out_add[i] -= y;
        }
    }

    /// |∂f_i/∂x_j| summed over j bounds all eigenvalues (Gershgorin).
    fn spectral_bounds(&self, x: &[f64]) -> SpectralBounds {
        let largest = x.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        SpectralBounds { oscillation_per_s: 4.0 * largest / UNIT_S, damping_per_s: 1.0 / UNIT_S }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let equations = Lorenz96::new(40, 8.0);
    let mut x = State::from_values(equations.layout(), vec![8.0; 40]);
    x.values_mut()[19] += 0.01;
    let step = Duration::from_seconds(21_600);
    let model = Stepped::new(equations, step, TimeScheme::Rk4)?;
    // A quarter of a year, onto the attractor.
    forecast(&model, &mut x, 360)?;
    let contract = check_contract(&model, &x);
    println!("Runge–Kutta: {contract:?}");
    let leapfrog = Leapfrog::new(Lorenz96::new(40, 8.0), step, 0.1)?;
    println!("leapfrog:    {:?}", check_contract(&leapfrog, &leapfrog.start(&x)));
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_model_keeps_the_contract() {
        super::main().unwrap();
    }
}
