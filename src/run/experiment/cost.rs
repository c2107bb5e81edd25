//! What a run will cost: the methods' work, and how fast this machine does it. The estimate is right within a small factor.

use crate::kinds::methods::Work;
use faer::Mat;
use isobar_assim::Problem;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// What a method is estimated to cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// The most memory held at one time \[bytes\].
    pub bytes: f64,
    /// Time of a cycle on this machine \[s\].
    pub seconds: f64,
}

/// The time that this machine takes for each operation that methods repeat \[s\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    step: f64,
    tangent_step: f64,
    adjoint_step: f64,
    multiplication: f64,
    root: f64,
}

/// How long each operation is timed; at least one is.
const TRIAL: Duration = Duration::from_millis(15);

/// The most numbers in the columns of a trial.
const MOST_NUMBERS: usize = 1 << 23;

/// Columns of a trial for each thread, unless these are too many numbers.
const COLUMNS: usize = 16;

/// Rows of the matrices whose product is timed.
const ROWS: usize = 384;

impl Rates {
    /// Times the model of a problem, its adjoint, the root of B and a product of matrices.
    pub fn measure(problem: &Problem) -> Self {
        let (model, start) = (&*problem.model, &problem.background);
        let m = start.values().len().max(1);
        let columns = (COLUMNS * rayon::current_num_threads()).min(MOST_NUMBERS / m).max(1);
        // Differences as small as those between members: a model's branches go as in a run.
        let increments =
            || start.values().iter().map(|value| 1e-3 * value).cycle().take(m * columns).collect::<Vec<_>>();
        let mut state = start.clone();
        let step = seconds(|| {
            model.step(&mut state);
            if state.first_non_finite().is_some() {
                state.clone_from(start);
            }
        });
        let mut forward = increments();
        let tangent_step = seconds(|| model.step_tl(start, &mut forward)) / columns as f64;
        let mut backward = increments();
        let adjoint_step = seconds(|| model.step_ad(start, &mut backward)) / columns as f64;
        let control = vec![1.0; problem.background_error.control_len()];
        let mut increment = vec![0.0; m];
        let root = seconds(|| problem.background_error.root_add(&control, &mut increment));
        black_box((&state, &forward, &backward, &increment));
        Self { step, tangent_step, adjoint_step, multiplication: multiplication(), root }
    }

    /// The cost of this work.
    pub fn cost(&self, work: &Work) -> Cost {
        let seconds = work.steps * self.step
            + work.tangent_steps * self.tangent_step
            + work.adjoint_steps * self.adjoint_step
            + work.multiplications * self.multiplication
            + work.roots * self.root;
        Cost { bytes: bytes(work), seconds }
    }
}

/// Memory of this work \[bytes\].
pub fn bytes(work: &Work) -> f64 {
    8.0 * work.numbers
}

fn multiplication() -> f64 {
    let matrix = Mat::from_fn(ROWS, ROWS, |i, j| ((i * 7 + j * 3) % 11) as f64);
    seconds(|| drop(black_box(&matrix * &matrix))) / (ROWS as f64).powi(3)
}

/// The shortest time of several trials: other programs on the machine can only make it longer.
fn seconds(mut work: impl FnMut()) -> f64 {
    let began = Instant::now();
    let mut shortest = f64::INFINITY;
    while shortest.is_infinite() || began.elapsed() < TRIAL {
        let before = Instant::now();
        work();
        shortest = shortest.min(before.elapsed().as_secs_f64());
    }
    shortest
}
