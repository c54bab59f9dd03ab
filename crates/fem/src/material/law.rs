//! A law with its numbers at one point.

use super::kinematics::Kinematics;
use super::tensor::{add, all_finite};
use super::{
    Fibre, Hyperelastic, LawKind, Matrix3, NeoHookean, Parameter, Response, Tangent, Volumetric,
    bimodular, det_f_minus_one, linear,
};

/// A law, its moduli and its fibres at one point.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::material::{Hyperelastic, LawKind, Parameter};
/// use tissuereg_fem::Material;
///
/// let material = Material::neo_hookean(3.0, 0.3)?.with_law(LawKind::Fung { b: 5.0 })?;
/// let law = material.law_at(0, 0);
/// let mut h = [[0.0; 3]; 3];
/// h[0][1] = 0.5;
/// let (Some(p), Some(by_young)) = (law.stress(&h), law.stress_by(&h, Parameter::Young)) else {
///     return Ok(());
/// };
/// assert!((by_young[0][1] - p[0][1] / 3.0).abs() < 1e-12);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Law {
    /// Lamé constants of small strain, as a law of their own.
    pub moduli: NeoHookean,
    /// Which law, and its shape.
    pub kind: LawKind,
    /// Energy of volume change.
    pub volumetric: Volumetric,
    /// Fibres, if any.
    pub fibre: Option<Fibre>,
}

impl From<NeoHookean> for Law {
    fn from(moduli: NeoHookean) -> Self {
        let (kind, volumetric) = (LawKind::NeoHookean, Volumetric::Log);
        Self { moduli, kind, volumetric, fibre: None }
    }
}

impl Law {
    /// Derivative `∂P/∂parameter` at a fixed displacement gradient: kPa over the unit of the
    /// parameter. Zero for a parameter that the law does not have; none where it has no stress.
    pub fn stress_by(&self, h: &Matrix3, parameter: Parameter) -> Option<Matrix3> {
        self.response_by(h, parameter).map(|(_, stress)| stress)
    }

    /// Derivatives `(∂ψ/∂parameter, ∂P/∂parameter)` at a fixed displacement gradient, as
    /// [`stress_by`](Self::stress_by).
    pub fn response_by(&self, h: &Matrix3, parameter: Parameter) -> Option<(f64, Matrix3)> {
        // Energy and stress are linear in the two moduli, and the shape parameters leave them alone.
        let moduli = match parameter {
            Parameter::Young => self.moduli.by_young(),
            Parameter::Poisson => self.moduli.by_poisson(),
            _ => return self.response_by_shape(h, parameter),
        };
        Self { moduli, ..*self }.response(h).map(|answer| (answer.energy, answer.stress))
    }

    fn response_by_shape(&self, h: &Matrix3, parameter: Parameter) -> Option<(f64, Matrix3)> {
        let k = match Kinematics::new(h) {
            Some(k) => k,
            None if self.holds_at_any_h() && all_finite(h) => return Some((0.0, [[0.0; 3]; 3])),
            None => return None,
        };
        let (energy, stress) = match (parameter, self.kind, self.fibre) {
            (Parameter::FibreK1, _, Some(fibre)) => {
                Fibre { k1_over_mu: 1.0, ..fibre }.response(h, &k)
            }
            (Parameter::FibreK2, _, Some(fibre)) => fibre.response_by_k2(h, &k),
            (Parameter::Shape { name: "excess", .. }, LawKind::Bimodular { .. }, _) => {
                bimodular::response(h)
            }
            (Parameter::Shape { name: "alpha", term }, LawKind::Ogden(terms), _) => {
                terms.response_by_alpha(term, self.volumetric, h, &k)
            }
            (Parameter::Shape { name: "weight", term }, LawKind::Ogden(terms), _) => {
                terms.response_by_weight(term, self.volumetric, h, &k)
            }
            (Parameter::Shape { name, .. }, kind, _) => match kind.place_of(name) {
                Some(nth) => kind.invariant_response_by(nth, self.volumetric, h, &k),
                None => (0.0, [[0.0; 3]; 3]),
            },
            _ => (0.0, [[0.0; 3]; 3]),
        };
        let stress = stress.map(|row| row.map(|v| self.moduli.mu * v));
        let energy = self.moduli.mu * energy;
        (energy.is_finite() && all_finite(&stress)).then_some((energy, stress))
    }

    /// The law that is worth a path of its own.
    #[inline(always)]
    fn is_plain(&self) -> bool {
        self.kind.is_plain(self.volumetric) && self.fibre.is_none()
    }

    fn holds_at_any_h(&self) -> bool {
        matches!(self.kind, LawKind::Hooke) && self.fibre.is_none()
    }

    fn volumetric_modulus(&self) -> f64 {
        match self.kind {
            LawKind::NeoHookean | LawKind::Bimodular { .. } => self.moduli.lambda,
            LawKind::StVenantKirchhoff | LawKind::Hooke => 0.0,
            _ if self.volumetric.splits() => self.moduli.bulk(),
            _ => self.moduli.lambda,
        }
    }

    /// Energy and stress of the law without volumetric part and fibres.
    fn matrix_response(&self, h: &Matrix3, k: &Kinematics) -> Option<(f64, Matrix3)> {
        let mu = self.moduli.mu;
        let scaled =
            |(energy, stress): (f64, Matrix3)| (mu * energy, stress.map(|row| row.map(|v| mu * v)));
        match self.kind {
            LawKind::NeoHookean => {
                let answer = NeoHookean { mu, lambda: 0.0 }.response(h)?;
                Some((answer.energy, answer.stress))
            }
            LawKind::Bimodular { excess } => {
                let answer = NeoHookean { mu, lambda: 0.0 }.response(h)?;
                let (energy, mut stress) = bimodular::response(h);
                stress = stress.map(|row| row.map(|v| mu * excess * v));
                add(&mut stress, 1.0, &answer.stress);
                Some((answer.energy + mu * excess * energy, stress))
            }
            LawKind::Ogden(terms) => Some(scaled(terms.response(self.volumetric, h, k))),
            LawKind::StVenantKirchhoff => Some(linear::st_venant_response(&self.moduli, h)),
            LawKind::Hooke => Some(linear::hooke_response(&self.moduli, h)),
            _ => self.kind.invariant_response(self.volumetric, h, k).map(scaled),
        }
    }

    #[inline(never)]
    fn full_response(&self, h: &Matrix3) -> Option<Response> {
        let Some(k) = Kinematics::new(h) else {
            let (energy, stress) = linear::hooke_response(&self.moduli, h);
            let sound = self.holds_at_any_h() && energy.is_finite() && all_finite(&stress);
            return sound.then(|| Response { energy, stress, det_f: 1.0 + det_f_minus_one(h) });
        };
        let (mut energy, mut stress) = self.matrix_response(h, &k)?;
        let modulus = self.volumetric_modulus();
        if modulus != 0.0 {
            energy += modulus * self.volumetric.energy(&k);
            self.volumetric.add_stress(modulus, h, &k, &mut stress);
        }
        if let Some(fibre) = self.fibre {
            let (of_fibre, pull) = fibre.response(h, &k);
            energy += self.moduli.mu * of_fibre;
            add(&mut stress, self.moduli.mu, &pull);
        }
        let sound = energy.is_finite() && all_finite(&stress);
        sound.then_some(Response { energy, stress, det_f: k.det_f })
    }

    #[inline(never)]
    fn full_tangent(&self, h: &Matrix3) -> Option<Tangent> {
        let mut tangent = [[0.0; 9]; 9];
        let Some(k) = Kinematics::new(h) else {
            linear::add_hooke_tangent(&self.moduli, &mut tangent);
            return (self.holds_at_any_h() && all_finite(h)).then_some(tangent);
        };
        let mu = self.moduli.mu;
        match self.kind {
            LawKind::NeoHookean => tangent = NeoHookean { mu, lambda: 0.0 }.tangent(h)?,
            LawKind::Bimodular { excess } => {
                tangent = NeoHookean { mu, lambda: 0.0 }.tangent(h)?;
                bimodular::add_tangent(mu * excess, h, &mut tangent);
            }
            LawKind::Ogden(terms) => terms.add_tangent(mu, self.volumetric, h, &k, &mut tangent),
            LawKind::StVenantKirchhoff => {
                linear::add_st_venant_tangent(&self.moduli, h, &mut tangent);
            }
            LawKind::Hooke => linear::add_hooke_tangent(&self.moduli, &mut tangent),
            _ => self.kind.add_invariant_tangent(mu, self.volumetric, h, &k, &mut tangent)?,
        }
        let modulus = self.volumetric_modulus();
        if modulus != 0.0 {
            self.volumetric.add_tangent(modulus, h, &k, &mut tangent);
        }
        if let Some(fibre) = self.fibre {
            fibre.add_tangent(mu, h, &k, &mut tangent);
        }
        tangent.as_flattened().iter().all(|v| v.is_finite()).then_some(tangent)
    }
}

impl Hyperelastic for Law {
    fn energy(&self, h: &Matrix3) -> Option<f64> {
        self.response(h).map(|answer| answer.energy)
    }

    fn stress(&self, h: &Matrix3) -> Option<Matrix3> {
        self.response(h).map(|answer| answer.stress)
    }

    #[inline]
    fn tangent(&self, h: &Matrix3) -> Option<Tangent> {
        if self.is_plain() { self.moduli.tangent(h) } else { self.full_tangent(h) }
    }

    #[inline(always)]
    fn response(&self, h: &Matrix3) -> Option<Response> {
        if self.is_plain() { self.moduli.response(h) } else { self.full_response(h) }
    }
}
