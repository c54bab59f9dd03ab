//! Is it right where the answer is known?
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::{Random, bar, bar_arrays, clamped_at_x0, largest_difference, nodes_where};
use tissuereg_fem::material::{Hyperelastic, NeoHookean};
use tissuereg_fem::{Body, Element, Load, Material, Mesh, SolveSettings, Supports, solve};

const ELEMENTS: [Element; 2] = [Element::Tet4, Element::Tet10];

fn moved_inside(cells: [usize; 3], size: [f64; 3]) -> Mesh {
    let (mut nodes, tets) = bar_arrays(cells, size);
    let mut random = Random::new(5);
    for x in &mut nodes {
        if (0..3).all(|i| x[i] > 1e-9 && x[i] < size[i] - 1e-9) {
            for c in x.iter_mut() {
                *c += 0.8 * random.next();
            }
        }
    }
    Mesh::new(nodes, tets).expect("still sound")
}

#[test]
fn an_affine_boundary_gives_an_affine_body() {
    let h = [[0.10, 0.20, -0.05], [0.0, -0.08, 0.1], [0.15, 0.0, 0.12]];
    for element in ELEMENTS {
        let mesh = moved_inside([3, 3, 3], [15.0; 3]);
        let surface: std::collections::BTreeSet<usize> =
            mesh.surface_triangles().iter().flatten().copied().collect();
        let held: Vec<usize> = surface.into_iter().collect();
        let body = Body::new(mesh, element, &held).expect("held");
        let affine = |x: &[f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| (0..3).map(|j| h[i][j] * x[j]).sum())
        };
        let prescribed = held.iter().map(|&n| affine(&body.nodes()[n])).collect();
        let material = Material::neo_hookean(10.0, 0.45).expect("sound");
        let answer =
            solve(&body, &material, &Load::from_prescribed(prescribed), &SolveSettings::default())
                .expect("an equilibrium");
        let exact: Vec<[f64; 3]> = body.nodes().iter().map(affine).collect();
        // 1e-9 of the forces, on displacements of about 5 mm.
        let error = largest_difference(&answer.displacement, &exact);
        assert!(error < 1e-8, "{element:?}: {error}");
    }
}

/// Bar on rollers, pulled along x: `P_xx` over the section, nothing across.
#[test]
fn a_bar_in_uniaxial_tension_stretches_as_the_law_says() {
    let law = NeoHookean::from_young(10.0, 0.4);
    let stress_at = |along: f64, across: f64| {
        let h = [[along, 0.0, 0.0], [0.0, across, 0.0], [0.0, 0.0, across]];
        law.stress(&h).expect("upright")
    };
    // For a stretch of 1.3 find the lateral strain without lateral stress, by bisection.
    let (mut low, mut high) = (-0.3, 0.0);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if stress_at(0.3, middle)[1][1] < 0.0 { low = middle } else { high = middle }
    }
    let traction = stress_at(0.3, low)[0][0];
    for element in ELEMENTS {
        let mesh = moved_inside([4, 2, 2], [20.0, 10.0, 10.0]);
        let mut axes = vec![[false; 3]; mesh.n_nodes()];
        for (node, x) in mesh.nodes().iter().enumerate() {
            axes[node] = x.map(|c| c < 1e-9);
        }
        let supports = (0..mesh.n_nodes())
            .filter(|&n| axes[n] != [false; 3])
            .fold(Supports::new(), |s, n| s.hold_axes(&[n], axes[n]));
        let body = Body::new(mesh, element, supports).expect("held");
        let end: Vec<[usize; 3]> = body
            .mesh()
            .surface_triangles()
            .iter()
            .copied()
            .filter(|t| t.iter().all(|&n| body.nodes()[n][0] > 20.0 - 1e-9))
            .collect();
        let forces = body
            .traction_forces(&end, &vec![[traction, 0.0, 0.0]; end.len()])
            .expect("on the surface");
        let material = Material::neo_hookean(10.0, 0.4).expect("sound");
        let answer = solve(&body, &material, &Load::from_forces(forces), &SolveSettings::default())
            .expect("an equilibrium");
        let exact: Vec<[f64; 3]> =
            body.nodes().iter().map(|x| [0.3 * x[0], low * x[1], low * x[2]]).collect();
        let error = largest_difference(&answer.displacement, &exact);
        assert!(error < 1e-7, "{element:?}: {error}");
        let pull: f64 = answer.reactions.iter().map(|r| r[0]).sum();
        assert!((pull + 100.0 * traction).abs() < 1e-6 * pull.abs(), "{pull}");
    }
}

/// A column under its own weight, held sideways everywhere: `∂P_zz/∂z = ρ g`, one unknown.
#[test]
fn a_column_under_its_own_weight_sinks_as_the_integral_says() {
    let (height, weight) = (40.0, 9.81e-3);
    let law = NeoHookean::from_young(3.0, 0.3);
    // (n = 20 layers) The strain at height z balances the weight above: P(e) = -weight (H - z).
    let strain = |z: f64| {
        let (mut low, mut high) = (-0.5, 0.0);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            let h = [[0.0; 3], [0.0; 3], [0.0, 0.0, middle]];
            let stress = law.stress(&h).expect("upright")[2][2];
            if stress < -weight * (height - z) { low = middle } else { high = middle }
        }
        low
    };
    let n = 4000;
    let top: f64 =
        (0..n).map(|k| strain(height * (k as f64 + 0.5) / n as f64) * height / n as f64).sum();
    for (element, limit) in [(Element::Tet4, 2e-3), (Element::Tet10, 1e-6)] {
        let mesh = bar([1, 1, 20], [4.0, 4.0, height]);
        let mut supports = Supports::new();
        for (node, x) in mesh.nodes().iter().enumerate() {
            supports = supports.hold_axes(&[node], [true, true, x[2] < 1e-9]);
        }
        let body = Body::new(mesh, element, supports).expect("held");
        let load = Load { body_force: [0.0, 0.0, -weight], ..Load::default() };
        let material = Material::neo_hookean(3.0, 0.3).expect("sound");
        let answer = solve(&body, &material, &load, &SolveSettings::default()).expect("sinks");
        let tops = nodes_where(body.mesh(), |x| x[2] > height - 1e-9);
        let mean: f64 =
            tops.iter().map(|&t| answer.displacement[t][2]).sum::<f64>() / tops.len() as f64;
        assert!(((mean - top) / top).abs() < limit, "{element:?}: {mean} {top}");
        let carried: f64 = answer.reactions.iter().map(|r| r[2]).sum();
        assert!((carried - weight * 16.0 * height).abs() < 1e-6, "{carried}");
    }
}

#[test]
fn reactions_balance_the_load_and_its_moment() {
    for element in ELEMENTS {
        let body = clamped_at_x0(bar([4, 2, 2], [20.0, 10.0, 10.0]), element);
        let tip = nodes_where(body.mesh(), |x| x[0] > 20.0 - 1e-9)[0];
        let mut forces = vec![[0.0; 3]; body.n_corner_nodes()];
        forces[tip] = [3.0, -2.0, 4.0];
        let material = Material::neo_hookean(10.0, 0.45).expect("sound");
        let load = Load { body_force: [0.0, 0.0, -9.81e-3], ..Load::from_forces(forces) };
        let answer = solve(&body, &material, &load, &SolveSettings::default()).expect("bends");
        let sum: [f64; 3] =
            std::array::from_fn(|i| answer.reactions.iter().map(|r| r[i]).sum::<f64>());
        let expected = [-3.0, 2.0, -4.0 + 9.81e-3 * 2000.0];
        for i in 0..3 {
            assert!((sum[i] - expected[i]).abs() < 1e-6, "{element:?} {sum:?}");
        }
    }
}

#[test]
fn a_dead_traction_on_ten_node_facets_has_the_right_resultant_and_moment() {
    let body = clamped_at_x0(bar([2, 2, 2], [10.0; 3]), Element::Tet10);
    let facets: Vec<[usize; 3]> = body
        .mesh()
        .surface_triangles()
        .iter()
        .copied()
        .filter(|t| t.iter().all(|&n| body.nodes()[n][2] > 10.0 - 1e-9))
        .collect();
    let forces = body.traction_forces(&facets, &vec![[0.0, 0.0, 2.0]; facets.len()]).expect("ok");
    let total: f64 = forces.iter().map(|f| f[2]).sum();
    let moment: f64 = forces.iter().zip(body.nodes()).map(|(f, x)| f[2] * x[0]).sum();
    assert!((total - 200.0).abs() < 1e-10 && (moment - 1000.0).abs() < 1e-9);
    assert!(forces[..body.n_corner_nodes()].iter().all(|f| *f == [0.0; 3]));
}
