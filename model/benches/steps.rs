//! Speed of the steps beside that of memory, all measured in one run:
//!
//! * the nonlinear step of shallow water (doubly periodic, potential-enstrophy form) in cell-steps per second, on one and
//!   two threads, by leapfrog and by the Runge–Kutta scheme of fourth order;
//! * the bandwidth of a memory copy on as many threads, of arrays far larger than any cache and of arrays as large as the
//!   state, and the fraction reached of the step rate at which the state would move through memory just once;
//! * a step of a member of an ensemble in a forecast of twelve steps, alone and together with others;
//! * the cost of one tangent-linear and one adjoint column, in a batch of 32 and of one, of the nonlinear and the linear
//!   equations, in nonlinear steps of the same scheme: of each of twelve steps at once, as filters and 4D-Var take them, and of
//!   a single one; of twelve tangent-linear steps also in single precision, over the time in double.
//!
//! `cargo bench -p isobar-model`, or with grid sizes: `cargo bench -p isobar-model -- 64 256`. Times are the shortest,
//! on one thread of the processor's time where the system tells it.

use isobar_model::forecast::{forecast_together, trajectory};
use isobar_model::initial::{self, RandomConfig};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Adjoint, Boundary, ColumnsMut, Duration, Forced, Forcing, Grid, Leapfrog, LinearShallowWater, Model, ShallowWater,
    ShallowWaterParameters, Source, State, Stepped, Time, TimeFunction, TimeScheme, VectorInvariant,
};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

/// Bytes read and written for each cell if a step reads and writes h, u and v once.
const ONE_LEVEL_BYTES: f64 = 48.0;

/// Steps of a tangent-linear forecast.
const STEPS: usize = 12;

/// Members of an ensemble.
const MEMBERS: usize = 16;

fn main() {
    let sizes: Vec<usize> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let sizes = if sizes.is_empty() { vec![64, 256, 1024, 2048] } else { sizes };
    for n in sizes {
        let mut single: [f64; 2] = [f64::NAN; 2];
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of threads");
            pool.install(|| nonlinear(n, threads, &mut single));
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
        pool.install(|| {
            members(n);
            tangent_linear(n);
        });
    }
}

fn shallow_water(n: usize) -> (ShallowWater, State) {
    let grid = Grid { nx: n, ny: n, dx_m: 1e5, dy_m: 1e5, boundary: Boundary::Periodic };
    let parameters = ShallowWaterParameters { gravity_m_per_s2: 9.81, coriolis_per_s: 1e-4, ..Default::default() };
    let equations = ShallowWater::new(grid, parameters, VectorInvariant::PotentialEnstrophy).expect("valid parameters");
    let hills = [initial::Vortex { center_x_m: 2e6, center_y_m: 3e6, amplitude_m: 30.0, radius_m: 8e5 }];
    let start = if n > 256 {
        initial::vortices(&equations, 1000.0, &hills)
    } else {
        let config = RandomConfig { mean_depth_m: 1000.0, height_standard_deviation_m: 20.0, length_scale_m: 4e5 };
        initial::random_balanced(&equations, &config, &mut stream(1, "truth"))
    };
    (equations, start.expect("a thin layer"))
}

/// Least seconds of `run`, as other programs only make it slower: of samples of as many calls as take about a fifth of a
/// second, five of them or, of slow calls, three.
fn least_seconds(mut run: impl FnMut()) -> f64 {
    let clock = clock();
    run();
    // The processor's time is known at the ticks of the system only.
    let start = Instant::now();
    run();
    let once = start.elapsed().as_secs_f64().max(1e-9);
    let calls = (0.2 / once).clamp(1.0, 1e6) as usize;
    let count = if once > 1.0 { 3 } else { 5 };
    let sample = |_| {
        let start = clock();
        (0..calls).for_each(|_| run());
        (clock() - start) / calls as f64
    };
    (0..count).map(sample).fold(f64::INFINITY, f64::min)
}

/// A clock in seconds: of the processor's time that the thread has had where the system tells it and the pool has no other
/// thread, so that programs beside this one count less.
fn clock() -> impl Fn() -> f64 {
    let of_thread = || -> Option<f64> {
        let times = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        Some(1e-9 * times.split(' ').next()?.parse::<f64>().ok()?)
    };
    let (start, is_alone) = (Instant::now(), rayon::current_num_threads() == 1);
    move || of_thread().filter(|_| is_alone).unwrap_or_else(|| start.elapsed().as_secs_f64())
}

/// Bytes read and written per second by copying an array of `len` numbers on the current pool.
fn copy_bandwidth(len: usize, threads: usize) -> f64 {
    let from: Vec<f64> = (0..len).map(|k| k as f64).collect();
    let mut to = vec![0.0; len];
    let part = len.div_ceil(threads);
    let seconds = least_seconds(|| {
        rayon::scope(|scope| {
            for (to, from) in to.chunks_mut(part).zip(from.chunks(part)) {
                scope.spawn(move |_| black_box(to).copy_from_slice(black_box(from)));
            }
        });
    });
    16.0 * len as f64 / seconds
}

fn nonlinear(n: usize, threads: usize, single: &mut [f64; 2]) {
    let Models { leapfrog, runge_kutta, start, begin, .. } = Models::new(n);
    let (memory, like_state) = (copy_bandwidth(1 << 25, threads), copy_bandwidth(3 * n * n, threads));
    let cases: [(&str, &dyn Model, &State, f64); 2] = [
        ("leapfrog", &leapfrog, &begin, 2.0 * ONE_LEVEL_BYTES),
        ("Runge-Kutta 4", &runge_kutta, &start, ONE_LEVEL_BYTES),
    ];
    for (case, (name, model, start, bytes)) in cases.into_iter().enumerate() {
        let mut x = start.clone();
        let rate = (n * n) as f64 / least_seconds(|| model.step(black_box(&mut x)));
        if threads == 1 {
            single[case] = rate;
        }
        println!(
            "{n:4}² {threads} thread(s), {name:13}: {rate:9.3e} cell-steps/s ({:5.2} ns/cell), {:4.2} of one thread; \
             copy {:5.1} GB/s, in arrays like the state {:5.1} GB/s; {:4.2} of the bandwidth bound",
            1e9 / rate,
            rate / single[case],
            memory / 1e9,
            like_state / 1e9,
            rate * bytes / memory
        );
    }
}

/// The models on `n`² cells, and where they start.
struct Models {
    leapfrog: Leapfrog<ShallowWater>,
    runge_kutta: Stepped<ShallowWater>,
    /// With Runge-Kutta steps.
    linear: Stepped<LinearShallowWater>,
    start: State,
    /// Both levels of the leapfrog.
    begin: State,
}

impl Models {
    fn new(n: usize) -> Self {
        let (equations, start) = shallow_water(n);
        let (dt, scheme) = (Duration::from_seconds(90), TimeScheme::Rk4);
        let leapfrog = Leapfrog::new(equations.clone(), dt, 0.001).expect("valid numbers");
        let runge_kutta = Stepped::new(equations.clone(), dt, scheme).expect("a positive step");
        let linear = LinearShallowWater::about_uniform_flow(equations, 1000.0, 10.0).expect("a thin layer");
        let linear = Stepped::new(linear, dt, scheme).expect("a positive step");
        let begin = leapfrog.start(&start);
        Self { leapfrog, runge_kutta, linear, start, begin }
    }
}

/// Forecasts of sixteen members of an ensemble, alone and as many together as the model says, on one thread.
fn members(n: usize) {
    let Models { leapfrog, runge_kutta, linear, start, begin } = Models::new(n);
    let cases: [(&str, &dyn Model, &State); 3] = [
        ("leapfrog", &leapfrog, &begin),
        ("Runge-Kutta 4", &runge_kutta, &start),
        ("the same, linear equations", &linear, &start),
    ];
    for (name, model, start) in cases {
        let mut states = vec![start.clone(); MEMBERS];
        let mut seconds = |together: usize| {
            let forecast = || {
                for states in states.chunks_mut(together) {
                    forecast_together(model, black_box(states), STEPS).expect("a stable step");
                }
            };
            1e9 * least_seconds(forecast) / (MEMBERS * STEPS * n * n) as f64
        };
        let together = model.best_together();
        println!(
            "{n:4}² 1 thread, {name}: a step of a member in a forecast of {STEPS} {:6.2} ns/cell alone, {:6.2} with \
             {together} together",
            seconds(1),
            seconds(together)
        );
    }
}

/// Tangent-linear and adjoint against nonlinear, on one thread.
fn tangent_linear(n: usize) {
    let Models { leapfrog, runge_kutta, linear, start, begin } = Models::new(n);
    let pattern = vec![1e-6; n * n];
    let sources = vec![Source { variable: 0, pattern, function: TimeFunction::Constant }];
    let forced = Forced::of(Arc::new(runge_kutta.clone()), &Arc::new(Forcing { sources })).expect("a source that fits");
    let timed = start.clone().valid_at(Time::from_seconds(0));
    let cases: [(&str, &dyn Model, &dyn Adjoint, &State); 4] = [
        ("leapfrog", &leapfrog, &leapfrog, &begin),
        ("Runge-Kutta 4", &runge_kutta, &runge_kutta, &start),
        ("the same, linear equations", &runge_kutta, &linear, &start),
        ("Runge-Kutta 4, forced", &runge_kutta, &*forced, &timed),
    ];
    for (name, nonlinear, model, at) in cases {
        let mut x = at.clone();
        let step = least_seconds(|| nonlinear.step(black_box(&mut x)));
        let states = trajectory(model, at, STEPS - 1).expect("a stable step");
        for batch in [1, 32] {
            let len = at.values().len();
            if batch * len > 1 << 28 {
                continue;
            }
            let one = standard_normals(&mut stream(1, "columns"), len);
            let mut columns: Vec<f64> = one.iter().cycle().take(batch * len).copied().collect();
            let forecast =
                least_seconds(|| model.steps_tl(at, ColumnsMut::Double(black_box(&mut columns)), STEPS)) / STEPS as f64;
            let mut narrow: Vec<f32> = one.iter().cycle().take(batch * len).map(|&value| value as f32).collect();
            let single =
                least_seconds(|| model.steps_tl(at, ColumnsMut::Single(black_box(&mut narrow)), STEPS)) / STEPS as f64;
            drop(narrow);
            let forward = least_seconds(|| model.step_tl(at, black_box(&mut columns)));
            columns.iter_mut().zip(one.iter().cycle()).for_each(|(column, one)| *column = *one);
            let backward = least_seconds(|| model.step_ad(at, black_box(&mut columns)));
            columns.iter_mut().zip(one.iter().cycle()).for_each(|(column, one)| *column = *one);
            let back = least_seconds(|| model.steps_ad(&states, black_box(&mut columns))) / STEPS as f64;
            let per_column = |seconds: f64| seconds / batch as f64;
            println!(
                "{n:4}² 1 thread, {name}: a column in a batch of {batch:2} costs {:5.2} nonlinear steps tangent-linear \
                 ({:5.2} ns/cell), in single precision {:4.2} of that, {:5.2} by single steps; {:5.2} adjoint \
                 ({:5.2} ns/cell), {:5.2} by single steps",
                per_column(forecast) / step,
                1e9 * per_column(forecast) / (n * n) as f64,
                single / forecast,
                per_column(forward) / step,
                per_column(back) / step,
                1e9 * per_column(back) / (n * n) as f64,
                per_column(backward) / step
            );
        }
    }
}
