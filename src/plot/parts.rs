//! Colours for the parts of a partition of cells: neighbours differ, and what nothing observes is grey.

use super::colors::{GREYS, HUES};
use std::collections::HashMap;

/// For each cell the number of its part's colour in [`Scale::Parts`](super::colors::Scale::Parts).
///
/// `part_of_cell` `[y, x]`, in rows of `nx`; `observed` by part. The largest part has the first colour; the others, by
/// size, the next that none of their neighbours has. Unobserved cells that are parts of their own are all of one grey.
pub fn numbers(part_of_cell: &[usize], observed: &[bool], nx: usize) -> Vec<u8> {
    let mut sizes: HashMap<usize, usize> = HashMap::new();
    part_of_cell.iter().for_each(|&part| *sizes.entry(part).or_default() += 1);
    let seen = |part: usize| observed.get(part).copied().unwrap_or(false);
    let mut neighbours: HashMap<usize, Vec<usize>> = HashMap::new();
    let mut meet = |a: usize, b: usize| {
        if a != b {
            neighbours.entry(a).or_default().push(b);
            neighbours.entry(b).or_default().push(a);
        }
    };
    for (cell, &part) in part_of_cell.iter().enumerate() {
        if cell % nx > 0 {
            meet(part, part_of_cell[cell - 1]);
        }
        if cell >= nx {
            meet(part, part_of_cell[cell - nx]);
        }
    }
    let mut order: Vec<usize> = sizes.keys().copied().collect();
    order.sort_unstable_by_key(|part| (std::cmp::Reverse(sizes[part]), *part));
    let mut numbers: HashMap<usize, usize> = HashMap::new();
    let mut count = [0, 0];
    for part in order {
        let (first, colors) = if seen(part) { (GREYS, HUES) } else { (0, GREYS) };
        let turn = count[usize::from(seen(part))];
        count[usize::from(seen(part))] += 1;
        if !seen(part) && sizes[&part] == 1 {
            numbers.insert(part, 0);
            continue;
        }
        let mut taken = [false; GREYS + HUES];
        let around = neighbours.get(&part).into_iter().flatten().filter_map(|other| numbers.get(other));
        around.for_each(|&number| taken[number] = true);
        let wanted = (0..colors).map(|step| first + (turn + step) % colors).find(|&number| !taken[number]);
        numbers.insert(part, wanted.unwrap_or(first + turn % colors));
    }
    part_of_cell.iter().map(|part| numbers[part] as u8).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_differ_and_the_unobserved_are_grey() {
        // Tiles of 2 × 2 in a field of 8 × 8, every third observed.
        let parts: Vec<usize> = (0..64).map(|cell| cell / 8 / 2 * 4 + cell % 8 / 2).collect();
        let observed: Vec<bool> = (0..16).map(|part| part % 3 == 0).collect();
        let found = numbers(&parts, &observed, 8);
        for cell in 0..64 {
            assert_eq!(usize::from(found[cell]) >= GREYS, observed[parts[cell]], "cell {cell}");
            for other in [cell + 1, cell + 8] {
                let neighbour = other < 64 && (other == cell + 8 || other % 8 > 0);
                if neighbour && parts[cell] != parts[other] {
                    assert_ne!(found[cell], found[other], "cells {cell} and {other}");
                }
            }
        }
    }

    #[test]
    fn the_largest_part_has_the_first_hue_and_single_cells_are_one_grey() {
        let found = numbers(&[0, 1, 1, 2, 3, 1, 4, 4], &[false, true, false, false, true], 4);
        let first = GREYS as u8;
        assert_eq!(found, [0, first, first, 0, 0, first, first + 1, first + 1]);
    }
}
