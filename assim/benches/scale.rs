//! Cost of the Fast Kalman Filter with common factors by the size of the grid.
//!
//! Nonlinear shallow water on doubly periodic grids of n × n cells of 5 km, steps of 40 s, cycles of half an hour, and
//! the same number of observations per cell at every size: soundings three cells apart over nine tenths of the domain, and a
//! sonde for each 170 cells, five of six with a bias of their own. The *spacing* is fixed, not the domain: the time step
//! follows the spacing, so that a cycle has 45 steps at every size, and what grows is the number of variables alone. The
//! number of factors is fixed too, although a larger domain would want more of them.
//!
//! `cargo bench -p isobar-assim --bench scale`, or with sizes and settings:
//! `cargo bench -p isobar-assim --bench scale -- 64 128 factors=80 threads=1 cycles=3 grid=2 single kf`, where `grid` is the
//! width in cells of those on which the factors are propagated, and with `single` each size is measured with factors in
//! double precision and then with factors in single.
//!
//! For each size: seconds of a cycle; of as many tangent-linear runs as the cycle has, measured alone; of the rest of the
//! forecast (compression) and of the analysis; the most memory that the filter took, setting it up included, over that
//! of Φ in double precision; and, with `kf`, the full Kalman filter's time. From the first size to the last the exponent of
//! the cost by the number of variables.

mod common;

use common::{PROBES, covariance, small, with_factors};
use isobar_assim::fast_kalman::{FastKalmanFilter, FastKalmanSettings, Precision};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::{Assimilator, BiasTreatment, Problem, reserve_workspace};
use isobar_model::forecast::forecast_tl;
use isobar_model::initial::{JetConfig, geostrophic_jet};
use isobar_model::{
    Boundary, Duration, Grid, ShallowWater, ShallowWaterParameters, State, Stepped, Stored, Time, TimeScheme,
    VectorInvariant,
};
use isobar_obs::{
    BiasProcess, BiasScope, Heading, Network, ObservedVariable, ObservingSystem, RadiosondeSettings, SatelliteSettings,
    ScanBias, ScanTerm, StationBias, StationSource,
};
use peak_alloc::PeakAlloc;
use std::sync::Arc;
use std::time::Instant;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

const SPACING_M: f64 = 5e3;
const WINDOW: Duration = Duration::from_seconds(1800);

/// Steps of a cycle, by how many times as wide the cells of a grid are; 0 for widths that are not measured.
const WINDOW_STEPS: [usize; 9] = [0, 45, 24, 0, 12, 0, 0, 0, 6];

/// What takes longer is measured once \[s\].
const PATIENCE_S: f64 = 10.0;

/// What the command line asks for.
struct Request {
    sizes: Vec<usize>,
    /// Common factors, those of the two shared biases included.
    factors: usize,
    threads: usize,
    cycles: usize,
    /// Cells on a side of those on which the factors are propagated.
    grid: usize,
    /// Whether factors in single precision are measured beside those in double.
    single: bool,
    kalman: bool,
}

/// Seconds of a cycle and of its tangent-linear runs, and memory.
struct Cost {
    variables: f64,
    cycle_s: f64,
    tangent_s: f64,
    memory: f64,
}

fn main() {
    let request = request();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(request.threads).build().expect("a pool of threads");
    println!(
        "r = {}, factors on a grid {} times as wide, {} threads, {} cycles of {} steps",
        request.factors,
        request.grid,
        pool.current_num_threads(),
        request.cycles,
        WINDOW_STEPS[1]
    );
    println!(
        "    n  variables    obs  biases   cycle s  tangent s  compression s  analysis s  cycle/tangent  memory MB  \
         memory/Φ  setup s"
    );
    let measure = |n: usize| {
        let double = measure::<f64>(n, Precision::Double, &request);
        if request.single {
            let single = measure::<f32>(n, Precision::Single, &request);
            println!(
                "      single / double: cycle {:.2}, tangent {:.2}, memory {:.2}",
                single.cycle_s / double.cycle_s,
                single.tangent_s / double.tangent_s,
                single.memory / double.memory
            );
        }
        double
    };
    let costs: Vec<Cost> = request.sizes.iter().map(|&n| pool.install(|| measure(n))).collect();
    if let [first, .., last] = costs.as_slice() {
        let exponent = (last.cycle_s / first.cycle_s).ln() / (last.variables / first.variables).ln();
        println!("seconds per cycle grow with the number of variables to the power {exponent:.3}");
    }
}

fn request() -> Request {
    let mut request =
        Request { sizes: Vec::new(), factors: 64, threads: 0, cycles: 2, grid: 1, single: false, kalman: false };
    for argument in std::env::args().skip(1) {
        let number = |text: &str| text.parse().unwrap_or_else(|_| panic!("{argument} is not a whole number"));
        match argument.split_once('=') {
            Some(("factors", value)) => request.factors = number(value),
            Some(("threads", value)) => request.threads = number(value),
            Some(("cycles", value)) => request.cycles = number(value),
            Some(("grid", value)) => request.grid = number(value),
            _ if argument == "kf" => request.kalman = true,
            _ if argument == "single" => request.single = true,
            // Cargo's own.
            _ if argument == "--bench" => {}
            _ => request.sizes.push(number(&argument)),
        }
    }
    if request.sizes.is_empty() {
        request.sizes = vec![64, 128, 256, 512];
    }
    request
}

/// Prints a line for factors of this precision, S.
fn measure<S: Stored>(n: usize, factor_precision: Precision, request: &Request) -> Cost {
    let (problem, mut observing) = experiment(n);
    let m = problem.background.values().len();
    let tangent_s = tangent_linear_s::<S>(&problem, request.factors + PROBES);
    reserve_workspace();
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage();
    let began = Instant::now();
    let settings = with_factors(request.factors - 2);
    let settings = FastKalmanSettings { largest_component: usize::MAX, factor_precision, ..settings };
    let mut filter = FastKalmanFilter::new(problem.clone(), settings).expect("a filter");
    if request.grid > 1 {
        let model = model(n / request.grid, request.grid as f64 * SPACING_M, WINDOW_STEPS[request.grid]);
        filter = filter.with_factors_on(Arc::new(model)).expect("a coarser grid");
    }
    let setup_s = began.elapsed().as_secs_f64();
    let (mut forecast_s, mut analysis_s, mut observations) = (f64::INFINITY, f64::INFINITY, 0);
    let mut cycles = 0;
    while cycles < request.cycles && (cycles == 0 || forecast_s < PATIENCE_S) {
        cycles += 1;
        // The truth has no influence on the cost.
        let observed = observing.observe(&problem.background);
        let began = Instant::now();
        let from_filter = filter.forecast(WINDOW).expect("a forecast");
        forecast_s = forecast_s.min(began.elapsed().as_secs_f64());
        let began = Instant::now();
        filter.analyse(&from_filter, &observed).expect("an analysis");
        analysis_s = analysis_s.min(began.elapsed().as_secs_f64());
        observations = observed.len();
    }
    let memory = (MEMORY.peak_usage() - before) as f64;
    let factors_bytes = ((m + problem.calibration.len()) * request.factors * 8) as f64;
    drop(filter);
    let cycle_s = forecast_s + analysis_s;
    println!(
        "{n:5} {m:10} {observations:6} {:7} {cycle_s:9.3} {tangent_s:10.3} {:14.3} {analysis_s:11.3} {:14.2} {:10.1} {:9.2} \
         {setup_s:8.2}",
        problem.calibration.len(),
        forecast_s - tangent_s,
        cycle_s / tangent_s,
        memory / 1e6,
        memory / factors_bytes,
    );
    if request.kalman {
        let observed = observing.observe(&problem.background);
        let mut kalman = KalmanFilter::new(problem).expect("a Kalman filter");
        let began = Instant::now();
        let from_kalman = kalman.forecast(WINDOW).expect("a forecast");
        kalman.analyse(&from_kalman, &observed).expect("an analysis");
        let seconds = began.elapsed().as_secs_f64();
        println!("      full Kalman filter {seconds:.2} s: {:.1} times the cycle", seconds / cycle_s);
    }
    Cost { variables: m as f64, cycle_s, tangent_s, memory }
}

/// Seconds of this number of tangent-linear runs over the window: the lesser of two measurements, if they do not take long.
fn tangent_linear_s<S: Stored>(problem: &Problem, columns: usize) -> f64 {
    let m = problem.background.values().len();
    let mut increments: Vec<S> = (0..m * columns).map(|index| S::narrow(small(index))).collect();
    let steps = WINDOW_STEPS[1];
    let run = |increments: &mut [S]| {
        let mut state = problem.background.clone();
        let began = Instant::now();
        forecast_tl(&*problem.model, &mut state, increments, steps).expect("a forecast");
        began.elapsed().as_secs_f64()
    };
    let first = run(&mut increments);
    if first > PATIENCE_S { first } else { first.min(run(&mut increments)) }
}

fn experiment(n: usize) -> (Problem, ObservingSystem) {
    let model = model(n, SPACING_M, WINDOW_STEPS[1]);
    let background = background(n);
    let layout = background.layout().clone();
    let mut observing =
        ObservingSystem::new(&layout, None, &instruments(n), 1, WINDOW, Time::from_seconds(0)).expect("instruments");
    let calibration = observing.calibration().clone();
    observing.observe(&background);
    let problem: Problem = Problem {
        model: Arc::new(model),
        background_error: covariance(&layout, 15.0, 8e5, 0.5),
        model_error: Some(covariance(&layout, 0.5, 6e5, 0.05)),
        background,
        calibration,
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 16 << 30,
        most_observations: 0,
    };
    (problem, observing)
}

fn model(n: usize, spacing_m: f64, steps: usize) -> Stepped<ShallowWater> {
    let step = Duration::from_seconds(WINDOW.seconds() / steps as i64);
    Stepped::new(equations(n, spacing_m), step, TimeScheme::Rk4).expect("a scheme")
}

fn equations(n: usize, spacing_m: f64) -> ShallowWater {
    let grid = Grid { nx: n, ny: n, dx_m: spacing_m, dy_m: spacing_m, boundary: Boundary::Periodic };
    let parameters = ShallowWaterParameters {
        gravity_m_per_s2: 9.8,
        coriolis_per_s: 1e-4,
        hyperdiffusion_m4_per_s: 5e9,
        ..Default::default()
    };
    ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).expect("a model")
}

/// A jet.
fn background(n: usize) -> State {
    let width = n as f64 * SPACING_M;
    let jet = JetConfig {
        mean_depth_m: 1000.0,
        speed_m_per_s: 10.0,
        center_y_m: 0.5 * width,
        width_m: 0.1 * width,
        perturbation: None,
    };
    geostrophic_jet(&equations(n, SPACING_M), &jet).expect("a state")
}

fn instruments(n: usize) -> [Network; 2] {
    let width_m = n as f64 * SPACING_M;
    let groups = ["A", "B", "C", "D", "E", "F"].map(str::to_string).to_vec();
    let stations = StationSource::Random { count: (n * n / 170).max(6), groups };
    let mut sondes = RadiosondeSettings::new(stations);
    sondes.reference_groups = vec!["A".into()];
    sondes.biases =
        vec![StationBias { variable: "h".into(), scope: BiasScope::EachStation, process: BiasProcess::constant(8.0) }];
    let bias = |term| ScanBias { term, process: BiasProcess::constant(7.0) };
    let spacing_m = 3.07 * SPACING_M;
    let positions = (0.9 * width_m / spacing_m) as usize;
    let satellite = SatelliteSettings {
        variable: ObservedVariable::new("h", 6.0),
        swath_width_m: (positions - 1) as f64 * spacing_m,
        scan_positions: positions,
        along_track_spacing_m: spacing_m,
        footprint_sigma_m: 0.0,
        crossing_x_m: 0.5 * width_m,
        shift_per_cycle_m: 0.3 * width_m,
        heading: Heading::Northward,
        track_angle_deg: 0.0,
        biases: vec![bias(ScanTerm::Offset), bias(ScanTerm::Linear)],
        air_mass_biases: Vec::new(),
    };
    [Network::new("sondes", sondes), Network::new("polar", satellite)]
}
