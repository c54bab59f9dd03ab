//! Stresses and gradients at quadrature points: what a displacement rate does there, and the nodal
//! forces of stresses that are known there.
//!
//! The two are transposes of each other: `Σ w P : ġ(v) = f(P) · v` for every stress and rate.

use super::averages::{self, Averages, Rates, averages, deformation, dot, sum_around};
use super::loops::{displacement_gradient, local, spatial_gradients};
use crate::element::{Element, Geometry, Patches, Rule, TET4, TET10};
use crate::material::{Matrix3, det_f_minus_one};

/// Undeformed volume that belongs to each quadrature point, element after element, mm³.
pub(crate) fn point_volumes(geometry: &Geometry) -> Vec<f64> {
    let n_points = geometry.element.n_points();
    let per_point = |v: &f64| std::iter::repeat_n(v / n_points as f64, n_points);
    geometry.volume.iter().flat_map(per_point).collect()
}

/// Where a body is, as far as its points need to know to follow rates.
#[derive(Debug)]
pub(crate) struct PointMap {
    /// Volume ratios of averaged elements.
    averaged: Option<Averages>,
}

impl PointMap {
    /// None where an averaged element is inverted.
    ///
    /// # Shapes
    ///
    /// `displacement` `(3 n_nodes)`, mm.
    pub(crate) fn new(geometry: &Geometry, displacement: &[f64]) -> Option<Self> {
        let averaged = match &geometry.patches {
            Some(patches) => Some(averages(geometry, patches, displacement, false)?),
            None => None,
        };
        Some(Self { averaged })
    }

    /// Rates of the displacement gradients at all points along a displacement rate `(3 n_nodes)`.
    ///
    /// With averaged volume ratios `Ḟ_ea = s Ḟ + ⅓ F_ea (θ̄_a − θ)`, as in `averaged_tangent`.
    pub(crate) fn gradients(&self, geometry: &Geometry, rate: &[f64]) -> Vec<Matrix3> {
        let (Some(patches), Some(averages)) = (&geometry.patches, &self.averaged) else {
            return gradients_at_points(geometry, rate);
        };
        let Rates { elements: changes, nodes: means } = averages.rates(geometry, patches, rate);
        let mut rates = Vec::with_capacity(4 * geometry.n_elements());
        for (element, (dh, theta)) in changes.iter().enumerate() {
            for &node in geometry.nodes_of(element) {
                let (growth, h) = averages.corner(element, node);
                let f = deformation(&h);
                let stretch = (means[node as usize] - theta) / 3.0;
                rates.push(matrix(|i, j| (1.0 + growth) * dh[i][j] + stretch * f[i][j]));
            }
        }
        rates
    }

    /// Add the nodal forces of stresses at all points: `f_ai += w Σ_j P_ij ∂N_a/∂X_j`, and with
    /// averaged volume ratios those of the element stresses that `averaged` forms of them.
    ///
    /// # Shapes
    ///
    /// `stresses` one per quadrature point, kPa; `force` `(3 n_nodes)`, mN.
    pub(crate) fn add_forces(&self, geometry: &Geometry, stresses: &[Matrix3], force: &mut [f64]) {
        match (&geometry.patches, &self.averaged) {
            (Some(patches), Some(averages)) => {
                let stresses = element_stresses(geometry, patches, averages, stresses);
                add_with(&TET4, geometry, &stresses, force);
            }
            _ if geometry.element == Element::Tet10 => {
                add_with(&TET10, geometry, stresses, force);
            }
            _ => add_with(&TET4, geometry, stresses, force),
        }
    }
}

/// `P_e = ¼ Σ_a (s P − p G) + J_e G Σ_a Q_a` of stresses `P` at the corners.
fn element_stresses(
    geometry: &Geometry,
    patches: &Patches,
    averages: &Averages,
    stresses: &[Matrix3],
) -> Vec<Matrix3> {
    let corners = |element: usize| {
        let nodes = geometry.nodes_of(element).iter().zip(&stresses[4 * element..]);
        nodes.map(move |(&node, stress)| {
            let (growth, h) = averages.corner(element, node);
            (node as usize, 1.0 + growth, stress, dot(stress, &deformation(&h)) / 3.0)
        })
    };
    let pressures: Vec<f64> = (0..geometry.n_elements())
        .flat_map(|element| corners(element).map(move |(.., p)| p))
        .collect();
    let part =
        |element: usize, a: usize| 0.25 * geometry.volume[element] * pressures[4 * element + a];
    let nodal: Vec<f64> = (0..patches.volume.len())
        .map(|node| sum_around(geometry, node, part) / averages.grown_volume(patches, node))
        .collect();
    (0..geometry.n_elements())
        .map(|element| {
            let deformed = &averages.elements[element];
            let g = &deformed.inverse;
            let mut sum = [[0.0; 3]; 3];
            for (node, s, stress, p) in corners(element) {
                let along = deformed.det_f() * nodal[node] - 0.25 * p;
                sum = matrix(|i, j| sum[i][j] + 0.25 * s * stress[i][j] + along * g[i][j]);
            }
            sum
        })
        .collect()
}

fn matrix(entry: impl Fn(usize, usize) -> f64) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

fn add_with<const N: usize, const Q: usize>(
    rule: &Rule<N, Q>,
    geometry: &Geometry,
    stresses: &[Matrix3],
    force: &mut [f64],
) {
    for (element, stresses) in stresses.as_chunks::<Q>().0.iter().enumerate() {
        let jacobian = &geometry.inverse_jacobian[element];
        let weight = geometry.volume[element] / Q as f64;
        let mut rows = [[0.0; 3]; N];
        for (stress, gradients) in stresses.iter().zip(&rule.gradients) {
            let spatial = spatial_gradients(gradients, jacobian);
            for (row, g) in rows.iter_mut().zip(&spatial) {
                for i in 0..3 {
                    row[i] += weight * (0..3).map(|j| stress[i][j] * g[j]).sum::<f64>();
                }
            }
        }
        for (row, &node) in rows.iter().zip(geometry.nodes_of(element)) {
            for i in 0..3 {
                force[3 * node as usize + i] += row[i];
            }
        }
    }
}

/// Smallest det F of every element of a displacement.
///
/// # Shapes
///
/// `displacement` `(3 n_nodes)`, mm; one entry an element, dimensionless.
pub(crate) fn det_f_by_element(geometry: &Geometry, displacement: &[f64]) -> Vec<f64> {
    match geometry.element {
        Element::Tet4 | Element::Tet4Averaged => det_f_with(&TET4, geometry, displacement),
        Element::Tet10 => det_f_with(&TET10, geometry, displacement),
    }
}

/// Displacement gradients at all quadrature points, element after element.
pub(crate) fn gradients_at_points(geometry: &Geometry, displacement: &[f64]) -> Vec<Matrix3> {
    match geometry.element {
        Element::Tet4 => gradients_with(&TET4, geometry, displacement),
        Element::Tet4Averaged => averages::gradients(geometry, displacement),
        Element::Tet10 => gradients_with(&TET10, geometry, displacement),
    }
}

fn gradients_with<const N: usize, const Q: usize>(
    rule: &Rule<N, Q>,
    geometry: &Geometry,
    displacement: &[f64],
) -> Vec<Matrix3> {
    let mut all = vec![[[0.0; 3]; 3]; Q * geometry.n_elements()];
    for (element, own) in all.as_chunks_mut::<Q>().0.iter_mut().enumerate() {
        let u = local::<N>(geometry, element, displacement);
        let jacobian = &geometry.inverse_jacobian[element];
        *own = rule.gradients.map(|g| displacement_gradient(&u, &g, jacobian));
    }
    all
}

fn det_f_with<const N: usize, const Q: usize>(
    rule: &Rule<N, Q>,
    geometry: &Geometry,
    displacement: &[f64],
) -> Vec<f64> {
    (0..geometry.n_elements())
        .map(|element| {
            let u = local::<N>(geometry, element, displacement);
            let jacobian = &geometry.inverse_jacobian[element];
            rule.gradients
                .iter()
                .map(|g| {
                    let h = displacement_gradient(&u, g, jacobian);
                    1.0 + det_f_minus_one(&h)
                })
                .fold(f64::INFINITY, f64::min)
        })
        .collect()
}
