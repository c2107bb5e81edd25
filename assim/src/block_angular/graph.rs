//! The graph of unknowns, or of blocks of them, that rows of a sparse system link.

/// An undirected graph with weighted nodes: the neighbours of each node, ascending.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Graph {
    offsets: Vec<usize>,
    neighbours: Vec<usize>,
    weights: Vec<usize>,
}

impl Graph {
    /// The graph that has an edge between any two nodes that one row touches.
    ///
    /// `weights[i]` is the size of node i, such as the number of a block's variables; `rows` yields the nodes of each
    /// row, in any order, repetitions allowed.
    ///
    /// # Panics
    /// If a row touches a node that is not there.
    pub fn of_rows<'a>(weights: Vec<usize>, rows: impl Iterator<Item = &'a [usize]> + Clone) -> Self {
        let nodes = weights.len();
        // The rows of each node.
        let mut start = vec![0; nodes + 1];
        for row in rows.clone() {
            row.iter().for_each(|&node| start[node + 1] += 1);
        }
        (0..nodes).for_each(|node| start[node + 1] += start[node]);
        let (mut next, mut touching) = (start.clone(), vec![&[][..]; start[nodes]]);
        for row in rows {
            for &node in row {
                touching[next[node]] = row;
                next[node] += 1;
            }
        }
        let (mut offsets, mut neighbours, mut seen) = (vec![0], Vec::new(), vec![usize::MAX; nodes]);
        for node in 0..nodes {
            let first = neighbours.len();
            seen[node] = node;
            for &other in touching[start[node]..start[node + 1]].iter().copied().flatten() {
                if seen[other] != node {
                    seen[other] = node;
                    neighbours.push(other);
                }
            }
            neighbours[first..].sort_unstable();
            offsets.push(neighbours.len());
        }
        Self { offsets, neighbours, weights }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there are no nodes.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// The neighbours of a node, ascending.
    pub fn neighbours(&self, node: usize) -> &[usize] {
        &self.neighbours[self.offsets[node]..self.offsets[node + 1]]
    }

    /// The size of a node.
    pub fn weight(&self, node: usize) -> usize {
        self.weights[node]
    }

    /// The size of all nodes together.
    pub fn total_weight(&self) -> usize {
        self.weights.iter().sum()
    }

    /// The part of the graph that some nodes make, numbered in their order. `scratch` holds `usize::MAX` for every node
    /// of the whole graph, before and after.
    pub(super) fn subgraph(&self, nodes: &[usize], scratch: &mut [usize]) -> Self {
        nodes.iter().enumerate().for_each(|(number, &node)| scratch[node] = number);
        let (mut offsets, mut neighbours) = (vec![0], Vec::new());
        for &node in nodes {
            let first = neighbours.len();
            let inside = self.neighbours(node).iter().map(|&other| scratch[other]);
            neighbours.extend(inside.filter(|&number| number != usize::MAX));
            neighbours[first..].sort_unstable();
            offsets.push(neighbours.len());
        }
        nodes.iter().for_each(|&node| scratch[node] = usize::MAX);
        Self { offsets, neighbours, weights: nodes.iter().map(|&node| self.weights[node]).collect() }
    }

    /// The distance of every node from `start` in edges, and the nodes in the order in which they are reached; those
    /// that are not reached are at `usize::MAX`.
    pub(super) fn distances(&self, start: usize) -> (Vec<usize>, Vec<usize>) {
        let mut distance = vec![usize::MAX; self.len()];
        let mut reached = vec![start];
        distance[start] = 0;
        let mut next = 0;
        while next < reached.len() {
            let node = reached[next];
            for &other in self.neighbours(node) {
                if distance[other] == usize::MAX {
                    distance[other] = distance[node] + 1;
                    reached.push(other);
                }
            }
            next += 1;
        }
        (distance, reached)
    }

    /// The connected components, each ascending, in the order of their first nodes.
    pub(super) fn connected_components(&self) -> Vec<Vec<usize>> {
        let mut known = vec![false; self.len()];
        let mut found = Vec::new();
        for start in 0..self.len() {
            if known[start] {
                continue;
            }
            known[start] = true;
            let mut component = vec![start];
            let mut next = 0;
            while next < component.len() {
                for &other in self.neighbours(component[next]) {
                    if !known[other] {
                        known[other] = true;
                        component.push(other);
                    }
                }
                next += 1;
            }
            component.sort_unstable();
            found.push(component);
        }
        found
    }
}
