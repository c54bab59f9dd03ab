//! Which law, and its shape parameters: the catalogue of laws.

use std::fmt;

use super::declaration::{Declaration, Range, ShapeParameter, Slopes};
use super::{Volumetric, laws};
use crate::error::FemError;

/// Writes [`LawKind`] and how its laws in invariants are reached, each in a match of its own: the
/// element loops know the law before they begin.
macro_rules! catalogue {
    (
        $(#[$doc:meta])*
        special { $($special:tt)* }
        invariants { $(
            $(#[$law_doc:meta])*
            $law:ident in $module:ident { $( $(#[$field_doc:meta])* $field:ident ),* $(,)? }
        )* }
    ) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Default)]
        #[non_exhaustive]
        pub enum LawKind {
            $($special)*
            $( $(#[$law_doc])* $law { $( $(#[$field_doc])* $field: f64 ),* }, )*
        }

        /// Laws in invariants, as they declare themselves.
        const IN_INVARIANTS: &[Declaration] = &[ $( laws::$module::DECLARATION ),* ];

        impl LawKind {
            /// The law in invariants of a name, if there is one and the numbers are as many as its
            /// shape parameters.
            fn in_invariants(name: &str, numbers: &[f64]) -> Option<Self> {
                $( if name == laws::$module::DECLARATION.name {
                    let &[ $($field),* ] = numbers else { return None };
                    return Some(Self::$law { $($field),* });
                } )*
                None
            }

            /// The declaration of a law in invariants.
            fn declared_in_invariants(&self) -> Option<Declaration> {
                match self {
                    $( Self::$law { .. } => Some(laws::$module::DECLARATION), )*
                    _ => None,
                }
            }

            /// Shape parameters of a law in invariants.
            fn numbers_in_invariants(&self) -> Vec<f64> {
                match *self {
                    $( Self::$law { $($field),* } => vec![ $($field),* ], )*
                    _ => vec![],
                }
            }

            /// None for a law that is not one in invariants.
            #[inline(always)]
            pub(super) fn slopes(&self, a: f64, b: f64) -> Option<Slopes> {
                Some(match *self {
                    $( Self::$law { $($field),* } => laws::$module::slopes([ $($field),* ], a, b), )*
                    _ => return None,
                })
            }

            /// Derivatives of the energy and of its slopes in `a` and `b` by a shape parameter.
            pub(super) fn slopes_by(&self, nth: usize, a: f64, b: f64) -> (f64, f64, f64) {
                match *self {
                    $( Self::$law { $($field),* } => {
                        laws::$module::slopes_by([ $($field),* ], nth, a, b)
                    } )*
                    _ => (0.0, 0.0, 0.0),
                }
            }

            /// Whether the energy depends on the second invariant.
            #[inline(always)]
            pub(super) fn has_second(&self) -> bool {
                match self {
                    $( Self::$law { .. } => laws::$module::SECOND, )*
                    _ => false,
                }
            }
        }
    };
}

catalogue! {
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
    special {
        /// Coupled compressible neo-Hookean law.
        #[default]
        NeoHookean,
        /// Stiffer, or softer, where it is stretched than where it is compressed; the moduli of small
        /// strain are those of compression in all directions.
        Bimodular {
            /// What stretched directions have more, over `μ`, dimensionless, above −1.
            excess: f64,
        },
        /// Ogden with one to three terms; made by [`LawKind::ogden`].
        Ogden(OgdenTerms),
        /// Linear between `E` and the second Piola–Kirchhoff stress.
        StVenantKirchhoff,
        /// Linear between `sym h` and stress.
        Hooke,
    }
    invariants {
        /// Mooney–Rivlin; polyconvex for a share in `[0, 1]`.
        MooneyRivlin in mooney_rivlin {
            /// `c₀₁ / (c₁₀ + c₀₁)`, dimensionless.
            share,
        }
        /// Yeoh, three terms.
        Yeoh in yeoh {
            /// `c₂ / c₁`, dimensionless.
            c2_over_c1,
            /// `c₃ / c₁`, dimensionless.
            c3_over_c1,
        }
        /// Isotropic exponential law of Fung.
        Fung in fung {
            /// Rate of stiffening, dimensionless, not negative.
            b,
        }
        /// Exponential law of Veronda and Westmann.
        VerondaWestmann in veronda_westmann {
            /// Rate of stiffening, dimensionless, not negative.
            b,
        }
    }
}

const NEO_HOOKEAN: Declaration = Declaration { name: "neo-hookean", shape: &[], starts: &[&[]] };
const BIMODULAR: Declaration = Declaration {
    name: "bimodular",
    shape: &[ShapeParameter::number("excess", Range::AboveMinusOne).searched(-0.95, 1e3)],
    starts: &[&[-0.3], &[1.0]],
};
const OGDEN: Declaration = Declaration {
    name: "ogden",
    shape: &[ShapeParameter::series("alpha"), ShapeParameter::series("weight")],
    starts: &[],
};
const ST_VENANT_KIRCHHOFF: Declaration =
    Declaration { name: "st-venant-kirchhoff", shape: &[], starts: &[&[]] };
const HOOKE: Declaration = Declaration { name: "hooke", shape: &[], starts: &[&[]] };

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
    /// A shape parameter by the name in the law's [`Declaration`]. Of a series the term: an Ogden
    /// weight moves as given, the others held.
    Shape {
        /// Name.
        name: &'static str,
        /// Term of a series, from 0 on; 0 of one number.
        term: usize,
    },
    /// Fibre stiffness over the shear modulus.
    FibreK1,
    /// Rate of stiffening of the fibres.
    FibreK2,
}

impl Parameter {
    /// A shape parameter that is one number.
    pub const fn shape(name: &'static str) -> Self {
        Self::Shape { name, term: 0 }
    }

    /// The shape parameter of a name that a caller spells, if any law has one.
    pub fn shape_named(name: &str, term: usize) -> Option<Self> {
        let all = LawKind::declarations();
        let mut shapes = all.iter().flat_map(|law| law.shape);
        shapes.find(|one| one.name == name).map(|one| Self::Shape { name: one.name, term })
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape { name, term: 0 } => write!(f, "`{name}`"),
            Self::Shape { name, term } => write!(f, "`{name}` of term {term}"),
            other => write!(f, "{other:?}"),
        }
    }
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
            Range::Finite.check("alpha", v)?;
        }
        for &v in weight {
            Range::Finite.check("weight", v)?;
        }
        let total: f64 = weight.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return refuse("weight", "of positive sum", total);
        }
        let padded =
            |values: &[f64]| std::array::from_fn(|p| values.get(p).copied().unwrap_or(0.0));
        Ok(Self::Ogden(OgdenTerms { n, alpha: padded(alpha), weight: padded(weight), total }))
    }

    /// Every law that there is, by name with its shape parameters.
    pub fn declarations() -> Vec<Declaration> {
        let mut all = vec![NEO_HOOKEAN, BIMODULAR];
        all.extend_from_slice(IN_INVARIANTS);
        all.extend([OGDEN, ST_VENANT_KIRCHHOFF, HOOKE]);
        all
    }

    /// The law of a name, with the numbers of each shape parameter in the order of its
    /// [`Declaration`]: one, or of a series one a term.
    ///
    /// None for an unknown name or another count of numbers.
    ///
    /// # Errors
    ///
    /// [`FemError::BadLaw`] for Ogden terms that are not sound; ranges of other laws are checked by
    /// [`Material::with_law`](super::Material::with_law).
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::material::LawKind;
    ///
    /// let fung = LawKind::from_shape("fung", &[vec![5.0]])?;
    /// assert_eq!(fung, Some(LawKind::Fung { b: 5.0 }));
    /// assert_eq!(LawKind::from_shape("fung", &[])?, None);
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn from_shape(name: &str, lists: &[Vec<f64>]) -> Result<Option<Self>, FemError> {
        Ok(match (name, lists) {
            ("neo-hookean", []) => Some(Self::NeoHookean),
            ("st-venant-kirchhoff", []) => Some(Self::StVenantKirchhoff),
            ("hooke", []) => Some(Self::Hooke),
            ("bimodular", [one]) => {
                one.first().filter(|_| one.len() == 1).map(|&excess| Self::Bimodular { excess })
            }
            ("ogden", [alpha, weight]) => Some(Self::ogden(alpha, weight)?),
            _ if lists.iter().all(|list| list.len() == 1) => {
                Self::in_invariants(name, &lists.concat())
            }
            _ => None,
        })
    }

    /// Name and shape parameters of the law.
    pub fn declaration(&self) -> Declaration {
        match self {
            Self::NeoHookean => NEO_HOOKEAN,
            Self::Bimodular { .. } => BIMODULAR,
            Self::Ogden(_) => OGDEN,
            Self::StVenantKirchhoff => ST_VENANT_KIRCHHOFF,
            Self::Hooke => HOOKE,
            _ => self.declared_in_invariants().unwrap_or(NEO_HOOKEAN),
        }
    }

    /// Which of the shape parameters has a name.
    pub(super) fn place_of(&self, name: &str) -> Option<usize> {
        self.declaration().shape.iter().position(|one| one.name == name)
    }

    /// Shape parameters of the law.
    pub fn parameters(&self) -> Vec<Parameter> {
        let n_terms = if let Self::Ogden(terms) = self { terms.n } else { 1 };
        let of = |one: &ShapeParameter| {
            let name = one.name;
            (0..n_terms).map(move |term| Parameter::Shape { name, term })
        };
        self.declaration().shape.iter().flat_map(of).collect()
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
            Self::Bimodular { excess } => Range::AboveMinusOne.check("excess", excess),
            Self::StVenantKirchhoff | Self::Hooke if volumetric != Volumetric::Log => {
                Err(FemError::BadLaw {
                    name: "volumetric",
                    must: "left out: this law has no volumetric energy of its own",
                    found: f64::from(volumetric as u8),
                })
            }
            Self::StVenantKirchhoff | Self::Hooke => Ok(()),
            _ => {
                let mut each = self.declaration().shape.iter().zip(self.numbers_in_invariants());
                each.try_for_each(|(one, found)| one.range.check(one.name, found))
            }
        }
    }
}
