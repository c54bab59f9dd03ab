//! Separators: few vertices that part a graph in two.
//!
//! A cut of the vertices in two halves is given. The smallest vertex cover of the cut edges (König:
//! as large as a maximum matching of the bipartite graph of the cut) is a separator; vertices are
//! then moved out of it, one by one and even where it grows for a while, and the smallest one seen
//! is kept (Fiduccia and Mattheyses, Proc. 19th Design Automation Conference, 175, 1982, on vertex
//! separators: Ashcraft and Liu, SIAM J. Matrix Anal. Appl. 19, 325, 1998).

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, HashMap, HashSet, VecDeque};

use super::graph::Graph;

/// Largest share of all vertices in one part.
const LARGEST_PART: f64 = 0.6;

/// Moves after which the search for a smaller separator ends.
const PATIENCE: usize = 20;

/// Rounds of moves.
const ROUNDS: usize = 3;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Side {
    Outside,
    Low,
    High,
    Separator,
}

impl Side {
    fn other(self) -> Self {
        match self {
            Self::Low => Self::High,
            Self::High => Self::Low,
            other => other,
        }
    }
}

/// Two parts without edges between them, and the separator.
pub(super) struct Parts {
    pub(super) low: Vec<u32>,
    pub(super) high: Vec<u32>,
    pub(super) separator: Vec<u32>,
}

/// A vertex that left the separator.
struct Move {
    vertex: u32,
    /// Vertices that had to enter it, in [`Halves::pulled`].
    pulled: std::ops::Range<usize>,
}

/// Finds separators of parts of one graph.
pub(super) struct Halves<'a> {
    graph: &'a Graph,
    side: Vec<Side>,
    mate: Vec<u32>,
    /// Whether a vertex has left the separator in this round.
    moved: Vec<bool>,
    pulled: Vec<u32>,
}

impl<'a> Halves<'a> {
    pub(super) fn new(graph: &'a Graph) -> Self {
        let n = graph.n_vertices();
        Self {
            graph,
            side: vec![Side::Outside; n],
            mate: vec![u32::MAX; n],
            moved: vec![false; n],
            pulled: Vec::new(),
        }
    }

    /// Part some vertices near the middle of the order in which they are given.
    pub(super) fn separate(&mut self, vertices: &[u32]) -> Parts {
        let middle = vertices.len() / 2;
        for (k, &v) in vertices.iter().enumerate() {
            self.side[v as usize] = if k < middle { Side::Low } else { Side::High };
        }
        let mut separator = self.cover(&vertices[..middle]);
        for &v in &separator {
            self.side[v as usize] = Side::Separator;
        }
        for _ in 0..ROUNDS {
            if !self.shrink(&mut separator, vertices) {
                break;
            }
        }
        let on = |side: Side| {
            let here = |&v: &u32| self.side[v as usize] == side;
            vertices.iter().copied().filter(here).collect::<Vec<u32>>()
        };
        let parts =
            Parts { low: on(Side::Low), high: on(Side::High), separator: on(Side::Separator) };
        for &v in vertices {
            self.side[v as usize] = Side::Outside;
        }
        parts
    }

    /// One round of moves; whether the separator is smaller than before.
    fn shrink(&mut self, separator: &mut Vec<u32>, vertices: &[u32]) -> bool {
        let count =
            |side: Side| vertices.iter().filter(|v| self.side[**v as usize] == side).count();
        let (mut low, mut high) = (count(Side::Low), count(Side::High));
        let most = (LARGEST_PART * vertices.len() as f64) as usize;
        let mut size = separator.len();
        let uneven = |low: usize, high: usize| low.abs_diff(high);
        let mut best = (size, uneven(low, high));
        let (before, mut n_best) = (size, 0);
        let mut queue = BinaryHeap::new();
        for &v in &*separator {
            self.offer(v, &mut queue);
        }
        let mut moves: Vec<Move> = Vec::new();
        self.pulled.clear();
        while let Some((gain, Reverse(v), to)) = queue.pop() {
            if self.side[v as usize] != Side::Separator || self.moved[v as usize] {
                continue;
            }
            let now = self.gain(v, to);
            if now != gain {
                if now < gain {
                    queue.push((now, Reverse(v), to));
                }
                continue;
            }
            if (if to == Side::Low { low } else { high }) >= most {
                continue;
            }
            let begin = self.pulled.len();
            self.side[v as usize] = to;
            self.moved[v as usize] = true;
            let graph = self.graph;
            for &w in graph.neighbours(v as usize) {
                if self.side[w as usize] == to.other() {
                    self.side[w as usize] = Side::Separator;
                    self.pulled.push(w);
                }
            }
            let n_pulled = self.pulled.len() - begin;
            size = size - 1 + n_pulled;
            if to == Side::Low {
                (low, high) = (low + 1, high - n_pulled);
            } else {
                (low, high) = (low - n_pulled, high + 1);
            }
            for k in begin..self.pulled.len() {
                let w = self.pulled[k];
                self.offer(w, &mut queue);
                for &u in graph.neighbours(w as usize) {
                    if self.side[u as usize] == Side::Separator && !self.moved[u as usize] {
                        queue.push((self.gain(u, to), Reverse(u), to));
                    }
                }
            }
            moves.push(Move { vertex: v, pulled: begin..self.pulled.len() });
            if (size, uneven(low, high)) < best {
                best = (size, uneven(low, high));
                n_best = moves.len();
            } else if moves.len() - n_best > PATIENCE {
                break;
            }
        }
        for done in &moves {
            self.moved[done.vertex as usize] = false;
        }
        for undone in moves.drain(n_best..).rev() {
            let from = self.side[undone.vertex as usize].other();
            self.side[undone.vertex as usize] = Side::Separator;
            for &w in &self.pulled[undone.pulled] {
                self.side[w as usize] = from;
            }
        }
        separator.extend(&self.pulled);
        separator.sort_unstable();
        separator.dedup();
        separator.retain(|&v| self.side[v as usize] == Side::Separator);
        best.0 < before
    }

    /// By how much the separator shrinks where a vertex of it moves to a side.
    fn gain(&self, vertex: u32, to: Side) -> i32 {
        let from = to.other();
        let neighbours = self.graph.neighbours(vertex as usize).iter();
        1 - neighbours.filter(|&&w| self.side[w as usize] == from).count() as i32
    }

    fn offer(&self, v: u32, queue: &mut BinaryHeap<(i32, Reverse<u32>, Side)>) {
        if !self.moved[v as usize] {
            for to in [Side::Low, Side::High] {
                queue.push((self.gain(v, to), Reverse(v), to));
            }
        }
    }

    /// Smallest set of vertices that touches every edge between the two sides.
    fn cover(&mut self, low: &[u32]) -> Vec<u32> {
        let border: Vec<u32> =
            low.iter().copied().filter(|&v| self.across(v).next().is_some()).collect();
        for &v in &border {
            self.match_greedily(v);
        }
        let mut visited = HashSet::new();
        for &v in &border {
            if self.mate[v as usize] == u32::MAX {
                visited.clear();
                self.augment(v, &mut visited);
            }
        }
        // König: from unmatched low vertices, alternate; the cover is what was not reached on the
        // low side and what was reached on the high side.
        let mut reached_low = HashSet::new();
        let mut reached_high = BTreeSet::new();
        let mut queue: Vec<u32> =
            border.iter().copied().filter(|&v| self.mate[v as usize] == u32::MAX).collect();
        while let Some(v) = queue.pop() {
            if reached_low.insert(v) {
                for w in self.across(v) {
                    if reached_high.insert(w) {
                        queue.push(self.mate[w as usize]);
                    }
                }
            }
        }
        let mut cover: Vec<u32> =
            border.iter().copied().filter(|v| !reached_low.contains(v)).collect();
        cover.extend(reached_high);
        for &v in &border {
            let w = std::mem::replace(&mut self.mate[v as usize], u32::MAX);
            if w != u32::MAX {
                self.mate[w as usize] = u32::MAX;
            }
        }
        cover
    }

    /// Neighbours on the high side.
    fn across(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.graph
            .neighbours(vertex as usize)
            .iter()
            .copied()
            .filter(|&w| self.side[w as usize] == Side::High)
    }

    fn match_greedily(&mut self, v: u32) {
        let free = self.across(v).find(|&w| self.mate[w as usize] == u32::MAX);
        if let Some(w) = free {
            self.mate[v as usize] = w;
            self.mate[w as usize] = v;
        }
    }

    /// Find an augmenting path from an unmatched low vertex, breadth first, and flip it.
    fn augment(&mut self, start: u32, visited: &mut HashSet<u32>) {
        let mut queue = VecDeque::from([start]);
        let mut reached_from = HashMap::new();
        while let Some(v) = queue.pop_front() {
            let next: Vec<u32> = self.across(v).filter(|&w| visited.insert(w)).collect();
            for w in next {
                reached_from.insert(w, v);
                match self.mate[w as usize] {
                    u32::MAX => return self.flip(w, &reached_from),
                    partner => queue.push_back(partner),
                }
            }
        }
    }

    fn flip(&mut self, end: u32, reached_from: &HashMap<u32, u32>) {
        let mut w = end;
        while w != u32::MAX {
            let Some(&v) = reached_from.get(&w) else { return };
            let previous = std::mem::replace(&mut self.mate[v as usize], w);
            self.mate[w as usize] = v;
            w = previous;
        }
    }
}
