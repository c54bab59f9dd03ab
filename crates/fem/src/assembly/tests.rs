//! Energy, forces and tangent of averaged elements, each against differences of the one before.
#![allow(clippy::expect_used)]

use super::averaged_neo_hookean::largest_stretch_bound;
use super::{ElementTangents, PointModel, TangentKind, internal_force_into, tangent_product_into};
use crate::element::{Element, Geometry};
use crate::material::{Directions, Fibres, LawKind, Material};
use crate::mesh::Mesh;
use crate::system::factor::Blocks;

/// A box of 2 x 2 x 2 cells with its inner node off the centre.
fn geometry() -> Geometry {
    let index = |x: usize, y: usize, z: usize| 9 * x + 3 * y + z;
    let (mut nodes, mut tets) = (Vec::new(), Vec::new());
    for (x, y, z) in grid(3) {
        nodes.push([4.0 * x as f64, 3.5 * y as f64, 3.0 * z as f64]);
    }
    nodes[index(1, 1, 1)] = [4.7, 3.1, 3.3];
    for (x, y, z) in grid(2) {
        let corner = |c: usize| index(x + (c & 1), y + (c >> 1 & 1), z + (c >> 2));
        for [a, b] in [[1, 3], [3, 2], [2, 6], [6, 4], [4, 5], [5, 1]] {
            tets.push([0, a, b, 7].map(corner));
        }
    }
    let mesh = Mesh::new(nodes, tets).expect("sound");
    Geometry::new(&mesh, Element::Tet4Averaged, &[]).0
}

fn grid(n: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..n * n * n).map(move |i| (i / (n * n), i / n % n, i % n))
}

/// A field without pattern, entries up to `size`.
fn field(n: usize, size: f64, seed: f64) -> Vec<f64> {
    (0..n).map(|i| size * (seed + 12.9898 * (i + 1) as f64).sin()).collect()
}

fn moved(u: &[f64], d: &[f64], by: f64) -> Vec<f64> {
    u.iter().zip(d).map(|(u, d)| u + by * d).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn energy_and_force(geometry: &Geometry, model: &Material, u: &[f64]) -> (f64, Vec<f64>) {
    let mut force = vec![0.0; u.len()];
    let energy = internal_force_into(geometry, model, u, &mut force, &mut Vec::new(), false);
    (energy.expect("upright").total, force)
}

fn product(geometry: &Geometry, model: &Material, u: &[f64], d: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; u.len()];
    let all: Vec<usize> = (0..geometry.n_elements()).collect();
    assert!(tangent_product_into(geometry, model, u, d, &all, &mut product));
    product
}

/// Product of the assembled blocks of all patches.
fn assembled<M: PointModel>(
    geometry: &Geometry,
    model: &M,
    u: &[f64],
    d: &[f64],
    kind: TangentKind,
) -> Vec<f64> {
    let tangents = ElementTangents::new(geometry, model, u, kind);
    let mut product = vec![0.0; u.len()];
    for patch in 0..geometry.cliques().len() {
        let nodes = geometry.cliques().get(patch);
        let mut blocks = vec![[0.0; 9]; nodes.len() * (nodes.len() + 1) / 2];
        assert_eq!(tangents.width(patch), nodes.len());
        assert!(tangents.blocks_into(patch, &mut blocks));
        for (a, &row) in nodes.iter().enumerate() {
            for (b, &column) in nodes[..=a].iter().enumerate() {
                let block = &blocks[a * (a + 1) / 2 + b];
                let (row, column) = (3 * row as usize, 3 * column as usize);
                for i in 0..3 {
                    for k in 0..3 {
                        product[row + i] += block[3 * i + k] * d[column + k];
                        if a != b {
                            product[column + k] += block[3 * i + k] * d[row + i];
                        }
                    }
                }
            }
        }
    }
    product
}

/// A plain neo-Hookean material, one that the loops for any law take for the same, and others.
fn materials(poisson: f64) -> Vec<(&'static str, Material)> {
    let plain = Material::neo_hookean(10.0, poisson).expect("valid");
    let along = |k1_over_mu| Fibres {
        k1_over_mu,
        k2: 2.0,
        tension_only: false,
        directions: Directions::Uniform([0.6, 0.0, 0.8]),
    };
    let with = |fibres| plain.clone().with_fibres(fibres).expect("valid");
    let law = |kind| plain.clone().with_law(kind).expect("valid");
    vec![
        ("neo-Hookean", plain.clone()),
        ("the same by the loops for any law", with(along(0.0))),
        ("with fibres", with(along(0.7))),
        ("Mooney-Rivlin", law(LawKind::MooneyRivlin { share: 0.3 })),
        ("Fung", law(LawKind::Fung { b: 1.3 })),
    ]
}

/// Largest difference of two fields over the largest entry of the first.
fn off(a: &[f64], b: &[f64]) -> f64 {
    let largest = a.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0_f64, |m, (x, y)| m.max((x - y).abs())) / largest
}

#[test]
fn forces_are_differences_of_the_energy_and_the_tangent_of_the_forces() {
    let geometry = geometry();
    let n = 3 * 27;
    // Far from equilibrium: volume ratios of elements from 0.8 to 1.2 at any Poisson's ratio.
    let (u, d) = (field(n, 0.25, 0.3), field(n, 1.0, 1.7));
    for poisson in [0.3, 0.49, 0.4995] {
        for (name, model) in materials(poisson) {
            let (_, force) = energy_and_force(&geometry, &model, &u);
            // Differences of fourth order: errors of step⁴ and of rounding over the step.
            let step = 1e-3;
            let slope = |of: &dyn Fn(f64) -> f64| {
                (8.0 * (of(step) - of(-step)) - (of(2.0 * step) - of(-2.0 * step))) / (12.0 * step)
            };
            let work = slope(&|by| energy_and_force(&geometry, &model, &moved(&u, &d, by)).0);
            assert!(
                (work / dot(&force, &d) - 1.0).abs() < 1e-7,
                "{name}, nu {poisson}: {work} {}",
                dot(&force, &d)
            );

            let change: Vec<f64> = (0..n)
                .map(|i| slope(&|by| energy_and_force(&geometry, &model, &moved(&u, &d, by)).1[i]))
                .collect();
            let exact = product(&geometry, &model, &u, &d);
            assert!(off(&exact, &change) < 1e-7, "{name}, nu {poisson}: {}", off(&exact, &change));
            let blocks = assembled(&geometry, &model, &u, &d, TangentKind::Exact);
            assert!(off(&exact, &blocks) < 1e-11, "{name}, nu {poisson}: {}", off(&exact, &blocks));
        }
    }
}

#[test]
fn the_closed_form_is_the_loop_for_any_law() {
    let geometry = geometry();
    let n = 3 * 27;
    let d = field(n, 1.0, 0.9);
    let [(_, plain), (_, any)] = <[_; 2]>::try_from(materials(0.49)[..2].to_vec()).expect("two");
    assert!(PointModel::neo_hookean(&plain).is_some() && PointModel::neo_hookean(&any).is_none());
    // Small strains keep their digits as well.
    for size in [0.2, 1e-4, 1e-9] {
        let u = field(n, size, 2.1);
        let (own, force) = energy_and_force(&geometry, &plain, &u);
        let (other, expected) = energy_and_force(&geometry, &any, &u);
        assert!((own / other - 1.0).abs() < 1e-11, "energies {own} {other} at {size}");
        assert!(off(&expected, &force) < 1e-11, "{} at {size}", off(&expected, &force));
        let kind = TangentKind::Exact;
        let [own, other] = [&plain, &any].map(|model| assembled(&geometry, model, &u, &d, kind));
        assert!(off(&other, &own) < 1e-11, "{} at {size}", off(&other, &own));
    }
}

#[test]
fn clamped_tangents_are_never_indefinite_and_exact_ones_can_be() {
    let geometry = geometry();
    let n = 3 * 27;
    let u = field(n, 0.25, 0.3);
    for (name, model) in materials(0.4995) {
        let least = |kind: TangentKind| {
            let unit = |k: usize| (0..n).map(|i| f64::from(u8::from(i == k))).collect::<Vec<f64>>();
            let columns: Vec<f64> =
                (0..n).flat_map(|k| assembled(&geometry, &model, &u, &unit(k), kind)).collect();
            let eigen = nalgebra::DMatrix::from_vec(n, n, columns).symmetric_eigenvalues();
            eigen.min() / eigen.max()
        };
        assert!(least(TangentKind::Clamped) > -1e-12, "{name}: {}", least(TangentKind::Clamped));
        if name == "neo-Hookean" {
            let exact = least(TangentKind::Exact);
            assert!(exact < -1e-6, "the case shows nothing: {exact}");
        }
    }
}

#[test]
fn the_bound_of_the_largest_singular_value_is_one() {
    assert_eq!(largest_stretch_bound(&[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), 1.0);
    let g = [[1.0, 2.0, 0.0], [0.0, 1.0, -0.5], [0.3, 0.0, 0.7]];
    let matrix = nalgebra::Matrix3::from_fn(|i, j| g[i][j]);
    let largest: f64 = matrix.singular_values()[0];
    assert!(largest_stretch_bound(&g) >= largest * largest);
}
