//! The members in a band of rows of cells, and what local analyses make of them.

use super::batch::Batch;
use super::inflation::Inflation;
use super::near::LocalObservations;
use super::perturbations::Perturbations;
use super::weights::WeightGrid;
use faer::Mat;
use isobar_model::vector::{add, subtract};
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
    /// The members' deviations in the parameters, `[p, N]`, now and in each earlier ensemble of a smoother.
    pub parameters: &'a [Mat<f64>],
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
    /// The rows of cells: all from the first of these on, as far as this rank has them.
    pub rows: Range<usize>,
    /// The values of each variable of the first member, then of the second …
    pub fields: Vec<&'a mut [f64]>,
    /// For each earlier ensemble the means of each variable, then the first member's deviations from these …
    pub earlier: Vec<Vec<&'a mut [f64]>>,
}

/// What the analyses of a band find beside its state.
pub(super) struct BesideState {
    /// Inflation of the background's covariance, for each analysis.
    pub variance_factors: Vec<f64>,
    /// The analysed parameters, now and in each earlier ensemble.
    pub parameters: Vec<BandParameters>,
}

/// The parameters of an ensemble that the analyses of a band find.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BandParameters {
    /// The numbers of local parameters, with the members' analysed deviations from the background's mean and the shift of
    /// the mean, `[N + 1]`.
    pub local: Vec<(usize, Vec<f64>)>,
    /// The same of all shared parameters: the sums of each row of analyses with their shares.
    pub shared: Vec<Vec<f64>>,
}

impl Plan<'_> {
    /// How many numbers a thread holds for a band of `height` rows of analyses, for `ensembles` ensembles of N members.
    pub fn numbers(
        grid: &Grid,
        variables: usize,
        weights: &WeightGrid,
        height: usize,
        members: f64,
        ensembles: usize,
    ) -> f64 {
        let rows = weights.rows.cells(0..height.min(weights.rows.len())).len();
        ((2.0 * members + 1.0) * ensembles as f64 + 3.0) * (rows * grid.nx * variables) as f64
    }

    fn members(&self) -> usize {
        self.parameters[0].ncols()
    }

    /// Takes the analyses into a band of the members.
    pub fn analyse(&self, mut band: Band<'_>) -> BesideState {
        let cells = band.rows.start * self.grid.nx..band.rows.end * self.grid.nx;
        let at = |cell: usize| self.local.partition_point(|local| local.0 < cell);
        let local = &self.local[at(cells.start)..at(cells.end)];
        let own_rows = band.points.len();
        let (state, parameters) = (self.variables * cells.len(), local.len() + own_rows * self.shared.len());
        let (mean, mut perturbations) = self.perturbations(&band, local, state + parameters);
        let variance_factors = self.apply(&band, cells, local, &mut perturbations);
        self.set(&mut band, mean, &mut perturbations);
        self.set_earlier(&mut band, &perturbations);
        let Perturbations { rows, ensembles, stride, after, .. } = &perturbations;
        let of_row = |row: usize| after.iter().skip(row).step_by(*stride).copied().collect();
        let of_ensemble = |first: usize| BandParameters {
            local: local.iter().enumerate().map(|(i, &(_, number))| (number, of_row(first + i))).collect(),
            shared: (first + local.len()..first + parameters).map(of_row).collect(),
        };
        let parameters = (0..*ensembles).map(|ensemble| of_ensemble(ensemble * rows + state)).collect();
        BesideState { variance_factors, parameters }
    }

    /// The means of the state's values and all perturbations.
    fn perturbations(&self, band: &Band<'_>, local: &[(usize, usize)], rows: usize) -> (Vec<f64>, Perturbations) {
        let (members, ensembles) = (self.members(), self.parameters.len());
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
        let stride = ((ensembles * rows).div_ceil(8) | 1) * 8;
        let mut before = Vec::with_capacity(members * stride);
        for member in 0..members {
            for (ensemble, parameters) in self.parameters.iter().enumerate() {
                if ensemble == 0 {
                    let values = of_member(member).iter().flat_map(|field| field.iter());
                    before.extend(values.zip(&mean).map(|(value, mean)| value - mean));
                } else {
                    let fields = &band.earlier[ensemble - 1][(member + 1) * self.variables..][..self.variables];
                    fields.iter().for_each(|field| before.extend_from_slice(field));
                }
                before.extend(local.iter().map(|&(_, number)| parameters[(number, member)]));
                for _ in band.points.clone() {
                    before.extend(self.shared.iter().map(|&(number, _)| parameters[(number, member)]));
                }
            }
            before.resize((member + 1) * stride, 0.0);
        }
        let after = vec![0.0; (members + 1) * stride];
        (mean, Perturbations { rows, ensembles, stride, before, after })
    }

    /// Applies all analyses that have a weight in the band; returns the inflation of its own.
    fn apply(
        &self,
        Band { points, rows: own_rows, .. }: &Band<'_>,
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
            let point = number % weights.rows.len();
            let is_own = number < points.end && own_rows.contains(&weights.rows.cell(point));
            let mut in_y: Vec<(usize, f64)> = Vec::new();
            if number > points.start {
                in_y.extend(weights.rows.before(point));
            }
            if number < points.end {
                in_y.extend(weights.rows.after(point));
            }
            in_y.retain(|(row, _)| own_rows.contains(row));
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
        let Perturbations { stride, before, after, .. } = perturbations;
        let (state, members) = (mean.len(), self.members());
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

    /// The means and deviations of earlier ensembles, whose spread is not relaxed.
    fn set_earlier(&self, band: &mut Band<'_>, perturbations: &Perturbations) {
        let members = self.members();
        let &Perturbations { rows, stride, ref after, .. } = perturbations;
        for (number, fields) in band.earlier.iter_mut().enumerate() {
            let (means, deviations) = fields.split_at_mut(self.variables);
            let mut first = (number + 1) * rows;
            for (variable, mean) in means.iter_mut().enumerate() {
                let of_member = |member: usize| &after[member * stride + first..][..mean.len()];
                let mut excess = vec![0.0; mean.len()];
                (0..members).for_each(|member| add(&mut excess, of_member(member)));
                excess.iter_mut().for_each(|excess| *excess /= members as f64);
                for member in 0..members {
                    let field = &mut deviations[member * self.variables + variable];
                    field.copy_from_slice(of_member(member));
                    subtract(field, &excess);
                }
                add(mean, of_member(members));
                add(mean, &excess);
                first += mean.len();
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

    /// Bands of any height give the same state and parameters, now and earlier, to the bit, and those of the interpolated
    /// weights.
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
            let parameters = [centered(3, 3), centered(3, 5)];
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
            let [state, state_earlier] = [4, 6].map(|seed| centered(VARIABLES * cells, seed));
            // In bands of as many rows of analyses as `height` says, those of each rank.
            let run = |height: usize, ranks: &[Range<usize>]| {
                let mut members: Vec<Vec<f64>> = (0..MEMBERS).map(|j| state.col_as_slice(j).to_vec()).collect();
                // About a mean of 2.
                let mut earlier: Vec<Vec<f64>> = (0..MEMBERS).map(|j| state_earlier.col_as_slice(j).to_vec()).collect();
                earlier.insert(0, vec![2.0; VARIABLES * cells]);
                let mut found = Vec::new();
                let bands = ranks.iter().flat_map(|own| {
                    let [first, last] = [own.start, own.end - 1].map(|row| weights.rows.around(row)[0].0);
                    (first..=last).step_by(height).map(move |first| (own, first..(last + 1).min(first + height)))
                });
                for (own, points) in bands {
                    let Range { start, end } = weights.rows.cells(points.clone());
                    let in_band = start.max(own.start)..end.min(own.end);
                    let rows = in_band.start * grid.nx..in_band.end * grid.nx;
                    let [fields, earlier] = [&mut members, &mut earlier].map(|columns| {
                        let parts = columns.iter_mut().flat_map(|column| {
                            let (first, second) = column.split_at_mut(cells);
                            [&mut first[rows.clone()], &mut second[rows.clone()]]
                        });
                        parts.collect()
                    });
                    found.push(plan.analyse(Band { points, rows: in_band, fields, earlier: vec![earlier] }));
                }
                (members, earlier, found)
            };
            let whole = &std::array::from_fn::<_, 1, _>(|_| 0..grid.ny)[..];
            let (members, earlier, found) = run(1, whole);
            let parameters_of = |found: &[BesideState], ensemble: usize| {
                let of_bands: Vec<BandParameters> = found.iter().map(|it| it.parameters[ensemble].clone()).collect();
                let local: Vec<_> = of_bands.iter().flat_map(|it| it.local.clone()).collect();
                // Rows of analyses that another rank makes add nothing.
                let of_rows = of_bands.into_iter().flat_map(|it| it.shared);
                (local, of_rows.filter(|row| row.iter().any(|&value| value != 0.0)).collect::<Vec<_>>())
            };
            for (height, ranks) in [(2, whole), (3, whole), (100, whole), (1, &[0..4, 4..5, 5..8]), (2, &[0..3, 3..8])]
            {
                let (others, others_earlier, other) = run(height, ranks);
                assert_eq!((&members, &earlier), (&others, &others_earlier), "{boundary:?} {height} {ranks:?}");
                let all = |found: &[BesideState]| {
                    let factors: Vec<f64> = found.iter().flat_map(|it| it.variance_factors.clone()).collect();
                    (factors, parameters_of(found, 0), parameters_of(found, 1))
                };
                assert_eq!(all(&found), all(&other));
            }
            let of_points: Vec<[Mat<f64>; 2]> = (0..weights.len())
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
                    let transform = transform(&observed, (1.0 + 0.1 * nearest).powi(2));
                    let earlier = transform.earlier_weights();
                    [transform.weights(0.0), earlier]
                })
                .collect();
            let mixed = |ensemble: usize, shares: &[f64], row: MatRef<'_, f64>| -> Vec<f64> {
                let mut sum = vec![0.0; MEMBERS + 1];
                for (weights, share) in of_points.iter().zip(shares) {
                    let analysed = product(row, weights[ensemble].as_ref());
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
                let analysed = mixed(0, &in_cell(row % cells), before);
                let spread = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
                let before: Vec<f64> = (0..MEMBERS).map(|j| before[(0, j)]).collect();
                let factor = 0.7 + 0.3 * spread(&before) / spread(&analysed[..MEMBERS]);
                let expected: Vec<f64> = (0..MEMBERS).map(|j| analysed[MEMBERS] + factor * analysed[j]).collect();
                close(&members.iter().map(|member| member[row]).collect::<Vec<_>>(), &expected);
                let expected = mixed(1, &in_cell(row % cells), state_earlier.as_ref().get(row..row + 1, ..));
                let mean = earlier[0][row];
                let deviations: Vec<f64> = earlier[1..].iter().map(|member| member[row]).collect();
                assert!(deviations.iter().sum::<f64>().abs() < 1e-12);
                let analysed: Vec<f64> = deviations.iter().map(|deviation| mean - 2.0 + deviation).collect();
                close(&analysed, &expected[..MEMBERS].iter().map(|it| expected[MEMBERS] + it).collect::<Vec<_>>());
            }
            for (ensemble, parameters) in parameters.iter().enumerate() {
                let (of_places, of_rows) = parameters_of(&found, ensemble);
                assert_eq!(of_places.len(), local.len());
                for (number, analysed) in of_places {
                    let cell = local.iter().find(|it| it.1 == number).unwrap().0;
                    close(&analysed, &mixed(ensemble, &in_cell(cell), parameters.as_ref().get(number..number + 1, ..)));
                }
                let sums = of_rows.iter().fold(vec![0.0; MEMBERS + 1], |mut sum, row| {
                    sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
                    sum
                });
                close(&sums, &mixed(ensemble, &shares, parameters.as_ref().get(1..2, ..)));
            }
        }
    }
}
