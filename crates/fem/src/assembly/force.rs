//! Internal forces and energy.

use std::ops::Range;

use rayon::prelude::*;

use super::loops::{
    CHUNK, Energy, Loops, PARALLEL_FROM, PointModel, Remembered, displacement_gradient, local,
};
use super::packs::{PACKS, Packs, PacksAnswer};
use crate::element::{Element, Geometry, PACK, Rule, TET4, TET10};
use crate::material::PlainLaws;

/// What elements side by side take.
type Lanes<'a> = (PlainLaws<'a>, Option<&'a Remembered>);

/// Write the internal forces of a displacement and return its energy; none where an element is
/// inverted (the forces are then unspecified).
///
/// # Shapes
///
/// `displacement` and `force` `(3 n_nodes)`, mm and mN. `buffer` is kept by the caller between
/// calls and only used in parallel.
pub(crate) fn internal_force_into<M: PointModel>(
    geometry: &Geometry,
    model: &M,
    displacement: &[f64],
    force: &mut [f64],
    buffer: &mut Vec<f64>,
    parallel: bool,
) -> Option<Energy> {
    let loops = Loops { geometry, model, displacement };
    if let Some(patches) = &geometry.patches {
        return loops.averaged_force(patches, force, parallel);
    }
    let parallel = parallel && geometry.n_elements() >= PARALLEL_FROM;
    let plain = model.neo_hookean().map(|laws| (laws, None));
    let lanes = plain.or_else(|| model.remembering().map(|(laws, memory)| (laws, Some(memory))));
    if let (Element::Tet4, Some(lanes)) = (geometry.element, lanes) {
        return match parallel {
            false => loops.serial_packs(lanes, force),
            true => loops.parallel_packs(lanes, force, buffer),
        };
    }
    match (geometry.element.n_nodes(), parallel) {
        (4, false) => loops.serial(&TET4, force),
        (_, false) => loops.serial(&TET10, force),
        (4, true) => loops.parallel(&TET4, force, buffer),
        (_, true) => loops.parallel(&TET10, force, buffer),
    }
}

impl<M: PointModel> Loops<'_, M> {
    fn serial<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        force: &mut [f64],
    ) -> Option<Energy> {
        force.fill(0.0);
        let n = self.geometry.n_elements();
        let mut sum = Energy::NOTHING;
        for first in (0..n).step_by(CHUNK) {
            let chunk = self.chunk(rule, first..n.min(first + CHUNK), |element, rows| {
                for (a, &node) in self.geometry.nodes_of(element).iter().enumerate() {
                    let row = &mut force[3 * node as usize..3 * node as usize + 3];
                    for i in 0..3 {
                        row[i] += rows[a][i];
                    }
                }
            })?;
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
                let first = c * CHUNK;
                let elements = first..first + slots.len() / (3 * N);
                self.chunk(rule, elements, |element, rows| {
                    let slot = 3 * N * (element - first);
                    slots[slot..slot + 3 * N].copy_from_slice(rows.as_flattened());
                })
            })
            .collect();
        let chunks = chunks?;
        self.collect(buffer.as_chunks().0, force, true);
        Some(chunks.into_iter().fold(Energy::NOTHING, Energy::and))
    }

    /// Write to each node the sum of the forces that its elements give it, one row a place.
    pub(super) fn collect(&self, rows: &[[f64; 3]], force: &mut [f64], parallel: bool) {
        let (start, places) = &self.geometry.node2place;
        let sum = |(node, target): (usize, &mut [f64])| {
            target.fill(0.0);
            for &place in &places[start[node] as usize..start[node + 1] as usize] {
                for i in 0..3 {
                    target[i] += rows[place as usize][i];
                }
            }
        };
        if parallel && self.geometry.n_elements() >= PARALLEL_FROM {
            force.par_chunks_exact_mut(3).with_min_len(CHUNK).enumerate().for_each(sum);
        } else {
            force.chunks_exact_mut(3).enumerate().for_each(sum);
        }
    }

    fn serial_packs(&self, lanes: Lanes, force: &mut [f64]) -> Option<Energy> {
        force.fill(0.0);
        let mut rows = [[[0.0; 3]; 4]; PACK * PACKS];
        let mut sum = Energy::NOTHING;
        let elements = self.geometry.connectivity.as_chunks::<4>().0;
        for (chunk, elements) in elements.chunks(rows.len()).enumerate() {
            let rows = &mut rows[..elements.len()];
            sum = sum.and(self.packs(lanes, chunk * PACKS, rows)?);
            for (nodes, rows) in elements.iter().zip(rows) {
                for (&node, row) in nodes.iter().zip(rows) {
                    let target = &mut force[3 * node as usize..3 * node as usize + 3];
                    for i in 0..3 {
                        target[i] += row[i];
                    }
                }
            }
        }
        Some(sum)
    }

    fn parallel_packs(
        &self,
        lanes: Lanes,
        force: &mut [f64],
        buffer: &mut Vec<f64>,
    ) -> Option<Energy> {
        buffer.resize(12 * self.geometry.n_elements(), 0.0);
        let chunks: Option<Vec<Energy>> = buffer
            .par_chunks_mut(12 * PACK * PACKS)
            .enumerate()
            .map(|(c, slots)| {
                let rows = slots.as_chunks_mut::<3>().0.as_chunks_mut::<4>().0;
                self.packs(lanes, c * PACKS, rows)
            })
            .collect();
        let chunks = chunks?;
        self.collect(buffer.as_chunks().0, force, true);
        Some(chunks.into_iter().fold(Energy::NOTHING, Energy::and))
    }

    /// Write the nodal forces of up to [`PACKS`] packs of elements.
    fn packs(&self, lanes: Lanes, first: usize, rows: &mut [[[f64; 3]; 4]]) -> Option<Energy> {
        let Self { geometry, displacement, .. } = *self;
        let (laws, memory) = lanes;
        let all = Packs { geometry, laws, memory, displacement, first, rows: &mut *rows };
        let PacksAnswer { mut energy, far } = pulp::Arch::new().dispatch(all);
        for pack in (0..PACKS).filter(|pack| far & (1 << pack) != 0) {
            let elements = PACK * pack..rows.len().min(PACK * (pack + 1));
            for (k, row) in elements.clone().zip(&mut rows[elements]) {
                let (own, forces) = self.element(&TET4, PACK * first + k)?;
                energy = energy.and(own);
                *row = forces;
            }
        }
        Some(energy)
    }

    /// Evaluate some elements in order and hand each one's nodal forces to `take`.
    #[inline(always)]
    fn chunk<const N: usize, const Q: usize>(
        &self,
        rule: &Rule<N, Q>,
        elements: Range<usize>,
        mut take: impl FnMut(usize, &[[f64; 3]; N]),
    ) -> Option<Energy> {
        let mut sum = Energy::NOTHING;
        for element in elements {
            let (energy, rows) = self.element(rule, element)?;
            sum = sum.and(energy);
            take(element, &rows);
        }
        Some(sum)
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
            let answer = self.model.response(element, point, &h)?;
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
