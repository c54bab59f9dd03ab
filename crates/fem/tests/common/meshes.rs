//! Meshes, and small helpers on rows.
#![allow(dead_code, clippy::expect_used, clippy::panic)]

use tissuereg_fem::{Body, Element, Mesh};

/// Box of `cells` cubes with edges `size` mm, each cube cut into six tetrahedra.
pub fn bar(cells: [usize; 3], size: [f64; 3]) -> Mesh {
    let (nodes, tets) = bar_arrays(cells, size);
    Mesh::new(nodes, tets).expect("a box mesh is sound")
}

/// Nodes and tetrahedra of [`bar`].
pub fn bar_arrays(cells: [usize; 3], size: [f64; 3]) -> (Vec<[f64; 3]>, Vec<[usize; 4]>) {
    const PATHS: [[usize; 3]; 6] =
        [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [1, 0, 2], [2, 1, 0]];
    let index = |c: [usize; 3]| (c[0] * (cells[1] + 1) + c[1]) * (cells[2] + 1) + c[2];
    let (mut nodes, mut tets) = (Vec::new(), Vec::new());
    for i in 0..=cells[0] {
        for j in 0..=cells[1] {
            for k in 0..=cells[2] {
                let c = [i, j, k];
                nodes.push(std::array::from_fn(|a| size[a] * c[a] as f64 / cells[a] as f64));
            }
        }
    }
    for i in 0..cells[0] {
        for j in 0..cells[1] {
            for k in 0..cells[2] {
                for (p, path) in PATHS.iter().enumerate() {
                    let mut corner = [i, j, k];
                    let mut tet = [index(corner); 4];
                    for (step, &axis) in path.iter().enumerate() {
                        corner[axis] += 1;
                        tet[step + 1] = index(corner);
                    }
                    if p >= 3 {
                        tet.swap(1, 2);
                    }
                    tets.push(tet);
                }
            }
        }
    }
    (nodes, tets)
}

/// Dome on a flat base: a box of `n` x `n` x `n / 2` cells bent to a half ball of 60 mm.
pub fn dome(n: usize) -> Mesh {
    let (mut nodes, tets) = bar_arrays([n, n, n / 2], [2.0, 2.0, 1.0]);
    for x in &mut nodes {
        let (a, b, c): (f64, f64, f64) = (x[0] - 1.0, x[1] - 1.0, x[2]);
        // Smooth map of the cube to the ball.
        let root = |p: f64, q: f64| (1.0 - 0.5 * p * p - 0.5 * q * q + p * p * q * q / 3.0).sqrt();
        *x = [60.0 * a * root(b, c), 60.0 * b * root(a, c), 60.0 * c * root(a, b)];
    }
    Mesh::new(nodes, tets).expect("a dome mesh is sound")
}

/// Nodes of a mesh for which a condition on the position holds.
pub fn nodes_where(mesh: &Mesh, holds: impl Fn(&[f64; 3]) -> bool) -> Vec<usize> {
    (0..mesh.n_nodes()).filter(|&n| holds(&mesh.nodes()[n])).collect()
}

/// Body of a mesh whose nodes at `x = 0` are clamped.
pub fn clamped_at_x0(mesh: Mesh, element: Element) -> Body {
    let held = nodes_where(&mesh, |x| x[0] < 1e-9);
    Body::new(mesh, element, held).expect("a clamped bar is supported")
}

/// Largest Euclidean length of the rows.
pub fn largest(rows: &[[f64; 3]]) -> f64 {
    rows.iter().map(|r| r.iter().map(|c| c * c).sum::<f64>().sqrt()).fold(0.0, f64::max)
}

/// Largest Euclidean difference of two lists of rows.
pub fn largest_difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let rows: Vec<[f64; 3]> =
        a.iter().zip(b).map(|(x, y)| std::array::from_fn(|i| x[i] - y[i])).collect();
    largest(&rows)
}

/// A small deterministic generator, uniform in (−1, 1).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn matrix(&mut self, size: f64) -> [[f64; 3]; 3] {
        std::array::from_fn(|_| std::array::from_fn(|_| size * self.next()))
    }
}

/// Number of random cases: the value of `TISSUEREG_CASES`, or `quick`.
pub fn count_or(quick: u64) -> u64 {
    match std::env::var("TISSUEREG_CASES") {
        Ok(text) => text.parse().expect("TISSUEREG_CASES must be a whole number"),
        Err(_) => quick,
    }
}
