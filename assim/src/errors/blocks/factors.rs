//! The common factors Φ = [Φ_b; Φ_c].

use crate::error::Error;
use crate::linalg::{cholesky, column, mirror_lower, product, solve_lower};
use crate::memory::Matrix;
use crate::tall_matrix::{ColumnMut, Precision, TallMatrix, add_scaled_gram};
use faer::prelude::ReborrowMut;
use faer::{Mat, MatMut, MatRef};
use isobar_model::vector::axpy;
use isobar_obs::Calibration;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Φ: each row is a variable, each column a direction of errors that many blocks have in common.
///
/// The state's rows are apart from those of the local parameters, so that a column of them is an increment, which the
/// tangent-linear model advances where it lies.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Factors {
    /// Rows of Φ_b of the state's values, `[m, r]`, in the precision of the settings.
    pub state: TallMatrix,
    /// Rows of Φ_b of the local parameters, `[local, r]`, in double precision: they are few.
    pub local: TallMatrix,
    /// Φ_c, `[shared parameters, r]`.
    pub shared: Matrix,
    /// Ψ: the rows of the same factors that the errors of the last analyses have, the oldest first, if there is a smoother.
    /// What combines the columns of Φ combines theirs; their errors do not change otherwise.
    pub past: VecDeque<Factors>,
}

/// Factors of the state `[m, r]` with those of the prior covariance P_c of the parameters. With P_c's part of the shared
/// parameters as L Lᵀ, the local ones have `C_ls L⁻ᵀ` in the first p factors, which carry the shared ones: it holds their
/// covariance with these. The rest of their covariance is in the blocks. What local parameters of two blocks have in common
/// beyond the shared ones is dropped, as whatever two blocks have in common.
///
/// # Errors
/// If P_c is not positive definite.
pub(super) fn with_priors(
    state: TallMatrix,
    calibration: &Calibration,
    shared: &[usize],
    local: &[usize],
) -> Result<Factors, Error> {
    let covariance = |i: usize, j: usize| calibration.prior_covariance(i, j);
    let (p, r) = (shared.len(), state.columns());
    let own = Mat::from_fn(p, p, |i, j| covariance(shared[i], shared[j]));
    let root = cholesky(own, || "the prior covariance of the shared calibration parameters".into())?;
    // (C_ls L⁻ᵀ)ᵀ = L⁻¹ C_sl, `[p, local]`.
    let mut with_local = Mat::from_fn(p, local.len(), |i, j| covariance(shared[i], local[j]));
    solve_lower(root.as_ref(), with_local.as_mut());
    let mut of_local = TallMatrix::zeros(local.len(), r, Precision::Double);
    for column in 0..p {
        (0..local.len()).for_each(|local| of_local.set(local, column, with_local[(column, local)]));
    }
    let of_shared = Mat::from_fn(p, r, |i, j| if j < p { root[(i, j)] } else { 0.0 });
    Ok(Factors { state, local: of_local, shared: Matrix(of_shared), past: VecDeque::new() })
}

/// Further factors F of the state, `[m, q]`, that join Φ.
#[derive(Clone, Copy)]
pub(crate) struct Further<'a> {
    pub factors: &'a TallMatrix,
    /// Fᵀ S⁻² F, `[q, q]`, S the scales of the state's values.
    pub gram: MatRef<'a, f64>,
}

impl Factors {
    /// `columns` columns of zeros, in double precision, for the variables of `like`.
    pub fn zeros_like(like: &Factors, columns: usize) -> Self {
        Self {
            state: like.state.zeros_like(columns, Precision::Double),
            local: TallMatrix::zeros(like.local.rows(), columns, Precision::Double),
            shared: Matrix(Mat::zeros(like.shared.nrows(), columns)),
            past: like.past.iter().map(|past| Self::zeros_like(past, columns)).collect(),
        }
    }

    /// Whether it is whole, and has these numbers of rows.
    pub fn has_rows(&self, state: usize, local: usize, shared: usize) -> bool {
        let columns = self.columns();
        self.state.has_shape(state, columns)
            && self.local.has_shape(local, columns)
            && self.local.precision() == Precision::Double
            && self.shared.has_shape(shared, columns)
            && self
                .past
                .iter()
                .all(|past| past.columns() == columns && past.past.is_empty() && past.has_rows(state, local, shared))
    }

    /// Number of factors r.
    pub fn columns(&self) -> usize {
        self.state.columns()
    }

    /// Entry of a block variable as it counts in a sum over the ranks: zero unless this rank has it. Those of parameters are rank 0's.
    pub fn value(&self, variable: usize, column: usize) -> f64 {
        match variable.checked_sub(self.state.rows()) {
            None => self.state.value(variable, column),
            Some(parameter) if self.has_parameters() => self.local.value(parameter, column),
            Some(_) => 0.0,
        }
    }

    /// Entry of a block variable whose row this rank has, or which is a parameter.
    pub fn own_value(&self, variable: usize, column: usize) -> f64 {
        match variable.checked_sub(self.state.rows()) {
            None => self.state.value(variable, column),
            Some(parameter) => self.local.value(parameter, column),
        }
    }

    /// Whether what parameters add to a sum over the ranks is added by this one. All have the rows of parameters.
    pub fn has_parameters(&self) -> bool {
        self.state.bands().is_none_or(|bands| bands.communicator().rank() == 0)
    }

    /// Sums over the ranks.
    pub fn sum(&self, values: &mut [f64]) {
        if let Some(bands) = self.state.bands() {
            bands.communicator().sum(values);
        }
    }

    /// Sets an entry of a block variable.
    pub fn set(&mut self, variable: usize, column: usize, value: f64) {
        let m = self.state.rows();
        if variable < m {
            self.state.set(variable, column, value);
        } else {
            self.local.set(variable - m, column, value);
        }
    }

    /// Appends factors of zeros.
    pub fn append(&mut self, columns: usize) {
        self.state.append(columns);
        self.local.append(columns);
        let before = &self.shared;
        let entry = |i: usize, j: usize| if j < before.ncols() { before[(i, j)] } else { 0.0 };
        self.shared = Matrix(Mat::from_fn(before.nrows(), before.ncols() + columns, entry));
        self.past.iter_mut().for_each(|past| past.append(columns));
    }

    /// Puts the columns of `others` before these, each multiplied by its scale.
    pub fn prepend(&mut self, others: &Factors, scales: &[f64]) {
        let q = scales.len();
        self.state.prepend(q);
        self.local.prepend(q);
        for (k, &scale) in scales.iter().enumerate() {
            self.state.edit_column(k, |column| axpy(scale, &others.state.column(k), column));
            self.local.edit_column(k, |column| axpy(scale, &others.local.column(k), column));
        }
        let (before, of_others) = (&self.shared, &others.shared);
        let entry = |i: usize, j: usize| if j < q { scales[j] * of_others[(i, j)] } else { before[(i, j - q)] };
        self.shared = Matrix(Mat::from_fn(before.nrows(), q + before.ncols(), entry));
        self.past.iter_mut().zip(&others.past).for_each(|(past, others)| past.prepend(others, scales));
    }

    /// Takes the first columns out, each divided by its scale.
    pub fn take_front(&mut self, scales: &[f64]) -> Factors {
        let q = scales.len();
        let (mut state, mut local) = (self.state.take_front(q), self.local.take_front(q));
        for (k, divisor) in scales.iter().enumerate() {
            for part in [&mut state, &mut local] {
                part.edit_column(k, |column| column.iter_mut().for_each(|value| *value /= divisor));
            }
        }
        let (p, joint) = (self.shared.nrows(), &self.shared);
        let shared = Matrix(Mat::from_fn(p, q, |i, j| joint[(i, j)] / scales[j]));
        self.shared = Matrix(Mat::from_fn(p, joint.ncols() - q, |i, j| joint[(i, q + j)]));
        let past = self.past.iter_mut().map(|past| past.take_front(scales)).collect();
        Factors { state, local, shared, past }
    }

    /// Adds a multiple of a column of `others` to one of these.
    pub fn add_to_column(&mut self, column: usize, factor: f64, others: &Factors, other: usize) {
        self.state.edit_column(column, |target| axpy(factor, &others.state.column(other), target));
        self.local.edit_column(column, |target| axpy(factor, &others.local.column(other), target));
        axpy(factor, others.shared.col_as_slice(other), self.shared.col_as_slice_mut(column));
        for (past, others) in self.past.iter_mut().zip(&others.past) {
            past.add_to_column(column, factor, others, other);
        }
    }

    /// Sets a column to zero.
    pub fn clear_column(&mut self, column: usize) {
        self.state.edit_column(column, |column| column.fill(0.0));
        self.local.edit_column(column, |column| column.fill(0.0));
        self.shared.col_as_slice_mut(column).fill(0.0);
        self.past.iter_mut().for_each(|past| past.clear_column(column));
    }

    /// Φ ← Φ T.
    fn rotate(&mut self, t: MatRef<'_, f64>) {
        self.recombine(None, t);
        self.shared = Matrix(product(self.shared.as_ref(), t));
    }

    /// Φ ← Φ T for a lower triangular T, whose entries above the diagonal are zero.
    pub fn multiply_lower(&mut self, t: MatRef<'_, f64>) {
        self.state.multiply_lower(t);
        self.local.multiply_lower(t);
        self.shared = Matrix(product(self.shared.as_ref(), t));
        self.past.iter_mut().for_each(|past| past.multiply_lower(t));
    }

    /// Φ_b ← \[Φ_b \[F; 0\]\] T, where F are further factors of the state, which are independent of the past: Ψ ← Ψ T_old.
    pub fn recombine(&mut self, further: Option<&TallMatrix>, t: MatRef<'_, f64>) {
        let of_old = t.get(..self.columns(), ..);
        self.state.recombine(further, t);
        self.local.recombine(None, of_old);
        self.past.iter_mut().for_each(|past| past.rotate(of_old));
    }

    /// The present rows become those of the newest analysis of the past.
    pub fn remember(&mut self) {
        let Factors { state, local, shared, .. } = &*self;
        let now = Factors { state: state.clone(), local: local.clone(), shared: shared.clone(), past: VecDeque::new() };
        self.past.push_back(now);
    }

    /// \[Φ_b \[F; 0\]\]ᵀ S⁻² \[Φ_b \[F; 0\]\], S the scales of the block variables, into a matrix of zeros.
    pub fn scaled_gram(&self, further: Option<Further<'_>>, scales: &[f64], mut gram: MatMut<'_, f64>) {
        let (of_state, of_local) = scales.split_at(self.state.rows());
        let r = self.columns();
        match further {
            None => add_scaled_gram(gram.rb_mut(), &self.state, None, of_state),
            Some(Further { factors, gram: own }) => {
                add_scaled_gram(gram.rb_mut(), &self.state, Some(factors), of_state);
                gram.rb_mut().get_mut(r.., r..).copy_from(own);
            }
        }
        add_scaled_gram(gram.rb_mut().get_mut(..r, ..r), &self.local, None, of_local);
        mirror_lower(gram);
    }

    /// Φ_b x.
    pub fn multiply_add(&self, x: &[f64], block_variables: &mut [f64]) {
        let (of_state, of_local) = block_variables.split_at_mut(self.state.rows());
        self.state.multiply_add(x, of_state);
        self.local.multiply_add(x, of_local);
    }

    /// Adds Φ_b x to what there is of the block variables; returns Φ_c x.
    pub fn increments(&self, x: &[f64], of_blocks: &mut [f64]) -> Vec<f64> {
        self.multiply_add(x, of_blocks);
        product(self.shared.as_ref(), column(x).as_ref()).col_as_slice(0).to_vec()
    }

    /// The variances of the block variables and of the shared parameters through the factors from `first` on.
    pub fn variances(&self, first: usize) -> (Vec<f64>, Vec<f64>) {
        let m = self.state.rows();
        let mut of_blocks = vec![0.0; m + self.local.rows()];
        self.state.add_squared_rows(first, &mut of_blocks[..m]);
        self.local.add_squared_rows(first, &mut of_blocks[m..]);
        let row = |row: usize| (first..self.columns()).map(|j| self.shared[(row, j)].powi(2)).sum();
        (of_blocks, (0..self.shared.nrows()).map(row).collect())
    }

    /// Calls `work` with the number of each factor and its rows of state and local parameters, in parallel.
    pub fn for_each_column(&mut self, work: impl Fn(usize, ColumnMut<'_>, ColumnMut<'_>) + Sync) {
        let columns = self.state.columns_mut().into_par_iter().zip(self.local.columns_mut()).enumerate();
        columns.for_each(|(number, (of_state, of_local))| work(number, of_state, of_local));
    }
}
