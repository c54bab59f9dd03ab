//! Material laws and the fields of stiffness they take.
//!
//! A law is a type that implements [`Hyperelastic`]; [`Material`] pairs a law with its parameters
//! over the body. The element loops ask [`Material::law_at`] for the law at a quadrature point:
//! values that vary inside an element would be added there.

mod neo_hookean;

pub use neo_hookean::NeoHookean;

use crate::error::FemError;

/// A matrix of three rows, `[i][j]`.
pub type Matrix3 = [[f64; 3]; 3];

/// Derivative of a stress by a displacement gradient: `[3 i + j][3 k + l] = ∂P_ij/∂h_kl`.
pub type Tangent = [[f64; 9]; 9];

/// A law that derives its stress from an energy.
///
/// All methods take the displacement gradient `h[i][j] = ∂u_i/∂X_j` (dimensionless) instead of
/// `F = I + h`, so that small strains keep their digits, and return `None` where `det F ≤ 0`:
/// an inverted element has no energy, and a line search treats that as "too far".
///
/// # Units
///
/// Energy density, stress `P` (first Piola–Kirchhoff) and tangent in kPa.
pub trait Hyperelastic {
    /// Energy density `ψ`, kPa.
    fn energy(&self, h: &Matrix3) -> Option<f64>;

    /// Stress `P = ∂ψ/∂h`, kPa.
    fn stress(&self, h: &Matrix3) -> Option<Matrix3>;

    /// Tangent `∂P/∂h`, kPa; symmetric.
    fn tangent(&self, h: &Matrix3) -> Option<Tangent>;

    /// Energy density, stress and `det F` together, for the element loop.
    fn response(&self, h: &Matrix3) -> Option<Response> {
        let det_f = 1.0 + det_f_minus_one(h);
        Some(Response { energy: self.energy(h)?, stress: self.stress(h)?, det_f })
    }
}

/// What a law answers at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// Energy density, kPa.
    pub energy: f64,
    /// First Piola–Kirchhoff stress, kPa.
    pub stress: Matrix3,
    /// Volume ratio `det F`, dimensionless.
    pub det_f: f64,
}

/// Cofactor matrix: `∂ det(m)/∂m`.
pub(crate) fn cofactor(m: &Matrix3) -> Matrix3 {
    [
        [
            m[1][1] * m[2][2] - m[1][2] * m[2][1],
            m[1][2] * m[2][0] - m[1][0] * m[2][2],
            m[1][0] * m[2][1] - m[1][1] * m[2][0],
        ],
        [
            m[2][1] * m[0][2] - m[2][2] * m[0][1],
            m[2][2] * m[0][0] - m[2][0] * m[0][2],
            m[2][0] * m[0][1] - m[2][1] * m[0][0],
        ],
        [
            m[0][1] * m[1][2] - m[0][2] * m[1][1],
            m[0][2] * m[1][0] - m[0][0] * m[1][2],
            m[0][0] * m[1][1] - m[0][1] * m[1][0],
        ],
    ]
}

/// `det(I + h) − 1`, exact for small `h`.
pub fn det_f_minus_one(h: &Matrix3) -> f64 {
    let c = cofactor(h);
    let trace = h[0][0] + h[1][1] + h[2][2];
    let second = c[0][0] + c[1][1] + c[2][2];
    let third = h[0][0] * c[0][0] + h[0][1] * c[0][1] + h[0][2] * c[0][2];
    trace + second + third
}

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
}

/// A law with its parameters over a body.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::{FemError, Material, Stiffness};
///
/// let fat = Material::neo_hookean(3.0, 0.45)?;
/// assert!(fat.is_uniform());
///
/// let field = Stiffness::PerTet { young: vec![3.0, 30.0], poisson: vec![0.45] };
/// assert_eq!(Material::new(field)?.n_values(), 2);
///
/// assert_eq!(
///     Material::neo_hookean(3.0, 0.5),
///     Err(FemError::BadPoisson { entry: 0, poisson: 0.5 })
/// );
/// # Ok::<(), FemError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    stiffness: Stiffness,
    laws: Vec<NeoHookean>,
}

impl Material {
    /// Neo-Hookean material with a field of stiffness.
    ///
    /// # Errors
    ///
    /// [`FemError::BadYoung`] unless `0 < E < ∞`, [`FemError::BadPoisson`] unless `−1 < ν < 0.5`,
    /// [`FemError::WrongLength`] where the two fields differ in length.
    pub fn new(stiffness: Stiffness) -> Result<Self, FemError> {
        let laws = match &stiffness {
            Stiffness::Uniform { young, poisson } => vec![checked_law(0, *young, *poisson)?],
            Stiffness::PerTet { young, poisson } => {
                let n = young.len();
                if poisson.len() != n && poisson.len() != 1 {
                    return Err(FemError::WrongLength {
                        what: "Poisson's ratio (one entry a tetrahedron, or one)",
                        expected: n,
                        found: poisson.len(),
                    });
                }
                let at = |t: usize| poisson[if poisson.len() == 1 { 0 } else { t }];
                (0..n).map(|t| checked_law(t, young[t], at(t))).collect::<Result<_, _>>()?
            }
        };
        Ok(Self { stiffness, laws })
    }

    /// Neo-Hookean material with Young's modulus `young` (kPa) and Poisson's ratio `poisson`
    /// everywhere.
    ///
    /// # Errors
    ///
    /// As [`Material::new`].
    pub fn neo_hookean(young: f64, poisson: f64) -> Result<Self, FemError> {
        Self::new(Stiffness::Uniform { young, poisson })
    }

    /// Stiffness as given.
    pub fn stiffness(&self) -> &Stiffness {
        &self.stiffness
    }

    /// Whether one value serves for all tetrahedra.
    pub fn is_uniform(&self) -> bool {
        matches!(self.stiffness, Stiffness::Uniform { .. })
    }

    /// Number of values: 1 where uniform, else one a tetrahedron.
    pub fn n_values(&self) -> usize {
        self.laws.len()
    }

    /// The law at one quadrature point of a tetrahedron.
    ///
    /// All points of a tetrahedron share a law today; fields that vary inside it start here.
    #[inline]
    pub fn law_at(&self, tet: usize, _point: usize) -> &NeoHookean {
        if self.laws.len() == 1 { &self.laws[0] } else { &self.laws[tet] }
    }

    /// The laws of a neo-Hookean material: one for all or one a tetrahedron.
    pub(crate) fn plain_neo_hookean(&self) -> Option<&[NeoHookean]> {
        Some(&self.laws)
    }

    /// Check that the field fits a body of `n_tets` tetrahedra.
    pub(crate) fn check_size(&self, n_tets: usize) -> Result<(), FemError> {
        if self.is_uniform() || self.laws.len() == n_tets {
            return Ok(());
        }
        Err(FemError::WrongLength {
            what: "stiffness (one entry a tetrahedron)",
            expected: n_tets,
            found: self.laws.len(),
        })
    }
}

fn checked_law(entry: usize, young: f64, poisson: f64) -> Result<NeoHookean, FemError> {
    if !(young > 0.0 && young.is_finite()) {
        return Err(FemError::BadYoung { entry, young });
    }
    if !(poisson > -1.0 && poisson < 0.5) {
        return Err(FemError::BadPoisson { entry, poisson });
    }
    Ok(NeoHookean::from_young(young, poisson))
}
