//! Which law, and its shape parameters.

use super::Volumetric;
use crate::error::FemError;

/// A law and its shape parameters, without its small-strain moduli.
///
/// Every law but the bimodular one has the linear response of Young's modulus and Poisson's ratio,
/// so laws can be exchanged. With `I₁, I₂` the invariants of `C`, a bar for the isochoric ones, `λ̄ᵢ` the isochoric
/// principal stretches and `U` a [`Volumetric`] energy of the bulk modulus `K = λ + 2μ/3`:
///
/// | law | energy density |
/// |---|---|
/// | neo-Hookean | `μ/2 (I₁ − 3) − μ ln J + U`, with `λ` in place of `K` |
/// | bimodular | neo-Hookean `+ μ excess Σ ⟨ln λᵢ⟩²`, of the principal stretches |
/// | Mooney–Rivlin | `μ/2 ((1 − share)(Ī₁ − 3) + share (Ī₂ − 3)) + U` |
/// | Yeoh | `c₁ (a + c₂/c₁ a² + c₃/c₁ a³) + U`, `c₁ = μ/2`, `a = Ī₁ − 3` |
/// | Ogden | `Σ 2 μ_p/α_p² (Σ λ̄ᵢ^α_p − 3) + U`, `μ_p` a share of `μ` |
/// | Fung | `μ/(2 b) (exp(b (Ī₁ − 3)) − 1) + U` |
/// | Veronda–Westmann | `μ/b (exp(b (Ī₁ − 3)) − 1) − μ/2 (Ī₂ − 3) + U` |
/// | St. Venant–Kirchhoff | `λ/2 (tr E)² + μ E : E`, `E = (C − I)/2` |
/// | Hooke | the same of `sym h`; small strain, holds at any `h` |
///
/// That is [`Volumetric::Log`] or [`Volumetric::Quadratic`]. With [`Volumetric::Coupled`] `Ī₁ − 3`
/// is `I₁ − 3 − 2 ln J`, `Ī₂ − 3` is `I₂ − 3 − 4 ln J − 2 ln²J`, `λ̄ᵢ^α − 1` is
/// `λᵢ^α − 1 − α ln λᵢ` and `K` is `λ`: the forms that FEBio calls coupled or unconstrained.
///
/// Exponents and rates may be 0: the limit is taken (`α = 0`: logarithmic strains; `b = 0`: no
/// stiffening).
///
/// # Reference
///
/// Curnier, He and Zysset, *Journal of Elasticity* 37, 1994 (bimodular, conewise linear);
/// Holzapfel, *Nonlinear Solid Mechanics*, Wiley, 2000, chapter 6; Veronda and Westmann, *Journal
/// of Biomechanics* 3, 1970.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum LawKind {
    /// Coupled compressible neo-Hookean law.
    #[default]
    NeoHookean,
    /// Stiffer, or softer, where it is stretched than where it is compressed; the moduli of small
    /// strain are those of compression in all directions.
    Bimodular {
        /// What stretched directions have more, over `μ`, dimensionless, above −1.
        excess: f64,
    },
    /// Mooney–Rivlin; polyconvex for a share in `[0, 1]`.
    MooneyRivlin {
        /// `c₀₁ / (c₁₀ + c₀₁)`, dimensionless.
        share: f64,
    },
    /// Yeoh, three terms.
    Yeoh {
        /// `c₂ / c₁`, dimensionless.
        c2_over_c1: f64,
        /// `c₃ / c₁`, dimensionless.
        c3_over_c1: f64,
    },
    /// Ogden with one to three terms; made by [`LawKind::ogden`].
    Ogden(OgdenTerms),
    /// Isotropic exponential law of Fung.
    Fung {
        /// Rate of stiffening, dimensionless, not negative.
        b: f64,
    },
    /// Exponential law of Veronda and Westmann.
    VerondaWestmann {
        /// Rate of stiffening, dimensionless, not negative.
        b: f64,
    },
    /// Linear between `E` and the second Piola–Kirchhoff stress.
    StVenantKirchhoff,
    /// Linear between `sym h` and stress.
    Hooke,
}

/// Exponents and weights of an Ogden law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OgdenTerms {
    n: usize,
    alpha: [f64; 3],
    weight: [f64; 3],
    total: f64,
}

impl OgdenTerms {
    /// Number of terms, 1 to 3.
    pub fn n_terms(&self) -> usize {
        self.n
    }

    /// Exponent and share of the shear modulus, term by term.
    pub fn terms(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        (0..self.n).map(|p| (self.alpha[p], self.weight[p] / self.total))
    }

    /// Sum of the weights as given.
    pub(super) fn total_weight(&self) -> f64 {
        self.total
    }
}

/// A number that the stress of a law depends on.
///
/// Young's modulus is in kPa, all others are dimensionless. Moving Young's modulus or Poisson's
/// ratio keeps the shape of the law, `k₁/μ` included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Parameter {
    /// Young's modulus.
    Young,
    /// Poisson's ratio.
    Poisson,
    /// Excess of a bimodular law.
    Excess,
    /// Share of a Mooney–Rivlin law.
    Share,
    /// Second coefficient of a Yeoh law over its first.
    C2OverC1,
    /// Third coefficient of a Yeoh law over its first.
    C3OverC1,
    /// Exponent of one term of an Ogden law.
    Alpha(usize),
    /// Weight of one term of an Ogden law as given, the others held.
    Weight(usize),
    /// Rate of a Fung or Veronda–Westmann law.
    B,
    /// Fibre stiffness over the shear modulus.
    FibreK1,
    /// Rate of stiffening of the fibres.
    FibreK2,
}

impl LawKind {
    /// Ogden law with exponents `alpha`, negative ones allowed, and `weight`: shares of the shear
    /// modulus, divided by their sum.
    ///
    /// # Errors
    ///
    /// [`FemError::BadLaw`] unless there are one to three finite exponents and as many finite
    /// weights with a positive sum.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::material::LawKind;
    ///
    /// let brain = LawKind::ogden(&[-19.0], &[1.0])?;
    /// assert!(LawKind::ogden(&[2.0, -2.0], &[1.0]).is_err());
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn ogden(alpha: &[f64], weight: &[f64]) -> Result<Self, FemError> {
        let n = alpha.len();
        let refuse = |name, must, found| Err(FemError::BadLaw { name, must, found });
        if !(1..=3).contains(&n) {
            return refuse("alpha", "a list of one to three exponents", n as f64);
        }
        if weight.len() != n {
            return refuse("weight", "a list as long as `alpha`", weight.len() as f64);
        }
        for &v in alpha {
            finite("alpha", v)?;
        }
        for &v in weight {
            finite("weight", v)?;
        }
        let total: f64 = weight.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return refuse("weight", "of positive sum", total);
        }
        let padded =
            |values: &[f64]| std::array::from_fn(|p| values.get(p).copied().unwrap_or(0.0));
        Ok(Self::Ogden(OgdenTerms { n, alpha: padded(alpha), weight: padded(weight), total }))
    }

    /// Shape parameters of the law.
    pub fn parameters(&self) -> Vec<Parameter> {
        match self {
            Self::NeoHookean | Self::StVenantKirchhoff | Self::Hooke => vec![],
            Self::Bimodular { .. } => vec![Parameter::Excess],
            Self::MooneyRivlin { .. } => vec![Parameter::Share],
            Self::Yeoh { .. } => vec![Parameter::C2OverC1, Parameter::C3OverC1],
            Self::Ogden(terms) => (0..terms.n)
                .map(Parameter::Alpha)
                .chain((0..terms.n).map(Parameter::Weight))
                .collect(),
            Self::Fung { .. } | Self::VerondaWestmann { .. } => vec![Parameter::B],
        }
    }

    /// Whether this is the neo-Hookean law with a logarithmic volumetric energy, which is coupled
    /// as it stands.
    #[inline(always)]
    pub(super) fn is_plain(&self, volumetric: Volumetric) -> bool {
        matches!(self, Self::NeoHookean) && volumetric != Volumetric::Quadratic
    }

    /// Check the shape parameters and the volumetric energy.
    pub(super) fn check(&self, volumetric: Volumetric) -> Result<(), FemError> {
        match *self {
            Self::NeoHookean | Self::Ogden(_) => Ok(()),
            Self::Bimodular { excess } => match excess.is_finite() && excess > -1.0 {
                true => Ok(()),
                false => Err(FemError::BadLaw { name: "excess", must: "above -1", found: excess }),
            },
            Self::MooneyRivlin { share } => finite("share", share),
            Self::Yeoh { c2_over_c1, c3_over_c1 } => {
                finite("c2_over_c1", c2_over_c1)?;
                finite("c3_over_c1", c3_over_c1)
            }
            Self::Fung { b } | Self::VerondaWestmann { b } => not_negative("b", b),
            Self::StVenantKirchhoff | Self::Hooke if volumetric != Volumetric::Log => {
                Err(FemError::BadLaw {
                    name: "volumetric",
                    must: "left out: this law has no volumetric energy of its own",
                    found: f64::from(volumetric as u8),
                })
            }
            Self::StVenantKirchhoff | Self::Hooke => Ok(()),
        }
    }
}

pub(super) fn finite(name: &'static str, found: f64) -> Result<(), FemError> {
    match found.is_finite() {
        true => Ok(()),
        false => Err(FemError::BadLaw { name, must: "finite", found }),
    }
}

pub(super) fn not_negative(name: &'static str, found: f64) -> Result<(), FemError> {
    match found.is_finite() && found >= 0.0 {
        true => Ok(()),
        false => Err(FemError::BadLaw { name, must: "finite and not negative", found }),
    }
}
