//! Rigid modes that the supports leave free, by name.
//!
//! Tetrahedra that share triangles move as one *block* when nothing deforms: six numbers, a
//! translation `t` and a rotation `w` about the block's centre `c`, so that a node at `x` moves by
//! `t + w × (x − c)`. Blocks that share an edge or a single node are hinged there. Every held axis
//! and every shared node is a linear condition on these numbers; with `B (6 n_blocks, n_conditions)`
//! their coefficients, the free modes are the null space of `B Bᵀ`. A part (blocks joined by
//! nodes) without free modes has a positive definite stiffness.

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};

use crate::error::{FemError, RigidModes};
use crate::groups::Groups;
use crate::mesh::Mesh;
use crate::supports::Resting;

/// Parts of more blocks than this are only checked as if they were one block: the dense null
/// space would cost more than the solve. A mechanism in them still shows as a failing pivot.
const MOST_BLOCKS: usize = 60;

/// Relative size below which an eigenvalue of `B Bᵀ` counts as zero.
const NULL_LIMIT: f64 = 1e-12;

/// Fail with the names of the rigid modes that `held` leaves free.
///
/// # Shapes
///
/// `held` one row of axes a corner node; `resting` facets on springs, of nodes that exist.
///
/// # Errors
///
/// [`FemError::Unconstrained`] for the first part that can move.
pub(crate) fn check_rigid_modes(
    mesh: &Mesh,
    held: &[[bool; 3]],
    resting: &[Resting],
) -> Result<(), FemError> {
    let carried = carried_directions(mesh, held, resting);
    let blocks = mesh.blocks();
    let parts = parts_by_node(mesh);
    let n_parts = parts.iter().max().map_or(0, |&p| p + 1);
    let mut part_blocks = vec![Vec::new(); n_parts];
    let n_blocks = blocks.iter().max().map_or(0, |&b| b + 1);
    let mut seen = vec![false; n_blocks];
    for (tet, &block) in blocks.iter().enumerate() {
        if !std::mem::replace(&mut seen[block], true) {
            part_blocks[parts[mesh.tets()[tet][0]]].push(block);
        }
    }
    let block_nodes = nodes_by_block(mesh, blocks, n_blocks);
    for (part, members) in part_blocks.iter().enumerate() {
        let part_nodes: Vec<usize> = (0..mesh.n_nodes()).filter(|&n| parts[n] == part).collect();
        let whole = [part_nodes.clone()];
        let bodies: Vec<&[usize]> = if members.len() <= MOST_BLOCKS {
            members.iter().map(|&b| block_nodes[b].as_slice()).collect()
        } else {
            whole.iter().map(Vec::as_slice).collect()
        };
        let modes = free_modes(mesh.nodes(), &carried, &bodies);
        if !modes.is_empty() {
            return Err(FemError::Unconstrained(RigidModes {
                modes,
                n_parts,
                n_part_nodes: part_nodes.len(),
                node: part_nodes[0],
            }));
        }
    }
    Ok(())
}

/// Directions along which each node is held or rests on springs.
fn carried_directions(
    mesh: &Mesh,
    held: &[[bool; 3]],
    resting: &[Resting],
) -> Vec<Vec<Vector3<f64>>> {
    let mut carried: Vec<Vec<Vector3<f64>>> = held
        .iter()
        .map(|axes| (0..3).filter(|&k| axes[k]).map(|k| Vector3::ith(k, 1.0)).collect())
        .collect();
    for facet in resting {
        let [a, b, c] = facet.triangle.map(|n| Vector3::from(mesh.nodes()[n]));
        let normal = (b - a).cross(&(c - a)).normalize();
        let along = (b - a).normalize();
        for node in facet.triangle {
            if facet.normal {
                carried[node].push(normal);
            }
            if facet.tangential {
                carried[node].extend([along, normal.cross(&along)]);
            }
        }
    }
    carried
}

fn parts_by_node(mesh: &Mesh) -> Vec<usize> {
    let mut groups = Groups::new(mesh.n_nodes());
    for tet in mesh.tets() {
        for &node in &tet[1..] {
            groups.join(tet[0], node);
        }
    }
    groups.numbered()
}

fn nodes_by_block(mesh: &Mesh, blocks: &[usize], n_blocks: usize) -> Vec<Vec<usize>> {
    let mut nodes = vec![Vec::new(); n_blocks];
    for (tet, &block) in blocks.iter().enumerate() {
        nodes[block].extend_from_slice(&mesh.tets()[tet]);
    }
    for list in &mut nodes {
        list.sort_unstable();
        list.dedup();
    }
    nodes
}

/// Names of the free modes of one part that consists of `bodies` (node lists of its blocks).
fn free_modes(
    nodes: &[[f64; 3]],
    carried: &[Vec<Vector3<f64>>],
    bodies: &[&[usize]],
) -> Vec<String> {
    let point = |n: usize| Vector3::from(nodes[n]);
    let all = || bodies.iter().flat_map(|b| b.iter().copied());
    let n = all().count() as f64;
    let centre = all().map(point).sum::<Vector3<f64>>() / n;
    let size = all().map(|k| (point(k) - centre).norm()).fold(0.0_f64, f64::max);
    let arm = |k: usize| (point(k) - centre) / size;

    let mut owner: Vec<(usize, usize)> =
        bodies.iter().enumerate().flat_map(|(b, list)| list.iter().map(move |&k| (k, b))).collect();
    owner.sort_unstable();
    let mut normal = DMatrix::<f64>::zeros(6 * bodies.len(), 6 * bodies.len());
    for shared in owner.chunk_by(|a, b| a.0 == b.0) {
        let (node, first) = shared[0];
        for direction in &carried[node] {
            let row = condition_row(direction, arm(node));
            add_condition(&mut normal, &[(first, 1.0)], &row);
        }
        for axis in 0..3 {
            let row = condition_row(&Vector3::ith(axis, 1.0), arm(node));
            for &(_, other) in &shared[1..] {
                add_condition(&mut normal, &[(first, 1.0), (other, -1.0)], &row);
            }
        }
    }
    let eigen = SymmetricEigen::new(normal);
    let largest = eigen.eigenvalues.amax().max(1.0);
    let free: Vec<DVector<f64>> = (0..eigen.eigenvalues.len())
        .filter(|&k| eigen.eigenvalues[k] <= NULL_LIMIT * largest)
        .map(|k| eigen.eigenvectors.column(k).into_owned())
        .collect();
    name_modes(&free)
}

/// Coefficients of the displacement along `direction` at `arm`: `(t + w × arm) · direction`.
fn condition_row(direction: &Vector3<f64>, arm: Vector3<f64>) -> [f64; 6] {
    let turn = arm.cross(direction);
    [direction[0], direction[1], direction[2], turn[0], turn[1], turn[2]]
}

fn add_condition(normal: &mut DMatrix<f64>, blocks: &[(usize, f64)], row: &[f64; 6]) {
    for &(a, sign_a) in blocks {
        for &(b, sign_b) in blocks {
            for i in 0..6 {
                for j in 0..6 {
                    normal[(6 * a + i, 6 * b + j)] += sign_a * sign_b * row[i] * row[j];
                }
            }
        }
    }
}

/// Names of the space of motions spanned by `free`, translations first.
///
/// Of a part made of several blocks, the block that moves most gives the name.
fn name_modes(free: &[DVector<f64>]) -> Vec<String> {
    let Some(first) = free.first() else { return Vec::new() };
    let weight = |b: usize| -> f64 { free.iter().map(|v| v.rows(6 * b, 6).norm_squared()).sum() };
    let block = (0..first.len() / 6)
        .fold(0, |best, b| if weight(b) > weight(best) * (1.0 + 1e-9) { b } else { best });
    let motion = DMatrix::from_fn(6, free.len(), |i, k| free[k][6 * block + i]);
    let rotations = column_space(&motion.rows(3, 3).into_owned());
    let translations = column_space(&translations_without_rotation(&motion));
    let mut names = Vec::new();
    for (space, verb) in [(translations, "translation"), (rotations, "rotation about")] {
        names.extend(space_names(&space, verb));
    }
    names
}

/// Translation parts of those combinations of `motion` that do not rotate.
fn translations_without_rotation(motion: &DMatrix<f64>) -> DMatrix<f64> {
    let rotation = motion.rows(3, 3).into_owned();
    let eigen = SymmetricEigen::new(rotation.transpose() * &rotation);
    let still: Vec<DVector<f64>> = (0..motion.ncols())
        .filter(|&k| eigen.eigenvalues[k] < 1e-10)
        .map(|k| motion.rows(0, 3) * eigen.eigenvectors.column(k))
        .collect();
    DMatrix::from_fn(3, still.len(), |i, k| still[k][i])
}

/// Orthonormal basis of the columns of a matrix with three rows.
fn column_space(columns: &DMatrix<f64>) -> Vec<Vector3<f64>> {
    let eigen = SymmetricEigen::new(columns * columns.transpose());
    (0..3)
        .filter(|&k| eigen.eigenvalues[k] > 1e-10)
        .map(|k| Vector3::from_fn(|i, _| eigen.eigenvectors[(i, k)]))
        .collect()
}

fn space_names(space: &[Vector3<f64>], verb: &str) -> Vec<String> {
    let mut rest = space.to_vec();
    let mut names = Vec::new();
    for (axis, name) in ["x", "y", "z"].iter().enumerate() {
        let unit = Vector3::ith(axis, 1.0);
        let inside: Vector3<f64> = rest.iter().map(|v| v * v.dot(&unit)).sum();
        if (inside - unit).norm() < 1e-5 {
            names.push(format!("{verb} {name}"));
            let across = DMatrix::from_fn(3, rest.len(), |i, k| {
                rest[k][i] - if i == axis { rest[k][axis] } else { 0.0 }
            });
            rest = column_space(&across);
        }
    }
    for v in rest {
        names.push(format!("{verb} ({:.3}, {:.3}, {:.3})", v[0], v[1], v[2]));
    }
    names
}
