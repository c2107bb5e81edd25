//! What is known of covariances that a model carries, of truncated covariances, and of biases that an analysis cannot see.

use faer::Mat;
use isobar_assim::covariance::{Covariance, Sum, Univariate, White};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::optimal_interpolation::OptimalInterpolation;
use isobar_assim::{Assimilator, Background, BiasTreatment, Estimate, Problem};
use isobar_model::{
    Adjoint, Advection, AdvectionScheme, Boundary, Duration, Grid, Layout, Location, Model, State, Stepped,
    TangentLinear, Time, TimeScheme, Variable, Wind,
};
use isobar_obs::{Calibration, Jacobian, LinearOperator, ObservationWindow, Parameter, Placement, Report, SparseRows};
use std::f64::consts::TAU;
use std::sync::Arc;

const STEP: Duration = Duration::from_seconds(3600);

/// An observation of zero: the cell, the parameter that it has, and the standard deviation of its error.
struct Observation(usize, Option<usize>, f64);

fn observe(rows: &[Observation]) -> ObservationWindow {
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for Observation(cell, parameter, _) in rows {
        state.push_row([(*cell, 1.0)]);
        calibration.push_row(parameter.map(|number| (number, 1.0)));
    }
    let report = Report { network: "n".into(), platform: "p".into(), variable: 0, x_m: 0.0, y_m: 0.0, scan: None };
    ObservationWindow {
        time: Time::from_seconds(0),
        cycle: 1,
        reports: vec![report; rows.len()],
        times: vec![Time::from_seconds(0); rows.len()],
        values: vec![0.0; rows.len()],
        sigma: rows.iter().map(|row| row.2).collect(),
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
    }
}

fn problem(model: Arc<dyn Adjoint>, background_error: Arc<dyn Covariance>, calibration: Calibration) -> Problem {
    Problem {
        background: State::zeros(model.layout()),
        model,
        background_error,
        model_error: None,
        calibration,
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    }
}

/// A plane on which upwind differences of first order carry a tracer by a quarter of a cell in a step.
fn upwind(nx: usize, ny: usize) -> Arc<dyn Adjoint> {
    let spacing = 4.0 * STEP.as_f64();
    let grid = Grid { nx, ny, dx_m: spacing, dy_m: spacing, boundary: Boundary::Periodic };
    let wind = Wind::Uniform { u_m_per_s: 1.0, v_m_per_s: 0.0 };
    let advection = Advection::new(grid, &wind, AdvectionScheme::FirstOrderUpwind).unwrap();
    Arc::new(Stepped::new(advection, STEP, TimeScheme::Rk4).unwrap())
}

/// |g(k)|² of a step of the Runge–Kutta scheme of fourth order, g = 1 + z + z²/2 + z³/6 + z⁴/24 with z = −c (1 − e^(−iθ)).
fn damping(courant: f64, theta: f64) -> f64 {
    let z = (-courant * (1.0 - theta.cos()), -courant * theta.sin());
    let multiply = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let (mut power, mut g) = ((1.0, 0.0), (1.0, 0.0));
    for divisor in 1..=4 {
        power = multiply(power, (z.0 / f64::from(divisor), z.1 / f64::from(divisor)));
        g = (g.0 + power.0, g.1 + power.1);
    }
    g.0 * g.0 + g.1 * g.1
}

/// The variance of homogeneous errors after n steps is the mean over all waves of S(k) |g(k)|^(2n): a scheme that damps short
/// waves takes variance that no observation has seen (Ménard 2000; Gilpin, Matsuo and Cohn 2022). The state may hardly show it.
#[test]
fn the_model_carries_homogeneous_variance_as_its_damping_says() {
    let (nx, ny, steps) = (64, 4, 12);
    let model = upwind(nx, ny);
    let layout = model.layout().clone();
    let cells = nx * ny;
    let width = layout.grid.dx_m;
    // Errors of little and of great length.
    for (length_cells, least, most) in [(1.0, 0.0, 0.55), (8.0, 0.9, 0.97)] {
        let terms: Vec<Box<dyn Covariance>> =
            vec![Box::new(Univariate::new(&layout, 0, 1.0, length_cells * width).unwrap())];
        let prior: Arc<dyn Covariance> = Arc::new(Sum::new(cells, terms));
        let row = isobar_assim::covariance::block(&*prior, &(0..cells).collect::<Vec<_>>());
        // The spectrum over x, whatever the wave in y: the wind does not know it.
        let spectrum = |k: usize| -> f64 {
            (0..nx).map(|i| row[(0, i)] * (TAU * (k * i) as f64 / nx as f64).cos()).sum::<f64>() / nx as f64
        };
        let expected: f64 = (0..nx).map(|k| spectrum(k) * damping(0.25, TAU * k as f64 / nx as f64).powi(steps)).sum();
        let mut filter = KalmanFilter::new(problem(model.clone(), prior, Calibration::default())).unwrap();
        let window = Duration::from_seconds(i64::from(steps) * STEP.seconds());
        let spread = filter.forecast(window).unwrap().estimate.state_spread.unwrap();
        for sigma in &spread {
            assert!((sigma * sigma / expected - 1.0).abs() < 1e-9, "{} and {expected}", sigma * sigma);
        }
        assert!(least < expected && expected < most, "{length_cells} cells: {expected}");
    }
    // Meanwhile a state of the scale of the domain has lost little.
    assert!(damping(0.25, TAU / nx as f64).powi(steps) > 0.96);
}

/// A covariance of two blocks with so much between them.
struct Blocks {
    root: Mat<f64>,
}

impl Blocks {
    fn new(size: usize, between: f64) -> Self {
        let half = size / 2;
        let entry = |i: usize, j: usize| {
            let own = (-(i.abs_diff(j) as f64 / 3.0)).exp();
            own * if (i < half) == (j < half) { 1.0 } else { between }
        };
        let root = Mat::from_fn(size, size, entry).llt(faer::Side::Lower).unwrap().L().to_owned();
        Self { root }
    }
}

impl Covariance for Blocks {
    fn len(&self) -> usize {
        self.root.nrows()
    }
    fn control_len(&self) -> usize {
        self.root.nrows()
    }
    fn root_add(&self, control: &[f64], increment: &mut [f64]) {
        for (i, value) in increment.iter_mut().enumerate() {
            *value += (0..=i).map(|j| self.root[(i, j)] * control[j]).sum::<f64>();
        }
    }
    fn root_transpose_add(&self, increment: &[f64], control: &mut [f64]) {
        for (j, value) in control.iter_mut().enumerate() {
            *value += (j..increment.len()).map(|i| self.root[(i, j)] * increment[i]).sum::<f64>();
        }
    }
}

/// A plane of nx × ny cells, x' = factor x + constant.
struct Affine {
    layout: Arc<Layout>,
    factor: f64,
    constant: f64,
}

fn affine(nx: usize, ny: usize, factor: f64, constant: f64) -> Arc<dyn Adjoint> {
    let grid = Grid { nx, ny, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
    let variable = Variable { name: "x", long_name: "x", standard_name: None, unit: "1", location: Location::Center };
    Arc::new(Affine { layout: Arc::new(Layout { grid, variables: vec![variable] }), factor, constant })
}

impl Model for Affine {
    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }
    fn time_step(&self) -> Duration {
        STEP
    }
    fn largest_time_step_s(&self, _: &State) -> f64 {
        f64::INFINITY
    }
    fn step(&self, x: &mut State) {
        x.values_mut().iter_mut().for_each(|value| *value = self.factor * *value + self.constant);
    }
}

impl TangentLinear for Affine {
    fn step_tl(&self, _: &State, columns: &mut [f64]) {
        columns.iter_mut().for_each(|value| *value *= self.factor);
    }
}

impl Adjoint for Affine {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        self.step_tl(at, columns);
    }
}

/// Leaving out the covariance between blocks, of size ε, costs ε² within them.
#[test]
fn truncation_to_blocks_costs_the_square_of_what_is_dropped() {
    let model = affine(5, 4, 1.0, 0.0);
    let sigma = |cell: usize| 0.4 + 0.02 * cell as f64;
    let rows: Vec<Observation> = (0..20).step_by(3).map(|cell| Observation(cell, None, sigma(cell))).collect();
    let observed = observe(&rows);
    let analysed = |between: f64| {
        let prior = Arc::new(Blocks::new(20, between));
        let mut filter = KalmanFilter::new(problem(model.clone(), prior, Calibration::default())).unwrap();
        let background = State::zeros(model.layout());
        let none = || None;
        let estimate =
            Estimate { state: background, calibration: Vec::new(), state_spread: none(), calibration_spread: none() };
        filter.analyse(&Background { estimate, window: STEP }, &observed).unwrap();
        filter.covariance().to_owned()
    };
    let truncated = analysed(0.0);
    let cost = |between: f64| {
        let whole = analysed(between);
        let within = |i: usize, j: usize| (i < 10) == (j < 10);
        let pairs = (0..20).flat_map(|i| (0..20).map(move |j| (i, j))).filter(|&(i, j)| within(i, j));
        pairs.map(|(i, j)| (whole[(i, j)] - truncated[(i, j)]).powi(2)).sum::<f64>().sqrt()
    };
    for between in [0.4, 0.2, 0.1, 0.05] {
        let order = (cost(between) / cost(0.5 * between)).log2();
        assert!((1.8..=2.1).contains(&order), "{between}: order {order}");
    }
}

/// A model drifts towards a climate m of its own, x' = (1 − g) x + g m, about a true zero. Observations whose bias is found
/// from O − B anew in each cycle tell nothing of it; anchors have the weight w. The background's bias is (Eyre 2016)
///
/// ```text
/// b = m g / [1 − (1 − g) (1 − w)]
/// ```
///
/// 0.345 m with g = 0.05 and w = 0.1, and all of m without anchors.
#[test]
fn observations_that_are_corrected_towards_the_background_keep_its_bias() {
    let (g, climate) = (0.05, 7.0);
    let bias = Parameter {
        name: "bias".into(),
        unit: "1".into(),
        placement: Placement::Shared,
        sigma_prior: 1e6,
        drift: isobar_obs::Drift::RandomWalk { sigma_per_sqrt_day: 1e6 },
    };
    let background_bias = |weight: f64| {
        let model = affine(1, 1, 1.0 - g, g * climate);
        let prior = Arc::new(Sum::new(1, vec![Box::new(White::new(model.layout(), 0, 1.0)) as Box<dyn Covariance>]));
        let calibration = Calibration { parameters: vec![bias.clone()], ..Calibration::default() };
        let mut method = OptimalInterpolation::new(problem(model, prior, calibration), 1.0).unwrap();
        // An anchor of variance r has the weight 1/(1 + r); the other observation is far more accurate, and of no use.
        let anchor = (1.0 / weight - 1.0).sqrt();
        let observed = observe(&[Observation(0, None, anchor), Observation(0, Some(0), 0.01)]);
        let mut last = 0.0;
        for _ in 0..2000 {
            let background = method.forecast(STEP).unwrap();
            last = background.estimate.state.values()[0];
            method.analyse(&background, &observed).unwrap();
        }
        last / climate
    };
    for weight in [0.1, 0.5, 1e-6] {
        let expected = g / (1.0 - (1.0 - g) * (1.0 - weight));
        let found = background_bias(weight);
        assert!((found / expected - 1.0).abs() < 1e-5, "{weight}: {found}, not {expected}");
    }
    assert!((background_bias(0.1) - 0.345).abs() < 5e-4 && background_bias(1e-6) > 0.999);
}
