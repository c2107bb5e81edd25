//! The analysis: a nested block-angular regression, cells → amplitudes of the tiles → border.
//!
//! With T = R + H blkdiag(C) Hᵀ, component by component, E_j = H F_j, E_c = H Γ + G and d the innovations:
//!
//! ```text
//! b ← b~ + Σ_j Ψ_j ξ̂_j + Γ' δc + C Hᵀ T⁻¹ d        Ψ_j = F_j − C Hᵀ T⁻¹ E_j,  Γ' = Γ − C Hᵀ T⁻¹ E_c
//! c ← c~ + δc                                       S, ξ̂, δc of the normal equations (`amplitudes`)
//! Γ ← Γ' − Σ_j Ψ_j (M⁻¹ M_xc)_j                     C ← C − C Hᵀ T⁻¹ H C
//! F_j ← Σ_i Ψ_i (M^-½)_ij
//! ```
//!
//! M^-½, which is symmetric, decays from tile to tile: its columns are taken from the principal submatrix of the tiles
//! next to j. Everything else is exact, and F_j is if those are all tiles.

use super::amplitudes::Amplitudes;
use super::inverse_roots::inverse_roots;
use super::local_factors::{LocalFactors, add_to_blocks, union};
use super::recombination::Recombination;
use super::{Frame, LocalErrors};
use crate::augmented::Augmented;
use crate::block_angular::{Component, Eliminated, PartitionReport};
use crate::error::Error;
use crate::errors::blocks::{Separation, SplitRows, augmented, check_component, partition, set_blocks, update_rows};
use crate::filter::Fit;
use crate::linalg::add_symmetric_product;
use crate::memory::Matrix;
use crate::problem::Innovations;
use faer::Mat;
use isobar_model::vector::axpy;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Components that are eliminated at a time.
const COMPONENTS: usize = 256;

/// Tiles away from a tile, in x and y, whose factors have a part in its factors after an analysis.
const NEAR: usize = 1;

/// A component without its own unknowns.
struct Part {
    /// The tiles in whose supports its observations are, ascending.
    tiles: Vec<usize>,
    variables: Vec<usize>,
    eliminated: Eliminated,
}

/// E_j = H F_j of a tile: the rows of the components that see it, one component after another.
struct Observed {
    /// The first row of each component, by its number.
    firsts: BTreeMap<usize, usize>,
    columns: Vec<Vec<f64>>,
}

impl LocalErrors {
    /// s ← s + K d, and the covariance of its errors.
    pub(super) fn analyse_rows(&mut self, s: &mut Augmented, innovations: &Innovations) -> Result<Fit, Error> {
        let frame = Arc::clone(&self.frame);
        let Frame { blocks, shared, local, covering, cells, .. } = &*frame;
        let rows = SplitRows::new(innovations, local, shared);
        let kept: Vec<usize> = self.memory.factors.iter().map(LocalFactors::columns).collect();
        let (components, separation) = self.separated(&rows);
        for component in &components {
            check_component(blocks, component, frame.memory_limit_bytes)?;
        }
        if innovations.len() == 0 {
            return Ok(Fit { chi2: 0.0, partition: Some(self.report(&components, &separation)) });
        }
        let tiles_of = |component: &Component| {
            let entries = component.observations.iter().flat_map(|&row| rows.block.row(row));
            let mut tiles: Vec<usize> =
                entries.flat_map(|&(variable, _)| covering[cells[variable]].iter().copied()).collect();
            tiles.sort_unstable();
            tiles.dedup();
            tiles
        };
        let tiles: Vec<Vec<usize>> = components.par_iter().map(tiles_of).collect();
        self.extend_to(&components, &tiles);
        let counts: Vec<usize> = self.memory.factors.iter().map(LocalFactors::columns).collect();
        let mut amplitudes = Amplitudes::new(&counts, shared.len());
        let mut increment = vec![0.0; blocks.variables()];
        for (chunk, (components, tiles)) in components.chunks(COMPONENTS).zip(tiles.chunks(COMPONENTS)).enumerate() {
            let parts = self.eliminate(chunk * COMPONENTS, components, tiles, &rows, innovations)?;
            add_information(&mut amplitudes, &parts);
            self.take_in(components, parts, &mut increment);
        }
        let solved = amplitudes.solve(self.memory.shared.as_ref())?;
        for (tile, factors) in self.memory.factors.iter().enumerate() {
            factors.multiply_add(&solved.amplitudes[amplitudes.of(tile)], &mut increment);
        }
        for (j, &change) in solved.border.iter().enumerate() {
            axpy(change, self.memory.sensitivity.col_as_slice(j), &mut increment);
        }
        let near: Vec<Vec<usize>> = (0..frame.supports.len()).map(|tile| frame.tiles.near(tile, NEAR)).collect();
        let roots = Recombination::new(inverse_roots(&amplitudes, &near));
        self.finish(&amplitudes, solved.of_border.as_ref(), &roots);
        let before = std::mem::replace(&mut self.memory.shared, Matrix(solved.shared.clone()));
        self.revise_past(&amplitudes, &solved, &roots, before.as_ref());
        self.drop_separators(&kept);
        s.add(&augmented(&increment, &solved.border, local, shared));
        Ok(Fit { chi2: solved.chi2, partition: Some(self.report(&components, &separation)) })
    }

    /// Gives each tile's factors rows for all variables of the components that see it.
    fn extend_to(&mut self, components: &[Component], tiles: &[Vec<usize>]) {
        let frame = Arc::clone(&self.frame);
        let mut seen = vec![Vec::new(); self.memory.factors.len()];
        for (component, tiles) in components.iter().zip(tiles) {
            tiles.iter().for_each(|&tile| seen[tile].extend(&component.blocks));
        }
        self.memory.factors.par_iter_mut().zip(seen).for_each(|(factors, seen)| {
            let members: Vec<usize> = seen.iter().flat_map(|&block| frame.blocks.members(block)).copied().collect();
            if members.iter().any(|&variable| factors.row(variable).is_none()) {
                *factors = factors.extended(&union([factors.variables.as_slice(), &members]), factors.precision());
            }
        });
    }

    fn eliminate(
        &self,
        first: usize,
        components: &[Component],
        tiles: &[Vec<usize>],
        rows: &SplitRows,
        innovations: &Innovations,
    ) -> Result<Vec<Part>, Error> {
        let (blocks, p) = (&self.frame.blocks, self.frame.shared.len());
        let observed = self.observed(components, tiles, rows);
        let eliminate = |(number, (component, tiles)): (usize, (&Component, &Vec<usize>))| {
            let columns = tiles.iter().map(|&tile| self.memory.factors[tile].columns()).sum::<usize>();
            let mut g = Mat::<f64>::zeros(component.observations.len(), columns + p);
            let mut column = 0;
            for &tile in tiles {
                let Observed { firsts, columns } = &observed[tile];
                for of_factor in columns {
                    let seen = &of_factor[firsts[&number]..][..component.observations.len()];
                    g.col_as_slice_mut(column).copy_from_slice(seen);
                    column += 1;
                }
            }
            for (i, &row) in component.observations.iter().enumerate() {
                for &(variable, weight) in rows.block.row(row) {
                    (0..p).for_each(|j| g[(i, columns + j)] += weight * self.memory.sensitivity[(variable, j)]);
                }
                rows.shared.row(row).iter().for_each(|&(j, weight)| g[(i, columns + j)] += weight);
            }
            let parts = (blocks, &self.memory.own);
            let (variables, block) = update_rows(parts, component, g.as_ref(), rows, innovations);
            let eliminated = block.eliminate(first + number, columns + p)?;
            Ok(Part { tiles: tiles.clone(), variables, eliminated })
        };
        components.par_iter().zip(tiles).enumerate().map(eliminate).collect()
    }

    /// E_j of each tile.
    ///
    /// Factor by factor, because a column of F_j lies together in memory, and its row does not.
    fn observed(&self, components: &[Component], tiles: &[Vec<usize>], rows: &SplitRows) -> Vec<Observed> {
        let mut seen = vec![Vec::new(); self.memory.factors.len()];
        tiles.iter().enumerate().for_each(|(number, tiles)| tiles.iter().for_each(|&tile| seen[tile].push(number)));
        let of_tile = |(factors, seen): (&LocalFactors, &Vec<usize>)| {
            let (mut firsts, mut entries, mut count) = (BTreeMap::new(), Vec::new(), 0);
            for &number in seen {
                firsts.insert(number, count);
                for &row in &components[number].observations {
                    let of_row = rows.block.row(row).iter();
                    entries
                        .extend(of_row.filter_map(|&(variable, weight)| Some((count, factors.row(variable)?, weight))));
                    count += 1;
                }
            }
            let of_factor = |j: usize| {
                let (column, mut products) = (factors.column(j), vec![0.0; count]);
                entries.iter().for_each(|&(row, place, weight)| products[row] += weight * column[place]);
                products
            };
            Observed { firsts, columns: (0..factors.columns()).map(of_factor).collect() }
        };
        self.memory.factors.par_iter().zip(&seen).map(of_tile).collect()
    }

    /// F_j ← Ψ_j, Γ ← Γ' and the new C_k on the variables of the components; C Hᵀ T⁻¹ d is added to the increment.
    fn take_in(&mut self, components: &[Component], parts: Vec<Part>, increment: &mut [f64]) {
        let frame = Arc::clone(&self.frame);
        let (blocks, p) = (&frame.blocks, frame.shared.len());
        for (component, Part { tiles, variables, eliminated }) in components.iter().zip(parts) {
            let Eliminated { estimate_without_border, covariance, sensitivity, .. } = eliminated;
            let mut column = 0;
            for &tile in &tiles {
                let factors = &mut self.memory.factors[tile];
                let place = |&variable: &usize| factors.row(variable).expect("the factors have rows for the component");
                let places: Vec<usize> = variables.iter().map(place).collect();
                let changes = sensitivity.get(.., column..column + factors.columns());
                factors.subtract_rows(&places, changes);
                column += factors.columns();
            }
            for j in 0..p {
                let values = self.memory.sensitivity.col_as_slice_mut(j);
                let changes = sensitivity.col_as_slice(column + j);
                variables.iter().zip(changes).for_each(|(&variable, change)| values[variable] -= change);
            }
            let estimate = estimate_without_border.col_as_slice(0);
            variables.iter().zip(estimate).for_each(|(&variable, value)| increment[variable] += value);
            set_blocks((blocks, &mut self.memory.own), component, &variables, covariance.as_ref());
        }
    }

    /// Γ ← Γ' − Σ_j Ψ_j (M⁻¹ M_xc)_j and F_j ← Σ_i Ψ_i (M^-½)_ij; the part of F_j outside its support joins the blocks.
    fn finish(&mut self, amplitudes: &Amplitudes, of_border: faer::MatRef<'_, f64>, roots: &Recombination) {
        let frame = Arc::clone(&self.frame);
        let Frame { supports, blocks, .. } = &*frame;
        for (tile, psi) in self.memory.factors.iter().enumerate() {
            psi.subtract_products(of_border.get(amplitudes.of(tile), ..), &mut self.memory.sensitivity);
        }
        let rooted = roots.parts(&self.memory.factors, supports, blocks.variables());
        let (inside, outside): (Vec<_>, Vec<_>) = rooted.into_iter().unzip();
        add_to_blocks(&mut self.memory.own, blocks, 1.0, &outside);
        self.memory.factors = inside;
    }

    /// The factors of all tiles.
    fn columns(&self) -> usize {
        self.memory.factors.iter().map(LocalFactors::columns).sum()
    }

    fn report(&self, components: &[Component], separation: &Separation) -> PartitionReport {
        separation.report(partition(&self.frame.blocks, components, self.columns(), self.frame.shared.len()))
    }
}

/// Adds what the components say of amplitudes and border, those that see the same tiles together.
fn add_information(amplitudes: &mut Amplitudes, parts: &[Part]) {
    let mut groups: BTreeMap<&[usize], Vec<&Eliminated>> = BTreeMap::new();
    parts.iter().for_each(|part| groups.entry(&part.tiles).or_default().push(&part.eliminated));
    let groups: Vec<(&[usize], Vec<&Eliminated>)> = groups.into_iter().collect();
    let gram = |(_, group): &(&[usize], Vec<&Eliminated>)| {
        let columns = group[0].border_rows.ncols();
        let mut gram = Mat::zeros(columns, columns);
        let mut rows = Mat::zeros(group.iter().map(|part| part.border_rows.nrows()).sum(), columns);
        let mut first = 0;
        for part in group {
            let count = part.border_rows.nrows();
            rows.as_mut().get_mut(first..first + count, ..).copy_from(&part.border_rows);
            first += count;
        }
        add_symmetric_product(gram.as_mut(), 1.0, rows.transpose(), rows.as_ref());
        gram
    };
    let grams: Vec<Mat<f64>> = groups.par_iter().map(gram).collect();
    for ((tiles, _), gram) in groups.iter().zip(&grams) {
        amplitudes.add(tiles, gram.as_ref());
    }
}
