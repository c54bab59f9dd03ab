//! The tangent element by element, and its product with a direction.

use super::averaged_neo_hookean::{PlainPatches, nodal_pressures};
use super::averages::Averages;
use super::loops::{
    Loops, PointModel, TangentKind, clamp, displacement_gradient, local, spatial_gradients,
};
use crate::element::{Geometry, Patches, Rule, TET4, TET10};
use crate::material::{Matrix3, NeoHookean, Tangent};
use crate::system::factor::Blocks;

/// The tangent at a displacement, element by element.
pub(crate) struct ElementTangents<'a, M: PointModel> {
    loops: Loops<'a, M>,
    kind: TangentKind,
    /// Of [`Element::Tet4Averaged`](crate::Element::Tet4Averaged) whose cliques are patches.
    patches: Option<&'a Patches>,
    /// Of patches; none where an element is inverted.
    averages: Option<Averages>,
    /// Of patches of a plain neo-Hookean law.
    plain: Option<PlainPatches<'a>>,
}

impl<'a, M: PointModel> ElementTangents<'a, M> {
    /// # Shapes
    ///
    /// `displacement` `(3 n_nodes)`, mm.
    pub(crate) fn new(
        geometry: &'a Geometry,
        model: &'a M,
        displacement: &'a [f64],
        kind: TangentKind,
    ) -> Self {
        let loops = Loops { geometry, model, displacement };
        let patches = geometry.patches.as_ref();
        let averages = patches.and_then(|patches| loops.averages(patches, false));
        let plain = averages.as_ref().zip(model.neo_hookean()).and_then(|(averages, laws)| {
            let pressures = nodal_pressures(&loops, laws, averages)?;
            Some(PlainPatches { laws, pressures })
        });
        Self { loops, kind, patches, averages, plain }
    }

    /// The tangent without averaging: linear tets with the law of their first point.
    pub(crate) fn without_patches(
        geometry: &'a Geometry,
        model: &'a M,
        displacement: &'a [f64],
        kind: TangentKind,
    ) -> Self {
        let loops = Loops { geometry, model, displacement };
        Self { loops, kind, patches: None, averages: None, plain: None }
    }
}

impl<M: PointModel> Blocks for ElementTangents<'_, M> {
    fn width(&self, clique: usize) -> usize {
        match self.patches {
            Some(patches) => patches.nodes_of(clique).len(),
            None => self.loops.geometry.element.n_nodes(),
        }
    }

    fn blocks_into(&self, clique: usize, blocks: &mut [[f64; 9]]) -> bool {
        if let Some(patches) = self.patches {
            let (loops, kind) = (&self.loops, self.kind);
            return match (&self.averages, &self.plain) {
                (Some(averages), Some(plain)) => {
                    loops.plain_patch_tangent(patches, averages, plain, clique, kind, blocks)
                }
                (Some(averages), None) => {
                    loops.patch_tangent(patches, averages, clique, kind, blocks)
                }
                (None, _) => false,
            };
        }
        match self.loops.geometry.element.n_nodes() {
            4 => self.loops.element_tangent(&TET4, clique, self.kind, blocks),
            _ => self.loops.element_tangent(&TET10, clique, self.kind, blocks),
        }
    }
}

impl<M: PointModel> Loops<'_, M> {
    fn element_tangent<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        element: usize,
        kind: TangentKind,
        blocks: &mut [[f64; 9]],
    ) -> bool {
        blocks.fill([0.0; 9]);
        let u = local::<N>(self.geometry, element, self.displacement);
        let inverse_jacobian = &self.geometry.inverse_jacobian[element];
        let weight = self.geometry.volume[element] / Q as f64;
        for (point, gradients) in rule.gradients.iter().enumerate() {
            let h = displacement_gradient(&u, gradients, inverse_jacobian);
            let spatial = spatial_gradients(gradients, inverse_jacobian);
            if let (Some(laws), TangentKind::Exact) = (self.model.neo_hookean(), kind) {
                let law = laws.at(element, point);
                let Some((inverse_f, twist)) = law.tangent_parts(&h) else { return false };
                add_neo_hookean(&law, &inverse_f, twist, &spatial, weight, blocks);
                continue;
            }
            let Some(mut tangent) = self.model.tangent(element, point, &h) else {
                return false;
            };
            if kind == TangentKind::Clamped {
                clamp(&mut tangent);
            }
            add_blocks(&tangent, &spatial, weight, blocks);
        }
        true
    }
}

/// Add the blocks of a neo-Hookean point. With `G = F⁻ᵀ` and `g_a' = G g_a` they are
///
/// ```text
/// w (μ (g_a·g_b) I + (μ − λ ln J) g_b' ⊗ g_a' + λ g_a' ⊗ g_b')
/// ```
#[inline(always)]
fn add_neo_hookean<const N: usize>(
    law: &NeoHookean,
    inverse_f: &Matrix3,
    twist: f64,
    gradients: &[[f64; 3]; N],
    weight: f64,
    blocks: &mut [[f64; 9]],
) {
    let mut pushed = [[0.0; 3]; N];
    for a in 0..N {
        for i in 0..3 {
            for j in 0..3 {
                pushed[a][i] += inverse_f[i][j] * gradients[a][j];
            }
        }
    }
    let (mu, twist, lambda) = (weight * law.mu, weight * twist, weight * law.lambda);
    let mut pair = 0;
    for a in 0..N {
        for b in 0..=a {
            let (ga, gb) = (&gradients[a], &gradients[b]);
            let diagonal = mu * (ga[0] * gb[0] + ga[1] * gb[1] + ga[2] * gb[2]);
            let block = &mut blocks[pair];
            pair += 1;
            for i in 0..3 {
                for k in 0..3 {
                    block[3 * i + k] +=
                        twist * pushed[b][i] * pushed[a][k] + lambda * pushed[a][i] * pushed[b][k];
                }
                block[4 * i] += diagonal;
            }
        }
    }
}

/// Add `w ∂N_a/∂X_j A_ijkl ∂N_b/∂X_l` for all pairs `a >= b`.
fn add_blocks<const N: usize>(
    tangent: &Tangent,
    gradients: &[[f64; 3]; N],
    weight: f64,
    blocks: &mut [[f64; 9]],
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

/// Write the product of the exact tangent at a displacement with a direction; false where an
/// element is inverted. No matrix is formed. Of elements that are not named, the product may lack the
/// parts (those with averaged volume ratios always count).
///
/// # Shapes
///
/// All `(3 n_nodes)`; `product` in mN.
pub(crate) fn tangent_product_into<M: PointModel>(
    geometry: &Geometry,
    model: &M,
    displacement: &[f64],
    direction: &[f64],
    elements: &[usize],
    product: &mut [f64],
) -> bool {
    let loops = Loops { geometry, model, displacement };
    if let Some(patches) = &geometry.patches {
        return loops.averaged_product(patches, direction, product);
    }
    match geometry.element.n_nodes() {
        4 => loops.product(&TET4, direction, elements, product),
        _ => loops.product(&TET10, direction, elements, product),
    }
}

impl<M: PointModel> Loops<'_, M> {
    fn product<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        direction: &[f64],
        elements: &[usize],
        product: &mut [f64],
    ) -> bool {
        product.fill(0.0);
        for &element in elements {
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
