//! Shallow water linearised about a steady zonal basic state.

use super::linear_rows::{LinearRows, SteadyRows};
use super::{Coefficients, ShallowWater};
use crate::error::{ModelError, require, require_finite, require_positive};
use crate::grid::Boundary;
use crate::scheme::rows::{AdjointRowStream, Pushed, Row, RowStream, TangentRowStream};
use crate::scheme::sweep::tendency_by_rows;
use crate::scheme::{Lanes, SpectralBounds, Tendency};
use crate::state::{Layout, State};
use crate::stored::Stored;

use std::ops::Range;
use std::sync::Arc;

/// dx/dt = N'(x̄)(x − x̄): the [`ShallowWater`] tendency N linearised about a steady zonal flow x̄.
///
/// There is one implementation of N'(x̄), the tangent-linear of the nonlinear model: row by row, with coefficients computed once
/// for the state and beside the sweep for increments, and on whole fields for the start of leapfrog. The forecast of a total
/// state x then differs from that of its increment by x̄, which stays as it is; drag and hyperdiffusion act on the increment alone.
///
/// For [`LinearShallowWater::about_uniform_flow`] the mean depth is uniform although the mean flow would need a
/// slope −f ū/g of the surface: that slope is the bottom's, as usual (the textbook equations with constant
/// coefficients). [`LinearShallowWater::about_steady_flow`] takes a flow that N itself keeps steady.
#[derive(Clone, Debug)]
pub struct LinearShallowWater {
    nonlinear: ShallowWater,
    basic_state: State,
    coefficients: Coefficients,
    rows: SteadyRows,
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
        let rows = SteadyRows::new(&nonlinear, basic_state.values(), &coefficients);
        let bounds = nonlinear.spectral_bounds(basic_state.values());
        Self { nonlinear, basic_state, coefficients, rows, bounds }
    }
}

impl Tendency for LinearShallowWater {
    type Linearisation = ();

    fn layout(&self) -> &Arc<Layout> {
        &self.nonlinear.layout
    }

    fn in_rows(&self, rows: &Range<isize>) -> Option<Self> {
        let nonlinear = self.nonlinear.in_rows(rows)?;
        let values = self.layout().grid.take_rows(rows, self.basic_state.values());
        let basic_state = State::from_values(nonlinear.layout(), values);
        Some(Self { bounds: self.bounds, ..Self::about(nonlinear, basic_state) })
    }

    fn open_ends(&self) -> [bool; 2] {
        self.nonlinear.open_ends()
    }

    fn reach(&self) -> usize {
        self.nonlinear.reach()
    }

    fn scratch_len(&self) -> usize {
        self.nonlinear.scratch_len()
    }

    #[inline(always)]
    fn constrain<N: Stored>(&self, x: &mut [N]) {
        self.nonlinear.constrain(x);
    }

    fn tendency(&self, x: &[f64], out: &mut [f64], _scratch: &mut [f64]) {
        tendency_by_rows(self, x, out);
    }

    fn row_stream(&self, nx: usize, lanes: usize) -> Option<Box<dyn RowStream + '_>> {
        Some(Box::new(LinearRows::new(&self.nonlinear, &self.rows, nx, lanes)))
    }

    fn linearised_at<'a>(&'a self, _at: &'a [f64]) -> &'a [f64] {
        self.basic_state.values()
    }

    fn tangent_row_stream<N: Stored>(&self, nx: usize, lanes: Lanes) -> Option<Box<dyn TangentRowStream<N> + '_>> {
        Some(Box::new(SteadyTangentRows(self.nonlinear.tangent_row_stream(nx, lanes)?)))
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
struct SteadyTangentRows<'a, N>(Box<dyn TangentRowStream<N> + 'a>);

impl<N: Stored> TangentRowStream<N> for SteadyTangentRows<'_, N> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::Model;
    use crate::grid::Grid;
    use crate::initial::{RandomConfig, random_balanced};
    use crate::random::{standard_normals, stream};
    use crate::scheme::{Stepped, TimeScheme};
    use crate::shallow_water::{ShallowWaterParameters, VectorInvariant};
    use crate::time::Duration;

    /// Linearised about a uniform flow, and about one that is not even steady, whose coefficients differ from place to place.
    fn models(
        nx: usize,
        ny: usize,
        boundary: Boundary,
        form: VectorInvariant,
        damped: bool,
    ) -> [LinearShallowWater; 2] {
        let grid = Grid { nx, ny, dx_m: 100e3, dy_m: 80e3, boundary };
        let parameters = ShallowWaterParameters {
            coriolis_per_s: 1e-4,
            beta_per_m_per_s: if boundary == Boundary::Channel { 1.6e-11 } else { 0.0 },
            drag_per_s: 1e-5,
            hyperdiffusion_m4_per_s: if damped { 5e14 } else { 0.0 },
            ..Default::default()
        };
        let nonlinear = ShallowWater::new(grid, parameters, form).unwrap();
        let config = RandomConfig { mean_depth_m: 1000.0, height_standard_deviation_m: 25.0, length_scale_m: 300e3 };
        let any = random_balanced(&nonlinear, &config, &mut stream(5, "basic state")).unwrap();
        let uniform = LinearShallowWater::about_uniform_flow(nonlinear.clone(), 900.0, 20.0).unwrap();
        [uniform, LinearShallowWater::about(nonlinear, any)]
    }

    /// A state near the basic one.
    fn near(model: &LinearShallowWater, number: u64) -> State {
        let mut x = model.basic_state.clone();
        let normals = standard_normals(&mut stream(number, "state"), x.values().len());
        crate::vector::axpy(2.0, &normals, x.values_mut());
        model.constrain(x.values_mut());
        x
    }

    #[test]
    fn rows_give_the_derivative_of_whole_fields_and_states_together_what_they_are_alone() {
        for (boundary, form) in [Boundary::Periodic, Boundary::Channel].into_iter().flat_map(|boundary| {
            [VectorInvariant::PotentialEnstrophy, VectorInvariant::Energy].map(|form| (boundary, form))
        }) {
            for (nx, ny, damped) in [(14, 11, false), (14, 11, true), (4, 4, true), (33, 5, false), (16, 6, true)] {
                for model in models(nx, ny, boundary, form, damped) {
                    check_tendency(&model);
                    check_together(model);
                }
            }
        }
    }

    fn check_tendency(model: &LinearShallowWater) {
        let x = near(model, 1);
        let increment = crate::vector::difference(x.values(), model.basic_state.values());
        let [mut rows, mut whole] = [vec![0.0; increment.len()], vec![0.0; increment.len()]];
        let mut scratch = vec![0.0; model.scratch_len()];
        model.tendency(x.values(), &mut rows, &mut scratch);
        model.tendency_tl(&(), &increment, &mut whole, &mut scratch);
        let cells = model.layout().grid.cells();
        for (rows, whole) in rows.chunks_exact(cells).zip(whole.chunks_exact(cells)) {
            let error = super::super::largest(&crate::vector::difference(rows, whole));
            assert!(error < 1e-14 * super::super::largest(whole), "{error:e}");
        }
    }

    fn check_together(model: LinearShallowWater) {
        let starts: Vec<State> = (0..7).map(|number| near(&model, number)).collect();
        let model = Stepped::new(model, Duration::from_seconds(200), TimeScheme::Rk4).unwrap();
        let mut together = starts.clone();
        model.steps(&mut together, 3);
        for (mut alone, together) in starts.into_iter().zip(together) {
            (0..3).for_each(|_| model.step(&mut alone));
            assert!(alone.first_non_finite().is_none() && alone == together);
        }
    }
}
