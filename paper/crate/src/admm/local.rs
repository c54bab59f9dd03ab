//! The local step of every tetrahedron, and what it pulls at the nodes with.

use rayon::prelude::*;

use tissuereg_fem::material::{Matrix3, NeoHookean};

use super::prox::prox;
use super::tets::Tets;

/// Fewer tetrahedra are not worth a task of their own.
const LEAST_TETS: usize = 128;

/// What is kept of a tetrahedron between iterations.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Tet {
    /// Scaled dual variable `u`, dimensionless.
    dual: Matrix3,
    /// `w² (z − u − D x)`, mN mm.
    pull: Matrix3,
    /// `|D x − z|²`
    gap: f64,
}

/// What all local steps read.
pub(super) struct Local<'a> {
    pub(super) tets: &'a Tets,
    /// One a tetrahedron.
    pub(super) laws: &'a [NeoHookean],
    /// The same, kPa.
    pub(super) kappa: &'a [f64],
    /// mm.
    pub(super) displacement: &'a [[f64; 3]],
    pub(super) parallel: bool,
}

impl Local<'_> {
    /// `p = D x + u`, `z = prox(p)`, `u ← p − z` of every tetrahedron.
    pub(super) fn step(&self, tets: &mut [Tet]) {
        let one = |(e, tet): (usize, &mut Tet)| self.step_of(e, tet);
        if self.parallel {
            tets.par_iter_mut().with_min_len(LEAST_TETS).enumerate().for_each(one);
        } else {
            tets.iter_mut().enumerate().for_each(one);
        }
    }

    fn step_of(&self, e: usize, tet: &mut Tet) {
        let gradient = self.tets.deformation_gradient(e, self.displacement);
        let (law, kappa) = (&self.laws[e], self.kappa[e]);
        let target = combined(&gradient, 1.0, &tet.dual);
        let z = prox(law, kappa, &target);
        tet.dual = combined(&target, -1.0, &z);
        let gap = combined(&gradient, -1.0, &z);
        tet.gap = gap.iter().flatten().map(|v| v * v).sum();
        let weight = kappa * self.tets.volume[e];
        for i in 0..3 {
            for j in 0..3 {
                tet.pull[i][j] = -weight * (gap[i][j] + tet.dual[i][j]);
            }
        }
    }

    /// Sum of the pulls at a node, in the order of its tetrahedra.
    #[inline(always)]
    pub(super) fn pull_at(&self, tets: &[Tet], node: usize) -> [f64; 3] {
        let (starts, corners) = &self.tets.node2corner;
        let mut sum = [0.0; 3];
        for &place in &corners[starts[node] as usize..starts[node + 1] as usize] {
            let (e, corner) = (place as usize / 4, place as usize % 4);
            let gradient = self.tets.shape_gradients(e)[corner];
            for i in 0..3 {
                for j in 0..3 {
                    sum[i] += tets[e].pull[i][j] * gradient[j];
                }
            }
        }
        sum
    }

    /// Root of the mean of `|D x − z|²` over the volume at the last local step, dimensionless.
    pub(super) fn gap(&self, tets: &[Tet]) -> f64 {
        let volume = &self.tets.volume;
        let sum: f64 = tets.iter().zip(volume).map(|(tet, v)| tet.gap * v).sum();
        (sum / volume.iter().sum::<f64>()).sqrt()
    }
}

/// `a + factor b`
#[inline(always)]
fn combined(a: &Matrix3, factor: f64, b: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + factor * b[i][j]))
}
