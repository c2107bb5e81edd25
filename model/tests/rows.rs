//! The sweep over rows against the equations cell by cell, and on any number of threads: the same bits; the tangent-linear
//! sweep against that of whole fields.

use crate::common::{BOUNDARIES, FORMS, SCHEMES, difference, grid, jet, largest, parameters, stepped, turbulence};
use isobar_model::forecast::{forecast_tl, trajectory};
use isobar_model::initial::{self, Vortex};
use isobar_model::random::{standard_normals, stream};
use isobar_model::shallow_water::{H, U, V};
use isobar_model::{
    Adjoint, Boundary, ColumnsMut, Duration, ForecastError, Lanes, Layout, Leapfrog, LinearShallowWater, Model,
    ShallowWater, ShallowWaterParameters, SpectralBounds, State, Stored, TangentLinear, Tendency, VectorInvariant,
};
use std::sync::Arc;

/// A tendency that hides its forms by rows, with f itself evaluated in another way.
#[derive(Clone)]
struct WholeFields<T> {
    inner: T,
    tendency: fn(&T, &[f64], &mut [f64]),
}

impl<T: Tendency> WholeFields<T> {
    fn of(inner: T) -> Self {
        Self { inner, tendency: |inner, x, out| inner.tendency(x, out, &mut vec![0.0; inner.scratch_len()]) }
    }
}

/// The equations of shallow water, term by term for one cell after the other.
fn cell_by_cell(model: &ShallowWater, x: &[f64], out: &mut [f64]) {
    let (grid, parameters) = (&model.layout().grid, model.parameters());
    let (nx, ny, walls) = (grid.nx as isize, grid.ny as isize, grid.boundary == Boundary::Channel);
    let (per_dx, per_dy) = (1.0 / grid.dx_m, 1.0 / grid.dy_m);
    let index = |variable: usize, j: isize, i: isize| variable * grid.cells() + (j * nx + i.rem_euclid(nx)) as usize;
    // Periodic, or continued evenly beyond the walls; v = 0 there.
    let continued = |field: &dyn Fn(isize, isize) -> f64, variable: usize, j: isize, i: isize| match walls {
        true if variable == V && (j <= 0 || j >= ny) => 0.0,
        true => field(j.clamp(0, ny - 1), i),
        false => field(j.rem_euclid(ny), i),
    };
    let value = |variable: usize, j: isize, i: isize| continued(&|j, i| x[index(variable, j, i)], variable, j, i);
    let (h, u, v) = (|j, i| value(H, j, i), |j, i| value(U, j, i), |j, i| value(V, j, i));
    let flux_x = |j, i| 0.5 * (h(j, i) + h(j, i - 1)) * u(j, i);
    let flux_y = |j, i| 0.5 * (h(j, i) + h(j - 1, i)) * v(j, i);
    let q = |j: isize, i| {
        let vorticity = (v(j, i) - v(j, i - 1)) * per_dx - (u(j, i) - u(j - 1, i)) * per_dy;
        4.0 * (model.coriolis_per_s(j as usize) + vorticity) / (h(j, i) + h(j, i - 1) + h(j - 1, i) + h(j - 1, i - 1))
    };
    let b = |j, i| {
        let [u, u_e, v, v_n] = [u(j, i), u(j, i + 1), v(j, i), v(j + 1, i)];
        parameters.gravity_m_per_s2 * h(j, i) + 0.25 * (u * u + u_e * u_e + v * v + v_n * v_n)
    };
    let laplacian = |field: &dyn Fn(isize, isize) -> f64, j, i| {
        let [center, west, east] = [field(j, i), field(j, i - 1), field(j, i + 1)];
        let [south, north] = [field(j - 1, i), field(j + 1, i)];
        ((east - center) - (center - west)) * grid.dx_m.powi(-2)
            + ((north - center) - (center - south)) * grid.dy_m.powi(-2)
    };
    for (j, i) in (0..ny).flat_map(|j| (0..nx).map(move |i| (j, i))) {
        let fluxes_y = [flux_y(j, i), flux_y(j, i - 1), flux_y(j + 1, i), flux_y(j + 1, i - 1)];
        let fluxes_x = [flux_x(j, i), flux_x(j, i + 1), flux_x(j - 1, i), flux_x(j - 1, i + 1)];
        let (q, q_n, q_e) = (q(j, i), q(j + 1, i), q(j, i + 1));
        let (q_v, q_u) = match model.form() {
            VectorInvariant::PotentialEnstrophy => {
                let sum = |it: [f64; 4]| it[0] + it[1] + it[2] + it[3];
                (0.125 * (q + q_n) * sum(fluxes_y), 0.125 * (q + q_e) * sum(fluxes_x))
            }
            VectorInvariant::Energy => {
                let [(v, v_w, v_n, v_nw), (u, u_e, u_s, u_se)] = [fluxes_y, fluxes_x].map(|it| it.into());
                (0.25 * (q * (v + v_w) + q_n * (v_n + v_nw)), 0.25 * (q * (u + u_s) + q_e * (u_e + u_se)))
            }
        };
        let mut slopes = [
            (fluxes_x[0] - fluxes_x[1]) * per_dx + (fluxes_y[0] - fluxes_y[2]) * per_dy,
            (b(j, i - 1) - b(j, i)) * per_dx + q_v - parameters.drag_per_s * u(j, i),
            (b(j - 1, i) - b(j, i)) * per_dy - q_u - parameters.drag_per_s * v(j, i),
        ];
        for (variable, slope) in slopes.iter_mut().enumerate() {
            let once = |j, i| laplacian(&|j, i| value(variable, j, i), j, i);
            let twice = laplacian(&|j, i| continued(&once, variable, j, i), j, i);
            *slope -= parameters.hyperdiffusion_m4_per_s * twice;
            let at_wall = walls && variable == V && j == 0;
            out[index(variable, j, i)] = if at_wall { 0.0 } else { *slope };
        }
    }
}

impl<T: Tendency> Tendency for WholeFields<T> {
    type Linearisation = T::Linearisation;

    fn layout(&self) -> &Arc<Layout> {
        self.inner.layout()
    }
    fn scratch_len(&self) -> usize {
        self.inner.scratch_len()
    }
    fn constrain<N: Stored>(&self, x: &mut [N]) {
        self.inner.constrain(x);
    }
    fn tendency(&self, x: &[f64], out: &mut [f64], _scratch: &mut [f64]) {
        (self.tendency)(&self.inner, x, out);
    }
    fn linearise(&self, at: &[f64]) -> Self::Linearisation {
        self.inner.linearise(at)
    }
    fn tendency_tl(&self, at: &Self::Linearisation, dx: &[f64], out: &mut [f64], scratch: &mut [f64]) {
        self.inner.tendency_tl(at, dx, out, scratch);
    }
    fn tendency_ad(&self, at: &Self::Linearisation, dy: &[f64], out_add: &mut [f64], scratch: &mut [f64]) {
        self.inner.tendency_ad(at, dy, out_add, scratch);
    }
    fn spectral_bounds(&self, x: &[f64]) -> SpectralBounds {
        self.inner.spectral_bounds(x)
    }
}

fn bits(x: &State) -> Vec<u64> {
    x.values().iter().map(|value| value.to_bits()).collect()
}

fn after(model: &dyn Model, start: &State, steps: usize) -> State {
    let mut x = start.clone();
    (0..steps).for_each(|_| model.step(&mut x));
    assert!(bits(&x) != bits(start) && x.first_non_finite().is_none());
    x
}

#[test]
fn rows_give_the_bits_of_the_equations_cell_by_cell() {
    for boundary in BOUNDARIES {
        for form in FORMS {
            for (nx, ny, drag_per_s, hyperdiffusion_m4_per_s) in [
                (14, 11, 0.0, 0.0),
                (4, 4, 1e-5, 0.0),
                (33, 5, 1e-5, 0.0),
                (14, 11, 1e-5, 5e14),
                (4, 4, 0.0, 5e14),
                (33, 5, 0.0, 5e14),
            ] {
                let parameters = ShallowWaterParameters { drag_per_s, hyperdiffusion_m4_per_s, ..parameters(boundary) };
                let rows = ShallowWater::new(grid(nx, ny, boundary), parameters, form).unwrap();
                let whole = WholeFields { inner: rows.clone(), tendency: cell_by_cell };
                assert!(rows.row_stream(nx, 1).is_some() && whole.row_stream(nx, 1).is_none());
                let start = turbulence(&rows);
                for scheme in SCHEMES {
                    let swept = after(&stepped(rows.clone(), 200, scheme), &start, 3);
                    assert_eq!(bits(&swept), bits(&after(&stepped(whole.clone(), 200, scheme), &start, 3)));
                }
                let step = Duration::from_seconds(100);
                let (rows, whole) =
                    (Leapfrog::new(rows, step, 0.02).unwrap(), Leapfrog::new(whole, step, 0.02).unwrap());
                let start = rows.start(&start);
                assert_eq!(bits(&after(&rows, &start, 3)), bits(&after(&whole, &start, 3)));
            }
        }
    }
}

/// 290 × 256 cells: enough for two bands.
#[test]
fn bands_on_several_threads_give_the_bits_of_one() {
    for (boundary, hyperdiffusion_m4_per_s) in BOUNDARIES.into_iter().flat_map(|it| [(it, 0.0), (it, 5e14)]) {
        let parameters = ShallowWaterParameters { hyperdiffusion_m4_per_s, ..parameters(boundary) };
        let equations = ShallowWater::new(grid(256, 290, boundary), parameters, FORMS[0]).unwrap();
        let vortex = Vortex { center_x_m: 9e6, center_y_m: 11.5e6, amplitude_m: 40.0, radius_m: 8e5 };
        let start = initial::vortices(&equations, 1000.0, &[vortex]).unwrap();
        let leapfrog = Leapfrog::new(equations.clone(), Duration::from_seconds(100), 0.02).unwrap();
        let linear = LinearShallowWater::about_uniform_flow(equations.clone(), 1000.0, 20.0).unwrap();
        let cases: [(Box<dyn Model>, State); 4] = [
            (Box::new(stepped(linear, 150, SCHEMES[0])), start.clone()),
            (Box::new(stepped(equations.clone(), 150, SCHEMES[0])), start.clone()),
            (Box::new(stepped(equations.clone(), 150, SCHEMES[1])), start.clone()),
            (Box::new(leapfrog.clone()), leapfrog.start(&start)),
        ];
        for (model, start) in cases {
            let on = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| bits(&after(&*model, &start, 4)))
            };
            let one = on(1);
            assert!(one == on(2), "two threads");
            assert!(one == on(5), "five threads");
        }
    }
}

/// With four stages rows of 150 places are swept in three strips, rows of 81 in two, those of a column alone and with leapfrog
/// from 289 on: the tangent-linear and the adjoint of whole fields to rounding, and a column has the bits it has alone, whatever
/// its place in a group, the others, and the steps taken at once.
#[test]
fn strips_give_the_tangent_linear_and_the_adjoint_of_whole_fields() {
    for (nx, ny, boundary, form, hyperdiffusion_m4_per_s) in [
        (289, 6, BOUNDARIES[0], FORMS[0], 5e14),
        (300, 4, BOUNDARIES[1], FORMS[1], 0.0),
        (4, 4, BOUNDARIES[1], FORMS[0], 5e14),
        (5, 4, BOUNDARIES[0], FORMS[1], 0.0),
        (150, 12, BOUNDARIES[0], FORMS[0], 0.0),
        (81, 9, BOUNDARIES[1], FORMS[1], 0.0),
        (150, 12, BOUNDARIES[0], FORMS[0], 5e14),
        (81, 9, BOUNDARIES[1], FORMS[1], 5e14),
        (20, 5, BOUNDARIES[0], FORMS[1], 5e14),
    ] {
        let parameters = ShallowWaterParameters { drag_per_s: 1e-5, hyperdiffusion_m4_per_s, ..parameters(boundary) };
        let nonlinear = ShallowWater::new(grid(nx, ny, boundary), parameters, form).unwrap();
        let (width, height) = (nonlinear.layout().grid.width_m(), nonlinear.layout().grid.height_m());
        let vortex = Vortex { center_x_m: 0.9 * width, center_y_m: 0.4 * height, amplitude_m: 40.0, radius_m: 3e5 };
        let start = initial::vortices(&nonlinear, 1000.0, &[vortex]).unwrap();
        let northward = if boundary == Boundary::Channel { 0.0 } else { -7.0 };
        let uniform = LinearShallowWater::about_uniform_wind(nonlinear.clone(), 900.0, 20.0, northward).unwrap();
        let jet = initial::geostrophic_jet(&nonlinear, &jet(&nonlinear)).unwrap();
        let zonal = LinearShallowWater::about_steady_flow(nonlinear.clone(), jet).unwrap();
        check_strips(&nonlinear, &start);
        check_strips(&uniform, &start);
        check_strips(&zonal, &start);
    }
}

fn check_strips<T: Tendency + Clone>(rows: &T, start: &State) {
    let whole = WholeFields::of(rows.clone());
    for lanes in [Lanes::One, Lanes::Group] {
        let whole_stream = whole.tangent_row_stream::<f64>(20, lanes);
        assert!(rows.tangent_row_stream::<f64>(20, lanes).is_some() && whole_stream.is_none());
        assert!(rows.adjoint_row_stream(20, lanes, 1).is_some() && whole.adjoint_row_stream(20, lanes, 1).is_none());
    }
    for scheme in SCHEMES {
        check_sweep(&stepped(rows.clone(), 200, scheme), &stepped(whole.clone(), 200, scheme), start);
    }
    let step = Duration::from_seconds(100);
    let (rows, whole) = (Leapfrog::new(rows.clone(), step, 0.02).unwrap(), Leapfrog::new(whole, step, 0.02).unwrap());
    check_sweep(&rows, &whole, &rows.start(start));
}

fn check_sweep(swept: &dyn Adjoint, fields: &dyn Adjoint, start: &State) {
    let len = start.values().len();
    let columns = standard_normals(&mut stream(3, "columns"), 11 * len);
    let states = trajectory(swept, start, 2).unwrap();
    for steps in 1..=3 {
        let forwards = |model: &dyn Adjoint, columns: &mut [f64]| {
            states[..steps].iter().for_each(|at| model.step_tl(at, columns));
        };
        let backwards = |model: &dyn Adjoint, columns: &mut [f64]| {
            states[..steps].iter().rev().for_each(|at| model.step_ad(at, columns));
        };
        let forwards_at_once = |columns: &mut [f64]| swept.steps_tl(start, ColumnsMut::Double(columns), steps);
        let backwards_at_once = |columns: &mut [f64]| swept.steps_ad(&states[..steps], columns);
        check_steps(swept, fields, &columns, len, &forwards, &forwards_at_once);
        check_steps(swept, fields, &columns, len, &backwards, &backwards_at_once);
    }
}

fn check_steps(
    swept: &dyn Adjoint,
    fields: &dyn Adjoint,
    columns: &[f64],
    len: usize,
    one_by_one: &dyn Fn(&dyn Adjoint, &mut [f64]),
    at_once: &(dyn Fn(&mut [f64]) + Sync),
) {
    let [mut single, mut expected] = [columns.to_vec(), columns.to_vec()];
    one_by_one(swept, &mut single);
    one_by_one(fields, &mut expected);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut together = columns.to_vec();
        pool.install(|| at_once(&mut together));
        assert!(together == single, "all steps at once on {threads} threads");
    }
    // Those of a group, of the few that are left, and of a group that is filled up.
    for (number, beside) in [(2, 1), (9, 1), (9, 2)] {
        let own = &single[number * len..(number + 1) * len];
        let mut alone = columns[number * len..][..beside * len].to_vec();
        at_once(&mut alone);
        assert!(own == &alone[..len], "a column knows of the others");
        let mut filled_up = columns[..6 * len].to_vec();
        filled_up[5 * len..].copy_from_slice(&columns[number * len..][..len]);
        at_once(&mut filled_up);
        assert!(own == &filled_up[5 * len..], "a column knows of the zeros beside it");
    }
    let scale = largest(&expected);
    assert!(largest(&difference(&single, columns)) > 0.1 * scale, "the columns must have moved");
    let differences = difference(&single, &expected);
    let error = largest(&differences) / scale;
    let worst = (0..columns.len()).find(|&k| differences[k].abs() == error * scale).map(|k| k % len);
    let place = swept.layout().describe(worst.unwrap_or(0));
    assert!(error < 1e-14, "relative error {error:e} in {place}");
}

/// Roundings of a step to 2⁻²⁴, of whatever size they are beside the largest value of a variable.
const ROUNDINGS_PER_STEP: f64 = 4.0;

/// Columns in single precision against those in double, whatever the strips: the difference grows by a few roundings with each
/// step, in hyperdiffusion near the stability limit as well.
#[test]
fn columns_in_single_precision_are_those_in_double_but_for_roundings() {
    for (nx, ny, boundary, form, hyperdiffusion_m4_per_s) in [
        (150, 12, BOUNDARIES[0], FORMS[0], 0.0),
        (150, 12, BOUNDARIES[0], FORMS[0], 1e16),
        (20, 9, BOUNDARIES[1], FORMS[1], 1e16),
        (81, 7, BOUNDARIES[1], FORMS[0], 5e14),
        (4, 4, BOUNDARIES[0], FORMS[1], 5e14),
    ] {
        let parameters = ShallowWaterParameters { drag_per_s: 1e-5, hyperdiffusion_m4_per_s, ..parameters(boundary) };
        let equations = ShallowWater::new(grid(nx, ny, boundary), parameters, form).unwrap();
        let start = turbulence(&equations);
        let uniform = LinearShallowWater::about_uniform_flow(equations.clone(), 900.0, 20.0).unwrap();
        let leapfrog = Leapfrog::new(equations.clone(), Duration::from_seconds(50), 0.3).unwrap();
        for scheme in SCHEMES {
            check_single(&stepped(equations.clone(), 200, scheme), &start);
            check_single(&stepped(uniform.clone(), 200, scheme), &start);
        }
        check_single(&leapfrog, &leapfrog.start(&start));
    }
}

fn check_single(model: &dyn TangentLinear, at: &State) {
    let (len, count) = (at.values().len(), 19);
    let normals = standard_normals(&mut stream(4, "columns"), count * len);
    let start: Vec<f32> = normals.into_iter().map(f32::narrow).collect();
    let after = |columns: &[f32], threads: usize, steps: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut columns = columns.to_vec();
        pool.install(|| forecast_tl(model, &mut at.clone(), &mut columns, steps).unwrap());
        columns
    };
    for steps in [1, 12] {
        let single = after(&start, 1, steps);
        let mut double: Vec<f64> = start.iter().map(|value| value.widen()).collect();
        forecast_tl(model, &mut at.clone(), &mut double, steps).unwrap();
        let error = largest(&difference(&single.iter().map(|value| value.widen()).collect::<Vec<_>>(), &double));
        let roundings = error / largest(&double) * f64::from(1 << 24);
        println!("{steps} steps, {len}: {roundings}");
        assert!(roundings > 0.1, "nothing is rounded");
        assert!(roundings < ROUNDINGS_PER_STEP * steps as f64, "{roundings} roundings in {steps} steps");
        assert!(single == after(&start, 2, steps), "on two threads");
        // Of a group, of the few that are left, and alone or in a group that is filled up.
        for (number, beside) in [(3, 1), (17, 1), (17, 2), (9, 7)] {
            let alone = after(&start[number * len..][..beside * len], 1, steps);
            assert!(alone == single[number * len..][..beside * len], "a column knows of the others");
        }
    }
    let (mut x, mut columns) = (at.clone(), start.clone());
    for _ in 0..3 {
        model.steps_tl(&x, ColumnsMut::Single(&mut columns), 1);
        model.step(&mut x);
    }
    assert!(columns == after(&start, 1, 3), "steps at once give other bits than one after another");
}

/// Without a form by rows columns are advanced in double precision and rounded once.
#[test]
fn columns_in_single_precision_of_whole_fields_are_rounded_when_they_are_written() {
    let parameters = ShallowWaterParameters { hyperdiffusion_m4_per_s: 5e14, ..parameters(BOUNDARIES[0]) };
    let equations = ShallowWater::new(grid(20, 9, BOUNDARIES[0]), parameters, FORMS[0]).unwrap();
    let at = turbulence(&equations);
    let model = stepped(WholeFields::of(equations), 200, SCHEMES[1]);
    let normals = standard_normals(&mut stream(4, "columns"), 11 * at.values().len());
    let mut single: Vec<f32> = normals.into_iter().map(f32::narrow).collect();
    let mut double: Vec<f64> = single.iter().map(|value| value.widen()).collect();
    forecast_tl(&model, &mut at.clone(), &mut single, 12).unwrap();
    forecast_tl(&model, &mut at.clone(), &mut double, 12).unwrap();
    assert!(single.iter().zip(&double).all(|(single, &double)| *single == f32::narrow(double)));
}

#[test]
fn an_increment_beyond_single_precision_is_an_error() {
    let equations = ShallowWater::new(grid(8, 6, BOUNDARIES[0]), parameters(BOUNDARIES[0]), FORMS[0]).unwrap();
    let mut at = turbulence(&equations);
    let mut columns = vec![f32::MAX; at.values().len()];
    columns.iter_mut().step_by(2).for_each(|value| *value = -f32::MAX);
    let model = stepped(equations, 200, SCHEMES[0]);
    let error = forecast_tl(&model, &mut at, &mut columns, 1).unwrap_err();
    assert!(matches!(error, ForecastError::IncrementNotFinite { step: 1, column: 0, .. }), "{error}");
}
