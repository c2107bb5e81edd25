//! Errors, claims and cost of the Fast Kalman Filter with local factors, all of one run.
//!
//! The experiment of the scenarios `growth_4000`, `growth_8000` and `growth_12000`, with other random numbers: linear shallow
//! water on n × n cells of 200 km, cycles of 3 hours, and observations in proportion to the area.
//!
//! `cargo bench -p isobar-assim --bench local`, or with settings:
//! `cargo bench -p isobar-assim --bench local -- side=40 cycles=60 seeds=3 per_tile=8 model_error_per_tile=16 support=4 mixed=0
//! left_over=blocks probes=8 threads=2 single`, where `probes=0` lets the residual persist. In its place, `factors=160` is a filter
//! with as many factors of the whole domain, and `kf` the full Kalman filter, which takes half an hour for `side=40`.
//!
//! For each seed, over the last two thirds of the cycles: the errors of h and u, their claims, and what these are above the
//! errors; the medians of the seconds of a cycle, and of its tangent-linear runs alone, measured between the cycles.

mod common;

use common::{PROBES, covariance, small, with_factors};
use isobar_assim::covariance::randomize;
use isobar_assim::fast_kalman::{BlockShape, FastKalmanFilter, Precision, Residual};
use isobar_assim::kalman::KalmanFilter;
use isobar_assim::local_factors::{LeftOver, LocalFactorSettings, LocalFastKalmanFilter};
use isobar_assim::{Assimilator, BiasTreatment, Problem, reserve_workspace};
use isobar_model::forecast::{forecast, forecast_tl};
use isobar_model::random::stream;
use isobar_model::{
    Boundary, Duration, Grid, LinearShallowWater, Model, ShallowWater, ShallowWaterParameters, State, Stepped, Time,
    TimeScheme, VectorInvariant,
};
use isobar_obs::{
    AssumedDrift, BiasProcess, BiasScope, Heading, InitialBias, Network, ObservedVariable, ObservingSystem,
    RadiosondeSettings, SatelliteSettings, ScanBias, ScanTerm, Schedule, StationBias, StationSource,
};
use std::sync::Arc;
use std::time::Instant;

const SPACING_M: f64 = 2e5;
const WINDOW: Duration = Duration::from_seconds(3 * 3600);
const TIME_STEP: Duration = Duration::from_seconds(600);
const STEPS: usize = 18;

/// What the command line asks for.
struct Request {
    side: usize,
    cycles: usize,
    seeds: u64,
    settings: LocalFactorSettings,
    threads: usize,
    /// In place of local factors, as many of the whole domain; 0 for none.
    factors: usize,
    kalman: bool,
}

fn main() {
    let request = request();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(request.threads).build().expect("a pool of threads");
    println!("seed  columns   h error   claim           u error    claim           s/cycle  tangent s  cycle/tangent");
    let all: Vec<[f64; 6]> = (1..=request.seeds).map(|seed| pool.install(|| measure(&request, seed))).collect();
    if let [_, _, ..] = all.as_slice() {
        let mean = |i: usize| all.iter().map(|of_seed| of_seed[i]).sum::<f64>() / all.len() as f64;
        print_line("mean", "", &std::array::from_fn(mean));
    }
}

fn print_line(seed: &str, columns: &str, values: &[f64; 6]) {
    let [h, h_claim, u, u_claim, cycle_s, tangent_s] = values;
    println!(
        "{seed:>4} {columns:>8} {h:9.4} {h_claim:9.4} ({:+5.1} %) {u:9.4} {u_claim:9.4} ({:+5.1} %) {cycle_s:9.4} {tangent_s:9.4} {:9.2}",
        100.0 * (h_claim / h - 1.0),
        100.0 * (u_claim / u - 1.0),
        cycle_s / tangent_s
    );
}

/// # Panics
/// On an unknown argument.
fn request() -> Request {
    let settings = LocalFactorSettings {
        blocks: BlockShape::Cell,
        per_tile: 8,
        model_error_per_tile: 16,
        tile_m: 1e6,
        support_tiles: 4,
        mixed: 0,
        left_over: LeftOver::Factors,
        factor_precision: Precision::Double,
        largest_component: usize::MAX,
        residual: Residual::Probe { count: PROBES },
    };
    let mut request = Request { side: 40, cycles: 60, seeds: 1, settings, threads: 0, factors: 0, kalman: false };
    for argument in std::env::args().skip(1) {
        let number = |text: &str| text.parse().unwrap_or_else(|_| panic!("{argument} is not a whole number"));
        let settings = &mut request.settings;
        match argument.split_once('=') {
            Some(("side", value)) => request.side = number(value),
            Some(("cycles", value)) => request.cycles = number(value),
            Some(("seeds", value)) => request.seeds = number(value) as u64,
            Some(("factors", value)) => request.factors = number(value),
            Some(("threads", value)) => request.threads = number(value),
            Some(("per_tile", value)) => settings.per_tile = number(value),
            Some(("model_error_per_tile", value)) => settings.model_error_per_tile = number(value),
            Some(("support", value)) => settings.support_tiles = number(value),
            Some(("mixed", value)) => settings.mixed = number(value),
            Some(("left_over", "blocks")) => settings.left_over = LeftOver::Blocks,
            Some(("probes", "0")) => settings.residual = Residual::Persist,
            Some(("probes", value)) => settings.residual = Residual::Probe { count: number(value) },
            _ if argument == "kf" => request.kalman = true,
            _ if argument == "single" => settings.factor_precision = Precision::Single,
            // Cargo's own.
            _ if argument == "--bench" => {}
            _ => panic!("unknown argument {argument}"),
        }
    }
    request
}

/// Runs one seed and prints its line.
fn measure(request: &Request, seed: u64) -> [f64; 6] {
    let (problem, mut observing) = experiment(request.side, seed);
    let layout = problem.background.layout().clone();
    let cells = layout.grid.cells();
    let random = &mut stream(seed, "truth");
    let mut truth = problem.background.clone();
    add(&mut truth, &randomize(&*problem.background_error, random));
    let model_error = problem.model_error.clone().expect("a model error");
    reserve_workspace();
    let (mut filter, columns): (Box<dyn Assimilator>, usize) = if request.kalman {
        (Box::new(KalmanFilter::new(problem.clone()).expect("a filter")), 3 * cells)
    } else if request.factors > 0 {
        let filter = FastKalmanFilter::new(problem.clone(), with_factors(request.factors)).expect("a filter");
        (Box::new(filter), request.factors + problem.calibration.len() + PROBES)
    } else {
        let filter = LocalFastKalmanFilter::with_local_factors(problem.clone(), request.settings).expect("a filter");
        let columns = filter.propagated_columns();
        (Box::new(filter), columns)
    };
    let (mut sums, mut scored, mut seconds, mut tangent_s) = ([0.0; 4], 0, Vec::new(), Vec::new());
    let mut increments = vec![0.0; 3 * cells * columns];
    for cycle in 1..=request.cycles {
        forecast(&*problem.model, &mut truth, STEPS).expect("a forecast");
        add(&mut truth, &randomize(&*model_error, random));
        let observed = observing.observe(&truth);
        let began = Instant::now();
        let background = filter.forecast(WINDOW).expect("a forecast");
        let analysis = filter.analyse(&background, &observed).expect("an analysis").estimate;
        seconds.push(began.elapsed().as_secs_f64());
        if cycle % 6 == 0 && !request.kalman {
            increments.iter_mut().enumerate().for_each(|(index, value)| *value = small(index));
            let mut state = problem.background.clone();
            let began = Instant::now();
            forecast_tl(&*problem.model, &mut state, &mut increments, STEPS).expect("a forecast");
            tangent_s.push(began.elapsed().as_secs_f64());
        }
        if 3 * cycle > request.cycles {
            scored += 1;
            let spread = analysis.state_spread.expect("a spread");
            for variable in [0, 1] {
                let range = variable * cells..(variable + 1) * cells;
                let pairs = analysis.state.values()[range.clone()].iter().zip(&truth.values()[range.clone()]);
                sums[2 * variable] += pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / cells as f64;
                sums[2 * variable + 1] += spread[range].iter().map(|sigma| sigma * sigma).sum::<f64>() / cells as f64;
            }
        }
    }
    let [h, h_claim, u, u_claim] = sums.map(|sum: f64| (sum / f64::from(scored)).sqrt());
    let values = [h, h_claim, u, u_claim, median(seconds), median(tangent_s)];
    print_line(&seed.to_string(), &columns.to_string(), &values);
    values
}

/// The middle one: whatever else the machine does counts less than in a mean.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn add(state: &mut State, increment: &[f64]) {
    state.values_mut().iter_mut().zip(increment).for_each(|(value, change)| *value += change);
}

fn experiment(side: usize, seed: u64) -> (Problem, ObservingSystem) {
    let grid = Grid { nx: side, ny: side, dx_m: SPACING_M, dy_m: SPACING_M, boundary: Boundary::Periodic };
    let parameters =
        ShallowWaterParameters { gravity_m_per_s2: 9.8, coriolis_per_s: 1e-4, ..ShallowWaterParameters::default() };
    let equations = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).expect("a model");
    let equations = LinearShallowWater::about_uniform_flow(equations, 1000.0, 20.0).expect("a flow");
    let model = Stepped::new(equations, TIME_STEP, TimeScheme::Rk4).expect("a scheme");
    let layout = model.layout().clone();
    let observing = ObservingSystem::new(&layout, None, &instruments(side), seed, WINDOW, Time::from_seconds(0));
    let observing = observing.expect("instruments");
    let problem: Problem = Problem {
        model: Arc::new(model),
        background: State::zeros(&layout),
        background_error: covariance(&layout, 20.0, 8e5, 3.0),
        model_error: Some(covariance(&layout, 2.0, 5e5, 0.3)),
        calibration: observing.calibration().clone(),
        bias: BiasTreatment::Estimate,
        memory_limit_bytes: 16 << 30,
        most_observations: 0,
    };
    (problem, observing)
}

fn instruments(side: usize) -> [Network; 2] {
    let groups = ["A", "B", "C", "D", "E", "F"].map(str::to_string).to_vec();
    let bias = |initial: InitialBias, sigma_prior: f64| BiasProcess {
        initial,
        assumed_sigma_prior: Some(sigma_prior),
        assumed_drift: Some(AssumedDrift::RandomWalk { sigma_per_sqrt_day: 0.09 }),
        ..BiasProcess::constant(sigma_prior)
    };
    let mut sondes = RadiosondeSettings::new(StationSource::Random { count: side * side * 3 / 40, groups });
    sondes.reference_groups = vec!["A".into()];
    let observed = |variable: &str, sigma: f64| ObservedVariable::new(variable, sigma);
    sondes.variables = vec![observed("h", 5.0), observed("u", 2.0), observed("v", 2.0)];
    let process = bias(InitialBias::Drawn { sigma: 8.0 }, 10.0);
    sondes.biases = vec![StationBias { variable: "h".into(), scope: BiasScope::EachGroup, process }];
    let scan = |term, value, sigma| ScanBias { term, process: bias(InitialBias::Given { value }, sigma) };
    let satellite = SatelliteSettings {
        variable: observed("h", 6.0),
        swath_width_m: 0.45 * side as f64 * SPACING_M,
        scan_positions: side / 2,
        along_track_spacing_m: 650e3,
        footprint_sigma_m: 0.0,
        crossing_x_m: 0.1 * side as f64 * SPACING_M,
        shift_per_cycle_m: 0.375 * side as f64 * SPACING_M,
        heading: Heading::Northward,
        track_angle_deg: 0.0,
        biases: vec![scan(ScanTerm::Offset, 10.0, 10.0), scan(ScanTerm::Linear, 6.0, 7.0)],
        air_mass_biases: Vec::new(),
    };
    let mut sondes = Network::new("sondes", sondes);
    sondes.schedule = Schedule { every_cycles: 2, first_cycle: 1 };
    [sondes, Network::new("polar", satellite)]
}
