//! The observations around the places of local analyses.

use super::buckets::Buckets;
use super::inflation::{Inflation, Sizes};
use super::localization::Taper;
use super::transform::{WhitenedObservations, transform};
use crate::lanes::{Fractions, lanes};
use crate::linalg::{row_major, squared_norm};
use faer::Mat;
use isobar_model::Grid;
use pulp::Arch;

/// All observations, to be found from any place.
pub(super) struct LocalObservations<'a> {
    pub whitened: &'a WhitenedObservations,
    /// Ỹ row by row, `[n, N]`, and |ỹ|² of each row.
    pub rows: Vec<f64>,
    squares: Vec<f64>,
    pub places: &'a [(f64, f64)],
    pub buckets: Buckets,
    pub taper: &'a Taper,
    pub inflation: Inflation,
    /// For matrices between 1 and 4, 4², 4³ …
    pub fractions: Vec<Fractions>,
    pub arch: Arch,
}

impl<'a> LocalObservations<'a> {
    pub fn new(
        grid: &Grid,
        taper: &'a Taper,
        places: &'a [(f64, f64)],
        whitened: &'a WhitenedObservations,
        inflation: Inflation,
    ) -> Self {
        let members = whitened.perturbations.ncols();
        let rows = row_major(whitened.perturbations.as_ref());
        let squares = rows.chunks_exact(members).map(squared_norm).collect();
        let largest = 1.0 + Sizes::LARGEST_SQUARE;
        let fractions = std::iter::successors(Some(4.0), |bound| (*bound < largest).then_some(4.0 * bound));
        let fractions = fractions.map(Fractions::new).collect();
        let buckets = Buckets::new(grid, taper.radius_m(), places);
        Self { whitened, rows, squares, places, buckets, taper, inflation, fractions, arch: Arch::new() }
    }

    /// How many places are analysed together.
    pub fn lanes(&self) -> usize {
        lanes(self.arch)
    }

    pub fn members(&self) -> usize {
        self.whitened.perturbations.ncols()
    }

    /// The sizes of some observations, given the roots of their weights.
    pub fn sizes(&self, numbers: impl Iterator<Item = (usize, f64)>) -> Sizes {
        let mut sizes = Sizes { perturbations: 0.0, departures: 0.0, weight: 0.0 };
        for (number, root) in numbers {
            let weight = root * root;
            sizes.perturbations += weight * self.squares[number];
            sizes.departures += weight * self.whitened.departures[number].powi(2);
            sizes.weight += weight;
        }
        sizes
    }
}

/// The observations of one place, and its analysis but for what it does to the members.
#[derive(Clone, Default)]
pub(super) struct Near {
    /// Their numbers among those of the batch, ascending, and the roots of their weights.
    pub numbers: Vec<usize>,
    pub roots: Vec<f64>,
    /// f.
    pub inflation: f64,
    /// Where double precision needs more care: the weights of the members, `[N, N + 1]`, and of earlier ensembles.
    pub weights: Option<[Mat<f64>; 2]>,
}

impl Near {
    pub fn clear(&mut self) {
        self.numbers.clear();
        self.roots.clear();
        self.weights = None;
    }

    /// With the roots of their weights.
    pub fn observations(&self) -> impl Iterator<Item = (usize, f64)> {
        self.numbers.iter().copied().zip(self.roots.iter().copied())
    }

    /// Whether it is analysed with the others of its batch.
    pub fn is_regular(&self) -> bool {
        !self.numbers.is_empty() && self.weights.is_none()
    }

    /// Finds the inflation, from that of the last cycle; and the weights where these have to be formed.
    pub fn set_analysis(&mut self, all: &LocalObservations<'_>, found: &[usize], last: &mut f64) {
        if self.numbers.is_empty() {
            return;
        }
        let sizes = all.sizes(self.observations().map(|(number, root)| (found[number], root)));
        *last = all.inflation.variance_factor(*last, &sizes);
        // Inflation has the analysis's taper: at the edge of an observation's reach there is next to no analysis to make up for.
        let nearest = self.roots.iter().copied().fold(0.0, f64::max).powi(2);
        self.inflation = (1.0 + (last.sqrt() - 1.0) * nearest).powi(2);
        if sizes.are_graded(self.inflation) {
            let WhitenedObservations { perturbations, departures, rounding } = all.whitened;
            let row = |i: usize| found[self.numbers[i]];
            let scaled = |values: &[f64]| (0..self.roots.len()).map(|i| self.roots[i] * values[row(i)]).collect();
            let local = WhitenedObservations {
                perturbations: Mat::from_fn(self.roots.len(), perturbations.ncols(), |i, j| {
                    self.roots[i] * perturbations[(row(i), j)]
                }),
                departures: scaled(departures),
                rounding: scaled(rounding),
            };
            let relaxation = all.inflation.relaxation_to_prior_perturbations;
            let transform = transform(&local, self.inflation);
            let earlier = transform.earlier_weights();
            self.weights = Some([transform.weights(relaxation), earlier]);
        }
    }
}
