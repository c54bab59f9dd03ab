//! Does it converge as theory predicts? Manufactured solution on refined cubes, L2 norm.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::bar;
use tissuereg_fem::material::{Hyperelastic, NeoHookean};
use tissuereg_fem::{Body, Element, Load, Material, SolveSettings, solve};

const YOUNG: f64 = 10.0;
const POISSON: f64 = 0.3;
const AMPLITUDE: [f64; 3] = [0.10, -0.06, 0.08];

/// Zero on the surface of the unit cube, so that held mid-edge nodes are exact.
fn exact(x: [f64; 3]) -> [f64; 3] {
    let bump: f64 = x.iter().map(|c| (std::f64::consts::PI * c).sin()).product();
    AMPLITUDE.map(|a| a * bump)
}

fn exact_gradient(x: [f64; 3]) -> [[f64; 3]; 3] {
    let pi = std::f64::consts::PI;
    let slope: [f64; 3] = std::array::from_fn(|j| {
        (0..3).map(|k| if k == j { pi * (pi * x[k]).cos() } else { (pi * x[k]).sin() }).product()
    });
    AMPLITUDE.map(|a| slope.map(|s| a * s))
}

/// `−Div P` by central differences of the stress.
fn force_density(x: [f64; 3]) -> [f64; 3] {
    let law = NeoHookean::from_young(YOUNG, POISSON);
    let step = 1e-4;
    let mut force = [0.0; 3];
    for j in 0..3 {
        let stress = |d: f64| {
            let mut moved = x;
            moved[j] += d;
            law.stress(&exact_gradient(moved)).expect("upright")
        };
        let (plus, minus) = (stress(step), stress(-step));
        for i in 0..3 {
            force[i] -= (plus[i][j] - minus[i][j]) / (2.0 * step);
        }
    }
    force
}

/// Four-point Gauss rule in each direction of the collapsed cube: barycentric points and weights
/// that sum to one.
fn quadrature() -> Vec<([f64; 4], f64)> {
    let (a, b): (f64, f64) = (0.339_981_043_584_856_26, 0.861_136_311_594_052_6);
    let (wa, wb) = (0.652_145_154_862_546_1, 0.347_854_845_137_453_9);
    let line = [(-b, wb), (-a, wa), (a, wa), (b, wb)].map(|(x, w)| (0.5 + 0.5 * x, 0.5 * w));
    let mut points = Vec::new();
    for (r, wr) in line {
        for (s, ws) in line {
            for (t, wt) in line {
                let l = [r, (1.0 - r) * s, (1.0 - r) * (1.0 - s) * t];
                let weight = 6.0 * wr * ws * wt * (1.0 - r) * (1.0 - r) * (1.0 - s);
                points.push(([1.0 - l[0] - l[1] - l[2], l[0], l[1], l[2]], weight));
            }
        }
    }
    points
}

/// Nodes of every element with the shape functions at barycentric coordinates.
fn shape(body: &Body, tet: usize, l: &[f64; 4]) -> Vec<(usize, f64)> {
    let corners = body.mesh().tets()[tet];
    if body.element() == Element::Tet4 {
        return corners.into_iter().zip(*l).collect();
    }
    let mut values: Vec<(usize, f64)> =
        corners.into_iter().zip(l.map(|v| v * (2.0 * v - 1.0))).collect();
    for a in 0..4 {
        for b in 0..a {
            let edge = [corners[a].min(corners[b]), corners[a].max(corners[b])];
            let k = body.mid_edges().binary_search(&edge).expect("an edge");
            values.push((body.n_corner_nodes() + k, 4.0 * l[a] * l[b]));
        }
    }
    values
}

fn position(body: &Body, tet: usize, l: &[f64; 4]) -> [f64; 3] {
    let corners = body.mesh().tets()[tet].map(|n| body.mesh().nodes()[n]);
    std::array::from_fn(|i| (0..4).map(|a| l[a] * corners[a][i]).sum())
}

fn l2_error(element: Element, n: usize) -> f64 {
    let mesh = bar([n; 3], [1.0; 3]);
    let surface: std::collections::BTreeSet<usize> =
        mesh.surface_triangles().iter().flatten().copied().collect();
    let held: Vec<usize> = surface.into_iter().collect();
    let body = Body::new(mesh, element, held).expect("held");
    let points = quadrature();
    let mut forces = vec![[0.0; 3]; body.n_nodes()];
    for tet in 0..body.n_tets() {
        for (l, weight) in &points {
            let density = force_density(position(&body, tet, l));
            for (node, value) in shape(&body, tet, l) {
                for i in 0..3 {
                    forces[node][i] += weight * body.mesh().tet_volume(tet) * value * density[i];
                }
            }
        }
    }
    let material = Material::neo_hookean(YOUNG, POISSON).expect("sound");
    let answer = solve(&body, &material, &Load::from_forces(forces), &SolveSettings::default())
        .expect("an equilibrium");
    let mut square = 0.0;
    for tet in 0..body.n_tets() {
        for (l, weight) in &points {
            let mut u = exact(position(&body, tet, l));
            for (node, value) in shape(&body, tet, l) {
                for i in 0..3 {
                    u[i] -= value * answer.displacement[node][i];
                }
            }
            square += weight * body.mesh().tet_volume(tet) * u.iter().map(|v| v * v).sum::<f64>();
        }
    }
    square.sqrt()
}

#[test]
fn four_node_elements_converge_with_order_two() {
    let (coarse, fine) = (l2_error(Element::Tet4, 6), l2_error(Element::Tet4, 12));
    let rate = (coarse / fine).log2();
    assert!((1.8..2.3).contains(&rate), "rate {rate}, errors {coarse:e} {fine:e}");
}

#[test]
fn ten_node_elements_converge_with_order_three() {
    let (coarse, fine) = (l2_error(Element::Tet10, 3), l2_error(Element::Tet10, 6));
    let rate = (coarse / fine).log2();
    assert!((2.7..3.4).contains(&rate), "rate {rate}, errors {coarse:e} {fine:e}");
}
