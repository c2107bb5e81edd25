//! What a cycle of every method costs, in one table: processor time and peak memory, and how they grow.
//!
//! `cargo bench -p isobar-assim --bench methods`, or with some of the [methods](list::METHODS), sizes and settings:
//! `cargo bench -p isobar-assim --bench methods -- kf fkf side=40 observations=150 factors=320 once`.
//!
//! | argument | meaning |
//! |---|---|
//! | a name | of a method; without any, all methods |
//! | `side=24` | cells on a side of the plane |
//! | `observations=256` | of a cycle |
//! | `members=40`, `factors=80`, `per_tile=8` | the size of a method that has one |
//! | `threads=1` | with more than one, seconds are those of the clock |
//! | `cycles=1` | the least number of cycles that are measured, after one that is not |
//! | `once` | no exponents |
//!
//! For each method: the seconds of a cycle, forecast and analysis; the most memory that it took, setting it up included; for
//! filters with common factors of the domain the seconds over those of the cycle's tangent-linear runs alone; the exponents
//! with which the seconds grow with the cells (from a plane of half as many on a side), the observations (from a quarter of
//! them), and the members or factors (from half of them).

#[path = "../common/mod.rs"]
mod common;
mod experiment;
mod list;

use common::small;
use experiment::{STEPS, WINDOW, observations, problem};
use isobar_assim::reserve_workspace;
use isobar_model::forecast::forecast_tl;
use isobar_obs::ObservationWindow;
use list::{METHODS, Method, SizeOf, propagated};
use peak_alloc::PeakAlloc;
use std::time::Instant;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// What the command line asks for.
struct Request {
    methods: Vec<&'static Method>,
    case: Case,
    members: usize,
    factors: usize,
    per_tile: usize,
    threads: usize,
    cycles: usize,
    once: bool,
}

/// What a method is measured on.
#[derive(Clone, Copy)]
struct Case {
    side: usize,
    observations: usize,
    /// Of the method; 0 for one without.
    size: usize,
}

struct Cost {
    seconds: f64,
    bytes: f64,
}

fn main() {
    let request = request();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(request.threads).build().expect("a pool of threads");
    pool.install(|| print_table(&request));
}

/// # Panics
/// On an unknown argument.
fn request() -> Request {
    let mut request = Request {
        methods: Vec::new(),
        case: Case { side: 24, observations: 256, size: 0 },
        members: SizeOf::Members.usual(),
        factors: SizeOf::Factors.usual(),
        per_tile: SizeOf::FactorsOfTile.usual(),
        threads: 1,
        cycles: 1,
        once: false,
    };
    for argument in std::env::args().skip(1) {
        let number = |text: &str| text.parse().unwrap_or_else(|_| panic!("{argument} is not a whole number"));
        match argument.split_once('=') {
            Some(("side", value)) => request.case.side = number(value),
            Some(("observations", value)) => request.case.observations = number(value),
            Some(("members", value)) => request.members = number(value),
            Some(("factors", value)) => request.factors = number(value),
            Some(("per_tile", value)) => request.per_tile = number(value),
            Some(("threads", value)) => request.threads = number(value),
            Some(("cycles", value)) => request.cycles = number(value),
            _ if argument == "once" => request.once = true,
            // Cargo's own.
            _ if argument == "--bench" => {}
            _ => {
                let found = METHODS.iter().find(|method| method.name == argument);
                let names = || METHODS.map(|method| method.name).join(", ");
                request.methods.push(found.unwrap_or_else(|| panic!("no method {argument}: there are {}", names())));
            }
        }
    }
    if request.methods.is_empty() {
        request.methods = METHODS.iter().collect();
    }
    request
}

fn print_table(request: &Request) {
    let Case { side, observations, .. } = request.case;
    let seconds = if request.threads == 1 { "of the processor" } else { "of the clock" };
    println!(
        "{side} x {side} cells ({} unknowns), {observations} observations a cycle, {} threads; seconds {seconds}",
        3 * side * side + 2,
        rayon::current_num_threads()
    );
    println!(
        "{:<22} {:>20} {:>9} {:>9} {:>8}   power of cells  observations  members or factors",
        "method", "size", "s/cycle", "MB", "tangent"
    );
    for method in &request.methods {
        let size = match method.size_of {
            Some(SizeOf::Members) => request.members,
            Some(SizeOf::Factors) => request.factors,
            Some(SizeOf::FactorsOfTile) => request.per_tile,
            None => 0,
        };
        let case = Case { size, ..request.case };
        let cost = measure(method, case, request.cycles);
        let named = method.size_of.map_or("–".into(), |of| format!("{size} {}", of.name()));
        let tangent = match method.size_of {
            Some(SizeOf::Factors) => format!("{:.2}", cost.seconds / tangent_linear_s(case)),
            _ => "–".into(),
        };
        print!("{:<22} {named:>20} {:9.2e} {:9.2} {tangent:>8}", method.name, cost.seconds, cost.bytes / 1e6);
        if request.once {
            println!();
            continue;
        }
        let exponent = |smaller: Case, ratio: f64| {
            let smaller = measure(method, smaller, request.cycles);
            (cost.seconds / smaller.seconds).ln() / ratio.ln()
        };
        let by_cells = exponent(Case { side: side / 2, ..case }, 4.0);
        let by_observations = exponent(Case { observations: observations / 4, ..case }, 4.0);
        let by_size = match method.size_of {
            Some(_) => format!("{:.2}", exponent(Case { size: size / 2, ..case }, 2.0)),
            None => "–".into(),
        };
        println!("   {by_cells:14.2}  {by_observations:12.2}  {by_size:>18}");
    }
}

/// Cycles are measured until they have taken this long \[s\]: Linux counts a thread's time in ticks.
const LEAST_S: f64 = 0.2;

/// Sets up a method and runs its cycles.
fn measure(method: &Method, case: Case, cycles: usize) -> Cost {
    let problem = problem(case.side, case.observations);
    let layout = problem.background.layout().clone();
    let observed = |cycle: usize| observations(&layout, case.observations, cycle);
    let windows: Vec<_> = (1..=cycles + 1).map(observed).collect();
    reserve_workspace();
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage();
    let mut filter = (method.build)(problem, case.size).unwrap_or_else(|error| panic!("{}: {error}", method.name));
    let mut cycle = |observed: &ObservationWindow| {
        let clock = Clock::start();
        let background = filter.forecast(WINDOW).unwrap_or_else(|error| panic!("{}: {error}", method.name));
        filter.analyse(&background, observed).unwrap_or_else(|error| panic!("{}: {error}", method.name));
        clock.seconds()
    };
    cycle(&windows[0]);
    let mut seconds: f64 = windows[1..].iter().map(&mut cycle).sum();
    let bytes = (MEMORY.peak_usage() - before) as f64;
    let mut measured = cycles;
    while seconds < LEAST_S {
        measured += 1;
        seconds += cycle(&observed(measured + 1));
    }
    Cost { seconds: seconds / measured as f64, bytes }
}

/// The seconds of the tangent-linear runs over the window of a filter with common factors.
fn tangent_linear_s(case: Case) -> f64 {
    let problem = problem(case.side, 0);
    let values = problem.background.values().len() * propagated(case.size);
    let mut columns: Vec<f64> = (0..values).map(small).collect();
    let mut run = || {
        let mut state = problem.background.clone();
        let clock = Clock::start();
        forecast_tl(&*problem.model, &mut state, &mut columns, STEPS).expect("a forecast");
        clock.seconds()
    };
    run();
    let (mut seconds, mut runs) = (0.0, 0);
    while seconds < LEAST_S {
        seconds += run();
        runs += 1;
    }
    seconds / f64::from(runs)
}

/// Measures the processor time of this thread if it is the only one, or else the time that passes.
struct Clock {
    began: Instant,
    processor_s: Option<f64>,
}

impl Clock {
    fn start() -> Self {
        Self { began: Instant::now(), processor_s: Self::processor_s() }
    }

    fn seconds(&self) -> f64 {
        match (self.processor_s, Self::processor_s()) {
            (Some(before), Some(now)) => now - before,
            _ => self.began.elapsed().as_secs_f64(),
        }
    }

    /// What Linux has given to this thread; other systems do not say.
    fn processor_s() -> Option<f64> {
        if rayon::current_num_threads() > 1 {
            return None;
        }
        let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        let nanoseconds: f64 = statistics.split_whitespace().next()?.parse().ok()?;
        Some(1e-9 * nanoseconds)
    }
}
