//! Nested dissection: a graph as a tree of parts, none of them over a size limit, and of the separators between them.
//!
//! George (1973), SIAM J. Numer. Anal. 10, 345. An elimination from the leaves to the root is that of Helmert blocks.

use super::graph::Graph;
use super::separator::{Balance, Side, bisect};

/// The tree, children before their parent.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Dissection {
    /// The parts and the separators.
    pub members: Vec<Member>,
}

/// A part, or a separator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    /// Numbers of its nodes, ascending.
    pub nodes: Vec<usize>,
    /// The separator that bounds it and those beside it; `None` for the last separator of a component, or a component
    /// that needs none.
    pub parent: Option<usize>,
    /// Whether it separates others.
    pub separator: bool,
}

impl Dissection {
    /// Cuts every connected component whose nodes weigh more than `limit`, until no part does.
    ///
    /// Nodes of two parts are never linked. A single node that is heavier than the limit is a part.
    pub fn new(graph: &Graph, limit: usize) -> Self {
        let mut tree = Self::default();
        let mut scratch = vec![usize::MAX; graph.len()];
        for component in graph.connected_components() {
            tree.add(graph, component, limit, &mut scratch);
        }
        tree
    }

    /// Adds a connected set of nodes, and returns the number of its last member.
    fn add(&mut self, graph: &Graph, nodes: Vec<usize>, limit: usize, scratch: &mut [usize]) -> usize {
        let weight: usize = nodes.iter().map(|&node| graph.weight(node)).sum();
        if weight <= limit || nodes.len() == 1 {
            self.members.push(Member { nodes, parent: None, separator: false });
            return self.members.len() - 1;
        }
        let own = graph.subgraph(&nodes, scratch);
        let parts = weight.div_ceil(limit.max(1)).max(2);
        let left_parts = parts / 2;
        let balance = Balance {
            left_share: left_parts as f64 / parts as f64,
            limits: [limit * left_parts, limit * (parts - left_parts)],
        };
        let sides = bisect(&own, balance);
        let on = |side: Side| {
            let pairs = nodes.iter().zip(&sides);
            pairs.filter(|pair| *pair.1 == side).map(|pair| *pair.0).collect::<Vec<usize>>()
        };
        let (rest, separator) = ([on(Side::Left), on(Side::Right)], on(Side::Separator));
        let mut children = Vec::new();
        for part in rest {
            let connected = graph.subgraph(&part, scratch).connected_components();
            for component in connected {
                let nodes = component.into_iter().map(|number| part[number]).collect();
                children.push(self.add(graph, nodes, limit, scratch));
            }
        }
        self.members.push(Member { nodes: separator, parent: None, separator: true });
        let number = self.members.len() - 1;
        for child in children {
            self.members[child].parent = Some(number);
        }
        number
    }

    /// The member of each of the graph's nodes.
    pub fn member_of(&self, nodes: usize) -> Vec<usize> {
        let mut member_of = vec![usize::MAX; nodes];
        for (number, member) in self.members.iter().enumerate() {
            member.nodes.iter().for_each(|&node| member_of[node] = number);
        }
        member_of
    }

    /// The nodes of all separators, ascending.
    pub fn border(&self) -> Vec<usize> {
        let separators = self.members.iter().filter(|member| member.separator);
        let mut nodes: Vec<usize> = separators.flat_map(|member| &member.nodes).copied().collect();
        nodes.sort_unstable();
        nodes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::random::stream;
    use rand::RngExt;

    fn five_point(nx: usize, ny: usize) -> Graph {
        let mut rows: Vec<Vec<usize>> = Vec::new();
        for node in 0..nx * ny {
            if node % nx + 1 < nx {
                rows.push(vec![node, node + 1]);
            }
            if node + nx < nx * ny {
                rows.push(vec![node, node + nx]);
            }
        }
        Graph::of_rows(vec![1; nx * ny], rows.iter().map(Vec::as_slice))
    }

    /// Every node is in one member, no part is over the limit, and no edge joins two members unless one of them is
    /// above the other in the tree.
    fn check(graph: &Graph, tree: &Dissection, limit: usize) {
        let mut member_of = vec![usize::MAX; graph.len()];
        for (number, member) in tree.members.iter().enumerate() {
            assert!(member.parent.is_none_or(|parent| parent > number && tree.members[parent].separator));
            assert!(!member.nodes.is_empty());
            let weight: usize = member.nodes.iter().map(|&node| graph.weight(node)).sum();
            assert!(member.separator || weight <= limit || member.nodes.len() == 1, "{weight} of {limit}");
            for &node in &member.nodes {
                assert_eq!(std::mem::replace(&mut member_of[node], number), usize::MAX);
            }
        }
        assert!(!member_of.contains(&usize::MAX));
        let above = |mut low: usize, high: usize| {
            while let Some(parent) = tree.members[low].parent.filter(|&parent| parent <= high) {
                low = parent;
            }
            low == high
        };
        for node in 0..graph.len() {
            for &other in graph.neighbours(node) {
                let (a, b) = (member_of[node], member_of[other]);
                assert!(above(a.min(b), a.max(b)), "{node} and {other} are linked");
            }
        }
    }

    #[test]
    fn the_border_of_tiles_of_a_five_point_graph_is_that_of_straight_cuts() {
        let n = 64;
        let graph = five_point(n, n);
        for tiles in [4, 16, 64] {
            let limit = n * n / tiles;
            let tree = Dissection::new(&graph, limit);
            check(&graph, &tree, limit);
            let wanted = 2.0 * n as f64 * ((tiles as f64).sqrt() - 1.0);
            let border = tree.border().len() as f64;
            assert!(border <= 1.1 * wanted, "{tiles} tiles: a border of {border}, {wanted} wanted");
            assert!(tree.members.iter().filter(|member| !member.separator).count() >= tiles);
        }
    }

    #[test]
    fn any_graph_falls_apart() {
        for seed in 0..40 {
            let random = &mut stream(seed, "graph");
            let nodes = 1 + random.random_range(0..120_usize);
            let weights: Vec<usize> = (0..nodes).map(|_| random.random_range(1..6)).collect();
            let rows: Vec<Vec<usize>> = (0..random.random_range(0..2 * nodes))
                .map(|_| (0..random.random_range(0..5)).map(|_| random.random_range(0..nodes)).collect())
                .collect();
            let graph = Graph::of_rows(weights, rows.iter().map(Vec::as_slice));
            for limit in [1, 7, 30, 1000] {
                check(&graph, &Dissection::new(&graph, limit), limit);
            }
        }
        // Everything linked with everything: nothing separates.
        let all: Vec<usize> = (0..30).collect();
        let graph = Graph::of_rows(vec![2; 30], std::iter::once(all.as_slice()));
        check(&graph, &Dissection::new(&graph, 10), 10);
    }

    #[test]
    fn a_ring_is_cut_twice() {
        let rows: Vec<Vec<usize>> = (0..100).map(|node| vec![node, (node + 1) % 100]).collect();
        let graph = Graph::of_rows(vec![1; 100], rows.iter().map(Vec::as_slice));
        let tree = Dissection::new(&graph, 50);
        check(&graph, &tree, 50);
        assert_eq!(tree.border().len(), 2);
    }
}
