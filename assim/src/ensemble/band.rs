//! The members in a band of rows of cells, and what local analyses make of them.

use super::batch::Batch;
use super::inflation::Inflation;
use super::near::LocalObservations;
use super::weights::WeightGrid;
use faer::Mat;
use isobar_model::{Grid, Location};
use std::ops::Range;

/// What all bands have in common.
pub(super) struct Plan<'a> {
    pub grid: &'a Grid,
    /// Number of variables of a cell.
    pub variables: usize,
    pub weights: &'a WeightGrid,
    pub observations: LocalObservations<'a>,
    pub inflation: Inflation,
    /// The members' deviations in the parameters, `[p, N]`.
    pub parameters: &'a Mat<f64>,
    /// Local parameters with the cells in which they belong, in the order of these.
    pub local: &'a [(usize, usize)],
    /// Shared parameters that are observed, with the share that each analysis has in theirs.
    pub shared: &'a [(usize, Vec<f64>)],
    /// Inflation of the background's covariance in the last cycle, for each analysis.
    pub last_factors: &'a [f64],
}

/// The state in some rows of cells.
pub(super) struct Band<'a> {
    /// The rows of analyses from the first row of cells on to that after the last.
    pub points: Range<usize>,
    /// The values of each variable of the first member, then of the second …
    pub fields: Vec<&'a mut [f64]>,
}

/// What the analyses of a band find beside its state.
pub(super) struct BesideState {
    /// Inflation of the background's covariance, for each analysis.
    pub variance_factors: Vec<f64>,
    /// The numbers of local parameters, with the members' analysed deviations from the background's mean and the shift of
    /// the mean, `[N + 1]`.
    pub local: Vec<(usize, Vec<f64>)>,
    /// The same of all shared parameters: the sums of each row of analyses with their shares.
    pub shared: Vec<Vec<f64>>,
}

/// Perturbations that become analysed deviations: of the state's values, variable by variable, of local parameters, and of
/// shared ones in the analyses of each row.
struct Perturbations {
    /// From a member to the next: an odd number of the processor's lines, so that the members of one row are in different
    /// sets of its cache.
    stride: usize,
    /// `[N, stride]`.
    before: Vec<f64>,
    /// `[N + 1, stride]`, with the shift of the mean last.
    after: Vec<f64>,
}

impl Plan<'_> {
    /// How many numbers a thread holds for bands of `height` rows of analyses and N members.
    pub fn numbers(grid: &Grid, variables: usize, weights: &WeightGrid, height: usize, members: f64) -> f64 {
        let rows = weights.rows.cells(0..height.min(weights.rows.len())).len();
        (2.0 * members + 4.0) * (rows * grid.nx * variables) as f64
    }

    /// Takes the analyses into a band of the members.
    pub fn analyse(&self, mut band: Band<'_>) -> BesideState {
        let cells = self.weights.rows.cells(band.points.clone());
        let cells = cells.start * self.grid.nx..cells.end * self.grid.nx;
        let at = |cell: usize| self.local.partition_point(|local| local.0 < cell);
        let local = &self.local[at(cells.start)..at(cells.end)];
        let own_rows = band.points.len();
        let (state, parameters) = (self.variables * cells.len(), local.len() + own_rows * self.shared.len());
        let (mean, mut perturbations) = self.perturbations(&band, local, state + parameters);
        let variance_factors = self.apply(&band.points, cells, local, &mut perturbations);
        self.set(&mut band, mean, &mut perturbations);
        let of_row = |row: usize| perturbations.after.iter().skip(row).step_by(perturbations.stride).copied().collect();
        BesideState {
            variance_factors,
            local: local.iter().enumerate().map(|(i, &(_, number))| (number, of_row(state + i))).collect(),
            shared: (state + local.len()..state + parameters).map(of_row).collect(),
        }
    }

    /// The means of the state's values and all perturbations.
    fn perturbations(&self, band: &Band<'_>, local: &[(usize, usize)], rows: usize) -> (Vec<f64>, Perturbations) {
        let members = self.parameters.ncols();
        let of_member = |member: usize| &band.fields[member * self.variables..][..self.variables];
        let mut mean = Vec::new();
        for member in 0..members {
            let values = of_member(member).iter().flat_map(|field| field.iter());
            if member == 0 {
                mean.extend(values);
            } else {
                mean.iter_mut().zip(values).for_each(|(mean, value)| *mean += value);
            }
        }
        mean.iter_mut().for_each(|mean| *mean /= members as f64);
        let stride = (rows.div_ceil(8) | 1) * 8;
        let mut before = Vec::with_capacity(members * stride);
        for member in 0..members {
            let values = of_member(member).iter().flat_map(|field| field.iter());
            before.extend(values.zip(&mean).map(|(value, mean)| value - mean));
            before.extend(local.iter().map(|&(_, number)| self.parameters[(number, member)]));
            for _ in band.points.clone() {
                before.extend(self.shared.iter().map(|&(number, _)| self.parameters[(number, member)]));
            }
            before.resize((member + 1) * stride, 0.0);
        }
        (mean, Perturbations { stride, before, after: vec![0.0; (members + 1) * stride] })
    }

    /// Applies all analyses that have a weight in the band; returns the inflation of its own.
    fn apply(
        &self,
        points: &Range<usize>,
        cells: Range<usize>,
        local: &[(usize, usize)],
        perturbations: &mut Perturbations,
    ) -> Vec<f64> {
        let Plan { grid, weights, shared, .. } = self;
        let columns = &weights.columns;
        let state = self.variables * cells.len();
        let mut own_factors = Vec::new();
        let mut batch = Batch::new(&self.observations);
        let lanes = self.observations.lanes();
        let mut rows: Vec<Vec<(usize, f64)>> = vec![Vec::new(); lanes];
        // The row after the last has a weight in the cells before it.
        for number in points.start..=points.end {
            let (point, is_own) = (number % weights.rows.len(), number < points.end);
            let mut in_y: Vec<(usize, f64)> = Vec::new();
            if number > points.start {
                in_y.extend(weights.rows.before(point));
            }
            if is_own {
                in_y.extend(weights.rows.after(point));
            }
            if in_y.is_empty() {
                continue;
            }
            let y_m = grid.y_m(Location::Center, weights.rows.cell(point));
            for first in (0..columns.len()).step_by(lanes) {
                let here: Vec<(f64, f64)> = (first..columns.len().min(first + lanes))
                    .map(|column| (grid.x_m(Location::Center, columns.cell(column)), y_m))
                    .collect();
                for (lane, rows) in rows.iter_mut().enumerate() {
                    rows.clear();
                    if lane >= here.len() {
                        continue;
                    }
                    let column = first + lane;
                    for (i, in_x) in columns.after(column).chain(columns.before(column)) {
                        for &(j, in_y) in &in_y {
                            let of_cell = self.rows_of_cell(j * grid.nx + i, &cells, local);
                            rows.extend(of_cell.map(|row| (row, in_x * in_y)));
                        }
                    }
                    if is_own {
                        let start = state + local.len() + (number - points.start) * shared.len();
                        let shares = shared.iter().map(|(_, shares)| shares[point * columns.len() + column]);
                        rows.extend((start..).zip(shares).filter(|(_, share)| *share > 0.0));
                    }
                }
                let of_points = point * columns.len() + first;
                let mut factors = self.last_factors[of_points..of_points + here.len()].to_vec();
                perturbations.analyse(&mut batch, &here, &mut factors, &rows);
                if is_own {
                    own_factors.extend(factors);
                }
            }
        }
        own_factors
    }

    /// The rows of a cell in the perturbations of a band with these cells: its values and its local parameters.
    fn rows_of_cell(&self, cell: usize, cells: &Range<usize>, local: &[(usize, usize)]) -> impl Iterator<Item = usize> {
        let (count, start) = (cells.len(), cells.start);
        let fields = (0..self.variables).map(move |variable| variable * count + cell - start);
        let first = local.partition_point(|local| local.0 < cell);
        let parameters = local[first..].iter().take_while(|local| local.0 == cell).count();
        let state = self.variables * count;
        fields.chain((first..first + parameters).map(move |number| state + number))
    }

    /// The analysed members of the state: deviations from the analysed mean, with their spread relaxed.
    fn set(&self, band: &mut Band<'_>, mut mean: Vec<f64>, perturbations: &mut Perturbations) {
        let Perturbations { stride, before, after } = perturbations;
        let (state, members) = (mean.len(), self.parameters.ncols());
        let (deviations, shift) = after.split_at_mut(members * *stride);
        let mut excess = vec![0.0; state];
        for deviations in deviations.chunks_exact(*stride) {
            excess.iter_mut().zip(deviations).for_each(|(sum, value)| *sum += value);
        }
        for ((mean, shift), excess) in mean.iter_mut().zip(shift).zip(&mut excess) {
            *excess /= members as f64;
            *mean += *shift + *excess;
        }
        for deviations in deviations.chunks_exact_mut(*stride) {
            deviations.iter_mut().zip(&excess).for_each(|(value, excess)| *value -= excess);
        }
        let spread = |values: &[f64]| -> Vec<f64> {
            let mut squares = vec![0.0; state];
            for values in values.chunks_exact(*stride) {
                squares.iter_mut().zip(values).for_each(|(sum, value)| *sum += value * value);
            }
            squares.iter().map(|square| (square / (members - 1) as f64).sqrt()).collect()
        };
        let factors: Vec<f64> = if self.inflation.relaxation_to_prior_spread > 0.0 {
            let spreads = spread(before).into_iter().zip(spread(deviations));
            spreads.map(|(before, after)| self.inflation.spread_factor(before, after)).collect()
        } else {
            vec![1.0; state]
        };
        let cells = state / self.variables;
        for (number, field) in band.fields.iter_mut().enumerate() {
            let (member, first) = (number / self.variables, number % self.variables * cells);
            let deviations = &deviations[member * *stride + first..][..cells];
            let of_cells = mean[first..].iter().zip(&factors[first..]).zip(deviations);
            for (value, ((mean, factor), deviation)) in field.iter_mut().zip(of_cells) {
                *value = mean + factor * deviation;
            }
        }
    }
}

impl Perturbations {
    /// Adds what the analyses at some places make of the rows of each place, times a weight.
    fn analyse(&mut self, batch: &mut Batch<'_>, here: &[(f64, f64)], factors: &mut [f64], rows: &[Vec<(usize, f64)>]) {
        let (lanes, most) = (rows.len(), rows.iter().map(Vec::len).max().unwrap_or(0));
        let members = self.before.len() / self.stride;
        // What a place has not has no weight.
        let of_lanes = |vector: usize| rows.iter().map(move |rows| rows.get(vector).copied().unwrap_or((0, 0.0)));
        let x = batch.perturbations(most);
        for (vector, x) in x.chunks_exact_mut(members * lanes).enumerate() {
            for (x, values) in x.chunks_exact_mut(lanes).zip(self.before.chunks_exact(self.stride)) {
                x.iter_mut().zip(of_lanes(vector)).for_each(|(x, (row, _))| *x = values[row]);
            }
        }
        let analysed = batch.analyse(here, factors);
        for (vector, analysed) in analysed.chunks_exact((members + 1) * lanes).enumerate() {
            for (analysed, values) in analysed.chunks_exact(lanes).zip(self.after.chunks_exact_mut(self.stride)) {
                analysed.iter().zip(of_lanes(vector)).for_each(|(value, (row, weight))| values[row] += weight * value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::inflation::BackgroundInflation;
    use super::super::localization::Taper;
    use super::super::transform::{WhitenedObservations, transform};
    use super::super::weights::Axis;
    use super::*;
    use crate::linalg::product;
    use faer::MatRef;
    use isobar_model::Boundary;
    use isobar_model::random::{standard_normals, stream};

    const MEMBERS: usize = 6;
    const VARIABLES: usize = 2;

    /// Numbers whose sum over the members is zero, `[rows, N]`.
    fn centered(rows: usize, seed: u64) -> Mat<f64> {
        let normals = standard_normals(&mut stream(seed, "band"), rows * MEMBERS);
        let mean = |i: usize| normals[i * MEMBERS..][..MEMBERS].iter().sum::<f64>() / MEMBERS as f64;
        Mat::from_fn(rows, MEMBERS, |i, j| normals[i * MEMBERS + j] - mean(i))
    }

    /// What bands of any height make of state and parameters is the same, to the bit, and what the interpolated weights do.
    #[test]
    fn bands_of_any_height_apply_the_interpolated_weights() {
        for (boundary, spacing) in [(Boundary::Periodic, 1), (Boundary::Periodic, 3), (Boundary::Channel, 2)] {
            let grid = Grid { nx: 13, ny: 8, dx_m: 1.0, dy_m: 1.0, boundary };
            let (cells, n) = (grid.cells(), 9);
            let places: Vec<(f64, f64)> =
                (0..n).map(|i| ((i * 5 % 13) as f64 + 0.3, (i * 3 % 8) as f64 + 0.6)).collect();
            let whitened = WhitenedObservations {
                perturbations: centered(n, 1),
                departures: standard_normals(&mut stream(2, "band"), n),
                rounding: vec![0.0; n],
            };
            let background = BackgroundInflation::Factor(1.1);
            let inflation = Inflation { background, relaxation_to_prior_spread: 0.3, ..Inflation::NONE };
            let (taper, weights) = (Taper::new(&grid, 4.0), WeightGrid::new(&grid, spacing));
            let parameters = centered(3, 3);
            let local = [(17, 2), (40, 0)];
            let shares = weights.shares([(5, 1.0), (70, 2.0)].into_iter()).unwrap();
            let shared = [(1, shares.clone())];
            let plan = Plan {
                grid: &grid,
                variables: VARIABLES,
                weights: &weights,
                observations: LocalObservations::new(&grid, &taper, &places, &whitened, inflation),
                inflation,
                parameters: &parameters,
                local: &local,
                shared: &shared,
                last_factors: &vec![1.0; weights.len()],
            };
            let state = centered(VARIABLES * cells, 4);
            let run = |height: usize| {
                let mut members: Vec<Vec<f64>> = (0..MEMBERS).map(|j| state.col_as_slice(j).to_vec()).collect();
                let mut found = Vec::new();
                for first in (0..weights.rows.len()).step_by(height) {
                    let points = first..weights.rows.len().min(first + height);
                    let rows = weights.rows.cells(points.clone());
                    let rows = rows.start * grid.nx..rows.end * grid.nx;
                    let fields = members.iter_mut().flat_map(|member| {
                        let (first, second) = member.split_at_mut(cells);
                        [&mut first[rows.clone()], &mut second[rows.clone()]]
                    });
                    found.push(plan.analyse(Band { points, fields: fields.collect() }));
                }
                (members, found)
            };
            let (members, found) = run(1);
            for height in [2, 3, 100] {
                let (others, other) = run(height);
                assert_eq!(members, others, "{boundary:?} {height}");
                let all = |found: &[BesideState]| {
                    let factors: Vec<f64> = found.iter().flat_map(|it| it.variance_factors.clone()).collect();
                    let local: Vec<_> = found.iter().flat_map(|it| it.local.clone()).collect();
                    (factors, local, found.iter().flat_map(|it| it.shared.clone()).collect::<Vec<_>>())
                };
                assert_eq!(all(&found), all(&other));
            }
            let of_points: Vec<Mat<f64>> = (0..weights.len())
                .map(|point| {
                    let here = |axis: &Axis, point| axis.cell(point) as f64 + 0.5;
                    let count = weights.columns.len();
                    let here = (here(&weights.columns, point % count), here(&weights.rows, point / count));
                    let roots: Vec<f64> = places.iter().map(|&place| taper.weight(here, place).sqrt()).collect();
                    let nearest = roots.iter().copied().fold(0.0, f64::max).powi(2);
                    let observed = WhitenedObservations {
                        perturbations: Mat::from_fn(n, MEMBERS, |i, j| roots[i] * whitened.perturbations[(i, j)]),
                        departures: (0..n).map(|i| roots[i] * whitened.departures[i]).collect(),
                        rounding: vec![0.0; n],
                    };
                    transform(&observed, (1.0 + 0.1 * nearest).powi(2)).weights(0.0)
                })
                .collect();
            let mixed = |shares: &[f64], row: MatRef<'_, f64>| -> Vec<f64> {
                let mut sum = vec![0.0; MEMBERS + 1];
                for (weights, share) in of_points.iter().zip(shares) {
                    let analysed = product(row, weights.as_ref());
                    sum.iter_mut().enumerate().for_each(|(j, sum)| *sum += share * analysed[(0, j)]);
                }
                sum
            };
            let close = |found: &[f64], expected: &[f64]| {
                found.iter().zip(expected).for_each(|(a, b)| assert!((a - b).abs() < 1e-11, "{boundary:?}: {a} {b}"));
            };
            let in_cell = |cell: usize| weights.shares([(cell, 1.0)].into_iter()).unwrap();
            for row in 0..VARIABLES * cells {
                let before = state.as_ref().get(row..row + 1, ..);
                let analysed = mixed(&in_cell(row % cells), before);
                let spread = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
                let before: Vec<f64> = (0..MEMBERS).map(|j| before[(0, j)]).collect();
                let factor = 0.7 + 0.3 * spread(&before) / spread(&analysed[..MEMBERS]);
                let expected: Vec<f64> = (0..MEMBERS).map(|j| analysed[MEMBERS] + factor * analysed[j]).collect();
                close(&members.iter().map(|member| member[row]).collect::<Vec<_>>(), &expected);
            }
            for (number, analysed) in found.iter().flat_map(|found| &found.local) {
                let cell = local.iter().find(|it| it.1 == *number).unwrap().0;
                close(analysed, &mixed(&in_cell(cell), parameters.as_ref().get(*number..number + 1, ..)));
            }
            let sums = found.iter().flat_map(|found| &found.shared).fold(vec![0.0; MEMBERS + 1], |mut sum, row| {
                sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
                sum
            });
            close(&sums, &mixed(&shares, parameters.as_ref().get(1..2, ..)));
        }
    }
}
