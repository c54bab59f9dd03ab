//! Forces of four-node elements whose volume ratios are averaged at the nodes.
//!
//! With `V_e` the volume of an element and `V_a = Σ_e V_e` that of all elements around node `a`,
//!
//! ```text
//! J̄_a = Σ_e V_e J_e / V_a,     F_ea = (J̄_a / J_e)^⅓ F_e,     W = Σ_e Σ_a V_e/4 ψ_e(F_ea)
//! ```
//!
//! over the four corners `a` of each element. A law that is the sum of an isochoric and a
//! volumetric part has the first by element and the second by node; all others work as well. With
//! `s = (J̄_a / J_e)^⅓`, `P` the stress at `F_ea`, `p = P : F_ea / 3` and `G = F_e⁻ᵀ`, the exact
//! derivative is the element stress
//!
//! ```text
//! P_e = ¼ Σ_a (s P − p G) + J_e G Σ_a Q_a,     Q_a = Σ_e ¼ V_e p / (V_a J̄_a)
//! ```
//!
//! Elements and nodes are passed in turn, every sum in one order, so that the bits do not depend
//! on the number of threads.

use rayon::prelude::*;

use super::averaged_neo_hookean as plain;
use super::force::Energy;
use super::tangent::spatial_gradients;
use super::{Loops, PARALLEL_FROM, PointModel, displacement_gradient, local};
use crate::element::{Geometry, Patches, TET4};
use crate::material::{Matrix3, Tangent, cofactor, det_f_minus_one};

/// Volume ratios of a state, by element and by node.
#[derive(Debug)]
pub(super) struct Averages {
    pub(super) elements: Vec<Deformed>,
    /// `J̄_a − 1`
    pub(super) nodes: Vec<f64>,
    /// `ln J̄_a`
    pub(super) logs: Vec<f64>,
}

impl Averages {
    /// `s − 1` and `F_ea − I` at the corner of an element that is a node.
    pub(super) fn corner(&self, element: usize, node: u32) -> (f64, Matrix3) {
        self.elements[element].averaged(self.logs[node as usize])
    }

    /// `V_a J̄_a`
    pub(super) fn grown_volume(&self, patches: &Patches, node: usize) -> f64 {
        patches.volume[node] * (1.0 + self.nodes[node])
    }

    /// What a displacement rate `(3 n_nodes)` does to elements and nodes.
    pub(super) fn rates(&self, geometry: &Geometry, patches: &Patches, rate: &[f64]) -> Rates {
        let elements: Vec<(Matrix3, f64)> = (0..geometry.n_elements())
            .map(|element| {
                let u = local::<4>(geometry, element, rate);
                let jacobian = &geometry.inverse_jacobian[element];
                let dh = displacement_gradient(&u, &TET4.gradients[0], jacobian);
                (dh, dot(&self.elements[element].inverse, &dh))
            })
            .collect();
        let grown = |element: usize, _| {
            geometry.volume[element] * self.elements[element].det_f() * elements[element].1
        };
        let nodes = (0..patches.volume.len())
            .map(|node| sum_around(geometry, node, grown) / self.grown_volume(patches, node))
            .collect();
        Rates { elements, nodes }
    }
}

/// How volume ratios change along a displacement rate.
pub(super) struct Rates {
    /// `dh` and `θ = dJ/J`.
    pub(super) elements: Vec<(Matrix3, f64)>,
    /// `θ̄ = dJ̄/J̄`
    pub(super) nodes: Vec<f64>,
}

/// How one element is deformed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Deformed {
    /// Displacement gradient.
    pub(super) h: Matrix3,
    /// `G = F⁻ᵀ`
    pub(super) inverse: Matrix3,
    /// `J − 1`
    x: f64,
    /// `ln J`
    pub(super) log: f64,
}

impl Deformed {
    /// None unless `0 < J < ∞`.
    fn new(h: Matrix3) -> Option<Self> {
        let x = det_f_minus_one(&h);
        let det_f = 1.0 + x;
        if !(det_f > 0.0 && det_f < f64::INFINITY) {
            return None;
        }
        let inverse = cofactor(&deformation(&h)).map(|row| row.map(|v| v / det_f));
        Some(Self { h, inverse, x, log: x.ln_1p() })
    }

    pub(super) fn det_f(&self) -> f64 {
        1.0 + self.x
    }

    /// `s − 1` and `F_ea − I` for a corner where `ln J̄ = log`.
    fn averaged(&self, log: f64) -> (f64, Matrix3) {
        let growth = ((log - self.log) / 3.0).exp_m1();
        let mut h = self.h;
        for i in 0..3 {
            for j in 0..3 {
                h[i][j] += growth * (self.h[i][j] + f64::from(u8::from(i == j)));
            }
        }
        (growth, h)
    }
}

/// `I + h`
pub(super) fn deformation(h: &Matrix3) -> Matrix3 {
    let mut f = *h;
    for i in 0..3 {
        f[i][i] += 1.0;
    }
    f
}

/// `a : b`
pub(super) fn dot(a: &Matrix3, b: &Matrix3) -> f64 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(x, y)| x * y).sum()
}

/// `tangent : direction`
pub(super) fn times(tangent: &Tangent, direction: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            tangent[3 * i + j].iter().zip(direction.as_flattened()).map(|(t, d)| t * d).sum()
        })
    })
}

fn add_scaled(sum: &mut Matrix3, factor: f64, m: &Matrix3) {
    for i in 0..3 {
        for j in 0..3 {
            sum[i][j] += factor * m[i][j];
        }
    }
}

/// `value(0)` to `value(n − 1)`, none where one is none.
fn all<T: Send>(
    n: usize,
    parallel: bool,
    value: impl Fn(usize) -> Option<T> + Send + Sync,
) -> Option<Vec<T>> {
    if parallel && n >= PARALLEL_FROM {
        (0..n).into_par_iter().with_min_len(256).map(value).collect()
    } else {
        (0..n).map(value).collect()
    }
}

/// Averaged displacement gradients at the corners of all elements; not a number where one is
/// inverted.
pub(super) fn gradients(geometry: &Geometry, displacement: &[f64]) -> Vec<Matrix3> {
    let averages =
        geometry.patches.as_ref().and_then(|p| averages(geometry, p, displacement, true));
    let Some(averages) = averages else {
        return vec![[[f64::NAN; 3]; 3]; 4 * geometry.n_elements()];
    };
    geometry
        .connectivity
        .chunks_exact(4)
        .enumerate()
        .flat_map(|(element, nodes)| nodes.iter().map(move |&node| (element, node)))
        .map(|(element, node)| averages.corner(element, node).1)
        .collect()
}

pub(super) fn averages(
    geometry: &Geometry,
    patches: &Patches,
    displacement: &[f64],
    parallel: bool,
) -> Option<Averages> {
    let elements = all(geometry.n_elements(), parallel, |element| {
        let u = local::<4>(geometry, element, displacement);
        let jacobian = &geometry.inverse_jacobian[element];
        Deformed::new(displacement_gradient(&u, &TET4.gradients[0], jacobian))
    })?;
    let nodes = all(patches.volume.len(), parallel, |node| {
        let part = |element: usize, _| geometry.volume[element] * elements[element].x;
        Some(sum_around(geometry, node, part) / patches.volume[node].max(f64::MIN_POSITIVE))
    })?;
    let logs = nodes.iter().map(|x: &f64| x.ln_1p()).collect();
    Some(Averages { elements, nodes, logs })
}

/// Sum over the elements around a node, of which it is corner `a`.
pub(super) fn sum_around(
    geometry: &Geometry,
    node: usize,
    part: impl Fn(usize, usize) -> f64,
) -> f64 {
    around(geometry, node).map(|(element, a)| part(element, a)).sum()
}

/// Elements around a node, and which of their corners it is.
pub(super) fn around(
    geometry: &Geometry,
    node: usize,
) -> impl Iterator<Item = (usize, usize)> + Clone + '_ {
    let (starts, places) = &geometry.node2place;
    let own = &places[starts[node] as usize..starts[node + 1] as usize];
    own.iter().map(|&place| (place as usize / 4, place as usize % 4))
}

/// What one element gives to its stress and to the pressures of its corners.
pub(super) struct Part {
    pub(super) energy: Energy,
    /// `¼ Σ_a (s P − p G)`
    pub(super) stress: Matrix3,
    /// `¼ V_e p` at each corner.
    pub(super) pressure: [f64; 4],
}

impl<M: PointModel> Loops<'_, M> {
    pub(super) fn averages(&self, patches: &Patches, parallel: bool) -> Option<Averages> {
        averages(self.geometry, patches, self.displacement, parallel)
    }

    /// Forces and energy, as [`super::internal_force_into`].
    pub(super) fn averaged_force(
        &self,
        patches: &Patches,
        force: &mut [f64],
        parallel: bool,
    ) -> Option<Energy> {
        let averages = self.averages(patches, parallel)?;
        let n = self.geometry.n_elements();
        let parts = match self.model.neo_hookean() {
            Some(laws) => all(n, parallel, |element| {
                let volume = self.geometry.volume[element];
                plain::part(laws, &averages, element, volume, self.geometry.nodes_of(element))
            }),
            None => all(n, parallel, |element| self.part(&averages, element)),
        }?;
        let nodal = all(patches.volume.len(), parallel, |node| {
            let sum = sum_around(self.geometry, node, |element, a| parts[element].pressure[a]);
            Some(sum / averages.grown_volume(patches, node))
        })?;
        let forces = all(n, parallel, |element| {
            let deformed = &averages.elements[element];
            let mut stress = parts[element].stress;
            let nodes = self.geometry.nodes_of(element);
            let sum: f64 = nodes.iter().map(|&node| nodal[node as usize]).sum();
            add_scaled(&mut stress, deformed.det_f() * sum, &deformed.inverse);
            Some(self.nodal_forces(element, &stress))
        })?;
        self.collect(forces.as_flattened(), force, parallel);
        Some(parts.iter().fold(Energy::NOTHING, |sum, part| sum.and(part.energy)))
    }

    fn part(&self, averages: &Averages, element: usize) -> Option<Part> {
        let deformed = &averages.elements[element];
        let quarter = 0.25 * self.geometry.volume[element];
        let min_det_f = deformed.det_f();
        let mut part = Part {
            energy: Energy { total: 0.0, min_det_f },
            stress: [[0.0; 3]; 3],
            pressure: [0.0; 4],
        };
        for (a, &node) in self.geometry.nodes_of(element).iter().enumerate() {
            let (growth, h) = averages.corner(element, node);
            let answer = self.model.response(element, a, &h)?;
            let p = dot(&answer.stress, &deformation(&h)) / 3.0;
            part.energy.total += quarter * answer.energy;
            part.pressure[a] = quarter * p;
            add_scaled(&mut part.stress, 0.25 * (1.0 + growth), &answer.stress);
            add_scaled(&mut part.stress, -0.25 * p, &deformed.inverse);
        }
        Some(part)
    }

    /// Forces of an element's stress on its corners.
    fn nodal_forces(&self, element: usize, stress: &Matrix3) -> [[f64; 3]; 4] {
        let jacobian = &self.geometry.inverse_jacobian[element];
        let volume = self.geometry.volume[element];
        spatial_gradients(&TET4.gradients[0], jacobian)
            .map(|g| stress.map(|row| volume * (row[0] * g[0] + row[1] * g[1] + row[2] * g[2])))
    }

    /// Product of the exact tangent with a direction, as [`super::tangent_product_into`].
    pub(super) fn averaged_product(
        &self,
        patches: &Patches,
        direction: &[f64],
        product: &mut [f64],
    ) -> bool {
        match self.averaged_stress_change(patches, direction) {
            Some(stresses) => {
                let each = stresses.iter().enumerate();
                let forces: Vec<_> =
                    each.map(|(element, stress)| self.nodal_forces(element, stress)).collect();
                self.collect(forces.as_flattened(), product, false);
                true
            }
            None => false,
        }
    }

    /// Change of the element stresses along a direction: every line of the force, differentiated.
    fn averaged_stress_change(&self, patches: &Patches, direction: &[f64]) -> Option<Vec<Matrix3>> {
        let geometry = self.geometry;
        let averages = self.averages(patches, false)?;
        let n = geometry.n_elements();
        let Rates { elements: changes, nodes: means } =
            averages.rates(geometry, patches, direction);
        let mut stresses = vec![[[0.0; 3]; 3]; n];
        let mut pressure = vec![[[0.0; 2]; 4]; n];
        for element in 0..n {
            let deformed = &averages.elements[element];
            let quarter = 0.25 * geometry.volume[element];
            let (dh, theta) = &changes[element];
            let turned = inverse_change(&deformed.inverse, dh);
            for (a, &node) in geometry.nodes_of(element).iter().enumerate() {
                let (growth, h) = averages.corner(element, node);
                let s = 1.0 + growth;
                let f = deformation(&h);
                let stretch = (means[node as usize] - theta) / 3.0;
                let mut df = dh.map(|row| row.map(|v| s * v));
                add_scaled(&mut df, stretch, &f);
                let stress = self.model.response(element, a, &h)?.stress;
                let change = times(&self.model.tangent(element, a, &h)?, &df);
                let p = dot(&stress, &f) / 3.0;
                let dp = (dot(&change, &f) + dot(&stress, &df)) / 3.0;
                add_scaled(&mut stresses[element], 0.25 * s, &change);
                add_scaled(&mut stresses[element], 0.25 * s * stretch, &stress);
                add_scaled(&mut stresses[element], -0.25 * dp, &deformed.inverse);
                add_scaled(&mut stresses[element], -0.25 * p, &turned);
                pressure[element][a] = [quarter * p, quarter * dp];
            }
        }
        let nodal: Vec<[f64; 2]> = (0..means.len())
            .map(|node| {
                let weight = averages.grown_volume(patches, node);
                let [sum, change] =
                    [0, 1].map(|k| sum_around(geometry, node, |e, a| pressure[e][a][k]));
                [sum / weight, (change - sum * means[node]) / weight]
            })
            .collect();
        for element in 0..n {
            let deformed = &averages.elements[element];
            let (dh, theta) = &changes[element];
            let nodes = geometry.nodes_of(element);
            let [sum, change] =
                [0, 1].map(|k| nodes.iter().map(|&node| nodal[node as usize][k]).sum::<f64>());
            let det_f = deformed.det_f();
            let turned = inverse_change(&deformed.inverse, dh);
            add_scaled(&mut stresses[element], det_f * (theta * sum + change), &deformed.inverse);
            add_scaled(&mut stresses[element], det_f * sum, &turned);
        }
        Some(stresses)
    }
}

/// `dG = −G dhᵀ G`
fn inverse_change(inverse: &Matrix3, dh: &Matrix3) -> Matrix3 {
    let mut change = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                for l in 0..3 {
                    change[i][j] -= inverse[i][k] * dh[l][k] * inverse[l][j];
                }
            }
        }
    }
    change
}
