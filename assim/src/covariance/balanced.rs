//! Geostrophically balanced errors of h, u and v.

use super::Covariance;
use super::gaussian_filter::GaussianFilter;
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
}

/// A streamfunction ψ at the corners with homogeneous Gaussian correlation, and with it
///
/// ```text
/// u = −δy ψ        v = δx ψ        h = (f(y) / g) ψ averaged to the centres
/// ```
///
/// On the C grid f times the average of v to the u points is then g δx h to rounding on an f-plane, and likewise in y:
/// the errors are in *discrete* geostrophic balance. At walls v = 0 is kept.
pub struct Balanced {
    grid: Grid,
    /// Number of the first value of h, u and v.
    offsets: [usize; 3],
    len: usize,
    filter: GaussianFilter,
    sigma_streamfunction: f64,
    /// f / g at the rows of h.
    height_per_streamfunction: Vec<f64>,
}

impl Balanced {
    /// The covariance for a layout with variables h, u and v.
    ///
    /// # Errors
    /// [`Error::Setting`] without these variables or without rotation.
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
        let filter = GaussianFilter::new(grid, parameters.length_m);
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
        })
    }

    /// Calls `visit` with each (index of the increment, index of ψ, weight) of the linear map from ψ to (h, u, v).
    fn for_each_weight(&self, mut visit: impl FnMut(usize, usize, f64)) {
        let (nx, ny) = (self.grid.nx, self.grid.ny);
        let [h, u, v] = self.offsets;
        let sigma = self.sigma_streamfunction;
        let (per_dx, per_dy) = (sigma / self.grid.dx_m, sigma / self.grid.dy_m);
        for j in 0..ny {
            let north = (j + 1) % self.filter.rows();
            let quarter = 0.25 * sigma * self.height_per_streamfunction[j];
            let wall = j == 0 && self.grid.boundary == Boundary::Channel;
            for i in 0..nx {
                let east = (i + 1) % nx;
                let cell = j * nx + i;
                let [sw, se, nw, ne] = [j * nx + i, j * nx + east, north * nx + i, north * nx + east];
                for corner in [sw, se, nw, ne] {
                    visit(h + cell, corner, quarter);
                }
                visit(u + cell, nw, -per_dy);
                visit(u + cell, sw, per_dy);
                if !wall {
                    visit(v + cell, se, per_dx);
                    visit(v + cell, sw, -per_dx);
                }
            }
        }
    }
}

impl Covariance for Balanced {
    fn len(&self) -> usize {
        self.len
    }

    fn control_len(&self) -> usize {
        self.filter.len()
    }

    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        let streamfunction = self.filter.apply(control);
        self.for_each_weight(|index, corner, weight| increment[index] += weight * streamfunction[corner]);
    }

    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        let mut streamfunction = vec![0.0; self.filter.len()];
        self.for_each_weight(|index, corner, weight| streamfunction[corner] += weight * increment[index]);
        for (control, filtered) in control.iter_mut().zip(self.filter.apply(&streamfunction)) {
            *control += filtered;
        }
    }
}
