//! Cost of an analysis of the local ensemble transform Kalman filter by the size of the grid.
//!
//! A tracer on doubly periodic planes with one observation for each 16 cells, at random places; each analysis has the
//! observations within 12 cells, on average 28.
//!
//! `cargo bench -p isobar-assim --bench letkf`, or with sizes and settings:
//! `cargo bench -p isobar-assim --bench letkf -- 256x128 512x512 members=80 threads=1 analyses=5 spacing=2 radius=12`.
//!
//! For each size: the least seconds of some analyses, and the most memory that the filter takes in them, its ensemble included,
//! in sizes of that. From the first size to the last the exponent of the seconds by the number of cells.

use isobar_assim::covariance::Univariate;
use isobar_assim::ensemble::{EnsembleSettings, LocalEnsembleTransformKalmanFilter, LocalSettings};
use isobar_assim::testing::Still;
use isobar_assim::{Assimilator, BiasTreatment, Problem, reserve_workspace};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, Duration, Grid, Layout, Location, Model, State, Time, Variable};
use isobar_obs::{Calibration, Jacobian, LinearOperator, ObservationWindow, Report, SparseRows};
use peak_alloc::PeakAlloc;
use rand::RngExt;
use std::sync::Arc;
use std::time::Instant;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

const TRACER: Variable =
    Variable { name: "tracer", long_name: "tracer", standard_name: None, unit: "1", location: Location::Center };

const CELLS_FOR_EACH_OBSERVATION: usize = 16;

/// What the command line asks for.
struct Request {
    sizes: Vec<[usize; 2]>,
    members: usize,
    threads: usize,
    analyses: usize,
    /// Every how many cells an analysis is made.
    spacing: usize,
    /// Localisation \[cells\].
    radius: usize,
}

fn main() {
    let request = request();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(request.threads).build().expect("a pool of threads");
    println!(
        "{} members, observations within {} cells, an analysis every {} cells, {} threads",
        request.members,
        request.radius,
        request.spacing,
        pool.current_num_threads()
    );
    println!("        cells  observations  ensemble MB  analysis s  memory MB  memory/ensemble");
    let costs: Vec<(f64, f64)> =
        request.sizes.iter().map(|&[nx, ny]| pool.install(|| measure(nx, ny, &request))).collect();
    if let [(first, first_s), .., (last, last_s)] = costs.as_slice() {
        let exponent = (last_s / first_s).ln() / (last / first).ln();
        println!("seconds grow with the number of cells to the power {exponent:.3}");
    }
}

fn request() -> Request {
    let mut request = Request { sizes: Vec::new(), members: 40, threads: 0, analyses: 3, spacing: 1, radius: 12 };
    for argument in std::env::args().skip(1) {
        let number = |text: &str| text.parse().unwrap_or_else(|_| panic!("{argument} is not a whole number"));
        match argument.split_once('=') {
            Some(("members", value)) => request.members = number(value),
            Some(("threads", value)) => request.threads = number(value),
            Some(("analyses", value)) => request.analyses = number(value),
            Some(("spacing", value)) => request.spacing = number(value),
            Some(("radius", value)) => request.radius = number(value),
            // Cargo's own.
            _ if argument == "--bench" => {}
            _ => {
                let (nx, ny) =
                    argument.split_once('x').unwrap_or_else(|| panic!("{argument} is not a size like 256x128"));
                request.sizes.push([number(nx), number(ny)]);
            }
        }
    }
    if request.sizes.is_empty() {
        request.sizes = vec![[256, 128], [512, 256]];
    }
    request
}

/// Prints a line; returns the number of cells and the seconds.
fn measure(nx: usize, ny: usize, request: &Request) -> (f64, f64) {
    let grid = Grid { nx, ny, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Periodic };
    let layout = Arc::new(Layout { grid, variables: vec![TRACER] });
    let background_error = Univariate::new(&layout, 0, 1.0, 5.0).expect("a covariance");
    let problem: Problem<dyn Model> = Problem {
        model: Arc::new(Still(Arc::clone(&layout))),
        background: State::zeros(&layout),
        background_error: Arc::new(background_error),
        model_error: None,
        calibration: Calibration::default(),
        bias: BiasTreatment::Ignore,
        memory_limit_bytes: u64::MAX,
        most_observations: 0,
    };
    let observed = observations(&layout, nx * ny / CELLS_FOR_EACH_OBSERVATION);
    let local = LocalSettings { localization_radius_m: request.radius as f64, analysis_spacing_cells: request.spacing };
    reserve_workspace();
    let settings = EnsembleSettings::new(request.members, 1.02);
    let mut filter = LocalEnsembleTransformKalmanFilter::new(problem, settings, local).expect("a filter");
    let from_filter = filter.forecast(Duration::from_seconds(60)).expect("a forecast");
    MEMORY.reset_peak_usage();
    let (before, mut seconds) = (MEMORY.current_usage(), f64::INFINITY);
    for _ in 0..request.analyses {
        let mut filter = filter.clone();
        let began = Instant::now();
        filter.analyse(&from_filter, &observed).expect("an analysis");
        seconds = seconds.min(began.elapsed().as_secs_f64());
    }
    let ensemble = (nx * ny * request.members * 8) as f64;
    let memory = (MEMORY.peak_usage() - before) as f64;
    println!(
        "{nx:7} x {ny:4} {:12} {:12.1} {seconds:11.4} {:10.1} {:16.2}",
        observed.len(),
        ensemble / 1e6,
        memory / 1e6,
        memory / ensemble
    );
    ((nx * ny) as f64, seconds)
}

/// Of single points at random places.
fn observations(layout: &Layout, count: usize) -> ObservationWindow {
    let random = &mut stream(1, "places");
    let places: Vec<(f64, f64)> = (0..count)
        .map(|_| (random.random::<f64>() * layout.grid.width_m(), random.random::<f64>() * layout.grid.height_m()))
        .collect();
    let (mut state, mut calibration) = (SparseRows::new(), SparseRows::new());
    for &(x_m, y_m) in &places {
        state.push_row(layout.grid.stencil(Location::Center, x_m, y_m).expect("a point of the domain").entries);
        calibration.push_row([]);
    }
    let report =
        |&(x_m, y_m)| Report { network: "points".into(), platform: "point".into(), variable: 0, x_m, y_m, scan: None };
    ObservationWindow {
        time: Time::from_seconds(60),
        cycle: 1,
        reports: places.iter().map(report).collect(),
        times: vec![Time::from_seconds(60); count],
        values: standard_normals(random, count),
        sigma: vec![0.3; count],
        error_regression: Default::default(),
        aside: Default::default(),
        comparisons: Vec::new(),
        operator: Arc::new(LinearOperator { jacobian: Jacobian { state, calibration } }),
    }
}
