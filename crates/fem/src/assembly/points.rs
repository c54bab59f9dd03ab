//! Sums over quadrature points of stresses that are known there.

use crate::element::{Element, Geometry, Rule, TET4, TET10};
use crate::material::Matrix3;

/// Undeformed volume that belongs to each quadrature point, element after element, mm³.
pub(crate) fn point_volumes(geometry: &Geometry) -> Vec<f64> {
    let n_points = geometry.element.n_points();
    let per_point = |v: &f64| std::iter::repeat_n(v / n_points as f64, n_points);
    geometry.volume.iter().flat_map(per_point).collect()
}

/// Add the nodal forces of stresses at all quadrature points, element after element:
/// `f_ai += w Σ_j P_ij ∂N_a/∂X_j`.
///
/// # Shapes
///
/// `stresses` one a quadrature point, kPa; `force` `(3 n_nodes)`, mN.
pub(crate) fn add_forces_of(geometry: &Geometry, stresses: &[Matrix3], force: &mut [f64]) {
    match geometry.element {
        Element::Tet4 => add_with(&TET4, geometry, stresses, force),
        Element::Tet10 => add_with(&TET10, geometry, stresses, force),
        // `Linearised::new` refuses these.
        Element::Tet4Averaged => {}
    }
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
            for i in 0..3 {
                let pulled: [f64; 3] = std::array::from_fn(|k| {
                    weight * (0..3).map(|j| stress[i][j] * jacobian[k][j]).sum::<f64>()
                });
                for (row, g) in rows.iter_mut().zip(gradients) {
                    row[i] += (0..3).map(|k| pulled[k] * g[k]).sum::<f64>();
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
