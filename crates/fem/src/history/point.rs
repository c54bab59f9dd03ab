//! A point within a time step: energy, stress and tangent of `Ψ`, once for all laws.
//!
//! With `G = F⁻ᵀ`, `j = J^(−1/3)` and `P̄`, `Ā` stress and tangent of the law at `F̄ = j F`, the
//! isochoric energy `ψ_iso(F) = ψ(F̄)` has
//!
//! ```text
//! P_iso = j (P̄ − ⅓ (P̄ : F) G)
//! A_iso[kl,mn] = (Qᵀ Ā Q)[kl,mn] − ⅓ P_iso[kl] G[mn] − j/3 G[kl] P̄[mn] + j/3 (P̄ : F) G[kn] G[ml]
//! Q[pq,kl] = j (δ_pk δ_ql − ⅓ F[pq] G[kl])
//! ```
//!
//! and `Fe = F A` with a constant `A` gives `P = s³ P_e Aᵀ`.

use super::softening::Softened;
use super::state::{PointStep, StepState, Weights};
use super::tensor::{
    ZERO, add_scaled, contracted, green_strain, inverse_transposed, plus_identity, product,
    transposed,
};
use crate::assembly::PointModel;
use crate::material::{Matrix3, Response, Tangent, det_f_minus_one};

/// A time step of a body as the element loops see it.
#[derive(Debug)]
pub(crate) struct StepModel<'a, M> {
    /// The law at every point.
    pub(super) elastic: &'a M,
    /// What holds within the step.
    pub(super) step: &'a StepState,
}

impl<M: PointModel> PointModel for StepModel<'_, M> {
    fn response(&self, element: usize, point: usize, h: &Matrix3) -> Option<Response> {
        let at = self.step.at(element, point);
        let elastic = |he: &Matrix3| self.elastic.response(element, point, he);
        let mut answer = self
            .step
            .stored(at, h, |he| weighted(elastic, he, self.step.weights, at, self.step))?;
        self.step.add_memory(at, h, &mut answer);
        Some(answer)
    }

    fn tangent(&self, element: usize, point: usize, h: &Matrix3) -> Option<Tangent> {
        let at = self.step.at(element, point);
        let he = at.elastic_gradient(h);
        let mut tangent = self.elastic_tangent(element, point, &he, at)?;
        if let Some(pull) = &at.pull {
            tangent = pulled(&tangent, pull);
        }
        let volume = self.step.stretch.powi(3);
        tangent.iter_mut().flatten().for_each(|v| *v *= volume);
        self.step.add_memory_tangent(at, h, &mut tangent);
        Some(tangent)
    }
}

impl<M: PointModel> StepModel<'_, M> {
    fn elastic_tangent(
        &self,
        element: usize,
        point: usize,
        he: &Matrix3,
        at: &PointStep,
    ) -> Option<Tangent> {
        let weights = self.step.weights;
        let mut tangent = self.elastic.tangent(element, point, he)?;
        scale(&mut tangent, weights.volumetric);
        if !self.step.is_split() {
            return Some(tangent);
        }
        let bar = bar_gradient(he);
        let law = self.elastic.response(element, point, &bar)?;
        let law_tangent = self.elastic.tangent(element, point, &bar)?;
        let stress = isochoric_stress(&law.stress, he);
        let iso = isochoric_tangent(&law.stress, &law_tangent, &stress, he);
        let softened = self.step.softened(law.energy, at);
        let slope = weights.isochoric * softened.slope - weights.volumetric;
        let curvature = weights.isochoric * softened.curvature;
        for a in 0..9 {
            for b in 0..9 {
                tangent[a][b] +=
                    slope * iso[a][b] + curvature * stress[a / 3][a % 3] * stress[b / 3][b % 3];
            }
        }
        Some(tangent)
    }
}

/// Energy and stress `a_vol (ψ − ψ_iso) + a_iso φ(ψ_iso)` at an elastic gradient.
pub(super) fn weighted(
    law: impl Fn(&Matrix3) -> Option<Response>,
    he: &Matrix3,
    weights: Weights,
    at: &PointStep,
    step: &StepState,
) -> Option<Response> {
    let whole = law(he)?;
    let mut stress = ZERO;
    add_scaled(&mut stress, weights.volumetric, &whole.stress);
    if !step.is_split() {
        let energy = weights.volumetric * whole.energy;
        return Some(Response { energy, stress, det_f: whole.det_f });
    }
    let iso = law(&bar_gradient(he))?;
    let Softened { energy, slope, .. } = step.softened(iso.energy, at);
    let iso_stress = isochoric_stress(&iso.stress, he);
    add_scaled(&mut stress, weights.isochoric * slope - weights.volumetric, &iso_stress);
    let energy = weights.volumetric * (whole.energy - iso.energy) + weights.isochoric * energy;
    Some(Response { energy, stress, det_f: whole.det_f })
}

/// `F̄ − I = j h + (j − 1) I`
pub(super) fn bar_gradient(h: &Matrix3) -> Matrix3 {
    let less = (-det_f_minus_one(h).ln_1p() / 3.0).exp_m1();
    let mut bar = h.map(|row| row.map(|v| (1.0 + less) * v));
    for i in 0..3 {
        bar[i][i] += less;
    }
    bar
}

fn isochoric_stress(law_stress: &Matrix3, h: &Matrix3) -> Matrix3 {
    let f = plus_identity(h);
    let j = (1.0 + det_f_minus_one(h)).cbrt().recip();
    let mean = contracted(law_stress, &f) / 3.0;
    let mut stress = ZERO;
    add_scaled(&mut stress, j, law_stress);
    add_scaled(&mut stress, -j * mean, &inverse_transposed(&f));
    stress
}

fn isochoric_tangent(
    law_stress: &Matrix3,
    law_tangent: &Tangent,
    iso_stress: &Matrix3,
    h: &Matrix3,
) -> Tangent {
    let f = plus_identity(h);
    let g = inverse_transposed(&f);
    let j = (1.0 + det_f_minus_one(h)).cbrt().recip();
    let mean = contracted(law_stress, &f) / 3.0;
    let (flat_f, flat_g) = (f.as_flattened(), g.as_flattened());
    // Ā Q, then Qᵀ (Ā Q): Q takes a third of the F direction off along G.
    let mut half = *law_tangent;
    for row in &mut half {
        let along: f64 = row.iter().zip(flat_f).map(|(a, f)| a * f).sum::<f64>() / 3.0;
        row.iter_mut().zip(flat_g).for_each(|(a, g)| *a = j * (*a - along * g));
    }
    let mut tangent = half;
    for column in 0..9 {
        let along = (0..9).map(|row| flat_f[row] * half[row][column]).sum::<f64>() / 3.0;
        for row in 0..9 {
            tangent[row][column] = j * (half[row][column] - along * flat_g[row]);
        }
    }
    for (k, l) in (0..9).map(|kl| (kl / 3, kl % 3)) {
        for (m, n) in (0..9).map(|mn| (mn / 3, mn % 3)) {
            tangent[3 * k + l][3 * m + n] += -iso_stress[k][l] * g[m][n] / 3.0
                - j / 3.0 * g[k][l] * law_stress[m][n]
                + j * mean * g[k][n] * g[m][l];
        }
    }
    tangent
}

/// `A[ik,ln] = A_e[ij,lm] A[k][j] A[n][m]` (all of `P_e Aᵀ`).
fn pulled(tangent: &Tangent, pull: &Matrix3) -> Tangent {
    let mut half = [[0.0; 9]; 9];
    for ij in 0..9 {
        for (l, n) in (0..9).map(|ln| (ln / 3, ln % 3)) {
            half[ij][3 * l + n] = (0..3).map(|m| tangent[ij][3 * l + m] * pull[n][m]).sum();
        }
    }
    let mut out = [[0.0; 9]; 9];
    for (i, k) in (0..9).map(|ik| (ik / 3, ik % 3)) {
        for ln in 0..9 {
            out[3 * i + k][ln] = (0..3).map(|j| half[3 * i + j][ln] * pull[k][j]).sum();
        }
    }
    out
}

fn scale(tangent: &mut Tangent, factor: f64) {
    tangent.iter_mut().flatten().for_each(|v| *v *= factor);
}

impl PointStep {
    /// `Fe − I = h A + (A − I)`
    pub(super) fn elastic_gradient(&self, h: &Matrix3) -> Matrix3 {
        let Some(pull) = &self.pull else { return *h };
        let mut he = product(h, pull);
        for i in 0..3 {
            for j in 0..3 {
                he[i][j] += pull[i][j] - if i == j { 1.0 } else { 0.0 };
            }
        }
        he
    }
}

impl StepState {
    /// The first line of `Ψ` and its stress, from an elastic answer at `Fe`.
    pub(super) fn stored(
        &self,
        at: &PointStep,
        h: &Matrix3,
        elastic: impl FnOnce(&Matrix3) -> Option<Response>,
    ) -> Option<Response> {
        let mut answer = elastic(&at.elastic_gradient(h))?;
        if let Some(pull) = &at.pull {
            answer.stress = product(&answer.stress, &transposed(pull));
            answer.det_f = 1.0 + det_f_minus_one(h);
        }
        let volume = self.stretch.powi(3);
        answer.energy *= volume;
        answer.stress.iter_mut().flatten().for_each(|v| *v *= volume);
        Some(answer)
    }

    /// Add what is remembered and what flows: the second line of `Ψ`.
    fn add_memory(&self, at: &PointStep, h: &Matrix3, answer: &mut Response) {
        let strain = green_strain(h);
        let mut stress = ZERO;
        if let Some(remembered) = &at.history_stress {
            answer.energy += contracted(remembered, &strain);
            stress = *remembered;
        }
        if let Some(flow) = &at.flow {
            let mut change = strain;
            add_scaled(&mut change, -1.0, &flow.strain);
            let mut viscous =
                product(&product(&flow.inverse_metric, &change), &flow.inverse_metric);
            viscous.iter_mut().flatten().for_each(|v| *v *= flow.factor);
            answer.energy += 0.5 * contracted(&viscous, &change);
            add_scaled(&mut stress, 1.0, &viscous);
        }
        if at.history_stress.is_some() || at.flow.is_some() {
            let first = product(&plus_identity(h), &stress);
            add_scaled(&mut answer.stress, 1.0, &first);
        }
    }

    /// Its tangent: `δ_im S_nl`, and for what flows `½ c ((F B Fᵀ)_im B_nl + (F B)_in (F B)_ml)`.
    fn add_memory_tangent(&self, at: &PointStep, h: &Matrix3, tangent: &mut Tangent) {
        let mut stress = at.history_stress.unwrap_or(ZERO);
        let f = plus_identity(h);
        if let Some(flow) = &at.flow {
            let b = &flow.inverse_metric;
            let mut change = green_strain(h);
            add_scaled(&mut change, -1.0, &flow.strain);
            add_scaled(&mut stress, flow.factor, &product(&product(b, &change), b));
            let fb = product(&f, b);
            let fbf = product(&fb, &transposed(&f));
            for (i, l) in (0..9).map(|il| (il / 3, il % 3)) {
                for (m, n) in (0..9).map(|mn| (mn / 3, mn % 3)) {
                    tangent[3 * i + l][3 * m + n] +=
                        0.5 * flow.factor * (fbf[i][m] * b[n][l] + fb[i][n] * fb[m][l]);
                }
            }
        }
        if at.history_stress.is_some() || at.flow.is_some() {
            for i in 0..3 {
                for l in 0..3 {
                    for n in 0..3 {
                        tangent[3 * i + l][3 * i + n] += stress[n][l];
                    }
                }
            }
        }
    }
}
