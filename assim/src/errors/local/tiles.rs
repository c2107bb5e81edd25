//! The tiles of a domain, and the supports of their factors.

use isobar_model::{Boundary, Grid};

/// One direction of the tiles.
#[derive(Clone, Debug)]
struct Axis {
    /// Cells in this direction.
    cells: usize,
    /// The first cell of each tile, and the end of the last.
    edges: Vec<usize>,
    periodic: bool,
    /// Tiles in the width of a support.
    width: usize,
}

impl Axis {
    /// About `wanted` tiles. Where the plane goes round and there are more of them than a support is wide, their number is
    /// a multiple of the width, so that the supports of one colour cover it without gaps.
    fn new(cells: usize, wanted: f64, width: usize, periodic: bool) -> Self {
        let tiles = (wanted.round().max(1.0) as usize).min(cells);
        let tiles = if periodic && tiles > width {
            ((tiles as f64 / width as f64).round() as usize * width).min(cells)
        } else {
            tiles
        };
        let edges = (0..=tiles).map(|tile| (tile * cells + tiles / 2) / tiles).collect();
        Self { cells, edges, periodic, width }
    }

    fn tiles(&self) -> usize {
        self.edges.len() - 1
    }

    fn tile_of(&self, cell: usize) -> usize {
        self.edges.partition_point(|&edge| edge <= cell) - 1
    }

    /// The cells of a tile's support, ascending: those within half a width of its centre. The supports of tiles a width
    /// apart adjoin each other.
    fn support(&self, tile: usize) -> Vec<usize> {
        if self.periodic && self.width >= self.tiles() {
            return (0..self.cells).collect();
        }
        let (tile, width) = (tile as isize, self.width as isize);
        let (first, end) = if width % 2 == 0 {
            (self.bound(tile - width / 2, true), self.bound(tile + width / 2, true))
        } else {
            (self.bound(tile - width / 2, false), self.bound(tile + width / 2 + 1, false))
        };
        let mut cells: Vec<usize> = (first..end).map(|cell| cell.rem_euclid(self.cells as isize) as usize).collect();
        cells.sort_unstable();
        cells
    }

    /// The middle or the first cell of a tile, whose number goes on beyond the ends: round the plane, or to the wall.
    fn bound(&self, tile: isize, middle: bool) -> isize {
        let tiles = self.tiles() as isize;
        if !self.periodic && tile < 0 {
            return 0;
        }
        if !self.periodic && tile >= tiles {
            return self.cells as isize;
        }
        let (round, tile) = (tile.div_euclid(tiles), tile.rem_euclid(tiles) as usize);
        let place = if middle { (self.edges[tile] + self.edges[tile + 1]) / 2 } else { self.edges[tile] };
        round * self.cells as isize + place as isize
    }

    /// A colour for each tile: tiles of one colour are at least `apart` from each other.
    fn colours(&self, apart: usize) -> Vec<usize> {
        let tiles = self.tiles();
        if !self.periodic {
            return (0..tiles).map(|tile| tile % apart).collect();
        }
        // Those beyond the last whole round have colours of their own.
        let whole = tiles / apart * apart;
        (0..tiles)
            .map(|tile| if tile < whole { tile % apart } else { tile - whole + if whole > 0 { apart } else { 0 } })
            .collect()
    }

    /// The tiles at most `distance` tiles away, ascending.
    fn near(&self, tile: usize, distance: usize) -> Vec<usize> {
        let tiles = self.tiles();
        let apart = |other: usize| {
            let direct = tile.abs_diff(other);
            if self.periodic { direct.min(tiles - direct) } else { direct }
        };
        (0..tiles).filter(|&other| apart(other) <= distance).collect()
    }

    /// Pairs of neighbours, in groups of pairs without a tile in common.
    fn pairs(&self) -> Vec<Vec<(usize, usize)>> {
        let tiles = self.tiles();
        let from = |first: usize| (first..tiles.saturating_sub(1)).step_by(2).map(|tile| (tile, tile + 1)).collect();
        let mut groups: Vec<Vec<(usize, usize)>> = vec![from(0), from(1)];
        if self.periodic && tiles > 2 {
            let round = (tiles - 1, 0);
            // With an even number of tiles, the last and the first have no part in the second group.
            if tiles.is_multiple_of(2) { groups[1].push(round) } else { groups.push(vec![round]) }
        }
        groups
    }

    /// How far a cell is beyond the upper edge of a tile \[cells\], by the shorter way where the plane goes round.
    fn beyond(&self, tile: usize, cell: usize) -> f64 {
        let n = self.cells as f64;
        let offset = cell as f64 + 0.5 - self.edges[tile + 1] as f64;
        if self.periodic { (offset + 0.5 * n).rem_euclid(n) - 0.5 * n } else { offset }
    }
}

/// The tiles of a domain. Their number goes along x first.
#[derive(Clone, Debug)]
pub(super) struct Tiles {
    x: Axis,
    y: Axis,
}

/// Tiles with a part each, whose supports do not overlap.
#[derive(Clone, Debug)]
pub(super) struct Colours {
    /// Number of colours.
    pub count: usize,
    /// The colour of each tile.
    pub of_tile: Vec<usize>,
}

impl Tiles {
    /// Tiles about as wide as said \[m\], with supports `width` tiles wide.
    pub fn new(grid: &Grid, tile_m: f64, width: usize) -> Self {
        let in_y = grid.boundary == Boundary::Periodic;
        Self {
            x: Axis::new(grid.nx, grid.width_m() / tile_m, width, true),
            y: Axis::new(grid.ny, grid.height_m() / tile_m, width, in_y),
        }
    }

    /// Number of tiles.
    pub fn count(&self) -> usize {
        self.x.tiles() * self.y.tiles()
    }

    fn number(&self, x: usize, y: usize) -> usize {
        y * self.x.tiles() + x
    }

    fn place(&self, tile: usize) -> (usize, usize) {
        (tile % self.x.tiles(), tile / self.x.tiles())
    }

    /// The tile that a cell of the grid belongs to.
    pub fn tile_of(&self, cell: usize) -> usize {
        self.number(self.x.tile_of(cell % self.x.cells), self.y.tile_of(cell / self.x.cells))
    }

    /// The cells of a tile's support, ascending.
    pub fn support(&self, tile: usize) -> Vec<usize> {
        let (x, y) = self.place(tile);
        let columns = self.x.support(x);
        let row = |row: usize| columns.iter().map(move |column| row * self.x.cells + column).collect::<Vec<_>>();
        self.y.support(y).into_iter().flat_map(row).collect()
    }

    /// Colours such that the tiles of one colour are `supports` widths of a support apart.
    pub fn colours(&self, supports: usize) -> Colours {
        let (x, y) = (self.x.colours(supports * self.x.width), self.y.colours(supports * self.y.width));
        let in_x = 1 + x.iter().copied().max().unwrap_or(0);
        let in_y = 1 + y.iter().copied().max().unwrap_or(0);
        let of = |tile: usize| {
            let (column, row) = self.place(tile);
            y[row] * in_x + x[column]
        };
        Colours { count: in_x * in_y, of_tile: (0..self.count()).map(of).collect() }
    }

    /// The tiles at most `distance` tiles away in x and in y, ascending.
    pub fn near(&self, tile: usize, distance: usize) -> Vec<usize> {
        let (x, y) = self.place(tile);
        let columns = self.x.near(x, distance);
        let row = |row: usize| columns.iter().map(move |&column| self.number(column, row)).collect::<Vec<_>>();
        self.y.near(y, distance).into_iter().flat_map(row).collect()
    }

    /// Pairs of neighbours along x, then along y, in groups of pairs without a tile in common.
    pub fn pairs(&self) -> Vec<Vec<Pair>> {
        let mut groups = Vec::new();
        for group in self.x.pairs() {
            let pair = |y: usize| move |&(a, b): &(usize, usize)| (a, b, y);
            let all = (0..self.y.tiles()).flat_map(|y| group.iter().map(pair(y)).collect::<Vec<_>>());
            groups.push(
                all.map(|(a, b, y)| Pair { tiles: [self.number(a, y), self.number(b, y)], along_x: true }).collect(),
            );
        }
        for group in self.y.pairs() {
            let pair = |x: usize| move |&(a, b): &(usize, usize)| (x, a, b);
            let all = (0..self.x.tiles()).flat_map(|x| group.iter().map(pair(x)).collect::<Vec<_>>());
            groups.push(
                all.map(|(x, a, b)| Pair { tiles: [self.number(x, a), self.number(x, b)], along_x: false }).collect(),
            );
        }
        groups.retain(|group: &Vec<Pair>| !group.is_empty());
        groups
    }

    /// How far a cell is beyond the common edge of a pair, on the side of the second \[cells\].
    pub fn beyond(&self, pair: &Pair, cell: usize) -> f64 {
        let (x, y) = self.place(pair.tiles[0]);
        if pair.along_x { self.x.beyond(x, cell % self.x.cells) } else { self.y.beyond(y, cell / self.x.cells) }
    }
}

/// Neighbouring tiles, the western or southern one first.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    pub tiles: [usize; 2],
    pub along_x: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grids() -> Vec<(Grid, usize)> {
        let grid = |nx, ny, boundary| Grid { nx, ny, dx_m: 1.0, dy_m: 1.0, boundary };
        let mut all = Vec::new();
        for boundary in [Boundary::Periodic, Boundary::Channel] {
            for (nx, ny) in [(8, 8), (17, 5), (24, 23), (1, 30), (40, 12)] {
                all.extend([1, 2, 3, 4, 9].map(|width| (grid(nx, ny, boundary), width)));
            }
        }
        all
    }

    #[test]
    fn tiles_of_one_colour_have_supports_without_a_cell_in_common() {
        for (grid, width) in grids() {
            let tiles = Tiles::new(&grid, 2.5, width);
            for supports in [1, 2] {
                let colours = tiles.colours(supports);
                let mut owner = vec![vec![false; grid.cells()]; colours.count];
                for tile in 0..tiles.count() {
                    let support = tiles.support(tile);
                    assert!(support.is_sorted_by(|a, b| a < b), "{grid:?} {width}");
                    for cell in support {
                        let seen = &mut owner[colours.of_tile[tile]][cell];
                        assert!(!*seen, "{grid:?}, width {width}: cell {cell} is in two supports of one colour");
                        *seen = true;
                    }
                }
            }
            // Each cell is in the support of its own tile.
            for cell in 0..grid.cells() {
                assert!(tiles.support(tiles.tile_of(cell)).contains(&cell));
            }
        }
    }

    #[test]
    fn supports_of_a_colour_cover_a_plane_that_goes_round() {
        let grid = Grid { nx: 40, ny: 40, dx_m: 200e3, dy_m: 200e3, boundary: Boundary::Periodic };
        let tiles = Tiles::new(&grid, 1000e3, 4);
        let colours = tiles.colours(1);
        assert_eq!((tiles.count(), colours.count), (64, 16));
        for colour in 0..16 {
            let own = (0..64).filter(|&tile| colours.of_tile[tile] == colour);
            let mut cells: Vec<usize> = own.flat_map(|tile| tiles.support(tile)).collect();
            cells.sort_unstable();
            assert_eq!(cells, (0..1600).collect::<Vec<_>>());
        }
    }

    #[test]
    fn every_pair_of_neighbours_is_there_once() {
        for (grid, width) in grids() {
            let tiles = Tiles::new(&grid, 2.5, width);
            let mut all = Vec::new();
            for group in tiles.pairs() {
                let mut members: Vec<usize> = group.iter().flat_map(|pair| pair.tiles).collect();
                members.sort_unstable();
                assert!(members.is_sorted_by(|a, b| a < b), "{grid:?}: a tile is in two pairs of a group");
                for pair in group {
                    let [a, b] = pair.tiles;
                    assert!(tiles.near(a, 1).contains(&b) && a != b);
                    all.push((pair.along_x, a, b));
                }
            }
            let count = all.len();
            all.sort_unstable();
            all.dedup();
            let edges = |axis: &Axis| match (axis.tiles(), axis.periodic) {
                (1, _) => 0,
                (n, true) if n > 2 => n,
                (n, _) => n - 1,
            };
            let expected = edges(&tiles.x) * tiles.y.tiles() + edges(&tiles.y) * tiles.x.tiles();
            assert_eq!((count, all.len()), (expected, expected), "{grid:?}");
        }
    }
}
