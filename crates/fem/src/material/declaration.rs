//! Declaration of a law: its name, its shape parameters, where a fit of them begins.

use crate::error::FemError;

/// A law as callers by name know it.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::material::LawKind;
///
/// let yeoh = LawKind::declarations().into_iter().find(|law| law.name == "yeoh");
/// let names = yeoh.map(|law| law.shape.iter().map(|one| one.name).collect::<Vec<_>>());
/// assert_eq!(names, Some(vec!["c2_over_c1", "c3_over_c1"]));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Declaration {
    /// Name, in lower case with hyphens.
    pub name: &'static str,
    /// Shape parameters, in the order in which [`LawKind::from_shape`](super::LawKind::from_shape)
    /// takes them. A law without any has the small-strain moduli alone.
    pub shape: &'static [ShapeParameter],
    /// Shapes at which a fit to measured curves begins; empty where the number of terms decides.
    pub starts: &'static [&'static [f64]],
}

/// One shape parameter, dimensionless.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ShapeParameter {
    /// Name in tables and files.
    pub name: &'static str,
    /// Whether there is one number a term, as of Ogden's law, instead of one.
    pub series: bool,
    /// Values that the law takes.
    pub range: Range,
    /// Least and largest value that a fit tries.
    pub searched: [f64; 2],
}

impl ShapeParameter {
    /// One number, that a fit seeks anywhere.
    pub(super) const fn number(name: &'static str, range: Range) -> Self {
        Self { name, series: false, range, searched: [f64::NEG_INFINITY, f64::INFINITY] }
    }

    /// One number a term.
    pub(super) const fn series(name: &'static str) -> Self {
        Self { series: true, ..Self::number(name, Range::Finite) }
    }

    /// The same, that a fit seeks between bounds.
    pub(super) const fn searched(self, least: f64, largest: f64) -> Self {
        Self { searched: [least, largest], ..self }
    }
}

/// Values that a shape parameter may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Range {
    /// Any finite number.
    Finite,
    /// Finite and not negative.
    NotNegative,
    /// Finite and above −1.
    AboveMinusOne,
}

impl Range {
    /// Refuse a value outside.
    pub(super) fn check(self, name: &'static str, found: f64) -> Result<(), FemError> {
        let (holds, must) = match self {
            Self::Finite => (true, "finite"),
            Self::NotNegative => (found >= 0.0, "finite and not negative"),
            Self::AboveMinusOne => (found > -1.0, "above -1"),
        };
        match holds && found.is_finite() {
            true => Ok(()),
            false => Err(FemError::BadLaw { name, must, found }),
        }
    }
}

/// Energy of a law in invariants per shear modulus, and its derivatives in `(a, b)`; all others
/// vanish for the laws here.
pub(super) struct Slopes {
    /// `ψ/μ` without volume change: `½ a` of the neo-Hookean law.
    pub(super) energy: f64,
    /// `∂/∂a`
    pub(super) a: f64,
    /// `∂/∂b`
    pub(super) b: f64,
    /// `∂²/∂a²`
    pub(super) aa: f64,
}
