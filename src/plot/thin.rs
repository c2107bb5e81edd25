//! Fields at reduced resolution, for pictures.

use isobar_model::Grid;

/// Means over square groups of cells: what a picture shows of a grid that is finer than its pixels.
///
/// Groups at the northern and eastern edges are smaller if the grid cannot be divided evenly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Thinning {
    nx: usize,
    ny: usize,
    factor: usize,
}

impl Thinning {
    /// The smallest groups with which neither side has more than `most` of them.
    pub fn new(grid: &Grid, most: usize) -> Self {
        Self { nx: grid.nx, ny: grid.ny, factor: grid.nx.max(grid.ny).div_ceil(most.max(1)).max(1) }
    }

    /// Cells on each side of a group; 1 if nothing is left out.
    pub fn factor(&self) -> usize {
        self.factor
    }

    /// Cells of the fine grid.
    pub fn cells(&self) -> usize {
        self.nx * self.ny
    }

    /// Columns and rows that are left.
    pub fn size(&self) -> [usize; 2] {
        [self.nx.div_ceil(self.factor), self.ny.div_ceil(self.factor)]
    }

    /// The coarse grid on which [`Thinning::apply`] gives values. Its last cells may reach beyond the fine one's edges.
    pub fn grid(&self, fine: &Grid) -> Grid {
        let [nx, ny] = self.size();
        let factor = self.factor as f64;
        Grid { nx, ny, dx_m: factor * fine.dx_m, dy_m: factor * fine.dy_m, ..fine.clone() }
    }

    /// The value in the middle of each group, for what has no means.
    pub fn pick<T: Copy>(&self, field: &[T]) -> Vec<T> {
        let middle = |group: usize, count: usize| (group * self.factor + self.factor / 2).min(count - 1);
        let [columns, rows] = self.size();
        let at = |row, column| field[middle(row, self.ny) * self.nx + middle(column, self.nx)];
        (0..rows)
            .flat_map(|row| (0..columns).map(move |column| (row, column)))
            .map(|(row, column)| at(row, column))
            .collect()
    }

    /// The means of a field `[y, x]`.
    pub fn apply(&self, field: &[f64]) -> Vec<f32> {
        if self.factor == 1 {
            return field.iter().map(|&value| value as f32).collect();
        }
        let [columns, rows] = self.size();
        let mut means = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            let js = row * self.factor..((row + 1) * self.factor).min(self.ny);
            for column in 0..columns {
                let is = column * self.factor..((column + 1) * self.factor).min(self.nx);
                let count = (js.len() * is.len()) as f64;
                let sum: f64 = js.clone().map(|j| field[j * self.nx..][is.clone()].iter().sum::<f64>()).sum();
                means.push((sum / count) as f32);
            }
        }
        means
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Boundary;

    fn grid(nx: usize, ny: usize) -> Grid {
        Grid { nx, ny, dx_m: 10.0, dy_m: 10.0, boundary: Boundary::Periodic }
    }

    #[test]
    fn a_small_field_stays_as_it_is() {
        let thinning = Thinning::new(&grid(3, 2), 3);
        assert_eq!((thinning.factor(), thinning.size()), (1, [3, 2]));
        assert_eq!(thinning.apply(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn a_large_field_becomes_means_with_smaller_groups_at_the_edges() {
        let thinning = Thinning::new(&grid(3, 3), 2);
        assert_eq!((thinning.factor(), thinning.size()), (2, [2, 2]));
        let field = [1.0, 3.0, 10.0, 5.0, 7.0, 20.0, 2.0, 4.0, 9.0];
        assert_eq!(thinning.apply(&field), [4.0, 15.0, 3.0, 9.0]);
        assert_eq!(thinning.grid(&grid(3, 3)).dx_m, 20.0);
        assert_eq!(thinning.pick(&[0, 1, 2, 3, 4, 5, 6, 7, 8]), [4, 5, 7, 8]);
    }
}
