//! A vertex separator: few nodes of a connected graph, without which it falls into two parts of given sizes.
//!
//! Candidates cut the graph in the middle of a ranking of its nodes by their distances from nodes far apart. The best of
//! them are refined by moving single nodes (Fiduccia and Mattheyses 1982, for vertex separators as in Ashcraft and Liu
//! 1998, SIAM J. Matrix Anal. Appl. 19, 325): a node that leaves the separator for one part draws its neighbours in the
//! other part into it.

use super::graph::Graph;
use std::collections::BinaryHeap;

/// Far-apart nodes from which distances are taken.
const CORNERS: usize = 4;

/// Candidates that are refined.
const REFINED: usize = 4;

/// Passes of refinement at most.
const PASSES: usize = 12;

/// Moves without a better separator after which a pass ends.
const PATIENCE: usize = 150;

/// Where a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Left = 0,
    Right = 1,
    Separator = 2,
}

/// The sizes that the parts may have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Balance {
    /// The share of all weight that is wanted on the left.
    pub left_share: f64,
    /// The most weight of the left and of the right part; only a node that is heavier may exceed it.
    pub limits: [usize; 2],
}

/// Splits a connected graph of at least two nodes; neither the left part nor the separator is empty.
pub(super) fn bisect(graph: &Graph, balance: Balance) -> Vec<Side> {
    let mut cuts: Vec<Cut> = rankings(graph).iter().map(|ranking| Cut::along(graph, ranking, balance)).collect();
    // The sort is stable: of equal ones the first goes first.
    cuts.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
    cuts.truncate(REFINED);
    for cut in &mut cuts {
        let mut left = PASSES;
        while left > 0 && cut.refine() {
            left -= 1;
        }
    }
    cuts.into_iter().min_by(|a, b| a.cost().total_cmp(&b.cost())).expect("there are rankings").side
}

/// Orders of the nodes, each of which runs from one end of the graph to another.
fn rankings(graph: &Graph) -> Vec<Vec<usize>> {
    // A node that is far from everything, then one that is farthest from those already chosen.
    let (_, reached) = graph.distances(0);
    let mut corners = vec![*reached.last().expect("the graph has nodes")];
    let mut distances: Vec<Vec<usize>> = Vec::new();
    loop {
        distances.push(graph.distances(corners[corners.len() - 1]).0);
        if corners.len() == CORNERS.min(graph.len()) {
            break;
        }
        let nearest = |node: usize| distances.iter().map(|own| own[node]).min().unwrap_or(0);
        let next = (0..graph.len()).max_by_key(|&node| (nearest(node), std::cmp::Reverse(node)));
        corners.push(next.expect("the graph has nodes"));
    }
    let sorted = |key: &dyn Fn(usize) -> i64| {
        let mut nodes: Vec<usize> = (0..graph.len()).collect();
        nodes.sort_by_key(|&node| (key(node), node));
        nodes
    };
    let mut rankings: Vec<Vec<usize>> = distances.iter().map(|own| sorted(&|node| own[node] as i64)).collect();
    for (number, first) in distances.iter().enumerate() {
        for second in &distances[number + 1..] {
            rankings.push(sorted(&|node| first[node] as i64 - second[node] as i64));
        }
    }
    rankings
}

/// A separator and the parts on its sides.
struct Cut<'a> {
    graph: &'a Graph,
    balance: Balance,
    side: Vec<Side>,
    /// The weight of the left part, the right part and the separator.
    weights: [usize; 3],
}

impl<'a> Cut<'a> {
    /// The first nodes of a ranking on the left, those linked with them in the separator.
    fn along(graph: &'a Graph, ranking: &[usize], balance: Balance) -> Self {
        let mut side = vec![Side::Right; graph.len()];
        let mut weights = [0, graph.total_weight(), 0];
        let wanted = balance.left_share * weights[1] as f64;
        for (number, &node) in ranking[..ranking.len() - 1].iter().enumerate() {
            let weight = graph.weight(node);
            // Half of the node may lie beyond the middle.
            if number > 0 && (weights[0] as f64 + 0.5 * weight as f64) > wanted {
                break;
            }
            side[node] = Side::Left;
            weights[0] += weight;
            weights[1] -= weight;
        }
        for node in 0..graph.len() {
            let linked = |other: &usize| side[*other] == Side::Left;
            if side[node] == Side::Right && graph.neighbours(node).iter().any(linked) {
                side[node] = Side::Separator;
                weights[1] -= graph.weight(node);
                weights[2] += graph.weight(node);
            }
        }
        Self { graph, balance, side, weights }
    }

    /// The weight of the separator; a part over its limit costs far more, and imbalance a little.
    fn cost(&self) -> f64 {
        let excess: usize = (0..2).map(|part| self.weights[part].saturating_sub(self.balance.limits[part])).sum();
        let total = self.weights.iter().sum::<usize>() as f64;
        let parts = (self.weights[0] + self.weights[1]) as f64;
        let imbalance = (self.weights[0] as f64 - self.balance.left_share * parts).abs() / total;
        self.weights[2] as f64 + 1e3 * excess as f64 + 0.5 * imbalance
    }

    /// How much lighter the separator becomes if `node` leaves it for `part`.
    fn gain(&self, node: usize, part: Side) -> i64 {
        let other = opposite(part);
        let drawn = self.graph.neighbours(node).iter().filter(|&&neighbour| self.side[neighbour] == other);
        self.graph.weight(node) as i64 - drawn.map(|&neighbour| self.graph.weight(neighbour) as i64).sum::<i64>()
    }

    fn put(&mut self, node: usize, side: Side) {
        let weight = self.graph.weight(node);
        self.weights[self.side[node] as usize] -= weight;
        self.weights[side as usize] += weight;
        self.side[node] = side;
    }

    /// One pass in which every node leaves the separator at most once, taken back to the best state on its way; whether
    /// that is better than before.
    fn refine(&mut self) -> bool {
        const PARTS: [Side; 2] = [Side::Left, Side::Right];
        let nodes = self.graph.len();
        let (mut moved, mut stamp) = (vec![false; nodes], vec![0_u32; nodes]);
        // The best move of each part first; among equal ones the later stamp, which keeps the moves together.
        let mut heaps: [BinaryHeap<(i64, u32, usize)>; 2] = Default::default();
        let mut clock = 0;
        let mut offer = |cut: &Self, node: usize, stamp: &mut [u32], heaps: &mut [BinaryHeap<_>; 2]| {
            clock += 1;
            stamp[node] = clock;
            for part in PARTS {
                heaps[part as usize].push((cut.gain(node, part), clock, node));
            }
        };
        for node in (0..nodes).filter(|&node| self.side[node] == Side::Separator) {
            offer(self, node, &mut stamp, &mut heaps);
        }
        let (mut best, mut best_length) = (self.cost(), 0);
        let before = best;
        // Nodes and where they were.
        let mut log: Vec<(usize, Side)> = Vec::new();
        let mut stalled = 0;
        while stalled < PATIENCE {
            let mut chosen: Option<(i64, f64, usize, Side)> = None;
            for part in PARTS {
                let heap = &mut heaps[part as usize];
                while let Some(&(gain, at, node)) = heap.peek() {
                    if at != stamp[node] || moved[node] || self.side[node] != Side::Separator {
                        heap.pop();
                        continue;
                    }
                    let weight = self.weights[part as usize];
                    if weight + self.graph.weight(node) > self.balance.limits[part as usize] {
                        break;
                    }
                    let share =
                        if part == Side::Left { self.balance.left_share } else { 1.0 - self.balance.left_share };
                    let fullness = weight as f64 / share;
                    if chosen.is_none_or(|(other, filled, ..)| gain > other || (gain == other && fullness < filled)) {
                        chosen = Some((gain, fullness, node, part));
                    }
                    break;
                }
            }
            let Some((.., node, part)) = chosen else { break };
            moved[node] = true;
            log.push((node, Side::Separator));
            self.put(node, part);
            let drawn: Vec<usize> =
                self.graph.neighbours(node).iter().copied().filter(|&it| self.side[it] == opposite(part)).collect();
            for &neighbour in &drawn {
                log.push((neighbour, opposite(part)));
                self.put(neighbour, Side::Separator);
            }
            // Whose neighbours changed sides has other gains now.
            let mut touched: Vec<usize> = drawn.clone();
            for &changed in drawn.iter().chain([&node]) {
                touched.extend(self.graph.neighbours(changed));
            }
            touched.sort_unstable();
            touched.dedup();
            for other in touched {
                if self.side[other] == Side::Separator && !moved[other] {
                    offer(self, other, &mut stamp, &mut heaps);
                }
            }
            stalled += 1;
            if self.cost() < best && self.weights[0] > 0 && self.weights[2] > 0 {
                (best, best_length, stalled) = (self.cost(), log.len(), 0);
            }
        }
        for &(node, side) in log[best_length..].iter().rev() {
            self.put(node, side);
        }
        best < before
    }
}

fn opposite(part: Side) -> Side {
    if part == Side::Left { Side::Right } else { Side::Left }
}
