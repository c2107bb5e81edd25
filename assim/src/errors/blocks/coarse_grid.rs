//! Factors propagated on a coarser grid.
//!
//! What the blocks' errors have in common is smooth: it needs no finer grid than resolves its correlation length. With R
//! the restriction to a grid of cells k times as wide, P the interpolation back, and A_c the tangent-linear model there,
//!
//! ```text
//! Φ_b ← Φ_b + P (A_c − I) R Φ_b
//! ```
//!
//! What the coarse grid does not show of a factor stays where it is. P is bilinear between the variable's own points on
//! the C grid, R = (diag(Pᵀ 1))⁻¹ Pᵀ (full weighting), so that both keep constants, and either is exact for k = 1. A
//! coarse cell takes k² cells' place and, with the time step that its spacing allows, k steps' too: k³ times less work.

use crate::error::Error;
use crate::filter::Cycle;
use crate::tall_matrix::{TallMatrix, stored};
use isobar_model::communicator::all_succeed;
use isobar_model::forecast::{ForecastError, forecast, forecast_tl, require_finite_increments};
use isobar_model::vector::axpy;
use isobar_model::{Boundary, ColumnsMut, Duration, InBands, Layout, State, Stored, TangentLinear};
use rayon::prelude::*;
use std::sync::Arc;

/// A model on a coarser grid of the same domain, and the way there and back.
pub(in crate::errors) struct CoarseGrid {
    model: Arc<dyn TangentLinear>,
    /// Of each variable along y and along x.
    interpolations: Vec<[Interpolation; 2]>,
    /// Values of a row, and of a field, of the fine and of the coarse grid.
    rows: [usize; 2],
    fields: [usize; 2],
}

impl CoarseGrid {
    /// The way from states of a layout to those of a model, and back.
    ///
    /// # Errors
    /// [`Error::Setting`] if the model's grid is not one of whole multiples of the layout's cells, or it has other
    /// variables.
    pub fn new(layout: &Layout, model: Arc<dyn TangentLinear>) -> Result<Self, Error> {
        let coarse = model.layout().clone();
        let (fine_grid, coarse_grid) = (&layout.grid, &coarse.grid);
        let factor = fine_grid.nx / coarse_grid.nx.max(1);
        let fits = coarse_grid.nx * factor == fine_grid.nx
            && coarse_grid.ny * factor == fine_grid.ny
            && (coarse_grid.dx_m - factor as f64 * fine_grid.dx_m).abs() < 1e-9 * coarse_grid.dx_m
            && (coarse_grid.dy_m - factor as f64 * fine_grid.dy_m).abs() < 1e-9 * coarse_grid.dy_m
            && coarse_grid.boundary == fine_grid.boundary
            && coarse.variables == layout.variables;
        if !fits {
            return Err(Error::Setting(format!(
                "the factors' grid of {} × {} cells is not a coarser one of {} × {}, with the same variables",
                coarse_grid.nx, coarse_grid.ny, fine_grid.nx, fine_grid.ny
            )));
        }
        let walls = fine_grid.boundary == Boundary::Channel;
        let interpolations = layout.variables.iter().map(|variable| {
            let (offset_x, offset_y) = variable.location.offset();
            [
                Interpolation::new(coarse_grid.ny, factor, offset_y, walls),
                Interpolation::new(coarse_grid.nx, factor, offset_x, false),
            ]
        });
        Ok(Self {
            interpolations: interpolations.collect(),
            rows: [fine_grid.nx, coarse_grid.nx],
            fields: [fine_grid.cells(), coarse_grid.cells()],
            model,
        })
    }

    /// Forecasts the state over a cycle, and columns of increments: the first `factors` of them on the coarser grid, if there
    /// is one, and the others, the probes, by the model of the state.
    ///
    /// # Errors
    /// As a forecast; [`Error::Setting`] if the window does not hold whole steps of the coarse model, or more of them.
    pub fn forecast(
        coarse: Option<&Self>,
        cycle: &Cycle<'_>,
        state: &mut State,
        columns: &mut TallMatrix,
        factors: usize,
    ) -> Result<(), Error> {
        if let Some(in_bands) = cycle.model.in_bands() {
            return match coarse {
                None => forecast_parts((cycle.model, in_bands), state, columns, 0, cycle.steps),
                Some(coarse) => coarse.forecast_parts_here(in_bands, state, cycle, columns, factors),
            };
        }
        let factors = factors * columns.rows();
        stored!(columns.values_mut(), columns => match coarse {
            None => Ok(forecast_tl(cycle.model, state, columns, cycle.steps)?),
            Some(coarse) => {
                let (factors, probes) = columns.split_at_mut(factors);
                coarse.forecast_here(cycle.model, state, (cycle.window, cycle.steps), factors, probes)
            }
        })
    }

    /// Forecasts the state over a window and its number of steps, the probes by the model of the state, and the factors here.
    fn forecast_here<S: Stored>(
        &self,
        model: &dyn TangentLinear,
        state: &mut State,
        (window, steps): (Duration, usize),
        factors: &mut [S],
        probes: &mut [S],
    ) -> Result<(), Error> {
        let coarse_steps = self.steps_of(window, steps)?;
        let (m, coarse_m) = (state.values().len(), self.model.layout().len());
        let mut coarse = vec![S::default(); factors.len() / m * coarse_m];
        let columns = factors.par_chunks_exact_mut(m).zip(coarse.par_chunks_exact_mut(coarse_m));
        columns.for_each_init(Default::default, |(fine, own), (factor, coarse)| {
            S::in_double(factor, fine, |factor| {
                S::in_double(coarse, own, |coarse| {
                    self.restrict(factor, coarse);
                    self.add_interpolated(-1.0, coarse, factor);
                });
            });
        });
        let mut at = State::zeros(self.model.layout());
        for step in 0..coarse_steps {
            let (done, next) = (step * steps / coarse_steps, (step + 1) * steps / coarse_steps);
            self.restrict(state.values(), at.values_mut());
            let advance = || forecast_tl(model, state, probes, next - done).map_err(|error| later(error, done));
            rayon::join(advance, || self.model.steps_tl(&at, S::columns_mut(&mut coarse), 1)).0?;
        }
        require_finite_increments(self.model.layout(), &coarse, steps)?;
        let columns = factors.par_chunks_exact_mut(m).zip(coarse.par_chunks_exact_mut(coarse_m));
        columns.for_each_init(Default::default, |(fine, own), (factor, coarse)| {
            S::in_double(factor, fine, |factor| {
                S::in_double(coarse, own, |coarse| self.add_interpolated(1.0, coarse, factor));
            });
        });
        Ok(())
    }

    /// The same of factors of whose rows each rank has some: each advances its share of them here, and all together the state and the
    /// probes.
    fn forecast_parts_here(
        &self,
        in_bands: &dyn InBands,
        state: &mut State,
        cycle: &Cycle<'_>,
        columns: &mut TallMatrix,
        factors: usize,
    ) -> Result<(), Error> {
        let (steps, coarse_steps) = (cycle.steps, self.steps_of(cycle.window, cycle.steps)?);
        let coarse_m = self.model.layout().len();
        let mut coarse: Vec<f64> = Vec::new();
        columns.edit_whole_columns(in_bands.bands(), 0..factors, |columns| {
            let first = coarse.len();
            coarse.resize(first + columns.len() * coarse_m, 0.0);
            columns.par_iter_mut().zip(coarse[first..].par_chunks_exact_mut(coarse_m)).for_each(|(column, coarse)| {
                self.restrict(column, coarse);
                self.add_interpolated(-1.0, coarse, column);
            });
        });
        let mut at = State::zeros(self.model.layout());
        for step in 0..coarse_steps {
            let (done, next) = (step * steps / coarse_steps, (step + 1) * steps / coarse_steps);
            self.restrict(state.values(), at.values_mut());
            forecast_parts((cycle.model, in_bands), state, columns, factors, next - done)?;
            self.model.steps_tl(&at, ColumnsMut::Double(&mut coarse), 1);
        }
        let own = require_finite_increments(self.model.layout(), &coarse, steps);
        all_succeed(in_bands.bands().communicator(), own).map_err(ForecastError::OnRank)?;
        let mut left = &coarse[..];
        columns.edit_whole_columns(in_bands.bands(), 0..factors, |columns| {
            let own = left.split_off(..columns.len() * coarse_m).expect("as many as there were");
            columns.par_iter_mut().zip(own.par_chunks_exact(coarse_m)).for_each(|(column, coarse)| {
                self.add_interpolated(1.0, coarse, column);
            });
        });
        Ok(())
    }

    /// Time steps of this model in a window that has `steps` of the state's.
    fn steps_of(&self, window: Duration, steps: usize) -> Result<usize, Error> {
        window.steps_of(self.model.time_step()).filter(|&coarse| coarse <= steps).ok_or_else(|| {
            let step = self.model.time_step();
            Error::Setting(format!("the window of {window} does not hold whole steps of {step} on the factors' grid"))
        })
    }

    /// coarse = R fine.
    fn restrict(&self, fine: &[f64], coarse: &mut [f64]) {
        let ([fine_row, coarse_row], [fine_field, coarse_field]) = (self.rows, self.fields);
        coarse.fill(0.0);
        let mut row = vec![0.0; coarse_row];
        let fields = fine.chunks_exact(fine_field).zip(coarse.chunks_exact_mut(coarse_field));
        for ([along_y, along_x], (fine, coarse)) in self.interpolations.iter().zip(fields) {
            for (fine, places) in fine.chunks_exact(fine_row).zip(&along_y.places) {
                row.fill(0.0);
                for (value, places) in fine.iter().zip(&along_x.places) {
                    for &(place, weight) in places {
                        row[place] += weight * along_x.inverse_totals[place] * value;
                    }
                }
                for &(place, weight) in places.iter().filter(|(_, weight)| *weight != 0.0) {
                    let weight = weight * along_y.inverse_totals[place];
                    let target = &mut coarse[place * coarse_row..][..coarse_row];
                    axpy(weight, &row, target);
                }
            }
        }
    }

    /// fine += sign P coarse.
    fn add_interpolated(&self, sign: f64, coarse: &[f64], fine: &mut [f64]) {
        let ([fine_row, coarse_row], [fine_field, coarse_field]) = (self.rows, self.fields);
        let mut row = vec![0.0; coarse_row];
        let fields = fine.chunks_exact_mut(fine_field).zip(coarse.chunks_exact(coarse_field));
        for ([along_y, along_x], (fine, coarse)) in self.interpolations.iter().zip(fields) {
            for (fine, places) in fine.chunks_exact_mut(fine_row).zip(&along_y.places) {
                let [south, north] = places.map(|(place, _)| &coarse[place * coarse_row..][..coarse_row]);
                let [of_south, of_north] = places.map(|(_, weight)| sign * weight);
                for ((value, south), north) in row.iter_mut().zip(south).zip(north) {
                    *value = of_south * south + of_north * north;
                }
                for (value, [west, east]) in fine.iter_mut().zip(&along_x.places) {
                    *value += west.1 * row[west.0] + east.1 * row[east.0];
                }
            }
        }
    }
}

/// Advances a state, and the columns from `first` on, of whose rows each rank has some.
fn forecast_parts(
    (model, in_bands): (&dyn TangentLinear, &dyn InBands),
    state: &mut State,
    columns: &mut TallMatrix,
    first: usize,
    steps: usize,
) -> Result<(), Error> {
    let (at, first) = (state.clone(), first * columns.own_rows());
    forecast(model, state, steps)?;
    stored!(columns.values_mut(), columns => {
        Ok(in_bands.forecast_tl_parts(&at, Stored::columns_mut(&mut columns[first..]), steps)?)
    })
}

/// Linear interpolation along one direction from coarse points to fine ones.
struct Interpolation {
    /// For each fine point the coarse ones before and after it with their weights.
    places: Vec<[(usize, f64); 2]>,
    /// One over the sum of the weights of each coarse point; zero where a wall keeps it zero.
    inverse_totals: Vec<f64>,
}

impl Interpolation {
    /// Onto points `factor` times as dense as `count` coarse ones, each `offset` behind its cell's edge.
    ///
    /// Towards a wall points inside of the cells are continued constantly, those on the edges to zero at the wall.
    fn new(count: usize, factor: usize, offset: f64, walls: bool) -> Self {
        let (last, on_edge) = (count as i64 - 1, offset == 0.0);
        let place = |number: i64| {
            let place = if walls { number.clamp(0, last) } else { number.rem_euclid(count as i64) };
            place as usize
        };
        let places: Vec<[(usize, f64); 2]> = (0..count * factor)
            .map(|fine| {
                let position = (fine as f64 + offset) / factor as f64 - offset;
                let (before, weight) = (position.floor() as i64, position - position.floor());
                // The northern wall, which is not stored, and at which all is zero.
                let beyond = walls && on_edge && before == last;
                [(place(before), 1.0 - weight), (place(before + 1), if beyond { 0.0 } else { weight })]
            })
            .collect();
        let mut totals = vec![0.0; count];
        places.iter().flatten().for_each(|&(place, weight)| totals[place] += weight);
        if walls && on_edge {
            totals[0] = f64::INFINITY;
        }
        Self { places, inverse_totals: totals.iter().map(|total| 1.0 / total).collect() }
    }
}

/// The error of a forecast that began after some steps, as that of the whole.
fn later(error: ForecastError, done: usize) -> ForecastError {
    match error {
        ForecastError::NotFinite { step, place, value, cfl } => {
            ForecastError::NotFinite { step: step + done, place, value, cfl }
        }
        ForecastError::IncrementNotFinite { step, column, place } => {
            ForecastError::IncrementNotFinite { step: step + done, column, place }
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Still;
    use isobar_model::random::{standard_normals, stream};
    use isobar_model::{Grid, shallow_water};

    fn layout(n: usize, boundary: Boundary) -> Arc<Layout> {
        let spacing = 48e5 / n as f64;
        shallow_water::layout(Grid { nx: n, ny: n, dx_m: spacing, dy_m: spacing, boundary })
    }

    fn way(factor: usize, boundary: Boundary) -> (Arc<Layout>, CoarseGrid) {
        let fine = layout(48, boundary);
        let coarse = CoarseGrid::new(&fine, Arc::new(Still(layout(48 / factor, boundary)))).unwrap();
        (fine, coarse)
    }

    #[test]
    fn restriction_is_the_scaled_transpose_of_interpolation_and_both_keep_constants() {
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            for factor in [1, 2, 4, 8] {
                let (fine, way) = way(factor, boundary);
                let coarse_len = way.model.layout().len();
                // The sums of the weights of P, and with them ⟨R a, S b⟩ = ⟨a, P b⟩ for the scaled product.
                let mut totals = vec![0.0; coarse_len];
                for variable in 0..3 {
                    let [along_y, along_x] = &way.interpolations[variable];
                    for (j, y) in along_y.inverse_totals.iter().enumerate() {
                        for (i, x) in along_x.inverse_totals.iter().enumerate() {
                            let scale = if *y == 0.0 { 0.0 } else { 1.0 / (x * y) };
                            totals[variable * way.fields[1] + j * way.rows[1] + i] = scale;
                        }
                    }
                }
                let a = standard_normals(&mut stream(1, "fine"), fine.len());
                let mut b = standard_normals(&mut stream(1, "coarse"), coarse_len);
                // At a wall v is zero.
                b.iter_mut().zip(&totals).filter(|(_, total)| **total == 0.0).for_each(|(value, _)| *value = 0.0);
                let (mut of_a, mut of_b) = (vec![0.0; coarse_len], vec![0.0; fine.len()]);
                way.restrict(&a, &mut of_a);
                way.add_interpolated(1.0, &b, &mut of_b);
                let left: f64 = of_a.iter().zip(&b).zip(&totals).map(|((a, b), total)| a * b * total).sum();
                let right: f64 = a.iter().zip(&of_b).map(|(a, b)| a * b).sum();
                assert!((left - right).abs() < 1e-10 * right.abs().max(1.0), "{left} {right}");

                let walled = boundary == Boundary::Channel;
                let ones = vec![1.0; fine.len()];
                way.restrict(&ones, &mut of_a);
                let free = 2 * way.fields[1] + if walled { way.rows[1] } else { 0 };
                for (place, value) in of_a.iter().enumerate() {
                    let at_wall = (2 * way.fields[1]..free).contains(&place);
                    let expected = if at_wall { 0.0 } else { 1.0 };
                    assert!((value - expected).abs() < 1e-12, "{boundary:?} {factor}: {value} at {place}");
                }
                let mut back = vec![0.0; fine.len()];
                way.add_interpolated(1.0, &vec![1.0; coarse_len], &mut back);
                let interior = |index: usize| index < 2 * way.fields[0] || !walled;
                let kept = back.iter().enumerate().filter(|(index, _)| interior(*index));
                assert!(kept.into_iter().all(|(_, value)| (value - 1.0).abs() < 1e-12));
                if factor == 1 && !walled {
                    way.restrict(&a, &mut of_a);
                    assert_eq!(of_a, a);
                }
            }
        }
    }

    #[test]
    fn smooth_fields_survive_the_way_there_and_back_to_second_order() {
        let errors = [2, 4, 8].map(|factor| {
            let (fine, way) = way(factor, Boundary::Periodic);
            let field: Vec<f64> = (0..fine.len())
                .map(|index| {
                    let (variable, row, column) = fine.place(index);
                    let location = fine.variables[variable].location;
                    let phase = |metres: f64| std::f64::consts::TAU * metres / 48e5;
                    phase(fine.grid.x_m(location, column)).sin() * phase(fine.grid.y_m(location, row)).cos()
                })
                .collect();
            let mut coarse = vec![0.0; way.model.layout().len()];
            let mut rest = field.clone();
            way.restrict(&field, &mut coarse);
            way.add_interpolated(-1.0, &coarse, &mut rest);
            rest.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()))
        });
        assert!(errors[0] < 0.03 && errors[2] < 0.4, "{errors:?}");
        assert!(errors.windows(2).all(|pair| (3.0..4.5).contains(&(pair[1] / pair[0]))), "{errors:?}");
    }

    #[test]
    fn what_is_no_coarser_grid_is_refused() {
        let fine = layout(48, Boundary::Periodic);
        for other in [layout(32, Boundary::Periodic), layout(24, Boundary::Channel), layout(96, Boundary::Periodic)] {
            let error = CoarseGrid::new(&fine, Arc::new(Still(other))).err().unwrap().to_string();
            assert!(error.contains("is not a coarser one of 48 × 48"), "{error}");
        }
    }
}
