//! Columns of increments, processed in parallel by code for the processor's widest vectors.

use crate::stored::Stored;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Increments one after another.
pub(crate) struct Columns<'a, S> {
    values: &'a mut [S],
    len: usize,
}

impl<'a, S: Stored> Columns<'a, S> {
    /// Increments of `len` values each.
    ///
    /// # Panics
    /// If the number of values is not a multiple of `len`.
    pub fn new(values: &'a mut [S], len: usize) -> Self {
        assert_eq!(values.len() % len, 0, "columns must be whole increments of {len} values");
        Self { values, len }
    }

    /// Applies `process` to each group of `columns` columns (the last may have fewer), with a workspace for each worker.
    pub fn for_each_group<W: Send>(
        self,
        columns: usize,
        work: impl Fn() -> W + Sync + Send,
        process: impl Fn(&mut [S], &mut W) + Sync + Send,
    ) {
        let groups = (self.values.len() / self.len).div_ceil(columns);
        let least = groups.div_ceil(8 * rayon::current_num_threads()).max(1);
        let groups = self.values.par_chunks_mut(columns * self.len).with_min_len(least);
        groups.for_each_init(work, |work, group| process(group, work));
    }
}

impl Columns<'_, f64> {
    /// Applies `process` to each column, with a workspace for each worker; which thread does which column has no
    /// influence on the result.
    ///
    /// What is inlined into `process` is compiled for the processor's widest vectors, chosen at run time. The bits are
    /// the same on all: no operations are fused or reordered.
    pub fn for_each<W: Send>(self, work: impl Fn() -> W + Sync + Send, process: impl Fn(&mut [f64], &mut W) + Sync) {
        let arch = Arch::new();
        let least = (self.values.len() / self.len).div_ceil(8 * rayon::current_num_threads());
        self.values.par_chunks_exact_mut(self.len).with_min_len(least.max(1)).for_each_init(work, |work, column| {
            arch.dispatch(Vectorised { process: &process, column, work });
        });
    }
}

/// A column to process, for [`pulp::Arch::dispatch`].
struct Vectorised<'a, F, W> {
    process: &'a F,
    column: &'a mut [f64],
    work: &'a mut W,
}

impl<W, F: Fn(&mut [f64], &mut W)> WithSimd for Vectorised<'_, F, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        (self.process)(self.column, self.work);
    }
}
