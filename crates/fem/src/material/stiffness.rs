//! Fields over a body: moduli and fibre directions.

use super::NeoHookean;
use crate::error::FemError;

/// Young's modulus and Poisson's ratio over a body.
#[derive(Debug, Clone, PartialEq)]
pub enum Stiffness {
    /// The same everywhere.
    Uniform {
        /// Young's modulus, kPa.
        young: f64,
        /// Poisson's ratio, dimensionless.
        poisson: f64,
    },
    /// One value a tetrahedron.
    PerTet {
        /// Young's modulus of each tetrahedron, kPa.
        young: Vec<f64>,
        /// Poisson's ratio of each tetrahedron, dimensionless; one entry means the same for all.
        poisson: Vec<f64>,
    },
    /// One value a quadrature point, so that a layer or an inclusion may cut through a tetrahedron;
    /// points of one tetrahedron stand together.
    PerPoint {
        /// Points of a tetrahedron, [`Element::n_points`](crate::Element::n_points).
        n_points: usize,
        /// Young's modulus, `(n_tets * n_points)`, kPa.
        young: Vec<f64>,
        /// Poisson's ratio, dimensionless, as many; one entry means the same for all.
        poisson: Vec<f64>,
    },
}

/// How the entries of a field lie over a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Layout {
    Uniform,
    PerTet,
    PerPoint(usize),
}

impl Layout {
    #[inline(always)]
    pub(crate) fn entry(self, tet: usize, point: usize) -> usize {
        match self {
            Self::Uniform => 0,
            Self::PerTet => tet,
            Self::PerPoint(n_points) => tet * n_points + point,
        }
    }

    /// Check that `found` entries fit a body.
    pub(crate) fn check(
        self,
        what: [&'static str; 2],
        found: usize,
        n_tets: usize,
        n_points: usize,
    ) -> Result<(), FemError> {
        let [per_tet, per_point] = what;
        let refuse = |what, expected| Err(FemError::WrongLength { what, expected, found });
        match self {
            Self::PerTet if found != n_tets => refuse(per_tet, n_tets),
            Self::PerPoint(n) if n != n_points || found != n_tets * n_points => {
                refuse(per_point, n_tets * n_points)
            }
            _ => Ok(()),
        }
    }
}

impl Stiffness {
    pub(crate) fn layout(&self) -> Layout {
        match self {
            Self::Uniform { .. } => Layout::Uniform,
            Self::PerTet { .. } => Layout::PerTet,
            Self::PerPoint { n_points, .. } => Layout::PerPoint(*n_points),
        }
    }

    /// Moduli in kPa and Poisson's ratios, each one entry or one a place.
    pub(crate) fn fields(&self) -> (&[f64], &[f64]) {
        match self {
            Self::Uniform { young, poisson } => {
                (std::slice::from_ref(young), std::slice::from_ref(poisson))
            }
            Self::PerTet { young, poisson } | Self::PerPoint { young, poisson, .. } => {
                (young, poisson)
            }
        }
    }

    /// Lamé constants, one entry an entry of Young's modulus.
    pub(crate) fn moduli(&self) -> Result<Vec<NeoHookean>, FemError> {
        let (young, poisson) = self.fields();
        let n = young.len();
        if poisson.len() != n && poisson.len() != 1 {
            return Err(FemError::WrongLength {
                what: "Poisson's ratio (one entry a tetrahedron, or one)",
                expected: n,
                found: poisson.len(),
            });
        }
        let at = |t: usize| poisson[if poisson.len() == 1 { 0 } else { t }];
        (0..n).map(|t| checked_moduli(t, young[t], at(t))).collect()
    }
}

fn checked_moduli(entry: usize, young: f64, poisson: f64) -> Result<NeoHookean, FemError> {
    if !(young > 0.0 && young.is_finite()) {
        return Err(FemError::BadYoung { entry, young });
    }
    if !(poisson > -1.0 && poisson < 0.5) {
        return Err(FemError::BadPoisson { entry, poisson });
    }
    Ok(NeoHookean::from_young(young, poisson))
}

/// A family of fibres over a body.
///
/// The energy added to that of the law is `k₁/(2 k₂) (exp(k₂ ⟨Ī₄ − 1⟩²) − 1)`, where `Ī₄` is the
/// squared isochoric stretch along the fibres and `⟨·⟩` the positive part where they bear tension
/// alone. With Hooke's law, too, they need `det F > 0`.
///
/// # Reference
///
/// Holzapfel, Gasser and Ogden, *Journal of Elasticity* 61, 2000.
#[derive(Debug, Clone, PartialEq)]
pub struct Fibres {
    /// Stiffness over the shear modulus of the matrix, `k₁/μ`; not negative.
    pub k1_over_mu: f64,
    /// Rate of stiffening `k₂`, dimensionless; not negative.
    pub k2: f64,
    /// Whether shortened fibres are slack.
    pub tension_only: bool,
    /// Where they point.
    pub directions: Directions,
}

/// Directions of fibres in the undeformed body; only the direction of a vector counts.
#[derive(Debug, Clone, PartialEq)]
pub enum Directions {
    /// The same everywhere.
    Uniform([f64; 3]),
    /// One a tetrahedron.
    PerTet(Vec<[f64; 3]>),
    /// One per quadrature point, as in [`Stiffness::PerPoint`].
    PerPoint {
        /// Points of a tetrahedron.
        n_points: usize,
        /// `(n_tets * n_points)` vectors.
        directions: Vec<[f64; 3]>,
    },
}

impl Directions {
    pub(crate) fn layout(&self) -> Layout {
        match self {
            Self::Uniform(_) => Layout::Uniform,
            Self::PerTet(_) => Layout::PerTet,
            Self::PerPoint { n_points, .. } => Layout::PerPoint(*n_points),
        }
    }

    pub(crate) fn vectors(&self) -> &[[f64; 3]] {
        match self {
            Self::Uniform(direction) => std::slice::from_ref(direction),
            Self::PerTet(directions) | Self::PerPoint { directions, .. } => directions,
        }
    }

    pub(super) fn vectors_mut(&mut self) -> &mut [[f64; 3]] {
        match self {
            Self::Uniform(direction) => std::slice::from_mut(direction),
            Self::PerTet(directions) | Self::PerPoint { directions, .. } => directions,
        }
    }
}
