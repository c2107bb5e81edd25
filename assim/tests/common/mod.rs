//! A small linear model whose propagator is a given matrix, and random observations of it.

use faer::{Mat, MatRef};
use isobar_assim::covariance::{Balanced, BalancedParameters, Covariance, Sum, White};
use isobar_assim::ensemble::{EnsembleSettings, Inflation, InitialMembers, ModelErrorTreatment};
use isobar_assim::fast_kalman::{BiasCoupling, BlockShape, FastKalmanSettings, Precision, Residual};
use isobar_assim::local_factors::{LeftOver, LocalFactorSettings};
use isobar_assim::time_volume::{AmplitudeEvolution, Factor, Target, TimeShape, TimeVolumeSettings};
use isobar_assim::{
    Assimilator, Background, BiasTreatment, CalibrationAccuracy, CovarianceColumn, Error, Estimate, EstimatedParameter,
    Problem, Unknown,
};
use isobar_model::initial::{JetConfig, geostrophic_jet};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Adjoint, Boundary, Duration, Grid, Layout, Location, Model, ShallowWater, ShallowWaterParameters, State, Stepped,
    TangentLinear, Time, TimeScheme, Variable, VectorInvariant,
};
use isobar_obs::{
    Calibration, Drift, Jacobian, LinearOperator, ObservationWindow, Parameter, Placement, Report, SparseRows,
};
use rand::RngExt;
use std::sync::Arc;

/// Blocks forecast exactly, without common factors, and no limit to what observations may merge.
pub fn settings(blocks: BlockShape, bias_coupling: BiasCoupling) -> FastKalmanSettings {
    FastKalmanSettings {
        blocks,
        bias_coupling,
        factors: 0,
        retained_energy: 1.0,
        residual: Residual::Exact,
        largest_component: usize::MAX,
        separator_factors: 0,
        factor_precision: Precision::Double,
    }
}

/// Tiles of a cell with a few factors, of which one is mixed.
pub fn tile_settings() -> LocalFactorSettings {
    LocalFactorSettings {
        blocks: BlockShape::Cell,
        per_tile: 4,
        model_error_per_tile: 6,
        tile_m: 1.0,
        support_tiles: 2,
        mixed: 1,
        left_over: LeftOver::Factors,
        factor_precision: Precision::Double,
        largest_component: usize::MAX,
        residual: Residual::Probe { count: 3 },
    }
}

pub const DAY: Duration = Duration::from_seconds(86_400);

/// A factor that is the same everywhere.
pub fn factor(name: &str, target: Target, shape: TimeShape, evolution: AmplitudeEvolution) -> Factor {
    Factor { name: name.into(), target, shape, patterns: Vec::new(), evolution }
}

/// Amplitudes that are constant over the window.
pub fn constant(sigma_prior: Option<f64>) -> AmplitudeEvolution {
    AmplitudeEvolution::Constant { sigma_prior }
}

/// A window of so many cycles that forgets what is older, with one block.
pub fn volume_settings(cycles: usize, factors: Vec<Factor>) -> TimeVolumeSettings {
    TimeVolumeSettings {
        filter: settings(BlockShape::Domain, BiasCoupling::Carry),
        cycles,
        keep_before: false,
        factors,
        start: Time::from_seconds(0),
        selection_threshold: 4.0,
    }
}

/// Second-order exact members, the square root of Q, and no inflation.
pub fn ensemble_settings(members: usize) -> EnsembleSettings {
    EnsembleSettings {
        members,
        initial_members: InitialMembers::SecondOrderExact,
        model_error: ModelErrorTreatment::SquareRoot,
        inflation: Inflation::NONE,
        seed: 0,
    }
}

pub const WINDOW: Duration = Duration::from_seconds(21_600);

/// x(t + 6 h) = A x(t).
pub struct MatrixModel {
    layout: Arc<Layout>,
    matrix: Mat<f64>,
}

impl MatrixModel {
    fn multiply(&self, columns: &mut [f64], transposed: bool) {
        let m = self.layout.len();
        for column in columns.chunks_exact_mut(m) {
            let before = column.to_vec();
            for (i, value) in column.iter_mut().enumerate() {
                let entry = |j: usize| if transposed { self.matrix[(j, i)] } else { self.matrix[(i, j)] };
                *value = (0..m).map(|j| entry(j) * before[j]).sum();
            }
        }
    }
}

impl Model for MatrixModel {
    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }
    fn time_step(&self) -> Duration {
        WINDOW
    }
    fn largest_time_step_s(&self, _: &State) -> f64 {
        f64::INFINITY
    }
    fn step(&self, x: &mut State) {
        self.multiply(x.values_mut(), false);
        x.advance(WINDOW);
    }
}

impl TangentLinear for MatrixModel {
    fn step_tl(&self, _: &State, columns: &mut [f64]) {
        self.multiply(columns, false);
    }
}

impl Adjoint for MatrixModel {
    fn step_ad(&self, _: &State, columns: &mut [f64]) {
        self.multiply(columns, true);
    }
}

pub fn layout() -> Arc<Layout> {
    let variable =
        |name| Variable { name, long_name: name, standard_name: None, unit: "m", location: Location::Center };
    let grid = Grid { nx: 5, ny: 4, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
    Arc::new(Layout { grid, variables: vec![variable("h"), variable("w")] })
}

/// A model that mixes all values, or only those of a cell; in either case with norms below one.
pub fn model(layout: &Arc<Layout>, coupled: bool, seed: u64) -> MatrixModel {
    let m = layout.len();
    let cells = layout.grid.cells();
    let values = standard_normals(&mut stream(seed, "model"), m * m);
    let matrix = Mat::from_fn(m, m, |i, j| {
        let size = if coupled { 0.9 / (m as f64).sqrt() } else { 0.6 };
        if coupled || i % cells == j % cells { size * values[j * m + i] } else { 0.0 }
    });
    MatrixModel { layout: Arc::clone(layout), matrix }
}

/// White covariance with the given standard deviation of every variable.
pub fn white(layout: &Layout, sigma: f64) -> Arc<dyn Covariance> {
    let terms = (0..layout.variables.len())
        .map(|variable| Box::new(White::new(layout, variable, sigma)) as Box<dyn Covariance>)
        .collect();
    Arc::new(Sum::new(layout.len(), terms))
}

/// `shared` shared and `local` local bias parameters with the given drift.
pub fn calibration(shared: usize, local: usize, drift: f64) -> Calibration {
    let parameter = |number: usize| Parameter {
        name: format!("bias/{number}"),
        unit: "m".into(),
        // Mixed in order, so that no method can rely on one.
        placement: if number % 2 == 1 && number / 2 < local || number >= 2 * shared.max(1) {
            Placement::Local { x_m: 0.5 + (number / 2 % 5) as f64, y_m: 1.5 }
        } else {
            Placement::Shared
        },
        sigma_prior: 2.0 + 0.1 * number as f64,
        // Every second one that drifts goes back to its prior.
        drift: if drift > 0.0 && number % 4 > 1 {
            Drift::FirstOrder { sigma: 2.0 + 0.1 * number as f64, correlation_time: WINDOW * 3 }
        } else {
            Drift::RandomWalk { sigma_per_sqrt_day: drift }
        },
    };
    let mut parameters: Vec<Parameter> = (0..2 * shared.max(local)).map(parameter).collect();
    parameters.retain({
        let (mut shared_left, mut local_left) = (shared, local);
        move |parameter| {
            let left = if parameter.placement == Placement::Shared { &mut shared_left } else { &mut local_left };
            *left > 0 && {
                *left -= 1;
                true
            }
        }
    });
    Calibration { parameters, ..Calibration::default() }
}

pub fn problem(coupled: bool, calibration: Calibration, seed: u64) -> Problem {
    let layout = layout();
    Problem {
        model: Arc::new(model(&layout, coupled, seed)),
        background: State::zeros(&layout).valid_at(Time::from_seconds(0)),
        background_error: white(&layout, 1.5),
        model_error: Some(white(&layout, 0.4)),
        calibration,
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    }
}

/// Observations that read `values_read` values of one cell or of any, and one bias parameter; their values are random:
/// agreement of two methods does not need a truth.
pub fn window(problem: &Problem, count: usize, within_cell: bool, cycle: usize, seed: u64) -> ObservationWindow {
    let layout = problem.background.layout();
    let cells = layout.grid.cells();
    let random = &mut stream(seed, &format!("window {cycle}"));
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for row in 0..count {
        let cell = random.random_range(0..cells);
        let place =
            |random: &mut rand_chacha::ChaCha8Rng| if within_cell { cell } else { random.random_range(0..cells) };
        let variable = row % layout.variables.len();
        let first = place(random) + variable * cells;
        let second = if within_cell { cell + (1 - variable) * cells } else { (first + 1) % layout.len() };
        state.push_row([(first, 0.8), (second, 0.3)]);
        let p = problem.calibration.len();
        calibration.push_row((p > 0 && row % 4 != 0).then(|| {
            // A local parameter is read only in its own cell, as its station stands there.
            let number = random.random_range(0..p);
            let parameter = &problem.calibration.parameters[number];
            let allowed = match parameter.placement {
                Placement::Shared => number,
                Placement::Local { x_m, y_m } if !within_cell || layout.grid.cell_at(x_m, y_m) == cell => number,
                Placement::Local { .. } => 0,
            };
            (allowed, 1.0 + 0.2 * (row % 3) as f64)
        }));
    }
    let values: Vec<f64> = standard_normals(random, count).iter().map(|value| 3.0 * value).collect();
    ObservationWindow {
        time: Time::from_seconds(cycle as i64 * WINDOW.seconds()),
        cycle,
        reports: vec![
            Report { network: "n".into(), platform: "p".into(), variable: 0, x_m: 0.0, y_m: 0.0, scan: None };
            count
        ],
        times: vec![Time::from_seconds(cycle as i64 * WINDOW.seconds()); count],
        values,
        sigma: (0..count).map(|row| 0.5 + 0.1 * (row % 5) as f64).collect(),
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
    }
}

/// Forecast and analysis of a window; in the third there are no observations.
pub fn cycle(method: &mut dyn Assimilator, problem: &Problem, number: usize) -> Estimate {
    let from = method.forecast(WINDOW).unwrap();
    let count = if number == 3 { 0 } else { 14 };
    method.analyse(&from, &window(problem, count, false, number, 5)).unwrap().estimate
}

/// The Jacobian of observations by (x, c) at an estimate, `[n, m + p]`.
pub fn dense_jacobian(observed: &ObservationWindow, at: &Estimate) -> Mat<f64> {
    let (jacobian, m) = (observed.operator.linearize(&at.state, &at.calibration), at.state.values().len());
    let mut dense = Mat::zeros(observed.len(), m + at.calibration.len());
    for row in 0..observed.len() {
        jacobian.state.row(row).iter().for_each(|&(column, weight)| dense[(row, column)] += weight);
        jacobian.calibration.row(row).iter().for_each(|&(column, weight)| dense[(row, m + column)] += weight);
    }
    dense
}

/// The background before any forecast.
pub fn start(problem: &Problem) -> Background {
    let estimate = Estimate {
        state: problem.background.clone(),
        calibration: vec![0.0; problem.calibration.len()],
        state_spread: None,
        calibration_spread: None,
    };
    Background { estimate, window: Duration::from_seconds(0) }
}

/// A column of a method's covariance.
pub fn column(method: &dyn Assimilator, unknown: Unknown) -> Option<CovarianceColumn> {
    method.can().joint_errors?.covariance_column(unknown)
}

/// A method's covariance of the errors of (x, c), `[m + p, m + p]`, found column by column.
pub fn covariance_matrix(method: &dyn Assimilator, m: usize, p: usize) -> Mat<f64> {
    let unknowns = (0..m).map(Unknown::Value).chain((0..p).map(Unknown::Parameter));
    let columns: Vec<_> = unknowns.map(|unknown| column(method, unknown).unwrap()).collect();
    Mat::from_fn(m + p, m + p, |i, j| if i < m { columns[j].state[i] } else { columns[j].calibration[i - m] })
}

/// State and calibration of an estimate, and their standard deviations.
pub fn values_and_spread(estimate: &Estimate) -> [Vec<f64>; 2] {
    let values = estimate.state.values().iter().chain(&estimate.calibration).copied().collect();
    let spread = estimate.state_spread.iter().chain(&estimate.calibration_spread).flatten().copied().collect();
    [values, spread]
}

/// Largest relative difference of two estimates, in values and standard deviations.
pub fn estimate_difference(found: &Estimate, expected: &Estimate) -> f64 {
    let parts = values_and_spread(found).into_iter().zip(values_and_spread(expected));
    parts.map(|(found, expected)| relative_difference(&found, &expected)).fold(0.0, f64::max)
}

/// What a method knows of the calibration.
pub fn accuracy(method: &dyn Assimilator) -> Option<CalibrationAccuracy> {
    Some(method.can().calibration?.calibration_accuracy())
}

/// The lag of a method's smoother.
pub fn lag(method: &dyn Assimilator) -> Option<usize> {
    Some(method.can().smoother?.lag())
}

/// An earlier analysis given all observations so far.
pub fn smoothed(method: &dyn Assimilator, analyses_ago: usize) -> Option<Estimate> {
    method.can().smoother?.smoothed(analyses_ago).unwrap()
}

/// What a method has estimated beside state and calibration.
pub fn parameters(method: &dyn Assimilator) -> Vec<EstimatedParameter> {
    method.can().parameters.map_or_else(Vec::new, |it| it.estimated_parameters())
}

/// Widens the errors of a method's calibration.
pub fn widen(method: &mut dyn Assimilator, covariance: MatRef<'_, f64>) -> Result<(), Error> {
    method.adjust().widen().expect("the method can").widen_calibration(covariance)
}

/// max |a − b| / max |b|; max |a − b| where b is zero.
pub fn relative_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    let size = largest(&mut b.iter().map(|b| b.abs()));
    largest(&mut a.iter().zip(b).map(|(a, b)| (a - b).abs())) / if size > 0.0 { size } else { 1.0 }
}

pub fn flat(matrix: &Mat<f64>) -> Vec<f64> {
    (0..matrix.ncols()).flat_map(|j| matrix.col_as_slice(j).to_vec()).collect()
}

/// Balanced errors of shallow water on the plane of [`jet`].
pub fn balanced(layout: &Layout, sigma_height_m: f64, length_m: f64, beta_per_m_per_s: f64) -> Balanced {
    let parameters = BalancedParameters {
        sigma_height_m,
        length_m,
        gravity_m_per_s2: 9.8,
        coriolis_per_s: 1e-4,
        beta_per_m_per_s,
        balanced_at_walls: false,
    };
    Balanced::new(layout, &parameters).unwrap()
}

/// A jet of nonlinear shallow water on this number of cells on a side, and its model.
pub fn jet(
    cells: usize,
    step_s: i64,
    boundary: Boundary,
    beta_per_m_per_s: f64,
    hyperdiffusion_m4_per_s: f64,
) -> (Arc<Stepped<ShallowWater>>, State) {
    let spacing = 48e5 / cells as f64;
    let grid = Grid { nx: cells, ny: cells, dx_m: spacing, dy_m: spacing, boundary };
    let parameters = ShallowWaterParameters {
        gravity_m_per_s2: 9.8,
        coriolis_per_s: 1e-4,
        beta_per_m_per_s,
        hyperdiffusion_m4_per_s,
        ..Default::default()
    };
    let equations = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).unwrap();
    let jet =
        JetConfig { mean_depth_m: 1000.0, speed_m_per_s: 25.0, center_y_m: 24e5, width_m: 6e5, perturbation: None };
    let state = geostrophic_jet(&equations, &jet).unwrap();
    (Arc::new(Stepped::new(equations, Duration::from_seconds(step_s), TimeScheme::Rk4).unwrap()), state)
}

/// A jet in a channel, with hyperdiffusion.
pub fn channel_jet(cells: usize, step_s: i64) -> (Arc<Stepped<ShallowWater>>, State) {
    jet(cells, step_s, Boundary::Channel, 1.6e-11, 5e14)
}

/// Balanced and white errors.
pub fn errors(layout: &Layout, sigma_height_m: f64, length_m: f64, white: f64) -> Arc<dyn Covariance> {
    let mut terms: Vec<Box<dyn Covariance>> = vec![Box::new(balanced(layout, sigma_height_m, length_m, 1.6e-11))];
    terms.extend(
        [1.0, 0.1, 0.1].iter().enumerate().map(|(variable, factor)| -> Box<dyn Covariance> {
            Box::new(White::new(layout, variable, factor * white))
        }),
    );
    Arc::new(Sum::new(layout.len(), terms))
}

pub fn jet_problem(cells: usize) -> Problem {
    let (model, background) = channel_jet(cells, 600);
    let layout = background.layout().clone();
    Problem {
        model,
        background_error: errors(&layout, 20.0, 9e5, 1.0),
        model_error: Some(errors(&layout, 1.0, 5e5, 0.2)),
        background,
        calibration: calibration(2, 3, 0.1),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    }
}

/// Observations around the background, a small deviation from it.
pub fn around(problem: &Problem, cycle: usize) -> ObservationWindow {
    let observed = window(problem, 60, false, cycle, 5);
    let at = observed.operator.simulate(&problem.background, &vec![0.0; problem.calibration.len()]);
    let values: Vec<f64> = observed.values.iter().zip(&at).map(|(value, at)| value + at).collect();
    ObservationWindow { values, ..observed }
}
