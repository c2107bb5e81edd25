//! What the cycles of a moving time volume say about the unknowns C that they share.

use crate::block_angular::reduced_basis;
use crate::linalg::{eigen, product};
use crate::memory::Matrix;
use crate::ties::first_largest;
use faer::Mat;
use isobar_model::vector::add;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Information about C of independent rows: J = Σ G' R G, j = Σ G' R y, y relative to the present reference of C.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Information {
    pub matrix: Matrix,
    pub vector: Vec<f64>,
}

/// A window of the last L cycles, and what is known from before.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Window {
    /// The prior of C and, if it is kept, what has left the window.
    pub before: Information,
    /// The last cycles, oldest first.
    pub cycles: VecDeque<Information>,
}

/// C as far as the window determines it, relative to the reference.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Posterior {
    /// Ĉ, `[q]`; zero for what is held at the reference.
    pub estimate: Vec<f64>,
    /// A root of the covariance, `[q, unknowns that are estimated]`.
    pub root: Matrix,
    /// Combinations that are not determined.
    pub undetermined: Vec<Vec<f64>>,
}

/// An eigenvalue of the information, scaled to a unit diagonal, below which a combination is not determined. What is found
/// by subtracting a nominal prior of 10⁻⁶ of the information has rounding errors of 10⁻¹⁰ of it.
const DETERMINED: f64 = 1e-8;

impl Information {
    pub fn none(q: usize) -> Self {
        Self { matrix: Matrix(Mat::zeros(q, q)), vector: vec![0.0; q] }
    }

    /// Adds independent information.
    pub fn add(&mut self, other: &Information) {
        *self.matrix += &*other.matrix;
        add(&mut self.vector, &other.vector);
    }

    /// Refers it to C + shift.
    pub fn shift(&mut self, shift: &[f64]) {
        for (i, own) in self.vector.iter_mut().enumerate() {
            *own -= (0..shift.len()).map(|k| self.matrix[(i, k)] * shift[k]).sum::<f64>();
        }
    }

    /// Ĉ of the active unknowns, with the others at the reference.
    ///
    /// Of each combination that is not determined the unknown with the largest part in it stays at the reference too: what
    /// is left then is determined. (The least change in all of them would give the most to what is seen the least.)
    pub fn solve(&self, active: &[bool]) -> Posterior {
        let q = self.vector.len();
        let mut numbers: Vec<usize> = (0..q).filter(|&k| active[k]).collect();
        let mut undetermined = Vec::new();
        let (scales, values, vectors) = loop {
            let (scales, values, vectors) = self.principal(&numbers);
            let free: Vec<usize> = (0..numbers.len()).filter(|&k| values[k] <= DETERMINED).collect();
            let entry = |i: usize, k: usize| scales[i] * vectors[(i, k)];
            if undetermined.is_empty() {
                let basis = Mat::from_fn(numbers.len(), free.len(), |i, k| entry(i, free[k]));
                undetermined = reduced_basis(basis, &vec![1.0; numbers.len()]);
                for combination in &mut undetermined {
                    let mut all = vec![0.0; q];
                    numbers.iter().zip(&*combination).for_each(|(&number, &value)| all[number] = value);
                    *combination = all;
                }
            }
            if free.is_empty() {
                break (scales, values, vectors);
            }
            // Whatever basis of them the eigenvectors are.
            let part = |i: usize| free.iter().map(|&k| entry(i, k).powi(2)).sum::<f64>();
            let largest = first_largest((0..numbers.len()).map(part));
            numbers.remove(largest.expect("a combination has parts"));
        };
        let mut root = Mat::zeros(q, numbers.len());
        for (k, value) in values.iter().enumerate() {
            for (i, &number) in numbers.iter().enumerate() {
                root[(number, k)] = scales[i] * vectors[(i, k)] / value.sqrt();
            }
        }
        let right = Mat::from_fn(q, 1, |i, _| self.vector[i]);
        let estimate = product(root.as_ref(), product(root.transpose(), right.as_ref()).as_ref());
        Posterior { estimate: estimate.col_as_slice(0).to_vec(), root: Matrix(root), undetermined }
    }

    /// Eigenvalues and eigenvectors of the part of J of some unknowns, in units in which each of them alone is known to one
    /// standard deviation: those units, values in ascending order, vectors.
    fn principal(&self, numbers: &[usize]) -> (Vec<f64>, Vec<f64>, Mat<f64>) {
        let scale = |&k: &usize| if self.matrix[(k, k)] > 0.0 { 1.0 / self.matrix[(k, k)].sqrt() } else { 1.0 };
        let scales: Vec<f64> = numbers.iter().map(scale).collect();
        let n = numbers.len();
        if n == 0 {
            return (scales, Vec::new(), Mat::new());
        }
        let scaled = Mat::from_fn(n, n, |i, j| scales[i] * self.matrix[(numbers[i], numbers[j])] * scales[j]);
        let (values, vectors) = eigen(scaled.as_ref());
        (scales, values, vectors)
    }
}

impl Posterior {
    /// Whether it is of q unknowns.
    pub fn has_unknowns(&self, q: usize) -> bool {
        self.estimate.len() == q && self.root.nrows() == q && self.undetermined.iter().all(|it| it.len() == q)
    }

    /// The variance of one unknown.
    pub fn variance(&self, k: usize) -> f64 {
        (0..self.root.ncols()).map(|column| self.root[(k, column)].powi(2)).sum()
    }

    /// Standard deviation of a linear function of C.
    pub fn sigma(&self, weights: &[f64]) -> f64 {
        let of = |column: usize| weights.iter().enumerate().map(|(k, w)| w * self.root[(k, column)]).sum::<f64>();
        (0..self.root.ncols()).map(|column| of(column).powi(2)).sum::<f64>().sqrt()
    }
}

impl Window {
    /// With priors of the given standard deviations, `None` for no prior.
    pub fn new(sigma_prior: &[Option<f64>]) -> Self {
        let mut before = Information::none(sigma_prior.len());
        for (k, sigma) in sigma_prior.iter().enumerate() {
            before.matrix[(k, k)] = sigma.map_or(0.0, |sigma| sigma.powi(-2));
        }
        Self { before, cycles: VecDeque::new() }
    }

    /// Whether it is of q unknowns.
    pub fn has_unknowns(&self, q: usize) -> bool {
        let mut all = std::iter::once(&self.before).chain(&self.cycles);
        all.all(|it| it.vector.len() == q && it.matrix.has_shape(q, q))
    }

    /// Makes room for a cycle in a window of `length`; what then is too old is kept in sum or forgotten.
    pub fn make_room(&mut self, length: usize, keep: bool) {
        while self.cycles.len() >= length {
            let oldest = self.cycles.pop_front().expect("it is not empty");
            if keep {
                self.before.add(&oldest);
            }
        }
    }

    /// All that is known.
    pub fn total(&self) -> Information {
        let mut total = self.before.clone();
        self.cycles.iter().for_each(|cycle| total.add(cycle));
        total
    }

    /// Moves the reference of C.
    pub fn shift(&mut self, shift: &[f64]) {
        self.before.shift(shift);
        self.cycles.iter_mut().for_each(|cycle| cycle.shift(shift));
    }
}
