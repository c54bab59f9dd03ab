//! Tangent of elements whose volume ratios are averaged at the nodes, patch by patch.
//!
//! The energy is a sum over nodes, each term of which is a function of the patch of elements around
//! a node; the second derivatives of one term couple the nodes of that patch. With the notation of
//! [`super::averaged`], `θ = G : dF` and `θ̄ = dJ̄/J̄`, the deformation changes by
//!
//! ```text
//! dF_ea = D : dF + ⅓ F_ea θ̄,     D : dF = s (dF − ⅓ F θ)
//! ```
//!
//! so that one patch is a sum of element blocks, of products of one vector `b = ∂ ln J̄/∂u` with
//! others, and of `b ⊗ b`.

use super::averages::{Averages, around, deformation, dot, times};
use super::loops::{Loops, PointModel, TangentKind, clamp, spatial_gradients};
use crate::element::{Patches, TET4};
use crate::material::{Matrix3, Tangent};

/// Second derivatives at one corner of an element.
struct Corner {
    /// By `dF` twice.
    local: Tangent,
    /// By `dF` and `θ̄`.
    mixed: Matrix3,
    /// By `θ̄` twice.
    nodal: f64,
    /// `p`, zero where the second derivatives of the averaging are left out.
    pressure: f64,
}

impl<M: PointModel> Loops<'_, M> {
    /// Blocks of the patch around a node, as [`crate::system::factor::Blocks`] has them.
    ///
    /// [`TangentKind::Exact`] is the exact second derivative. [`TangentKind::Clamped`] clamps the
    /// law's tangent and leaves out the second derivatives of `F_ea`: never indefinite.
    pub(super) fn patch_tangent(
        &self,
        patches: &Patches,
        averages: &Averages,
        centre: usize,
        kind: TangentKind,
        blocks: &mut [[f64; 9]],
    ) -> bool {
        blocks.fill([0.0; 9]);
        let geometry = self.geometry;
        let patch_volume = averages.grown_volume(patches, centre);
        let mut corners = Vec::new();
        let (mut nodal, mut pressure) = (0.0, 0.0);
        for (element, a) in around(geometry, centre) {
            let Some(corner) = self.corner(averages, element, a, centre, kind) else {
                return false;
            };
            let quarter = 0.25 * geometry.volume[element];
            nodal += quarter * corner.nodal;
            pressure += quarter * corner.pressure;
            corners.push((element, quarter, corner));
        }
        nodal -= pressure;

        let width = patches.nodes_of(centre).len();
        let mut growth = vec![[0.0; 3]; width];
        let mut mixed = vec![[0.0; 3]; width];
        for (element, quarter, corner) in &mut corners {
            let deformed = &averages.elements[*element];
            let share = geometry.volume[*element] * deformed.det_f() / patch_volume;
            let inverse = &deformed.inverse;
            for (row, entries) in corner.local.iter_mut().enumerate() {
                let (i, j) = (row / 3, row % 3);
                for (column, entry) in entries.iter_mut().enumerate() {
                    let (k, l) = (column / 3, column % 3);
                    let cofactor = inverse[i][j] * inverse[k][l] - inverse[i][l] * inverse[k][j];
                    *entry = *quarter * *entry + pressure * share * cofactor;
                }
            }
            let jacobian = &geometry.inverse_jacobian[*element];
            let gradients = spatial_gradients(&TET4.gradients[0], jacobian);
            let nodes = geometry.nodes_of(*element);
            let places: [usize; 4] = std::array::from_fn(|b| patches.place(centre, nodes[b]));
            for (gradient, &place) in gradients.iter().zip(&places) {
                for i in 0..3 {
                    for j in 0..3 {
                        growth[place][i] += share * inverse[i][j] * gradient[j];
                        mixed[place][i] += *quarter * corner.mixed[i][j] * gradient[j];
                    }
                }
            }
            add_element(&corner.local, &gradients, &places, blocks);
        }
        let mut pair = 0;
        for a in 0..width {
            for b in 0..=a {
                let block = &mut blocks[pair];
                pair += 1;
                for i in 0..3 {
                    for k in 0..3 {
                        block[3 * i + k] += mixed[a][i] * growth[b][k]
                            + growth[a][i] * (mixed[b][k] + nodal * growth[b][k]);
                    }
                }
            }
        }
        true
    }

    fn corner(
        &self,
        averages: &Averages,
        element: usize,
        a: usize,
        node: usize,
        kind: TangentKind,
    ) -> Option<Corner> {
        let deformed = &averages.elements[element];
        let (growth, h) = averages.corner(element, node as u32);
        let s = 1.0 + growth;
        let mut tangent = self.model.tangent(element, a, &h)?;
        if kind == TangentKind::Clamped {
            clamp(&mut tangent);
        }
        let f = deformation(&deformed.h);
        let along = times(&tangent, &f).map(|row| row.map(|v| s * s * v));
        let twice = dot(&along, &f);
        let inverse = &deformed.inverse;
        let mut corner = Corner {
            local: [[0.0; 9]; 9],
            mixed: [[0.0; 3]; 3],
            nodal: twice / 9.0,
            pressure: 0.0,
        };
        let mut pull = [[0.0; 3]; 3];
        if kind == TangentKind::Exact {
            let stress = self.model.response(element, a, &h)?.stress;
            pull = stress.map(|row| row.map(|v| s * v));
            corner.pressure = dot(&pull, &f) / 3.0;
            corner.nodal += corner.pressure / 3.0;
        }
        let p = corner.pressure;
        for i in 0..3 {
            for j in 0..3 {
                corner.mixed[i][j] =
                    (along[i][j] - (twice / 3.0 + p) * inverse[i][j] + pull[i][j]) / 3.0;
                for k in 0..3 {
                    for l in 0..3 {
                        let both = |m: &Matrix3| inverse[i][j] * m[k][l] + m[i][j] * inverse[k][l];
                        corner.local[3 * i + j][3 * k + l] = s * s * tangent[3 * i + j][3 * k + l]
                            - (both(&along) + both(&pull)) / 3.0
                            + (twice / 9.0 + p / 3.0) * inverse[i][j] * inverse[k][l]
                            + p * inverse[i][l] * inverse[k][j];
                    }
                }
            }
        }
        Some(corner)
    }
}

/// Add the blocks of an element at the places of its nodes.
fn add_element(
    local: &Tangent,
    gradients: &[[f64; 3]; 4],
    places: &[usize; 4],
    blocks: &mut [[f64; 9]],
) {
    for a in 0..4 {
        let mut half = [[0.0; 9]; 3];
        for i in 0..3 {
            for j in 0..3 {
                for kl in 0..9 {
                    half[i][kl] += gradients[a][j] * local[3 * i + j][kl];
                }
            }
        }
        for b in 0..4 {
            if places[b] > places[a] {
                continue;
            }
            let block = &mut blocks[places[a] * (places[a] + 1) / 2 + places[b]];
            for i in 0..3 {
                for k in 0..3 {
                    block[3 * i + k] +=
                        (0..3).map(|l| half[i][3 * k + l] * gradients[b][l]).sum::<f64>();
                }
            }
        }
    }
}
