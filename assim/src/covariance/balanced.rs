//! Geostrophically balanced errors of h, u and v.

use super::homogeneous_filter::HomogeneousFilter;
use super::{Covariance, Spectrum};
use crate::error::Error;
use isobar_model::{Boundary, Grid, Layout};

/// What a [`Balanced`] covariance is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct BalancedParameters {
    /// Standard deviation of h at mid-domain \[m\].
    pub sigma_height_m: f64,
    /// Correlation length of the streamfunction \[m\].
    pub length_m: f64,
    /// Gravity g \[m s⁻²\].
    pub gravity_m_per_s2: f64,
    /// Coriolis parameter f at mid-domain \[s⁻¹\].
    pub coriolis_per_s: f64,
    /// Its change with y, β \[m⁻¹ s⁻¹\].
    pub beta_per_m_per_s: f64,
    /// Whether ψ vanishes at the walls of a channel.
    pub balanced_at_walls: bool,
}

/// A streamfunction ψ at the corners with homogeneous Gaussian correlation, and with it
///
/// ```text
/// u = −δy ψ        v = δx ψ        h = (f(y) / g) ψ averaged to the centres
/// ```
///
/// On the C grid f times the average of v to the u points is then g δx h to rounding on an f-plane, and likewise in y:
/// the errors are in *discrete* geostrophic balance. At walls v = 0 is kept: either ψ goes on as if there were no wall, and what
/// blows towards it ends there, which leaves gravity waves of the size of the errors in the whole channel; or ψ is multiplied by
///
/// ```text
/// √(1 − exp(−2 d²/L²)),   d the distance to the nearer wall,
/// ```
///
/// the standard deviation of ψ(y) less its image beyond the wall, over that of both: it is zero at the wall, as geostrophic
/// balance without flow through it asks for, and with it the errors of h.
pub struct Balanced {
    grid: Grid,
    /// Number of the first value of h, u and v.
    offsets: [usize; 3],
    len: usize,
    filter: HomogeneousFilter,
    sigma_streamfunction: f64,
    /// f / g at the rows of h.
    height_per_streamfunction: Vec<f64>,
    /// What ψ is multiplied by at the rows of corners, the northern wall's among them.
    at_rows: Vec<f64>,
}

impl Balanced {
    /// The covariance for a layout with variables h, u and v.
    ///
    /// # Errors
    /// [`Error::Setting`] without these variables or without rotation, and for a length that needs too much padding in a
    /// channel.
    pub fn new(layout: &Layout, parameters: &BalancedParameters) -> Result<Self, Error> {
        let grid = &layout.grid;
        let offset = |name: &str| {
            layout.variable(name).map(|variable| variable * grid.cells()).ok_or_else(|| {
                Error::Setting(format!("a balanced covariance needs the variables h, u and v; there is no {name}"))
            })
        };
        let offsets = [offset("h")?, offset("u")?, offset("v")?];
        if parameters.coriolis_per_s == 0.0 {
            return Err(Error::Setting("a balanced covariance needs rotation: coriolis_per_s is 0".into()));
        }
        let filter = HomogeneousFilter::gaussian(grid, [parameters.length_m; 2])?;
        let averaged = filter.variance_after(|k, l| (0.5 * k).cos().powi(2) * (0.5 * l).cos().powi(2));
        let gravity = parameters.gravity_m_per_s2;
        let middle = 0.5 * grid.height_m();
        let height_per_streamfunction = (0..grid.ny)
            .map(|j| (j as f64 + 0.5) * grid.dy_m - middle)
            .map(|y| (parameters.coriolis_per_s + parameters.beta_per_m_per_s * y) / gravity)
            .collect();
        let sigma_streamfunction =
            parameters.sigma_height_m * gravity / (parameters.coriolis_per_s.abs() * averaged.sqrt());
        Ok(Self {
            grid: grid.clone(),
            offsets,
            len: layout.len(),
            filter,
            sigma_streamfunction,
            height_per_streamfunction,
            at_rows: at_rows(grid, parameters),
        })
    }

    /// The value of a variable (0 to 2 for h, u and v) of a cell as a weighted sum of ψ: indices and weights, of which
    /// those of a wall's v are zero.
    fn weights(&self, variable: usize, row: usize, column: usize) -> ([usize; 4], [f64; 4]) {
        let nx = self.grid.nx;
        let (north, east) = ((row + 1) % self.filter.rows(), (column + 1) % nx);
        let [sw, se, nw, ne] = [row * nx + column, row * nx + east, north * nx + column, north * nx + east];
        let [of_south, of_north] = [row, row + 1].map(|row| self.sigma_streamfunction * self.at_rows[row]);
        match variable {
            0 => {
                let [south, north] =
                    [of_south, of_north].map(|sigma| 0.25 * sigma * self.height_per_streamfunction[row]);
                ([sw, se, nw, ne], [south, south, north, north])
            }
            1 => {
                let [south, north] = [of_south, of_north].map(|sigma| sigma / self.grid.dy_m);
                ([nw, sw, nw, sw], [-north, south, 0.0, 0.0])
            }
            _ => {
                let wall = row == 0 && self.grid.boundary == Boundary::Channel;
                let per_dx = if wall { 0.0 } else { of_south / self.grid.dx_m };
                ([se, sw, se, sw], [per_dx, -per_dx, 0.0, 0.0])
            }
        }
    }

    /// Calls `visit` with each (index of the increment, index of ψ, weight) of the linear map from ψ to (h, u, v).
    #[inline(always)]
    fn for_each_weight(&self, mut visit: impl FnMut(usize, usize, f64)) {
        for row in 0..self.grid.ny {
            for column in 0..self.grid.nx {
                let cell = row * self.grid.nx + column;
                for (variable, count) in [(0, 4), (1, 2), (2, 2)] {
                    let (corners, weights) = self.weights(variable, row, column);
                    for (&corner, &weight) in corners.iter().zip(&weights).take(count) {
                        visit(self.offsets[variable] + cell, corner, weight);
                    }
                }
            }
        }
    }

    /// The weights of the value at an index of the increment; `None` if it is none of h, u and v.
    fn weights_at(&self, index: usize) -> Option<([usize; 4], [f64; 4])> {
        let (cells, nx) = (self.grid.cells(), self.grid.nx);
        let variable = self.offsets.iter().position(|&offset| (offset..offset + cells).contains(&index))?;
        let cell = index - self.offsets[variable];
        Some(self.weights(variable, cell / nx, cell % nx))
    }
}

/// What ψ is multiplied by at each row of corners.
fn at_rows(grid: &Grid, parameters: &BalancedParameters) -> Vec<f64> {
    let vanishes = parameters.balanced_at_walls && grid.boundary == Boundary::Channel;
    let at = |row: usize| {
        let distance = row.min(grid.ny - row) as f64 * grid.dy_m / parameters.length_m;
        if vanishes { (-(-2.0 * distance * distance).exp_m1()).sqrt() } else { 1.0 }
    };
    (0..=grid.ny).map(at).collect()
}

impl Covariance for Balanced {
    fn len(&self) -> usize {
        self.len
    }

    fn control_len(&self) -> usize {
        self.filter.len()
    }

    fn control_cells(&self) -> Option<Vec<usize>> {
        Some(self.filter.cells(self.grid.ny))
    }

    fn spectrum(&self, scales: &[f64]) -> Option<Spectrum> {
        let [h, u, v] = self.offsets.map(|offset| scales[offset + self.grid.cells() - 1].powi(-2));
        let rows = &self.height_per_streamfunction;
        let per_streamfunction = rows.iter().map(|factor| factor * factor).sum::<f64>() / rows.len() as f64;
        let energy = |[k, l]: [f64; 2]| {
            let mean = ((0.5 * k).cos() * (0.5 * l).cos()).powi(2);
            let [along_x, along_y] =
                [(k, self.grid.dx_m), (l, self.grid.dy_m)].map(|(k, d)| (2.0 * (0.5 * k).sin() / d).powi(2));
            h * per_streamfunction * mean + u * along_y + v * along_x
        };
        let variance = self.sigma_streamfunction.powi(2);
        let eigenvalues = self.filter.spectrum().map(|(phases, value)| variance * value * energy(phases));
        Some(Spectrum::new(eigenvalues, self.grid.cells() as f64 / self.filter.len() as f64))
    }

    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        let mut streamfunction = control.to_vec();
        self.filter.apply(&mut streamfunction);
        self.for_each_weight(|index, corner, weight| increment[index] += weight * streamfunction[corner]);
    }

    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        let mut streamfunction = vec![0.0; self.filter.len()];
        self.for_each_weight(|index, corner, weight| streamfunction[corner] += weight * increment[index]);
        self.filter.apply(&mut streamfunction);
        for (control, filtered) in control.iter_mut().zip(streamfunction) {
            *control += filtered;
        }
    }

    fn multiply_add(&self, increment: &[f64], result: &mut [f64]) {
        let mut streamfunction = vec![0.0; self.filter.len()];
        self.for_each_weight(|index, corner, weight| streamfunction[corner] += weight * increment[index]);
        self.filter.correlate(&mut streamfunction);
        self.for_each_weight(|index, corner, weight| result[index] += weight * streamfunction[corner]);
    }

    /// Σ w_c w'_d ρ(c, d) over the corners c and d of the two values, ρ the correlation of ψ.
    fn covariance(&self, first: usize, second: usize) -> f64 {
        let (Some((corners, weights)), Some((others, other_weights))) =
            (self.weights_at(first), self.weights_at(second))
        else {
            return 0.0;
        };
        let mut sum = 0.0;
        for (&corner, weight) in corners.iter().zip(weights).filter(|(_, weight)| *weight != 0.0) {
            for (&other, other_weight) in others.iter().zip(other_weights).filter(|(_, weight)| *weight != 0.0) {
                sum += weight * other_weight * self.filter.correlation(corner, other);
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::covariance::randomize;
    use isobar_model::random::stream;
    use isobar_model::{
        Duration, LinearShallowWater, ShallowWater, ShallowWaterParameters, State, Stepped, TimeScheme,
        VectorInvariant, forecast,
    };

    /// How much a draw changes in six hours on an f-plane at rest, relative to itself.
    fn change(balanced_at_walls: bool) -> f64 {
        let grid = Grid { nx: 16, ny: 14, dx_m: 1.5e5, dy_m: 1.5e5, boundary: Boundary::Channel };
        let (gravity_m_per_s2, coriolis_per_s) = (9.8, 1e-4);
        let parameters = ShallowWaterParameters { gravity_m_per_s2, coriolis_per_s, ..Default::default() };
        let equations = ShallowWater::new(grid, parameters, VectorInvariant::Energy).unwrap();
        let linear = LinearShallowWater::about_uniform_flow(equations, 1000.0, 0.0).unwrap();
        let model = Stepped::new(linear, Duration::from_seconds(600), TimeScheme::Rk4).unwrap();
        let basic =
            State::from_values(isobar_model::Model::layout(&model), [vec![1000.0; 224], vec![0.0; 448]].concat());
        let parameters = BalancedParameters {
            sigma_height_m: 10.0,
            length_m: 5e5,
            gravity_m_per_s2,
            coriolis_per_s,
            beta_per_m_per_s: 0.0,
            balanced_at_walls,
        };
        let covariance = Balanced::new(basic.layout(), &parameters).unwrap();
        let draw = randomize(&covariance, &mut stream(1, "draw"));
        let mut state = basic.clone();
        state.values_mut().iter_mut().zip(&draw).for_each(|(value, draw)| *value += draw);
        forecast::forecast(&model, &mut state, 36).unwrap();
        let changes =
            state.values().iter().zip(basic.values()).zip(&draw).map(|((now, basic), draw)| now - basic - draw);
        (changes.map(|it| it * it).sum::<f64>() / draw.iter().map(|it| it * it).sum::<f64>()).sqrt()
    }

    /// Balanced at the walls as well it is a steady flow; otherwise waves start there.
    #[test]
    fn errors_that_are_balanced_at_the_walls_do_not_change_on_an_f_plane() {
        let (still, waves) = (change(true), change(false));
        assert!(still < 1e-9 && waves > 0.3, "{still} {waves}");
    }
}
