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

use nalgebra::{SMatrix, SymmetricEigen};
use rayon::prelude::*;

use crate::element::{Element, Geometry, Rule, TET4, TET10};
use crate::material::{Hyperelastic, Material, Matrix3, Tangent};
use crate::system::pattern::Pattern;

/// Elements whose energies are summed together.
const CHUNK: usize = 256;

/// Bodies with fewer elements than this are not worth a second thread.
const PARALLEL_FROM: usize = 2_000;

/// Energy and smallest volume ratio of a state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Energy {
    /// Strain energy, µJ.
    pub(crate) total: f64,
    /// Smallest det F of all quadrature points.
    pub(crate) min_det_f: f64,
}

impl Energy {
    const NOTHING: Self = Self { total: 0.0, min_det_f: f64::INFINITY };

    fn and(self, other: Self) -> Self {
        Self { total: self.total + other.total, min_det_f: self.min_det_f.min(other.min_det_f) }
    }
}

/// Write the internal forces of a displacement and return its energy; none where an element is
/// inverted (the forces are then unspecified).
///
/// # Shapes
///
/// `displacement` and `force` `(3 n_nodes)`, mm and mN. `buffer` is kept by the caller between
/// calls and only used in parallel.
pub(crate) fn internal_force_into(
    geometry: &Geometry,
    material: &Material,
    displacement: &[f64],
    force: &mut [f64],
    buffer: &mut Vec<f64>,
    parallel: bool,
) -> Option<Energy> {
    let loops = Loops { geometry, material, displacement };
    let parallel = parallel && geometry.n_elements() >= PARALLEL_FROM;
    match (geometry.element, parallel) {
        (Element::Tet4, false) => loops.serial(&TET4, force),
        (Element::Tet10, false) => loops.serial(&TET10, force),
        (Element::Tet4, true) => loops.parallel(&TET4, force, buffer),
        (Element::Tet10, true) => loops.parallel(&TET10, force, buffer),
    }
}

#[derive(Clone, Copy)]
struct Loops<'a> {
    geometry: &'a Geometry,
    material: &'a Material,
    displacement: &'a [f64],
}

impl Loops<'_> {
    fn serial<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        force: &mut [f64],
    ) -> Option<Energy> {
        force.fill(0.0);
        let n = self.geometry.n_elements();
        let mut sum = Energy::NOTHING;
        for first in (0..n).step_by(CHUNK) {
            let mut chunk = Energy::NOTHING;
            for element in first..n.min(first + CHUNK) {
                let (energy, rows) = self.element(rule, element)?;
                chunk = chunk.and(energy);
                for (a, &node) in self.geometry.nodes_of(element).iter().enumerate() {
                    for i in 0..3 {
                        force[3 * node as usize + i] += rows[a][i];
                    }
                }
            }
            sum = sum.and(chunk);
        }
        Some(sum)
    }

    fn parallel<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        force: &mut [f64],
        buffer: &mut Vec<f64>,
    ) -> Option<Energy> {
        buffer.resize(3 * N * self.geometry.n_elements(), 0.0);
        let chunks: Option<Vec<Energy>> = buffer
            .par_chunks_mut(3 * N * CHUNK)
            .enumerate()
            .map(|(c, slots)| {
                let mut chunk = Energy::NOTHING;
                for (k, slot) in slots.chunks_exact_mut(3 * N).enumerate() {
                    let (energy, rows) = self.element(rule, c * CHUNK + k)?;
                    chunk = chunk.and(energy);
                    slot.copy_from_slice(rows.as_flattened());
                }
                Some(chunk)
            })
            .collect();
        let chunks = chunks?;
        let (start, places) = &self.geometry.node2place;
        force.par_chunks_mut(3 * CHUNK).enumerate().for_each(|(c, rows)| {
            for (k, row) in rows.chunks_exact_mut(3).enumerate() {
                let node = c * CHUNK + k;
                row.fill(0.0);
                for &place in &places[start[node] as usize..start[node + 1] as usize] {
                    for i in 0..3 {
                        row[i] += buffer[3 * place as usize + i];
                    }
                }
            }
        });
        Some(chunks.into_iter().fold(Energy::NOTHING, Energy::and))
    }

    /// Energy and nodal forces of one element.
    #[inline(always)]
    fn element<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        element: usize,
    ) -> Option<(Energy, [[f64; 3]; N])> {
        let u = local::<N>(self.geometry, element, self.displacement);
        let inverse_jacobian = &self.geometry.inverse_jacobian[element];
        let weight = self.geometry.volume[element] / Q as f64;
        let mut energy = Energy::NOTHING;
        let mut rows = [[0.0; 3]; N];
        for (point, gradients) in rule.gradients.iter().enumerate() {
            let h = displacement_gradient(&u, gradients, inverse_jacobian);
            let answer = self.material.law_at(element, point).response(&h)?;
            energy = energy.and(Energy { total: weight * answer.energy, min_det_f: answer.det_f });
            // P (∂ξ/∂X)ᵀ, the stress seen from the reference element.
            let mut pulled = [[0.0; 3]; 3];
            for i in 0..3 {
                for k in 0..3 {
                    for j in 0..3 {
                        pulled[i][k] += weight * answer.stress[i][j] * inverse_jacobian[k][j];
                    }
                }
            }
            for a in 0..N {
                for i in 0..3 {
                    for k in 0..3 {
                        rows[a][i] += pulled[i][k] * gradients[a][k];
                    }
                }
            }
        }
        Some((energy, rows))
    }
}

#[inline(always)]
fn local<const N: usize>(geometry: &Geometry, element: usize, values: &[f64]) -> [[f64; 3]; N] {
    let nodes = &geometry.connectivity[element * N..(element + 1) * N];
    std::array::from_fn(|a| {
        let flat = 3 * nodes[a] as usize;
        [values[flat], values[flat + 1], values[flat + 2]]
    })
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
        Element::Tet4 => det_f_with(&TET4, geometry, displacement),
        Element::Tet10 => det_f_with(&TET10, geometry, displacement),
    }
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
pub(crate) fn tangent_into(
    geometry: &Geometry,
    pattern: &Pattern,
    material: &Material,
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
    let loops = Loops { geometry, material, displacement };
    let parallel = parallel && geometry.n_elements() >= PARALLEL_FROM;
    match geometry.element {
        Element::Tet4 => loops.tangent::<4, 1, 10>(&TET4, pattern, kind, parallel, values),
        Element::Tet10 => loops.tangent::<10, 4, 55>(&TET10, pattern, kind, parallel, values),
    }
}

impl Loops<'_> {
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
            let Some(mut tangent) = self.material.law_at(element, point).tangent(&h) else {
                return false;
            };
            if kind == TangentKind::Clamped {
                clamp(&mut tangent);
            }
            let spatial: [[f64; 3]; N] = std::array::from_fn(|a| {
                std::array::from_fn(|j| {
                    (0..3).map(|k| gradients[a][k] * inverse_jacobian[k][j]).sum()
                })
            });
            add_blocks(&tangent, &spatial, weight, blocks);
        }
        true
    }
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
pub(crate) fn tangent_product_into(
    geometry: &Geometry,
    material: &Material,
    displacement: &[f64],
    direction: &[f64],
    product: &mut [f64],
) -> bool {
    let loops = Loops { geometry, material, displacement };
    match geometry.element {
        Element::Tet4 => loops.product(&TET4, direction, product),
        Element::Tet10 => loops.product(&TET10, direction, product),
    }
}

impl Loops<'_> {
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
                let Some(tangent) = self.material.law_at(element, point).tangent(&h) else {
                    return false;
                };
                let dh = displacement_gradient(&d, gradients, inverse_jacobian);
                for (a, &node) in self.geometry.nodes_of(element).iter().enumerate() {
                    let g: [f64; 3] = std::array::from_fn(|j| {
                        (0..3).map(|k| gradients[a][k] * inverse_jacobian[k][j]).sum()
                    });
                    for i in 0..3 {
                        for j in 0..3 {
                            let stress: f64 =
                                (0..9).map(|kl| tangent[3 * i + j][kl] * dh[kl / 3][kl % 3]).sum();
                            product[3 * node as usize + i] += weight * stress * g[j];
                        }
                    }
                }
            }
        }
        true
    }
}
