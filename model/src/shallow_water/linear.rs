//! Shallow water linearised about a steady zonal basic state.

use super::{Coefficients, ShallowWater};
use crate::error::{ModelError, require, require_finite, require_positive};
use crate::grid::Boundary;
use crate::scheme::rows::{AdjointRowStream, Pushed, Row, TangentRowStream};
use crate::scheme::{Lanes, SpectralBounds, Tendency};
use crate::state::{Layout, State};
use crate::stored::Stored;

use std::sync::Arc;

/// dx/dt = N'(x̄)(x − x̄): the [`ShallowWater`] tendency N linearised about a steady zonal flow x̄.
///
/// There is one implementation of N'(x̄), the tangent-linear of the nonlinear model: row by row for increments, and on whole
/// fields, with coefficients computed once, for the state and the adjoint. The forecast of a total state x then differs from
/// that of its increment by x̄, which stays as it is; drag and hyperdiffusion act on the increment alone.
///
/// For [`LinearShallowWater::about_uniform_flow`] the mean depth is uniform although the mean flow would need a
/// slope −f ū/g of the surface: that slope is the bottom's, as usual (the textbook equations with constant
/// coefficients). [`LinearShallowWater::about_steady_flow`] takes a flow that N itself keeps steady.
#[derive(Clone, Debug)]
pub struct LinearShallowWater {
    nonlinear: ShallowWater,
    basic_state: State,
    coefficients: Coefficients,
    bounds: SpectralBounds,
}

impl LinearShallowWater {
    /// Linearised about h = mean depth, u = mean flow, v = 0.
    ///
    /// # Errors
    /// If the mean depth is not positive or the mean flow not finite.
    pub fn about_uniform_flow(
        nonlinear: ShallowWater,
        mean_depth_m: f64,
        mean_flow_m_per_s: f64,
    ) -> Result<Self, ModelError> {
        Self::about_uniform_wind(nonlinear, mean_depth_m, mean_flow_m_per_s, 0.0)
    }

    /// Linearised about h = mean depth and a uniform wind, whose northward component is 0 in a channel.
    ///
    /// # Errors
    /// If the mean depth is not positive, or the wind not finite or blowing through walls.
    pub fn about_uniform_wind(
        nonlinear: ShallowWater,
        mean_depth_m: f64,
        mean_flow_m_per_s: f64,
        mean_flow_y_m_per_s: f64,
    ) -> Result<Self, ModelError> {
        require_positive("mean_depth_m", mean_depth_m)?;
        require_finite("mean_flow_m_per_s", mean_flow_m_per_s)?;
        require_finite("mean_flow_y_m_per_s", mean_flow_y_m_per_s)?;
        let walls = nonlinear.layout.grid.boundary == Boundary::Channel;
        require(!walls || mean_flow_y_m_per_s == 0.0, "mean_flow_y_m_per_s", mean_flow_y_m_per_s, "zero in a channel")?;
        let cells = nonlinear.layout.grid.cells();
        let mut values = vec![mean_depth_m; cells];
        values.resize(2 * cells, mean_flow_m_per_s);
        values.resize(3 * cells, mean_flow_y_m_per_s);
        let basic_state = State::from_values(&nonlinear.layout, values);
        Ok(Self::about(nonlinear, basic_state))
    }

    /// Linearised about a zonal flow in balance, such as [`crate::initial::geostrophic_jet`] without perturbation.
    ///
    /// # Errors
    /// [`ModelError::NotSteady`] if the flow without drag and hyperdiffusion changes by more than 10⁻¹⁰ of the
    /// budget's largest term; [`ModelError::Thickness`] if the thickness is somewhere not positive.
    pub fn about_steady_flow(nonlinear: ShallowWater, basic_state: State) -> Result<Self, ModelError> {
        let layout = Arc::clone(&nonlinear.layout);
        let (grid, cells) = (&layout.grid, layout.grid.cells());
        assert_eq!(basic_state.values().len(), layout.len(), "the basic state is not of this model's layout");
        if let Some(index) = basic_state.values()[..cells].iter().position(|&h| !(h.is_finite() && h > 0.0)) {
            let (_, row, column) = layout.place(index);
            return Err(ModelError::Thickness { row, column, thickness_m: basic_state.values()[index] });
        }
        let mut inviscid = nonlinear.clone();
        inviscid.parameters.drag_per_s = 0.0;
        inviscid.parameters.hyperdiffusion_m4_per_s = 0.0;
        let mut tendency = vec![0.0; layout.len()];
        inviscid.tendency(basic_state.values(), &mut tendency, &mut vec![0.0; inviscid.scratch_len()]);
        let [h, u, v] = nonlinear.fields(basic_state.values());
        let (depth, wind) = (super::largest(h), super::largest(u) + super::largest(v));
        let spacing = grid.dx_m.min(grid.dy_m);
        let pressure = nonlinear.parameters.gravity_m_per_s2 * depth / spacing;
        let tolerance = 1e-10;
        for (index, &change) in tendency.iter().enumerate() {
            let scale = if index < cells { depth * wind / spacing } else { pressure };
            if change.is_nan() || change.abs() > tolerance * scale {
                return Err(ModelError::NotSteady { place: layout.describe(index), tendency: change, tolerance });
            }
        }
        Ok(Self::about(nonlinear, basic_state))
    }

    /// The model that is linearised.
    pub fn nonlinear(&self) -> &ShallowWater {
        &self.nonlinear
    }

    /// The basic state x̄.
    pub fn basic_state(&self) -> &State {
        &self.basic_state
    }

    fn about(nonlinear: ShallowWater, basic_state: State) -> Self {
        let coefficients = Coefficients::new(&nonlinear, basic_state.values());
        let bounds = nonlinear.spectral_bounds(basic_state.values());
        Self { nonlinear, basic_state, coefficients, bounds }
    }
}

impl Tendency for LinearShallowWater {
    type Linearisation = ();

    fn layout(&self) -> &Arc<Layout> {
        &self.nonlinear.layout
    }

    fn scratch_len(&self) -> usize {
        self.nonlinear.scratch_len() + self.nonlinear.layout.len()
    }

    #[inline(always)]
    fn constrain<N: Stored>(&self, x: &mut [N]) {
        self.nonlinear.constrain(x);
    }

    #[inline(always)]
    fn tendency(&self, x: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        let (scratch, increment) = scratch.split_at_mut(self.nonlinear.scratch_len());
        for ((increment, x), basic) in increment.iter_mut().zip(x).zip(self.basic_state.values()) {
            *increment = x - basic;
        }
        self.nonlinear.tendency_tl(&self.coefficients, increment, out, scratch);
    }

    fn linearised_at<'a>(&'a self, _at: &'a [f64]) -> &'a [f64] {
        self.basic_state.values()
    }

    fn tangent_row_stream<N: Stored>(&self, nx: usize, lanes: Lanes) -> Option<Box<dyn TangentRowStream<N> + '_>> {
        Some(Box::new(SteadyRows(self.nonlinear.tangent_row_stream(nx, lanes)?)))
    }

    fn adjoint_row_stream(&self, nx: usize, lanes: Lanes, delay: usize) -> Option<Box<dyn AdjointRowStream + '_>> {
        Some(Box::new(SteadyAdjointRows(self.nonlinear.adjoint_row_stream(nx, lanes, delay)?)))
    }

    fn linearise(&self, _at: &[f64]) {}

    #[inline(always)]
    fn tendency_tl(&self, (): &(), dx: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        self.nonlinear.tendency_tl(&self.coefficients, dx, out, scratch);
    }

    #[inline(always)]
    fn tendency_ad(&self, (): &(), dy: &[f64], out_add: &mut [f64], scratch: &mut [f64]) {
        self.nonlinear.tendency_ad(&self.coefficients, dy, out_add, scratch);
    }

    /// Those of the nonlinear model at x̄, whatever x.
    fn spectral_bounds(&self, _x: &[f64]) -> SpectralBounds {
        self.bounds
    }
}

/// N' row by row at a state that stays as it is, whatever N of it: the basic state at every stage of every step.
struct SteadyRows<'a, N>(Box<dyn TangentRowStream<N> + 'a>);

impl<N: Stored> TangentRowStream<N> for SteadyRows<'_, N> {
    fn reach(&self) -> usize {
        self.0.reach()
    }

    fn begin(&mut self, row: isize, x: Row<'_>, dx: Row<'_, N>) {
        self.0.begin(row, x, dx);
    }

    fn beyond_wall(&self, x: Row<'_>, dx: Row<'_, N>, ghost: &mut [f64], d_ghost: &mut [N]) {
        self.0.beyond_wall(x, dx, ghost, d_ghost);
    }

    fn push(&mut self, row: isize, x: Pushed<'_>, dx: Pushed<'_, N>) {
        self.0.push(row, Pushed { tendency: &mut *x.tendency, ..x }, dx);
        x.tendency.fill(0.0);
    }

    fn finish(&mut self, tendency: &mut [f64], d_tendency: &mut [N]) {
        self.0.finish(tendency, d_tendency);
        tendency.fill(0.0);
    }
}

/// The same for the transpose of N'.
struct SteadyAdjointRows<'a>(Box<dyn AdjointRowStream + 'a>);

impl AdjointRowStream for SteadyAdjointRows<'_> {
    fn reach(&self) -> usize {
        self.0.reach()
    }

    fn begin(&mut self, row: isize, x: Row<'_>) {
        self.0.begin(row, x);
    }

    fn beyond_wall(&self, x: Row<'_>, ghost: &mut [f64]) {
        self.0.beyond_wall(x, ghost);
    }

    fn push_state(&mut self, row: isize, x: Pushed<'_>) {
        self.0.push_state(row, Pushed { tendency: &mut *x.tendency, ..x });
        x.tendency.fill(0.0);
    }

    fn finish_state(&mut self, tendency: &mut [f64]) {
        self.0.finish_state(tendency);
        tendency.fill(0.0);
    }

    fn push(&mut self, row: isize, south: Row<'_>, north: Row<'_>, out: &mut [f64]) {
        self.0.push(row, south, north, out);
    }

    fn finish(&mut self, out: &mut [f64]) {
        self.0.finish(out);
    }
}
