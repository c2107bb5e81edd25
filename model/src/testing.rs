//! The contract every model must pass (feature `testing`), [`check_contract`], and ranks that are threads, [`on_ranks`].

mod ranks;

pub use ranks::{ThreadRank, on_ranks};

use crate::forecast::Adjoint;
use crate::random::{standard_normals, stream};
use crate::state::State;
use crate::stored::{ColumnsMut, Stored};
use crate::time::Time;
use crate::vector::{self, dot};

/// Roundings to 2⁻²⁴ of the norm that a step in single precision may have.
const ROUNDINGS_PER_STEP: f64 = 8.0;

/// What [`check_contract`] measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Contract {
    /// Decades of ε over which the Taylor remainder fell with slope 2 ± 0.05; `None` for a linear model, whose
    /// remainder is rounding.
    pub taylor_decades: Option<usize>,
    /// |⟨M'δx, M'δx⟩ − ⟨δx, M'ᵀM'δx⟩| relative to either.
    pub dot_product_error: f64,
}

/// Runs the battery at a state: time, zero, linearity, Taylor ladder, dot product, batches, threads, several steps, states
/// together, single precision.
///
/// * Time: a step moves the state's valid time on by the time step.
/// * Zero: M'0 = 0 and M'ᵀ0 = 0.
/// * Linearity: M'(2a − 3b) = 2 M'a − 3 M'b to rounding, and the same for M'ᵀ.
/// * Taylor ladder: |M(x + εδ) − M(x) − ε M'δ| falls with ε², slope 2 ± 0.05 in each of at least four decades in a row;
///   or, if it is rounding at all ε, the model is linear.
/// * Dot product: ⟨M'δx, y⟩ = ⟨δx, M'ᵀy⟩ to 100 machine epsilons, relative, for y = M'δx, and for a random y relative
///   to the sum of the products' absolute values.
/// * Batches and threads: a matrix of columns gives the bits that single columns give, on one thread and on two.
/// * Several steps: [`TangentLinear::steps_tl`](crate::TangentLinear::steps_tl) gives the bits that single steps along the
///   trajectory give.
/// * States together: [`Model::steps`](crate::Model::steps) gives each of several states the values and the time that single steps
///   give it alone, on one thread and on two.
/// * Single precision: columns stored so become those of M' in double precision but for a few roundings of each step, relative
///   to the increment's norm; and with the same bits in a batch as alone, on one thread and on two.
///
/// Increments are random, scaled for each variable by the largest deviation from its mean (of a uniform variable, by a
/// hundredth of its value, or 1).
///
/// # Panics
/// With the numbers, if the model breaks the contract.
pub fn check_contract(model: &dyn Adjoint, at: &State) -> Contract {
    let scales = scales(at);
    let increment = |purpose: &str| -> Vec<f64> {
        standard_normals(&mut stream(1, purpose), at.values().len())
            .iter()
            .zip(&scales)
            .map(|(normal, scale)| 0.1 * normal * scale)
            .collect()
    };
    let (a, b) = (increment("contract/a"), increment("contract/b"));
    check_time(model, at);
    check_zero(model, at);
    check_linearity(model, at, &a, &b, &scales);
    check_batches_and_threads(model, at, &increment);
    check_several_steps(model, at, &increment);
    check_states_together(model, at, &increment);
    check_single_precision(model, at, &increment, &scales);
    Contract {
        taylor_decades: taylor_ladder(model, at, &a, &scales),
        dot_product_error: dot_product_error(model, at, &a, &b, &scales),
    }
}

fn step_tl(model: &dyn Adjoint, at: &State, dx: &[f64]) -> Vec<f64> {
    let mut dx = dx.to_vec();
    model.step_tl(at, &mut dx);
    dx
}

fn step_ad(model: &dyn Adjoint, at: &State, dy: &[f64]) -> Vec<f64> {
    let mut dy = dy.to_vec();
    model.step_ad(at, &mut dy);
    dy
}

fn check_time(model: &dyn Adjoint, at: &State) {
    let start = at.time().unwrap_or(Time::from_seconds(0));
    let mut x = at.clone().valid_at(start);
    model.step(&mut x);
    assert_eq!(x.time(), Some(start + model.time_step()), "the state's valid time does not go on with the step");
}

fn check_zero(model: &dyn Adjoint, at: &State) {
    let zero = vec![0.0; at.values().len()];
    assert!(step_tl(model, at, &zero).iter().all(|&value| value == 0.0), "M'0 is not 0");
    assert!(step_ad(model, at, &zero).iter().all(|&value| value == 0.0), "M'ᵀ0 is not 0");
}

fn check_linearity(model: &dyn Adjoint, at: &State, a: &[f64], b: &[f64], scales: &[f64]) {
    let combine = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| 2.0 * a - 3.0 * b).collect() };
    let whole = step_tl(model, at, &combine(a, b));
    let parts = combine(&step_tl(model, at, a), &step_tl(model, at, b));
    let error = norm(&vector::difference(&whole, &parts), scales) / norm(&whole, scales);
    assert!(error < 1e-12, "M' is not linear: relative error {error:e}");
    let dual: Vec<f64> = scales.iter().map(|scale| 1.0 / scale).collect();
    let weigh = |a: &[f64]| -> Vec<f64> { a.iter().zip(&dual).map(|(a, dual)| a * dual * dual).collect() };
    let (a, b) = (weigh(a), weigh(b));
    let whole = step_ad(model, at, &combine(&a, &b));
    let parts = combine(&step_ad(model, at, &a), &step_ad(model, at, &b));
    let error = norm(&vector::difference(&whole, &parts), &dual) / norm(&whole, &dual);
    assert!(error < 1e-12, "M'ᵀ is not linear: relative error {error:e}");
}

fn taylor_ladder(model: &dyn Adjoint, at: &State, direction: &[f64], scales: &[f64]) -> Option<usize> {
    let mut forecast = at.clone();
    model.step(&mut forecast);
    let tangent = step_tl(model, at, direction);
    let size = norm(forecast.values(), scales).max(norm(&tangent, scales));
    let remainders: Vec<f64> = (0..=10)
        .map(|power| {
            let epsilon = 10f64.powi(-power);
            let mut perturbed = at.clone();
            vector::axpy(epsilon, direction, perturbed.values_mut());
            model.step(&mut perturbed);
            let remainder: Vec<f64> = (0..tangent.len())
                .map(|k| perturbed.values()[k] - forecast.values()[k] - epsilon * tangent[k])
                .collect();
            norm(&remainder, scales)
        })
        .collect();
    if remainders.iter().all(|&remainder| remainder < 1e-12 * size) {
        return None;
    }
    let slopes: Vec<f64> = remainders.windows(2).map(|pair| (pair[0] / pair[1]).log10()).collect();
    let (mut longest, mut current) = (0, 0);
    for slope in &slopes {
        current = if (slope - 2.0).abs() <= 0.05 { current + 1 } else { 0 };
        longest = longest.max(current);
    }
    assert!(longest >= 4, "Taylor slopes per decade {slopes:.3?} are not 2 ± 0.05 in four in a row: {remainders:?}");
    Some(longest)
}

fn dot_product_error(model: &dyn Adjoint, at: &State, a: &[f64], b: &[f64], scales: &[f64]) -> f64 {
    let limit = 100.0 * f64::EPSILON;
    let magnitude = |x: &[f64], y: &[f64]| -> f64 { x.iter().zip(y).map(|(x, y)| (x * y).abs()).sum() };
    let weigh = |x: &[f64]| -> Vec<f64> { x.iter().zip(scales).map(|(x, scale)| x / (scale * scale)).collect() };
    let tangent = step_tl(model, at, a);
    let y = weigh(b);
    let back = step_ad(model, at, &y);
    let error = (dot(&tangent, &y) - dot(a, &back)).abs() / magnitude(&tangent, &y);
    assert!(error < limit, "⟨M'a, b⟩ differs from ⟨a, M'ᵀb⟩ by {error:e} of the sum of absolute values");
    let y = weigh(&tangent);
    let (forward, backward) = (dot(&tangent, &y), dot(a, &step_ad(model, at, &y)));
    let error = (forward - backward).abs() / forward;
    assert!(error < limit, "⟨M'a, M'a⟩ = {forward:e}, but ⟨a, M'ᵀM'a⟩ = {backward:e}: relative difference {error:e}");
    error
}

fn check_batches_and_threads(model: &dyn Adjoint, at: &State, increment: &dyn Fn(&str) -> Vec<f64>) {
    let (len, count) = (at.values().len(), 21);
    let columns: Vec<f64> = (0..count).flat_map(|column| increment(&format!("contract/column{column}"))).collect();
    let narrow: Vec<f32> = columns.iter().map(|&value| f32::narrow(value)).collect();
    same_bits("tangent-linear", &columns, len, &|columns| model.step_tl(at, columns));
    same_bits("adjoint", &columns, len, &|columns| model.step_ad(at, columns));
    same_bits("forecast", &columns, len, &|columns| {
        for (x, base) in columns.chunks_exact_mut(len).map(|column| (column, at)) {
            let mut state = base.clone();
            vector::axpy(0.01, x, state.values_mut());
            model.step(&mut state);
            x.copy_from_slice(state.values());
        }
    });
    same_bits("tangent-linear in single precision", &narrow, len, &|columns| {
        model.steps_tl(at, ColumnsMut::Single(columns), 2);
    });
}

/// The same bits on two threads as on one, and for all columns as for each alone.
fn same_bits<S: Stored>(name: &str, columns: &[S], len: usize, step: &(dyn Fn(&mut [S]) + Sync)) {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of one or two threads");
        let mut columns = columns.to_vec();
        pool.install(|| step(&mut columns));
        columns
    };
    let (one, two) = (run(1), run(2));
    assert!(bits(&one).eq(bits(&two)), "the {name} gives other bits on two threads than on one");
    let mut single = columns.to_vec();
    single.chunks_exact_mut(len).for_each(step);
    assert!(bits(&one).eq(bits(&single)), "the {name} gives other bits for many columns than for single ones");
}

fn check_several_steps(model: &dyn Adjoint, at: &State, increment: &dyn Fn(&str) -> Vec<f64>) {
    let columns: Vec<f64> = (0..11).flat_map(|column| increment(&format!("contract/column{column}"))).collect();
    let (mut x, mut single) = (at.clone(), columns.clone());
    for steps in 0..=3 {
        let mut together = columns.clone();
        model.steps_tl(at, ColumnsMut::Double(&mut together), steps);
        assert!(bits(&together).eq(bits(&single)), "{steps} steps at once give other bits than one after another");
        model.step_tl(&x, &mut single);
        model.step(&mut x);
    }
}

fn check_states_together(model: &dyn Adjoint, at: &State, increment: &dyn Fn(&str) -> Vec<f64>) {
    for (count, steps) in [(1, 3), (5, 0), (5, 3), (19, 2)] {
        let start = |number: usize| {
            let mut x = at.clone();
            vector::axpy(0.01, &increment(&format!("contract/state{number}")), x.values_mut());
            x
        };
        let starts: Vec<State> = (0..count).map(start).collect();
        let mut alone = starts.clone();
        for x in &mut alone {
            (0..steps).for_each(|_| model.step(x));
        }
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of threads");
            let mut together = starts.clone();
            pool.install(|| model.steps(&mut together, steps));
            for (number, (together, alone)) in together.iter().zip(&alone).enumerate() {
                assert!(
                    bits(together.values()).eq(bits(alone.values())) && together.time() == alone.time(),
                    "{steps} steps of {count} states on {threads} threads: state {number} is not the one that it is alone"
                );
            }
        }
    }
}

fn check_single_precision(model: &dyn Adjoint, at: &State, increment: &dyn Fn(&str) -> Vec<f64>, scales: &[f64]) {
    let stored: Vec<f32> = increment("contract/single").into_iter().map(f32::narrow).collect();
    for steps in [1, 3] {
        let (mut single, mut double) = (stored.clone(), widened(&stored));
        model.steps_tl(at, ColumnsMut::Single(&mut single), steps);
        model.steps_tl(at, ColumnsMut::Double(&mut double), steps);
        let roundings = norm(&vector::difference(&widened(&single), &double), scales) / norm(&double, scales);
        let limit = ROUNDINGS_PER_STEP * steps as f64 * f64::from(f32::EPSILON / 2.0);
        assert!(
            roundings < limit,
            "the tangent-linear in single precision differs from that in double by {roundings:e}"
        );
    }
}

fn widened(stored: &[f32]) -> Vec<f64> {
    stored.iter().map(|value| value.widen()).collect()
}

fn bits<S: Stored>(values: &[S]) -> impl Iterator<Item = u64> + '_ {
    values.iter().map(|value| value.widen().to_bits())
}

/// Euclidean norm of the values over their scales.
fn norm(values: &[f64], scales: &[f64]) -> f64 {
    values.iter().zip(scales).map(|(value, scale)| (value / scale).powi(2)).sum::<f64>().sqrt()
}

/// For each value, the scale of its variable.
fn scales(at: &State) -> Vec<f64> {
    let cells = at.layout().grid.cells();
    at.values()
        .chunks_exact(cells)
        .flat_map(|field| {
            let mean = field.iter().sum::<f64>() / cells as f64;
            let largest = field.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
            let deviation = field.iter().fold(0.0, |largest: f64, value| largest.max((value - mean).abs()));
            let scale = if deviation > 1e-6 * largest { deviation } else { 0.01 * largest };
            std::iter::repeat_n(if scale > 0.0 { scale } else { 1.0 }, cells)
        })
        .collect()
}
