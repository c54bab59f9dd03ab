//! Four-node elements of one displacement, eight by eight.

use pulp::Simd;

use super::lanes::{Elements, Matrices, Memory, neo_hookean};
use super::loops::{Energy, Remembered};
use crate::element::{Geometry, PACK};
use crate::material::PlainLaws;

/// Packs evaluated by one call.
pub(super) const PACKS: usize = 32;

/// Evaluates up to [`PACKS`] packs; a type, so that it is compiled for the processor at hand.
pub(super) struct Packs<'a> {
    pub(super) geometry: &'a Geometry,
    pub(super) laws: PlainLaws<'a>,
    pub(super) memory: Option<&'a Remembered>,
    /// `(3 n_nodes)`, mm.
    pub(super) displacement: &'a [f64],
    /// First pack.
    pub(super) first: usize,
    /// Nodal forces of the elements, mN; one row each.
    pub(super) rows: &'a mut [[[f64; 3]; 4]],
}

/// What some packs answer.
pub(super) struct PacksAnswer {
    /// Of all elements whose packs are not `far`.
    pub(super) energy: Energy,
    /// Bit `k`: pack `k` is left to the scalar law.
    pub(super) far: u32,
}

impl pulp::WithSimd for Packs<'_> {
    type Output = PacksAnswer;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> PacksAnswer {
        // Twice, so that plain elements ask for no memory.
        match self.memory {
            None => self.all(simd, |_, _| None),
            Some(memory) => {
                self.all(simd, |pack, part| Some(load_memory(simd, memory, pack, part)))
            }
        }
    }
}

impl Packs<'_> {
    #[inline(always)]
    fn all<S: Simd>(
        self,
        simd: S,
        memory: impl Fn(usize, usize) -> Option<Memory<S>>,
    ) -> PacksAnswer {
        let mut energy = simd.splat_f64s(0.0);
        let mut min_det_f = simd.splat_f64s(f64::INFINITY);
        let mut far = 0;
        for (k, rows) in self.rows.chunks_mut(PACK).enumerate() {
            let pack = self.first + k;
            let edges = gather(self.geometry, pack, self.displacement);
            let mut force = [[[0.0; PACK]; 3]; 3];
            let (mut own, mut least, mut is_far) = (energy, min_det_f, simd.splat_f64s(0.0));
            for part in 0..PACK / S::F64_LANES {
                let elements = load(simd, self.geometry, self.laws, pack, part);
                let edges = lanes_of::<S>(&edges, part);
                let answer = neo_hookean(simd, &elements, &edges, memory(pack, part).as_ref());
                for k in 0..3 {
                    for i in 0..3 {
                        S::as_mut_simd_f64s(&mut force[k][i]).0[part] = answer.force[k][i];
                    }
                }
                // Padding has no volume and does not move: no energy, det F = 1.
                own = simd.add_f64s(own, answer.energy);
                least = simd.min_f64s(least, answer.det_f);
                is_far = simd.add_f64s(is_far, answer.far);
            }
            if simd.reduce_sum_f64s(is_far) > 0.0 {
                far |= 1 << k;
                continue;
            }
            (energy, min_det_f) = (own, least);
            for (l, row) in rows.iter_mut().enumerate() {
                for i in 0..3 {
                    let [a, b, c] = [force[0][i][l], force[1][i][l], force[2][i][l]];
                    (row[1][i], row[2][i], row[3][i]) = (a, b, c);
                    row[0][i] = -(a + b + c);
                }
            }
        }
        let total = simd.reduce_sum_f64s(energy);
        let min_det_f = simd.reduce_min_f64s(min_det_f);
        PacksAnswer { energy: Energy { total, min_det_f }, far }
    }
}

/// `[k][i]`: component `i` of `u_(k+1) − u_0` of eight elements, mm.
#[inline(always)]
fn gather(geometry: &Geometry, pack: usize, displacement: &[f64]) -> [[[f64; PACK]; 3]; 3] {
    let nodes = &geometry.packs.nodes[pack];
    let mut edges = [[[0.0; PACK]; 3]; 3];
    for l in 0..PACK {
        let row = |a: usize| {
            let flat = 3 * nodes[a][l] as usize;
            &displacement[flat..flat + 3]
        };
        let origin = row(0);
        for k in 0..3 {
            let other = row(k + 1);
            for i in 0..3 {
                edges[k][i][l] = other[i] - origin[i];
            }
        }
    }
    edges
}

/// Part of eight elements.
#[inline(always)]
fn lanes_of<S: Simd>(eight: &[[[f64; PACK]; 3]; 3], part: usize) -> Matrices<S> {
    let lanes = |values: &[f64; PACK]| S::as_simd_f64s(values).0[part];
    [
        [lanes(&eight[0][0]), lanes(&eight[0][1]), lanes(&eight[0][2])],
        [lanes(&eight[1][0]), lanes(&eight[1][1]), lanes(&eight[1][2])],
        [lanes(&eight[2][0]), lanes(&eight[2][1]), lanes(&eight[2][2])],
    ]
}

#[inline(always)]
fn load_memory<S: Simd>(simd: S, memory: &Remembered, pack: usize, part: usize) -> Memory<S> {
    let differs = memory.isochoric != memory.volumetric;
    Memory {
        volumetric: simd.splat_f64s(memory.volumetric),
        excess: differs.then(|| simd.splat_f64s(memory.isochoric - memory.volumetric)),
        stress: memory
            .stress
            .get(pack)
            .map(|six| six.each_ref().map(|v| S::as_simd_f64s(v).0[part])),
    }
}

#[inline(always)]
fn load<S: Simd>(
    simd: S,
    geometry: &Geometry,
    laws: PlainLaws,
    pack: usize,
    part: usize,
) -> Elements<S> {
    let jacobian = lanes_of::<S>(&geometry.packs.inverse_jacobian[pack], part);
    let weight = S::as_simd_f64s(&geometry.packs.volume[pack]).0[part];
    if let Some(law) = laws.uniform() {
        let (mu, lambda) = (simd.splat_f64s(law.mu), simd.splat_f64s(law.lambda));
        return Elements { jacobian, weight, mu, lambda };
    }
    let last = geometry.n_elements() - 1;
    let mut moduli = [[0.0; PACK]; 2];
    for l in 0..PACK {
        let law = laws.at((PACK * pack + l).min(last), 0);
        moduli[0][l] = law.mu;
        moduli[1][l] = law.lambda;
    }
    let [mu, lambda] = moduli.map(|values| S::as_simd_f64s(&values).0[part]);
    Elements { jacobian, weight, mu, lambda }
}
