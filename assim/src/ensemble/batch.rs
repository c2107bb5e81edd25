//! The analyses of neighbouring places, each with the observations around it.

use super::near::{LocalObservations, Near};
use super::products::{Operation, Products};
use super::transform;
use crate::lanes::{Aligned, Functions, lanes};
use crate::linalg::add_symmetric_product;
use faer::{Mat, MatRef};
use pulp::Arch;

/// Analyses of neighbouring places along x, as many at a time as the processor has lanes.
///
/// With Ỹ and d̃ the observations of a place, tapered, f its inflation and α the relaxation to the prior perturbations, any
/// perturbations x of N members, those of one value of the state, become
///
/// ```text
/// √f (1−α) A^-½ x + α x,    A = I + f Ỹᵀ Ỹ,    and their mean moves by    f/√(N−1) xᵀ A⁻¹ Ỹᵀ d̃
/// ```
///
/// (the transform of [`super::transform`]); those of an earlier ensemble of a smoother become
///
/// ```text
/// A^-½ x    and their mean moves by    √f/√(N−1) xᵀ A⁻¹ Ỹᵀ d̃
/// ```
///
/// The weights of the members need not be formed for this. With fewer observations than members the matrix `M = I + f Ỹ Ỹᵀ` of
/// observations is used (Higham 2008, Functions of Matrices, theorem 1.35):
///
/// ```text
/// A^-½ x = x − f Ỹᵀ (M + M^½)⁻¹ Ỹ x,    A⁻¹ Ỹᵀ d̃ = Ỹᵀ M⁻¹ d̃
/// ```
///
/// The taper enters M as `D Y Yᵀ D` with the roots of its weights in D, and the products Y Yᵀ of neighbouring places are the
/// same.
pub(super) struct Batch<'a> {
    all: &'a LocalObservations<'a>,
    lanes: usize,
    members: usize,
    near: Vec<Near>,
    /// Observations that any of the places has, ascending, and their Y, `[n, N]` row by row.
    found: Vec<usize>,
    y: Vec<f64>,
    /// Perturbations, `[vectors, N, lanes]`, and what they become, with the shift of their mean in row N of
    /// `[vectors, N + 1, lanes]`.
    x: Aligned,
    analysed: Aligned,
    matrix: Aligned,
    right: Aligned,
    vectors: Aligned,
    observed: Aligned,
    inner: Aligned,
    work: Aligned,
}

impl<'a> Batch<'a> {
    pub fn new(all: &'a LocalObservations<'a>) -> Self {
        let none = Aligned::default;
        Self {
            all,
            lanes: all.lanes(),
            members: all.members(),
            near: vec![Near::default(); all.lanes()],
            found: Vec::new(),
            y: Vec::new(),
            x: none(),
            analysed: none(),
            matrix: none(),
            right: none(),
            vectors: none(),
            observed: none(),
            inner: none(),
            work: none(),
        }
    }

    /// The perturbations that are to be analysed, `[vectors, N, lanes]`: zero at first.
    pub fn perturbations(&mut self, vectors: usize) -> &mut [f64] {
        self.x.reset(vectors * self.members * self.lanes)
    }

    /// Analyses the perturbations at some places along x, given the inflation of each place in the last cycle, which becomes
    /// that of this one; returns the analysed ones, `[vectors, N + 1, lanes]`. The first `present` vectors are of the present
    /// ensemble, the others of earlier ones.
    pub fn analyse(&mut self, here: &[(f64, f64)], last_factors: &mut [f64], present: usize) -> &[f64] {
        self.find(here);
        for (near, last) in self.near.iter_mut().zip(last_factors) {
            near.set_analysis(self.all, &self.found, last);
        }
        let most = self.near.iter().filter(|near| near.is_regular()).map(|near| near.numbers.len()).max();
        if let Some(most) = most {
            let perturbations = &self.all.rows;
            self.y.clear();
            for &number in &self.found {
                self.y.extend_from_slice(&perturbations[number * self.members..][..self.members]);
            }
            if most < self.members { self.of_observations(most) } else { self.of_members() }
        }
        self.combine(present);
        self.analysed.as_ref()
    }

    /// Finds the observations of each place.
    fn find(&mut self, here: &[(f64, f64)]) {
        let Self { all, near, found, .. } = self;
        near.iter_mut().for_each(Near::clear);
        all.buckets.near([here[0].0, here[here.len() - 1].0], here[0].1, found);
        let mut number = 0;
        found.retain(|&observation| {
            let mut is_near = false;
            for (near, &here) in near.iter_mut().zip(here) {
                let weight = all.taper.weight(here, all.places[observation]);
                if weight > 0.0 {
                    near.numbers.push(number);
                    near.roots.push(weight.sqrt());
                    is_near = true;
                }
            }
            number += usize::from(is_near);
            is_near
        });
    }

    /// A^-½ x in `vectors`, `[vectors, N, lanes]`, and xᵀ A⁻¹ Ỹᵀ d̃ in `inner`, in the space of at most `size` observations.
    fn of_observations(&mut self, size: usize) {
        let (lanes, members, n) = (self.lanes, self.members, self.found.len());
        let count = self.x.as_ref().len() / (members * lanes);
        let y = MatRef::from_column_major_slice(&self.y, members, n);
        let mut gram = Mat::zeros(n, n);
        add_symmetric_product(gram.as_mut(), 1.0, y.transpose(), y);
        let matrix = self.matrix.reset(size * size * lanes);
        let right = self.right.reset(size * lanes);
        (0..size).for_each(|i| matrix[i * (size + 1) * lanes..][..lanes].fill(1.0));
        let observed = self.observed.reset(count * n * lanes);
        let operation = Operation::Observe { x: self.x.as_ref(), observed: &mut *observed };
        self.all.arch.dispatch(Products { members, y: &self.y, operation });
        let vectors = self.vectors.reset(count * size * lanes);
        for (lane, near) in self.near.iter().enumerate().filter(|(_, near)| near.is_regular()) {
            for (j, (second, other)) in near.observations().enumerate() {
                let (column, factor) = (gram.col_as_slice(second), near.inflation * other);
                let below = matrix[j * (size + 1) * lanes + lane..].iter_mut().step_by(lanes);
                for ((entry, &first), root) in below.zip(&near.numbers[j..]).zip(&near.roots[j..]) {
                    *entry += factor * root * column[first];
                }
                right[j * lanes + lane] = other * self.all.whitened.departures[self.found[second]];
                for vector in 0..count {
                    vectors[(vector * size + j) * lanes + lane] =
                        other * observed[(vector * n + second) * lanes + lane];
                }
            }
        }
        self.evaluate(size, true);
        // z of Ỹᵀ z.
        let (vectors, observed) = (self.vectors.as_ref(), self.observed.as_mut());
        observed.fill(0.0);
        for (lane, near) in self.near.iter().enumerate().filter(|(_, near)| near.is_regular()) {
            for (j, (number, root)) in near.observations().enumerate() {
                for vector in 0..count {
                    observed[(vector * n + number) * lanes + lane] =
                        -near.inflation * root * vectors[(vector * size + j) * lanes + lane];
                }
            }
        }
        let x = self.x.as_ref();
        let vectors = self.vectors.reset(x.len());
        vectors.copy_from_slice(x);
        let operation = Operation::Combine { z: self.observed.as_ref(), x: vectors };
        self.all.arch.dispatch(Products { members, y: &self.y, operation });
    }

    /// The same in the space of the members.
    fn of_members(&mut self) {
        let (lanes, members, n) = (self.lanes, self.members, self.found.len());
        let (all, found) = (self.all, &self.found);
        let weights = self.observed.reset(2 * n * lanes);
        let (weights, departures) = weights.split_at_mut(n * lanes);
        for (lane, near) in self.near.iter().enumerate().filter(|(_, near)| near.is_regular()) {
            for (number, root) in near.observations() {
                weights[number * lanes + lane] = near.inflation * root * root;
                departures[number * lanes + lane] = root * root * all.whitened.departures[found[number]];
            }
        }
        let matrix = self.matrix.reset(members * members * lanes);
        (0..members).for_each(|i| matrix[i * (members + 1) * lanes..][..lanes].fill(1.0));
        let y = &self.y;
        all.arch.dispatch(Products { members, y, operation: Operation::Square { weights, matrix } });
        let operation = Operation::Combine { z: departures, x: self.right.reset(members * lanes) };
        all.arch.dispatch(Products { members, y, operation });
        let x = self.x.as_ref();
        self.vectors.reset(x.len()).copy_from_slice(x);
        self.evaluate(members, false);
    }

    /// M^-½ of `vectors`, or (M + M^½)⁻¹, and `inner`.
    fn evaluate(&mut self, size: usize, is_difference: bool) {
        let all = self.all;
        let largest = |near: &Near| {
            let numbers = near.observations().map(|(number, root)| (self.found[number], root));
            1.0 + near.inflation * all.sizes(numbers).perturbations
        };
        let largest = self.near.iter().filter(|near| near.is_regular()).map(largest).fold(1.0, f64::max);
        let fractions = &all.fractions[((0.5 * largest.log2()).ceil() as usize).clamp(1, all.fractions.len()) - 1];
        let weights = if is_difference { &fractions.of_difference } else { &fractions.weights };
        let count = self.vectors.as_ref().len() / (size * self.lanes);
        all.arch.dispatch(Functions {
            size,
            matrix: self.matrix.as_mut(),
            right: self.right.as_mut(),
            vectors: self.vectors.as_mut(),
            inner: self.inner.reset(count * self.lanes),
            shifts: &fractions.shifts,
            weights,
            work: &mut self.work,
        });
    }

    /// The analysed perturbations; the first `present` are of the present ensemble, the others of earlier ones.
    fn combine(&mut self, present: usize) {
        let (lanes, members) = (self.lanes, self.members);
        let x = self.x.as_ref();
        let analysed = self.analysed.reset(x.len() / members * (members + 1));
        let (vectors, inner) = (self.vectors.as_ref(), self.inner.as_ref());
        for (vector, analysed) in analysed.chunks_exact_mut((members + 1) * lanes).enumerate() {
            let first = vector * members * lanes;
            let is_earlier = vector >= present;
            let relaxation = if is_earlier { 0.0 } else { self.all.inflation.relaxation_to_prior_perturbations };
            for (lane, near) in self.near.iter().enumerate() {
                let at = |member: usize| first + member * lanes + lane;
                if let Some(weights) = &near.weights {
                    let weights = &weights[usize::from(is_earlier)];
                    for j in 0..=members {
                        analysed[j * lanes + lane] = (0..members).map(|i| x[at(i)] * weights[(i, j)]).sum();
                    }
                } else if near.numbers.is_empty() {
                    (0..members).for_each(|j| analysed[j * lanes + lane] = x[at(j)]);
                } else {
                    let root = near.inflation.sqrt();
                    let [of_root, of_mean] = if is_earlier { [1.0, root] } else { [root, near.inflation] };
                    let gain = of_root * (1.0 - relaxation);
                    for j in 0..members {
                        analysed[j * lanes + lane] = gain * vectors[at(j)] + relaxation * x[at(j)];
                    }
                    let gain = of_mean / ((members - 1) as f64).sqrt();
                    analysed[members * lanes + lane] = gain * inner[vector * lanes + lane];
                }
            }
        }
    }
}

/// How many numbers a [`Batch`] holds for N members and n observations around its places, and for its vectors: each before and
/// after the analysis, two intermediate results, and as observed.
pub(super) fn numbers(members: f64, observations: f64, vectors: f64) -> f64 {
    let size = members.min(observations);
    let lanes = lanes(Arch::new()) as f64;
    let graded = transform::numbers(members, observations);
    let of_vectors = vectors * (4.0 * members + observations);
    graded + lanes * (size * size + 3.0 * observations + of_vectors) + members * observations + size.powi(2)
}

#[cfg(test)]
mod tests {
    use super::super::inflation::{BackgroundInflation, Inflation, Sizes};
    use super::super::localization::Taper;
    use super::super::transform::{WhitenedObservations, transform};
    use super::*;
    use isobar_model::random::{standard_normals, stream};
    use isobar_model::{Boundary, Grid};

    const GRID: Grid = Grid { nx: 23, ny: 17, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Channel };

    /// The weights of one place and those of earlier members, from all observations and the eigenvectors of its matrix; and
    /// the inflation.
    fn dense(all: &LocalObservations<'_>, here: (f64, f64), last: f64) -> (Option<[Mat<f64>; 2]>, f64) {
        let WhitenedObservations { perturbations, departures, rounding } = all.whitened;
        let roots: Vec<f64> = all.places.iter().map(|&place| all.taper.weight(here, place).max(0.0).sqrt()).collect();
        if roots.iter().all(|root| *root == 0.0) {
            return (None, last);
        }
        let scaled = |values: &[f64]| roots.iter().zip(values).map(|(root, value)| root * value).collect::<Vec<_>>();
        let observed = WhitenedObservations {
            perturbations: Mat::from_fn(roots.len(), all.members(), |i, j| roots[i] * perturbations[(i, j)]),
            departures: scaled(departures),
            rounding: scaled(rounding),
        };
        let weight = roots.iter().map(|root| root * root).sum();
        let factor = all.inflation.variance_factor(last, &Sizes { weight, ..observed.sizes() });
        let nearest = roots.iter().copied().fold(0.0, f64::max).powi(2);
        let tapered = (1.0 + (factor.sqrt() - 1.0) * nearest).powi(2);
        let transform = transform(&observed, tapered);
        let earlier = transform.earlier_weights();
        (Some([transform.weights(all.inflation.relaxation_to_prior_perturbations), earlier]), factor)
    }

    /// Places with more and fewer observations than members, and with none; near the seam of the plane and at a wall; with
    /// spreads far below and far above the errors of the observations; one of them with an observation of next to no error.
    #[test]
    fn analyses_of_a_batch_are_those_of_the_eigenvectors() {
        for (members, count, radius, spread) in [
            (7, 60, 3.1, 1.0),
            (7, 9, 4.0, 30.0),
            (12, 300, 2.2, 0.01),
            (10, 25, f64::INFINITY, 3e3),
            (41, 150, 5.0, 200.0),
        ] {
            let normals = standard_normals(&mut stream(3, "batch"), count * (members + 3));
            let (places, normals) = normals.split_at(2 * count);
            let places: Vec<(f64, f64)> = places
                .chunks_exact(2)
                .map(|pair| ((2.0 + 5.0 * pair[0]).rem_euclid(23.0), (4.0 + 4.0 * pair[1]).clamp(0.0, 17.0)))
                .collect();
            let (departures, normals) = normals.split_at(count);
            let is_accurate = |i: usize| radius < 5.0 && i == count / 2;
            let whitened = WhitenedObservations {
                perturbations: Mat::from_fn(count, members, |i, j| {
                    let value = |j: usize| spread / (members as f64).sqrt() * normals[j * count + i];
                    let mean = (0..members).map(value).sum::<f64>() / members as f64;
                    (value(j) - mean) * if is_accurate(i) { 1e9 } else { 1.0 }
                }),
                departures: departures.iter().map(|departure| (1.0 + spread) * departure).collect(),
                rounding: vec![0.0; count],
            };
            let inflation = Inflation {
                background: BackgroundInflation::Adaptive { sigma: 0.3 },
                relaxation_to_prior_perturbations: 0.2,
                ..Inflation::NONE
            };
            let taper = Taper::new(&GRID, radius);
            let all = LocalObservations::new(&GRID, &taper, &places, &whitened, inflation);
            let (lanes, mut batch) = (all.lanes(), Batch::new(&all));
            let mut kinds = [0; 4];
            for row in 0..GRID.ny {
                for first in (0..GRID.nx).step_by(lanes) {
                    let here: Vec<(f64, f64)> =
                        (first..GRID.nx.min(first + lanes)).map(|i| (i as f64 + 0.5, row as f64 + 0.5)).collect();
                    let (vectors, present) = (5, 3);
                    let values = standard_normals(&mut stream(row as u64, "x"), vectors * members * lanes);
                    batch.perturbations(vectors).copy_from_slice(&values);
                    let mut factors = vec![1.1; here.len()];
                    let analysed = batch.analyse(&here, &mut factors, present).to_vec();
                    for (lane, &here) in here.iter().enumerate() {
                        let (weights, factor) = dense(&all, here, 1.1);
                        assert!((factors[lane] / factor - 1.0).abs() < 1e-9);
                        let near = &batch.near[lane];
                        kinds[match &weights {
                            None => 0,
                            Some(_) if near.weights.is_some() => 1,
                            Some(_) if near.numbers.len() < members => 2,
                            Some(_) => 3,
                        }] += 1;
                        // Of eigenvalues, in either way.
                        let roots = places.iter().map(|&place| taper.weight(here, place).max(0.0).sqrt()).enumerate();
                        let square = near.inflation * all.sizes(roots).perturbations;
                        let rounding = 8.0 * f64::EPSILON * square.min(Sizes::LARGEST_SQUARE);
                        for vector in 0..vectors {
                            let x = |i: usize| values[(vector * members + i) * lanes + lane];
                            let found = |i: usize| analysed[(vector * (members + 1) + i) * lanes + lane];
                            let expected = |j: usize| match &weights {
                                Some(weights) => {
                                    let weights = &weights[usize::from(vector >= present)];
                                    (0..members).map(|i| x(i) * weights[(i, j)]).sum()
                                }
                                None if j < members => x(j),
                                None => 0.0,
                            };
                            for j in 0..=members {
                                let allowed = (1e-12 + rounding) * (1.0 + expected(j).abs());
                                let error = (found(j) - expected(j)).abs();
                                assert!(error < allowed, "{members} {count} {radius}: {error:e} of {allowed:e}");
                            }
                        }
                    }
                }
            }
            println!("{members} members, {count} observations within {radius}: {kinds:?}");
            assert!(kinds[2] + kinds[3] > 0);
            assert!(radius != 3.1 || kinds.iter().all(|kind| *kind > 0), "{kinds:?}");
        }
    }
}
