//! Columns in groups that stay interleaved from step to step, where something comes between the steps that all columns have part in.

use super::groups::least_of_a_group;
use super::interleaving::Interleaving;
use super::strips::Lanes;
use super::tendency::Tendency;
use crate::columns::Columns;
use crate::stored::{ColumnsMut, Stored};

/// Columns of `len` values each, constrained, as [`super::groups::for_each_group`] arranges them: interleaved, or alone if few are left.
pub(super) struct HeldGroups<'a, N> {
    len: usize,
    nx: usize,
    cells: usize,
    /// Whole groups, where they lie.
    whole: &'a mut [N],
    /// A group that is not filled up, and its copy that is.
    last: &'a mut [N],
    filled: Vec<N>,
    alone: &'a mut [N],
}

impl<'a, N: Stored> HeldGroups<'a, N> {
    /// Arranges columns of `levels` levels.
    ///
    /// # Panics
    /// If they are not whole.
    pub fn new<T: Tendency>(tendency: &T, levels: usize, columns: &'a mut [N]) -> Self {
        let (grid, level) = (&tendency.layout().grid, tendency.layout().len());
        let len = levels * level;
        assert_eq!(columns.len() % len, 0, "columns must be whole increments of {len} values");
        columns.chunks_exact_mut(level).for_each(|level| tendency.constrain(level));
        let left = columns.len() / len % N::COLUMNS * len;
        let (whole, left) = columns.split_at_mut(columns.len() - left);
        let is_group = left.len() / len >= least_of_a_group::<N>(len);
        let (last, alone) = left.split_at_mut(if is_group { left.len() } else { 0 });
        let mut filled = last.to_vec();
        filled.resize(if is_group { N::COLUMNS * len } else { 0 }, N::default());
        let mut groups = Self { len, nx: grid.nx, cells: grid.cells(), whole, last, filled, alone };
        groups.rearrange(Interleaving::interleave);
        groups
    }

    fn rearrange(&mut self, how: impl Fn(&mut Interleaving<N>, &mut [N]) + Sync) {
        let (len, nx) = (self.len, self.nx);
        let new = || Interleaving::new(len / nx, nx);
        for groups in [&mut *self.whole, &mut self.filled] {
            Columns::new(groups, N::COLUMNS * len)
                .for_each_group(1, new, |group, interleaving| how(interleaving, group));
        }
    }

    /// The fields of the columns, `[y, x, lane]` of a group and `[y, x]` of a column alone.
    pub fn fields(&mut self) -> impl Iterator<Item = ColumnsMut<'_>> {
        let of_group = N::COLUMNS * self.cells;
        let groups = self.whole.chunks_exact_mut(of_group).chain(self.filled.chunks_exact_mut(of_group));
        groups.chain(self.alone.chunks_exact_mut(self.cells)).map(N::columns_mut)
    }

    /// Applies `advance` to each group and to each column alone, with a sweep for each worker.
    pub fn for_each<W: Send>(
        &mut self,
        sweep: impl Fn(Lanes) -> Option<W> + Sync,
        advance: impl Fn(&mut [N], &mut W) + Sync,
    ) {
        let all = |columns: &mut [N], len: usize, lanes: Lanes| {
            Columns::new(columns, len).for_each_group(
                1,
                || sweep(lanes),
                |columns, sweep| {
                    if let Some(sweep) = sweep {
                        advance(columns, sweep);
                    }
                },
            );
        };
        all(self.whole, N::COLUMNS * self.len, Lanes::Group);
        all(&mut self.filled, N::COLUMNS * self.len, Lanes::Group);
        all(self.alone, self.len, Lanes::One);
    }

    /// The columns one after another again.
    pub fn separate(mut self) {
        self.rearrange(Interleaving::separate);
        let count = self.last.len();
        self.last.copy_from_slice(&self.filled[..count]);
    }
}
