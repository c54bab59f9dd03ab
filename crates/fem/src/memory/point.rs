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

use super::behaviour::SofteningForm;
use super::common::{Common, PointStep, Weights};
use super::layout::set_matrix;
use super::softening::Softened;
use super::tensor::{
    ZERO, add_scaled, contracted, det_f_minus_one, green_strain, inverse_transposed,
    log_strain_beyond, minus, plus_identity, plus_scalar, product, scaled, spectral, transposed,
};
use crate::material::{Matrix3, Response, Tangent};

impl Common {
    /// The tangent of `Ψ`, from law and tangent of the law at a gradient.
    pub(super) fn tangent(
        &self,
        at: &PointStep,
        h: &Matrix3,
        law: impl Fn(&Matrix3) -> Option<Response>,
        law_tangent: impl Fn(&Matrix3) -> Option<Tangent>,
    ) -> Option<Tangent> {
        let he = at.elastic_gradient(h);
        let mut tangent = self.elastic_tangent(at, &he, law, law_tangent)?;
        if let Some(pull) = &at.pull {
            tangent = pulled(&tangent, pull);
        }
        let volume = self.stretch.powi(3);
        tangent.iter_mut().flatten().for_each(|v| *v *= volume);
        add_memory_tangent(at, h, &mut tangent);
        Some(tangent)
    }

    fn elastic_tangent(
        &self,
        at: &PointStep,
        he: &Matrix3,
        law: impl Fn(&Matrix3) -> Option<Response>,
        law_tangent: impl Fn(&Matrix3) -> Option<Tangent>,
    ) -> Option<Tangent> {
        let weights = self.weights;
        let mut tangent = law_tangent(he)?;
        if self.softens(SofteningForm::Damage) {
            let whole = law(he)?;
            let damaged = self.softened(SofteningForm::Damage, whole.energy, at);
            scale(&mut tangent, weights.of_whole(damaged.slope));
            add_dyad(&mut tangent, weights.isochoric * damaged.curvature, &whole.stress);
        } else {
            scale(&mut tangent, weights.volumetric);
        }
        if !self.split {
            return Some(tangent);
        }
        let (j, bar) = bar_gradient(he);
        let (own, own_tangent) = (law(&bar)?, law_tangent(&bar)?);
        let stress = isochoric_stress(&own.stress, he, j);
        let iso = isochoric_tangent(&own.stress, &own_tangent, &stress, he, j);
        let softened = self.softened(SofteningForm::OgdenRoxburgh, own.energy, at);
        let slope = weights.isochoric * softened.slope - weights.volumetric;
        for (row, of_iso) in tangent.iter_mut().zip(&iso) {
            row.iter_mut().zip(of_iso).for_each(|(v, w)| *v += slope * w);
        }
        add_dyad(&mut tangent, weights.isochoric * softened.curvature, &stress);
        Some(tangent)
    }
}

/// The law at an elastic gradient, whole and of the isochoric part.
pub(super) struct Parts {
    whole: Response,
    /// What damage leaves of the whole energy.
    damaged: Softened,
    /// Where the parts have to be separated.
    isochoric: Option<Isochoric>,
}

struct Isochoric {
    energy: f64,
    stress: Matrix3,
    softened: Softened,
}

impl Parts {
    /// The energy of which the largest so far softens, kPa: `ψ` for damage, otherwise `ψ_iso`.
    pub(super) fn softening_energy(&self, form: SofteningForm) -> f64 {
        match (form, &self.isochoric) {
            (SofteningForm::OgdenRoxburgh, Some(isochoric)) => isochoric.energy,
            _ => self.whole.energy,
        }
    }

    /// Energy and stress `a_vol (ψ − ψ_iso) + a_iso (φ(ψ_iso) + φ(ψ) − ψ)`; one `φ` softens at most.
    fn weighted(&self, weights: Weights) -> Response {
        let mut stress = scaled(weights.of_whole(self.damaged.slope), &self.whole.stress);
        let mut energy = weights.volumetric * self.whole.energy
            + weights.isochoric * (self.damaged.energy - self.whole.energy);
        if let Some(iso) = &self.isochoric {
            let slope = weights.isochoric * iso.softened.slope - weights.volumetric;
            add_scaled(&mut stress, slope, &iso.stress);
            energy =
                energy + weights.isochoric * iso.softened.energy - weights.volumetric * iso.energy;
        }
        Response { energy, stress, det_f: self.whole.det_f }
    }
}

impl Common {
    /// The law at a displacement gradient.
    pub(super) fn parts(
        &self,
        at: &PointStep,
        h: &Matrix3,
        law: impl Fn(&Matrix3) -> Option<Response>,
    ) -> Option<Parts> {
        let he = at.elastic_gradient(h);
        let whole = law(&he)?;
        let isochoric = match self.split {
            true => {
                let (j, bar) = bar_gradient(&he);
                let iso = law(&bar)?;
                let stress = isochoric_stress(&iso.stress, &he, j);
                let softened = self.softened(SofteningForm::OgdenRoxburgh, iso.energy, at);
                Some(Isochoric { energy: iso.energy, stress, softened })
            }
            false => None,
        };
        let damaged = self.softened(SofteningForm::Damage, whole.energy, at);
        Some(Parts { whole, damaged, isochoric })
    }

    /// The first line of `Ψ` and its stress with other weights of its parts.
    pub(super) fn stored(
        &self,
        at: &PointStep,
        h: &Matrix3,
        parts: &Parts,
        weights: Weights,
    ) -> Response {
        let Response { energy, mut stress, mut det_f } = parts.weighted(weights);
        if let Some(pull) = &at.pull {
            stress = product(&stress, &transposed(pull));
            det_f = 1.0 + det_f_minus_one(h);
        }
        let volume = self.stretch * self.stretch * self.stretch;
        Response { energy: volume * energy, stress: scaled(volume, &stress), det_f }
    }

    /// `Ψ` and its stress.
    pub(super) fn response(
        &self,
        at: &PointStep,
        h: &Matrix3,
        law: impl Fn(&Matrix3) -> Option<Response>,
    ) -> Option<Response> {
        Some(self.response_of(at, h, &self.parts(at, h, law)?))
    }

    /// The same from the law at the gradient.
    pub(super) fn response_of(&self, at: &PointStep, h: &Matrix3, parts: &Parts) -> Response {
        self.with_memory(at, h, self.stored(at, h, parts, self.weights))
    }

    /// With what is remembered and what flows: the second line of `Ψ`.
    fn with_memory(&self, at: &PointStep, h: &Matrix3, mut answer: Response) -> Response {
        if at.history_stress.is_none() && at.flow.is_none() {
            return answer;
        }
        let strain = green_strain(h);
        let mut stress = ZERO;
        if let Some(remembered) = &at.history_stress {
            answer.energy += contracted(remembered, &strain);
            stress = *remembered;
        }
        if let Some(flow) = &at.flow {
            let change = minus(&strain, &flow.strain);
            let viscous = product(&product(&flow.inverse_metric, &change), &flow.inverse_metric);
            let viscous = scaled(flow.factor, &viscous);
            answer.energy += 0.5 * contracted(&viscous, &change);
            add_scaled(&mut stress, 1.0, &viscous);
        }
        let first = product(&plus_identity(h), &stress);
        add_scaled(&mut answer.stress, 1.0, &first);
        answer
    }
}

impl Common {
    /// End the step of a point at a displacement gradient; none where it is inverted.
    pub(super) fn update(
        &self,
        at: &PointStep,
        h: &Matrix3,
        law: impl Fn(&Matrix3) -> Option<Response>,
        row: &mut [f64],
    ) -> Option<()> {
        if self.layout.remembers() || self.softening.is_some() {
            self.update_stresses(at, h, &self.parts(at, h, law)?, row);
        }
        self.update_strains(h, row);
        Some(())
    }

    /// The part of [`update`](Self::update) that depends on the law, from the law at the gradient.
    pub(super) fn update_stresses(
        &self,
        at: &PointStep,
        h: &Matrix3,
        parts: &Parts,
        row: &mut [f64],
    ) {
        if self.layout.remembers() {
            let inverse = transposed(&inverse_transposed(&plus_identity(h)));
            let second = |volumetric: f64, isochoric: f64| {
                let weights = Weights { volumetric, isochoric };
                product(&inverse, &self.stored(at, h, parts, weights).stress)
            };
            let weights = [(1.0, if self.split { 0.0 } else { 1.0 }), (0.0, 1.0)];
            let places = self.decays.iter().zip(&self.layout.series);
            for ((decay, place), (volumetric, isochoric)) in places.zip(weights) {
                if let Some(place) = place {
                    decay.update(&mut row[place.clone()], &second(volumetric, isochoric));
                }
            }
        }
        if let Some((softening, place)) = self.softening.as_ref().zip(self.layout.largest_energy) {
            row[place] = row[place].max(parts.softening_energy(softening.form));
        }
    }

    /// The part of [`update`](Self::update) that does not depend on the law.
    pub(super) fn update_strains(&self, h: &Matrix3, row: &mut [f64]) {
        if let Some((place, fraction)) = self.layout.set.zip(self.set) {
            let strain = log_strain_beyond(row[place].sqrt(), &self.without_swelling(h));
            if let Some((values, axes)) = strain {
                let square: f64 = values.iter().map(|value| value * value).sum();
                if square > row[place] && square.is_finite() {
                    row[place] = square;
                    let back = values.map(|value| (-fraction * value).exp());
                    set_matrix(row, place + 1, &spectral(&back, &axes));
                }
            }
        }
        if let Some(first) = self.layout.gradient {
            set_matrix(row, first, h);
        }
    }
}

/// `j`, and `F̄ − I = j h + (j − 1) I`.
fn bar_gradient(h: &Matrix3) -> (f64, Matrix3) {
    let x = det_f_minus_one(h);
    let less = (-x.ln_1p() / 3.0).exp_m1();
    (1.0 + less, plus_scalar(&scaled(1.0 + less, h), less))
}

fn isochoric_stress(law_stress: &Matrix3, h: &Matrix3, j: f64) -> Matrix3 {
    let f = plus_identity(h);
    let mean = contracted(law_stress, &f) / 3.0;
    let mut stress = scaled(j, law_stress);
    add_scaled(&mut stress, -j * mean, &inverse_transposed(&f));
    stress
}

fn isochoric_tangent(
    law_stress: &Matrix3,
    law_tangent: &Tangent,
    iso_stress: &Matrix3,
    h: &Matrix3,
    j: f64,
) -> Tangent {
    let f = plus_identity(h);
    let g = inverse_transposed(&f);
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

/// Add `factor · stress ⊗ stress`.
fn add_dyad(tangent: &mut Tangent, factor: f64, stress: &Matrix3) {
    for (a, row) in tangent.iter_mut().enumerate() {
        for (b, v) in row.iter_mut().enumerate() {
            *v += factor * stress[a / 3][a % 3] * stress[b / 3][b % 3];
        }
    }
}

impl PointStep {
    /// `Fe − I = h A + (A − I)`
    fn elastic_gradient(&self, h: &Matrix3) -> Matrix3 {
        let Some(pull) = &self.pull else { return *h };
        let mut he = plus_scalar(pull, -1.0);
        add_scaled(&mut he, 1.0, &product(h, pull));
        he
    }
}

/// Its tangent: `δ_im S_nl`, and for what flows `½ c ((F B Fᵀ)_im B_nl + (F B)_in (F B)_ml)`.
fn add_memory_tangent(at: &PointStep, h: &Matrix3, tangent: &mut Tangent) {
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
