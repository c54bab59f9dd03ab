//! Energy, internal forces and tangent of a displacement field.
//!
//! For every element and quadrature point, with `h` from [`crate::element`] and weight `w`:
//!
//! ```text
//! W    += w ψ(h)
//! f_ai += w Σ_j P_ij ∂N_a/∂X_j                           (3) a node
//! K_ab += w Σ_jl ∂N_a/∂X_j A_ijkl ∂N_b/∂X_l              (3, 3) a pair of nodes
//! ```
//!
//! In parallel, element forces are written to a buffer and then summed node by node in the order
//! of the elements; alone, they are added at once, in the same order. Energies are summed in fixed
//! chunks. So the bits do not depend on the number of threads.

mod averaged;
mod averaged_neo_hookean;
mod averaged_tangent;
mod force;
mod lanes;
mod nodal;
mod packs;
mod points;
mod tangent;
#[cfg(test)]
mod tests;

pub(crate) use force::{Energy, internal_force_into};
pub(crate) use nodal::NodalGradients;
pub(crate) use points::{PointMap, point_volumes};
pub(crate) use tangent::{ElementTangents, TangentKind, tangent_product_into};

use crate::element::{Element, Geometry, PACK, Rule, TET4, TET10};
use crate::material::{Hyperelastic, Material, Matrix3, PlainLaws, Response, Tangent};

/// Elements whose energies are summed together.
const CHUNK: usize = 256;

/// Bodies with fewer elements than this are not worth a second thread.
const PARALLEL_FROM: usize = 2_000;

/// What a body answers at its quadrature points. The loops below know nothing else of what it is
/// made of or has been through.
pub(crate) trait PointModel: Sync {
    /// Energy, stress and volume ratio; none where the point is inverted.
    fn response(&self, element: usize, point: usize, h: &Matrix3) -> Option<Response>;

    /// `∂P/∂h`; none where the point is inverted.
    fn tangent(&self, element: usize, point: usize, h: &Matrix3) -> Option<Tangent>;

    /// The laws of a plain neo-Hookean body, for which the loops have faster forms.
    fn neo_hookean(&self) -> Option<PlainLaws<'_>> {
        None
    }

    /// The same of a body whose points remember stresses and nothing else.
    fn remembering(&self) -> Option<(PlainLaws<'_>, &Remembered)> {
        None
    }
}

/// What one-point elements add to a law that is split into parts, `Ψ = a_vol (ψ − ψ_iso) + a_iso ψ_iso +
/// ½ S : (C − I)`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Remembered {
    /// `a_vol`
    pub(crate) volumetric: f64,
    /// `a_iso`; that of the volumetric part where the parts are not separated.
    pub(crate) isochoric: f64,
    /// `S` of eight elements at a time: components 00, 11, 22, 01, 02, 12, kPa. Empty where nothing is
    /// remembered.
    pub(crate) stress: Vec<[[f64; PACK]; 6]>,
}

impl PointModel for Material {
    #[inline(always)]
    fn response(&self, element: usize, point: usize, h: &Matrix3) -> Option<Response> {
        self.law_at(element, point).response(h)
    }

    #[inline(always)]
    fn tangent(&self, element: usize, point: usize, h: &Matrix3) -> Option<Tangent> {
        self.law_at(element, point).tangent(h)
    }

    fn neo_hookean(&self) -> Option<PlainLaws<'_>> {
        self.plain_neo_hookean()
    }
}

/// What every loop over elements reads.
struct Loops<'a, M: PointModel> {
    geometry: &'a Geometry,
    model: &'a M,
    displacement: &'a [f64],
}

#[inline(always)]
fn local<const N: usize>(geometry: &Geometry, element: usize, values: &[f64]) -> [[f64; 3]; N] {
    let nodes = &geometry.connectivity[element * N..(element + 1) * N];
    let mut rows = [[0.0; 3]; N];
    for a in 0..N {
        let flat = 3 * nodes[a] as usize;
        rows[a].copy_from_slice(&values[flat..flat + 3]);
    }
    rows
}

#[inline(always)]
fn displacement_gradient<const N: usize>(
    u: &[[f64; 3]; N],
    gradients: &[[f64; 3]; N],
    inverse_jacobian: &[[f64; 3]; 3],
) -> Matrix3 {
    let mut local = [[0.0; 3]; 3];
    for a in 0..N {
        for i in 0..3 {
            for k in 0..3 {
                local[i][k] += u[a][i] * gradients[a][k];
            }
        }
    }
    let mut h = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                h[i][j] += local[i][k] * inverse_jacobian[k][j];
            }
        }
    }
    h
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
        Element::Tet4Averaged => averaged::gradients(geometry, displacement),
        Element::Tet10 => gradients_with(&TET10, geometry, displacement),
    }
}

fn gradients_with<const N: usize, const Q: usize>(
    rule: &Rule<N, Q>,
    geometry: &Geometry,
    displacement: &[f64],
) -> Vec<Matrix3> {
    (0..geometry.n_elements())
        .flat_map(|element| {
            let u = local::<N>(geometry, element, displacement);
            let jacobian = &geometry.inverse_jacobian[element];
            rule.gradients.iter().map(move |g| displacement_gradient(&u, g, jacobian))
        })
        .collect()
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
                    1.0 + crate::material::det_f_minus_one(&h)
                })
                .fold(f64::INFINITY, f64::min)
        })
        .collect()
}
