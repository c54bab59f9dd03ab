//! The tangent as a sparse matrix, and its product with a direction.

use nalgebra::{SMatrix, SymmetricEigen};
use rayon::prelude::*;

use super::{CHUNK, Loops, PARALLEL_FROM, PointModel, displacement_gradient, local};
use crate::element::{Element, Geometry, Rule, TET4, TET10};
use crate::material::{Matrix3, Tangent};
use crate::system::pattern::Pattern;

/// Which tangent an assembly forms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TangentKind {
    /// The derivative of the forces.
    Exact,
    /// With the negative eigenvalues of `∂P/∂h` removed at every point: never indefinite.
    Clamped,
}

/// Write the lower triangle of the tangent at a displacement; false where an element is inverted.
///
/// # Shapes
///
/// `displacement` `(3 n_nodes)`, none for the undeformed state; `values` one entry an entry of
/// the pattern, mN/mm.
pub(crate) fn tangent_into<M: PointModel>(
    geometry: &Geometry,
    pattern: &Pattern,
    model: &M,
    displacement: Option<&[f64]>,
    kind: TangentKind,
    parallel: bool,
    values: &mut [f64],
) -> bool {
    let zero;
    let displacement = match displacement {
        Some(u) => u,
        None => {
            zero = vec![0.0; 3 * (geometry.node2place.0.len() - 1)];
            &zero
        }
    };
    let loops = Loops { geometry, model, displacement };
    let parallel = parallel && geometry.n_elements() >= PARALLEL_FROM;
    match geometry.element {
        Element::Tet4 => loops.tangent::<4, 1, 10>(&TET4, pattern, kind, parallel, values),
        Element::Tet10 => loops.tangent::<10, 4, 55>(&TET10, pattern, kind, parallel, values),
    }
}

impl<M: PointModel> Loops<'_, M> {
    fn tangent<const N: usize, const Q: usize, const PAIRS: usize>(
        &self,
        rule: &Rule<N, Q>,
        pattern: &Pattern,
        kind: TangentKind,
        parallel: bool,
        values: &mut [f64],
    ) -> bool {
        values.fill(0.0);
        let n = self.geometry.n_elements();
        let mut blocks = vec![[[0.0; 9]; PAIRS]; n.min(8 * CHUNK)];
        for first in (0..n).step_by(8 * CHUNK) {
            let count = (n - first).min(8 * CHUNK);
            let fill = |(k, slot): (usize, &mut [[f64; 9]; PAIRS])| {
                self.element_tangent(rule, first + k, kind, slot)
            };
            let sound = if parallel {
                blocks[..count].par_iter_mut().with_min_len(32).enumerate().all(fill)
            } else {
                blocks[..count].iter_mut().enumerate().all(fill)
            };
            if !sound {
                return false;
            }
            for (k, block) in blocks[..count].iter().enumerate() {
                let element = first + k;
                pattern.add_element_into(element, self.geometry.nodes_of(element), block, values);
            }
        }
        true
    }

    fn element_tangent<const N: usize, const Q: usize, const PAIRS: usize>(
        &self,
        rule: &Rule<N, Q>,
        element: usize,
        kind: TangentKind,
        blocks: &mut [[f64; 9]; PAIRS],
    ) -> bool {
        *blocks = [[0.0; 9]; PAIRS];
        let u = local::<N>(self.geometry, element, self.displacement);
        let inverse_jacobian = &self.geometry.inverse_jacobian[element];
        let weight = self.geometry.volume[element] / Q as f64;
        for (point, gradients) in rule.gradients.iter().enumerate() {
            let h = displacement_gradient(&u, gradients, inverse_jacobian);
            let Some(mut tangent) = self.model.tangent(element, point, &h) else {
                return false;
            };
            if kind == TangentKind::Clamped {
                clamp(&mut tangent);
            }
            let spatial = spatial_gradients(gradients, inverse_jacobian);
            add_blocks(&tangent, &spatial, weight, blocks);
        }
        true
    }
}

/// `∂N/∂X` from `∂N/∂ξ`.
fn spatial_gradients<const N: usize>(
    gradients: &[[f64; 3]; N],
    inverse_jacobian: &[[f64; 3]; 3],
) -> [[f64; 3]; N] {
    gradients.map(|g| std::array::from_fn(|j| (0..3).map(|k| g[k] * inverse_jacobian[k][j]).sum()))
}

/// Add `w ∂N_a/∂X_j A_ijkl ∂N_b/∂X_l` for all pairs `a >= b`.
fn add_blocks<const N: usize, const PAIRS: usize>(
    tangent: &Tangent,
    gradients: &[[f64; 3]; N],
    weight: f64,
    blocks: &mut [[f64; 9]; PAIRS],
) {
    for a in 0..N {
        // Σ_j ∂N_a/∂X_j A_ijkl, rows i, columns 3 k + l.
        let mut half = [[0.0; 9]; 3];
        for i in 0..3 {
            for j in 0..3 {
                let g = weight * gradients[a][j];
                for kl in 0..9 {
                    half[i][kl] += g * tangent[3 * i + j][kl];
                }
            }
        }
        for b in 0..=a {
            let block = &mut blocks[a * (a + 1) / 2 + b];
            for i in 0..3 {
                for k in 0..3 {
                    let mut sum = 0.0;
                    for l in 0..3 {
                        sum += half[i][3 * k + l] * gradients[b][l];
                    }
                    block[3 * i + k] += sum;
                }
            }
        }
    }
}

/// Remove the negative eigenvalues of a symmetric tangent.
fn clamp(tangent: &mut Tangent) {
    let matrix = SMatrix::<f64, 9, 9>::from_fn(|i, j| tangent[i][j]);
    let mut eigen = SymmetricEigen::new(matrix);
    if eigen.eigenvalues.iter().all(|&v| v >= 0.0) {
        return;
    }
    eigen.eigenvalues.apply(|v| *v = v.max(0.0));
    let clamped = eigen.recompose();
    for i in 0..9 {
        for j in 0..9 {
            tangent[i][j] = clamped[(i, j)];
        }
    }
}

/// Write the product of the exact tangent at a displacement with a direction; false where an
/// element is inverted. No matrix is formed.
///
/// # Shapes
///
/// All `(3 n_nodes)`; `product` in mN.
pub(crate) fn tangent_product_into<M: PointModel>(
    geometry: &Geometry,
    model: &M,
    displacement: &[f64],
    direction: &[f64],
    product: &mut [f64],
) -> bool {
    let loops = Loops { geometry, model, displacement };
    match geometry.element {
        Element::Tet4 => loops.product(&TET4, direction, product),
        Element::Tet10 => loops.product(&TET10, direction, product),
    }
}

impl<M: PointModel> Loops<'_, M> {
    fn product<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        direction: &[f64],
        product: &mut [f64],
    ) -> bool {
        product.fill(0.0);
        for element in 0..self.geometry.n_elements() {
            let u = local::<N>(self.geometry, element, self.displacement);
            let d = local::<N>(self.geometry, element, direction);
            let inverse_jacobian = &self.geometry.inverse_jacobian[element];
            let weight = self.geometry.volume[element] / Q as f64;
            for (point, gradients) in rule.gradients.iter().enumerate() {
                let h = displacement_gradient(&u, gradients, inverse_jacobian);
                let Some(tangent) = self.model.tangent(element, point, &h) else {
                    return false;
                };
                let dh = displacement_gradient(&d, gradients, inverse_jacobian);
                let stress: Matrix3 = std::array::from_fn(|i| {
                    std::array::from_fn(|j| {
                        (0..9).map(|kl| tangent[3 * i + j][kl] * dh[kl / 3][kl % 3]).sum()
                    })
                });
                let spatial = spatial_gradients(gradients, inverse_jacobian);
                for (g, &node) in spatial.iter().zip(self.geometry.nodes_of(element)) {
                    for i in 0..3 {
                        let row: f64 = (0..3).map(|j| stress[i][j] * g[j]).sum();
                        product[3 * node as usize + i] += weight * row;
                    }
                }
            }
        }
        true
    }
}
