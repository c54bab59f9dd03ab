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

use super::averaged_neo_hookean as plain;
use super::averages::{
    Averages, Part, Rates, add_scaled, all, averages, deformation, dot, sum_around, times,
};
use super::loops::{Energy, Loops, PointModel, spatial_gradients};
use crate::element::{Patches, TET4};
use crate::material::Matrix3;

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
