//! Systems of one unknown a node, against what the same matrix does.
#![allow(clippy::expect_used)]

mod common;

use common::{Random, bar, nodes_where};
use tissuereg_fem::{FemError, Mesh, ScalarScratch, ScalarSystem};

/// Entries of `V_e (∇N·∇N + 0.01)` of every tetrahedron: a Laplacian with a little mass.
fn entries(mesh: &Mesh, tet: usize) -> [f64; 10] {
    let x = mesh.tets()[tet].map(|n| mesh.nodes()[n]);
    let e: [[f64; 3]; 3] = std::array::from_fn(|k| std::array::from_fn(|i| x[k + 1][i] - x[0][i]));
    let six = 6.0 * mesh.tet_volume(tet);
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let g = [cross(e[1], e[2]), cross(e[2], e[0]), cross(e[0], e[1])].map(|r| r.map(|v| v / six));
    let first = std::array::from_fn(|i| -(g[0][i] + g[1][i] + g[2][i]));
    let g = [first, g[0], g[1], g[2]];
    let (mut all, mut pair) = ([0.0; 10], 0);
    for a in 0..4 {
        for b in 0..=a {
            let product: f64 = (0..3).map(|i| g[a][i] * g[b][i]).sum();
            all[pair] = six / 6.0 * (product + 0.01);
            pair += 1;
        }
    }
    all
}

/// The matrix of the free nodes times a vector with one entry per node.
fn product(mesh: &Mesh, u: &[f64]) -> Vec<f64> {
    let mut sum = vec![0.0; u.len()];
    for (tet, nodes) in mesh.tets().iter().enumerate() {
        let (all, mut pair) = (entries(mesh, tet), 0);
        for a in 0..4 {
            for b in 0..=a {
                sum[nodes[a]] += all[pair] * u[nodes[b]];
                if a != b {
                    sum[nodes[b]] += all[pair] * u[nodes[a]];
                }
                pair += 1;
            }
        }
    }
    sum
}

#[test]
fn a_solution_times_the_matrix_is_the_right_hand_side_at_any_number_of_threads() {
    let mesh = bar([7, 4, 4], [70.0, 40.0, 40.0]);
    let mut held = vec![false; mesh.n_nodes()];
    nodes_where(&mesh, |x| x[0] < 1e-9).into_iter().for_each(|n| held[n] = true);
    let system = ScalarSystem::new(&mesh, &held).expect("small");
    assert_eq!(system.n_unknowns(), held.iter().filter(|&&held| !held).count());
    let mut random = Random::new(3);
    let rhs: Vec<f64> = (0..system.n_unknowns()).map(|_| random.next()).collect();
    let mut found = Vec::new();
    for parallel in [false, true] {
        let factor = system.factor(|tet| entries(&mesh, tet), parallel).expect("positive");
        let mut out = vec![0.0; rhs.len()];
        let mut scratch = ScalarScratch::default();
        factor.solve_into(&rhs, &mut out, &mut scratch, parallel).expect("fits");
        found.push(out);
    }
    assert_eq!(found[0], found[1]);
    let mut all = vec![0.0; mesh.n_nodes()];
    system.nodes().zip(&found[0]).for_each(|(node, &v)| all[node] = v);
    let back = product(&mesh, &all);
    let largest = all.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    for (node, wanted) in system.nodes().zip(&rhs) {
        // Rounding of the entries, some ten each.
        assert!((back[node] - wanted).abs() < 1e-11 * (1.0 + 100.0 * largest), "node {node}");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let mesh = bar([2, 2, 2], [10.0; 3]);
    let short = ScalarSystem::new(&mesh, &[false; 3]).expect_err("three of 27");
    assert!(matches!(short, FemError::WrongLength { expected: 27, found: 3, .. }), "{short}");
    let system = ScalarSystem::new(&mesh, &[false; 27]).expect("small");
    let singular = system.factor(|_| [0.0; 10], false).expect_err("zero");
    assert!(matches!(singular, FemError::SingularStiffness { .. }), "{singular}");
    let factor = system.factor(|tet| entries(&mesh, tet), false).expect("positive");
    let mut scratch = ScalarScratch::default();
    for (n_rhs, n_out) in [(26, 27), (27, 26)] {
        let (rhs, mut out) = (vec![0.0; n_rhs], vec![0.0; n_out]);
        let error = factor.solve_into(&rhs, &mut out, &mut scratch, false).expect_err("short");
        assert!(matches!(error, FemError::WrongLength { expected: 27, found: 26, .. }), "{error}");
    }
}
