//! Published problems of near incompressibility: Cook's membrane and a pressed block.
//!
//! Both of Schröder et al., *A selection of benchmark problems in solid mechanics and applied
//! mathematics*, Arch. Comput. Methods Eng. 28, 713–751, 2021 (the benchmarks of SPP 1748), with
//! its numbers as the tests of DuMux quote them (`test/geomechanics/hyperelastic`). Stresses are in
//! MPa there and in kPa here; lengths are in mm; loads are dead.

use std::collections::{BTreeMap, BTreeSet};

use tissuereg_fem::material::Volumetric;
use tissuereg_fem::{Body, Element, Load, Material, Mesh, Supports};

use super::nodes_where;

/// A problem and the displacement that is measured.
pub struct Problem {
    pub body: Body,
    pub material: Material,
    pub load: Load,
    pub node: usize,
    pub axis: usize,
}

/// Shear modulus of Cook's membrane, kPa: with the paper's λ = 432.099 MPa, ν is 0.35.
const COOK_MU: f64 = 185_185.0;

/// Poisson's ratio and the corner's rise in mm, by three-dimensional finite elements of high order
/// (table 9 of the paper's section on hyperelasticity). The paper varies λ. For all but the first
/// of its values ν is inferred: with these five, quadratic tets meet every rise under refinement.
pub const COOK: [(f64, f64); 5] = [
    (0.35, 11.381_135_37),
    (0.4, 11.156_397_36),
    (0.49, 10.782_672_46),
    (0.499, 10.746_416_06),
    (0.4999, 10.740_610_99),
];

/// How far the middle of the pressed patch goes down, mm: bricks with constant pressure, with
/// enhanced strains and quadratic tets with linear pressure give 20.00, 20.00 and 19.98 at 102,432
/// unknowns (tables 3 and 4 of the section on the incompressible block).
pub const BLOCK: f64 = 20.0;

/// Poisson's ratio of the pressed block: λ = 499.92568 and μ = 1.61148 MPa.
pub const BLOCK_POISSON: f64 = 0.498_393_4;

/// Shear modulus of the pressed block, kPa.
const BLOCK_MU: f64 = 1_611.48;

fn neo_hookean(mu: f64, poisson: f64) -> Material {
    Material::neo_hookean(2.0 * mu * (1.0 + poisson), poisson)
        .and_then(|material| material.with_volumetric(Volumetric::Quadratic))
        .expect("valid moduli")
}

fn near(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

/// Facets all of whose corners fulfil a condition.
fn facets(mesh: &Mesh, holds: impl Fn(&[f64; 3]) -> bool) -> Vec<[usize; 3]> {
    let inside = |t: &&[usize; 3]| t.iter().all(|&n| holds(&mesh.nodes()[n]));
    mesh.surface_triangles().iter().filter(inside).copied().collect()
}

/// Body under a dead traction on facets.
fn loaded(body: Body, triangles: &[[usize; 3]], traction: [f64; 3]) -> (Body, Load) {
    let tractions = vec![traction; triangles.len()];
    let forces = body.traction_forces(triangles, &tractions).expect("facets of the surface");
    (body, Load::from_forces(forces))
}

/// Cook's membrane: corners (0, 0), (48, 44), (48, 60), (0, 44), 1 mm thick, clamped at x = 0, on
/// rollers at z = 0 and free at z = 1 (half of 2 mm), with a traction of 20 MPa along y at x = 48.
/// Measured at (48, 60, 0), along y. `n` x `n` cells, smaller towards the upper clamped corner.
///
/// The paper's volumetric energy, λ/4 (J² − 1 − 2 ln J), lies between the logarithmic and the
/// quadratic one taken here, which differ by 0.04 % of the rise at ν = 0.35 and by less above.
pub fn cook(n: usize, element: Element, poisson: f64) -> Problem {
    let (mut nodes, tets) = symmetric_box([n, n, 1], [1.0; 3]);
    for x in &mut nodes {
        let (across, up) = (x[0].powf(1.3), 1.0 - (1.0 - x[1]).powf(1.3));
        let (low, high) = (44.0 * across, 44.0 + 16.0 * across);
        *x = [48.0 * across, low + (high - low) * up, x[2]];
    }
    let mesh = Mesh::new(nodes, tets).expect("a sound mesh");
    let clamped = nodes_where(&mesh, |x| near(x[0], 0.0));
    let rolling = nodes_where(&mesh, |x| !near(x[0], 0.0) && near(x[2], 0.0));
    let corner = nodes_where(&mesh, |x| near(x[0], 48.0) && near(x[1], 60.0) && near(x[2], 0.0));
    let end = facets(&mesh, |x| near(x[0], 48.0));
    let supports = Supports::new().hold(&clamped).hold_axes(&rolling, [false, false, true]);
    let body = Body::new(mesh, element, supports).expect("supported");
    let (body, load) = loaded(body, &end, [0.0, 20_000.0, 0.0]);
    Problem { body, material: neo_hookean(COOK_MU, poisson), load, node: corner[0], axis: 1 }
}

/// A quarter of a block of 100 x 100 x 50 mm on rollers, whose top cannot move sideways, pressed by
/// 3 MPa on the middle quarter of the top. Measured in the middle of that, downwards positive.
/// `n` x `n` x `n` cells, `n` even.
pub fn block(n: usize, element: Element, poisson: f64) -> Problem {
    let (nodes, tets) = symmetric_box([n; 3], [50.0; 3]);
    let mesh = Mesh::new(nodes, tets).expect("a sound mesh");
    let mut supports = Supports::new();
    for (node, x) in mesh.nodes().iter().enumerate() {
        let top = near(x[2], 50.0);
        let axes = [near(x[0], 50.0) || top, near(x[1], 50.0) || top, near(x[2], 0.0)];
        if axes != [false; 3] {
            supports = supports.hold_axes(&[node], axes);
        }
    }
    let middle = nodes_where(&mesh, |x| x.iter().all(|&v| near(v, 50.0)));
    let patch = facets(&mesh, |x| near(x[2], 50.0) && x[0] > 25.0 - 1e-9 && x[1] > 25.0 - 1e-9);
    let body = Body::new(mesh, element, supports).expect("supported");
    let (body, load) = loaded(body, &patch, [0.0, 0.0, -3_000.0]);
    Problem { body, material: neo_hookean(BLOCK_MU, poisson), load, node: middle[0], axis: 2 }
}

/// Nodes and tetrahedra of a box of cells, each cut into 24 around its middle and those of its
/// faces. No direction is preferred: cut into six along one diagonal, the block's middle comes out
/// 20.6, 19.9 or 19.3 mm down on 12 or 16 cells, by where that diagonal points.
fn symmetric_box(cells: [usize; 3], size: [f64; 3]) -> (Vec<[f64; 3]>, Vec<[usize; 4]>) {
    let mut index = BTreeMap::new();
    let (mut nodes, mut tets) = (Vec::new(), Vec::new());
    // Nodes by their place on the grid of half cells.
    let mut node = |place: [usize; 3]| {
        *index.entry(place).or_insert_with(|| {
            nodes.push(std::array::from_fn(|a| 0.5 * size[a] * place[a] as f64 / cells[a] as f64));
            nodes.len() - 1
        })
    };
    let places = |n: usize| (0..n).map(|i| 2 * i + 1);
    for x in places(cells[0]) {
        for y in places(cells[1]) {
            for z in places(cells[2]) {
                for (axis, side) in [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)] {
                    let at = |first: isize, second: isize| {
                        let mut place = [x, y, z];
                        for (a, by) in [(axis, side), (axis + 1, first), (axis + 2, second)] {
                            place[a % 3] = place[a % 3].wrapping_add_signed(by);
                        }
                        place
                    };
                    const RING: [(isize, isize); 5] =
                        [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)];
                    for ends in RING.windows(2) {
                        let [a, b] = [ends[0], ends[1]].map(|(first, second)| at(first, second));
                        let (a, b) = if side > 0 { (a, b) } else { (b, a) };
                        tets.push([[x, y, z], a, b, at(0, 0)].map(&mut node));
                    }
                }
            }
        }
    }
    (nodes, tets)
}

/// How even the volume ratios of an answer are.
pub struct Evenness {
    /// Least and largest volume ratio of elements (of their quadrature points).
    pub range: [f64; 2],
    /// Root mean square over all nodes of the difference between a node's volume ratio (the mean of
    /// the elements around it) and the mean of its neighbours', over the standard deviation of the
    /// former. Pressure is the bulk modulus times volume ratio minus one, so that this is the
    /// roughness of the pressure as well: a fraction of an element's size over that of the pattern
    /// where pressure is smooth, above 1 where it alternates from node to node.
    pub roughness: f64,
}

/// Evenness of a displacement.
pub fn evenness(body: &Body, displacement: &[[f64; 3]]) -> Evenness {
    let mesh = body.mesh();
    let mut around = vec![(0.0, 0.0); mesh.n_nodes()];
    let mut range = [f64::INFINITY, f64::NEG_INFINITY];
    let mut neighbours = vec![BTreeSet::new(); mesh.n_nodes()];
    for (tet, nodes) in mesh.tets().iter().enumerate() {
        for (a, &node) in nodes.iter().enumerate() {
            let ratio = volume_ratio(body, displacement, tet, a);
            range = [range[0].min(ratio), range[1].max(ratio)];
            around[node].0 += mesh.tet_volume(tet) * ratio;
            around[node].1 += mesh.tet_volume(tet);
            neighbours[node].extend(nodes.iter().filter(|&&other| other != node));
        }
    }
    let ratios: Vec<f64> = around.iter().map(|(sum, volume)| sum / volume).collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let square = |values: &[f64]| mean(&values.iter().map(|v| v * v).collect::<Vec<_>>());
    let centre = mean(&ratios);
    let spread: Vec<f64> = ratios.iter().map(|r| r - centre).collect();
    let steps: Vec<f64> = neighbours
        .iter()
        .zip(&ratios)
        .map(|(near, own)| own - mean(&near.iter().map(|&n: &usize| ratios[n]).collect::<Vec<_>>()))
        .collect();
    Evenness { range, roughness: (square(&steps) / square(&spread)).sqrt() }
}

/// Volume ratio of a linear tetrahedron, or of the quadrature point of a quadratic one that is
/// closest to corner `a`.
fn volume_ratio(body: &Body, displacement: &[[f64; 3]], tet: usize, a: usize) -> f64 {
    let nodes = body.mesh().tets()[tet];
    let x = nodes.map(|n| nalgebra::Vector3::from(body.nodes()[n]));
    let jacobian = nalgebra::Matrix3::from_columns(&[x[1] - x[0], x[2] - x[0], x[3] - x[0]]);
    let inverse = jacobian.try_inverse().expect("no flat tetrahedron");
    let mut slopes = [nalgebra::RowVector3::zeros(); 4];
    for k in 0..3 {
        slopes[k + 1] = inverse.row(k).into_owned();
        slopes[0] -= inverse.row(k);
    }
    let moved = |n: usize| nalgebra::Vector3::from(displacement[n]);
    let mut f = nalgebra::Matrix3::identity();
    if body.element() != Element::Tet10 {
        for (b, &node) in nodes.iter().enumerate() {
            f += moved(node) * slopes[b];
        }
        return f.determinant();
    }
    let root = 5.0_f64.sqrt();
    let weight = |b: usize| if a == b { (5.0 + 3.0 * root) / 20.0 } else { (5.0 - root) / 20.0 };
    for (b, &node) in nodes.iter().enumerate() {
        f += moved(node) * slopes[b] * (4.0 * weight(b) - 1.0);
        for (c, &other) in nodes.iter().enumerate().skip(b + 1) {
            let ends = [node.min(other), node.max(other)];
            let edge = body.mid_edges().partition_point(|e| *e < ends);
            let slope = slopes[c] * weight(b) + slopes[b] * weight(c);
            f += moved(body.n_corner_nodes() + edge) * slope * 4.0;
        }
    }
    f.determinant()
}
