//! A law over a body.

use super::declaration::Range;
use super::stiffness::Layout;
use super::{Fibre, Fibres, Law, LawKind, NeoHookean, Parameter, Stiffness, Volumetric};
use crate::error::FemError;

/// Poisson's ratio from which linear tetrahedra lock.
const LOCKING_POISSON: f64 = 0.475;

/// A law with its parameters over a body.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::material::{Directions, Fibres, LawKind};
/// use tissuereg_fem::{FemError, Material, Stiffness};
///
/// let fat = Material::neo_hookean(3.0, 0.45)?;
/// assert!(fat.is_uniform());
///
/// let field = Stiffness::PerTet { young: vec![3.0, 30.0], poisson: vec![0.45] };
/// assert_eq!(Material::new(field)?.n_values(), 2);
///
/// let muscle = fat.with_law(LawKind::Yeoh { c2_over_c1: 0.2, c3_over_c1: 0.0 })?.with_fibres(
///     Fibres {
///         k1_over_mu: 2.0,
///         k2: 1.0,
///         tension_only: true,
///         directions: Directions::Uniform([0.0, 0.0, 1.0]),
///     },
/// )?;
/// assert_eq!(muscle.parameters().len(), 6);
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
    layout: Layout,
    moduli: Vec<NeoHookean>,
    kind: LawKind,
    volumetric: Volumetric,
    fibres: Option<Fibres>,
}

/// A field of neo-Hookean laws and nothing else.
#[derive(Clone, Copy)]
pub(crate) struct PlainLaws<'a> {
    moduli: &'a [NeoHookean],
    layout: Layout,
}

impl PlainLaws<'_> {
    /// The one law of a homogeneous body.
    #[inline(always)]
    pub(crate) fn uniform(self) -> Option<NeoHookean> {
        if self.layout == Layout::Uniform { self.moduli.first().copied() } else { None }
    }

    /// The law at one quadrature point of a tetrahedron.
    #[inline(always)]
    pub(crate) fn at(self, tet: usize, point: usize) -> NeoHookean {
        self.moduli[self.layout.entry(tet, point)]
    }
}

impl Material {
    /// Neo-Hookean material with a field of stiffness; [`with_law`](Self::with_law) and
    /// [`with_fibres`](Self::with_fibres) make others of it.
    ///
    /// # Errors
    ///
    /// [`FemError::BadYoung`] unless `0 < E < ∞`, [`FemError::BadPoisson`] unless `−1 < ν < 0.5`,
    /// [`FemError::WrongLength`] where the two fields differ in length.
    pub fn new(stiffness: Stiffness) -> Result<Self, FemError> {
        Ok(Self {
            layout: stiffness.layout(),
            moduli: stiffness.moduli()?,
            stiffness,
            kind: LawKind::NeoHookean,
            volumetric: Volumetric::Log,
            fibres: None,
        })
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

    /// The same stiffness under another law.
    ///
    /// # Errors
    ///
    /// [`FemError::BadLaw`] for a shape parameter out of range, or a quadratic volumetric energy
    /// set before for a law that has none.
    pub fn with_law(mut self, kind: LawKind) -> Result<Self, FemError> {
        kind.check(self.volumetric)?;
        self.kind = kind;
        Ok(self)
    }

    /// The same with another energy of volume change.
    ///
    /// # Errors
    ///
    /// [`FemError::BadLaw`] for a law that has no volumetric energy of its own.
    pub fn with_volumetric(mut self, volumetric: Volumetric) -> Result<Self, FemError> {
        self.kind.check(volumetric)?;
        self.volumetric = volumetric;
        Ok(self)
    }

    /// The same with fibres. Directions are divided by their lengths.
    ///
    /// # Errors
    ///
    /// [`FemError::BadLaw`] for a stiffness or rate that is negative or not finite,
    /// [`FemError::BadFibre`] for a direction without length.
    pub fn with_fibres(mut self, mut fibres: Fibres) -> Result<Self, FemError> {
        Range::NotNegative.check("k1_over_mu", fibres.k1_over_mu)?;
        Range::NotNegative.check("k2", fibres.k2)?;
        for (entry, n) in fibres.directions.vectors_mut().iter_mut().enumerate() {
            let length = n[0].hypot(n[1]).hypot(n[2]);
            if !(length > 0.0 && length.is_finite()) {
                return Err(FemError::BadFibre { entry, direction: *n });
            }
            *n = n.map(|v| v / length);
        }
        self.fibres = Some(fibres);
        Ok(self)
    }

    /// Stiffness as given.
    pub fn stiffness(&self) -> &Stiffness {
        &self.stiffness
    }

    /// The law and its shape.
    pub fn kind(&self) -> LawKind {
        self.kind
    }

    /// Fibres, with directions of unit length.
    pub fn fibres(&self) -> Option<&Fibres> {
        self.fibres.as_ref()
    }

    /// Whether one value serves for all tetrahedra.
    pub fn is_uniform(&self) -> bool {
        self.layout == Layout::Uniform
    }

    /// Number of values of the stiffness: 1 where uniform, else one a tetrahedron or a point.
    pub fn n_values(&self) -> usize {
        self.moduli.len()
    }

    /// Everything the stress depends on: the moduli, the shape of the law, the fibres.
    pub fn parameters(&self) -> Vec<Parameter> {
        let mut all = vec![Parameter::Young, Parameter::Poisson];
        all.extend(self.kind.parameters());
        if self.fibres.is_some() {
            all.extend([Parameter::FibreK1, Parameter::FibreK2]);
        }
        all
    }

    /// The law at one quadrature point of a tetrahedron.
    #[inline(always)]
    pub fn law_at(&self, tet: usize, point: usize) -> Law {
        Law {
            moduli: self.moduli[self.layout.entry(tet, point)],
            kind: self.kind,
            volumetric: self.volumetric,
            fibre: self.fibres.as_ref().map(|fibres| Fibre {
                k1_over_mu: fibres.k1_over_mu,
                k2: fibres.k2,
                direction: fibres.directions.vectors()
                    [fibres.directions.layout().entry(tet, point)],
                tension_only: fibres.tension_only,
            }),
        }
    }

    /// Whether four-node tetrahedra ([`Element::Tet4`](crate::Element::Tet4)) lock with this
    /// material: Poisson's ratio is above 0.475 somewhere. On a dome of 4,000 nodes they then move
    /// a tenth too little or worse; [`Element::Tet4Averaged`](crate::Element::Tet4Averaged) and
    /// [`Element::Tet10`](crate::Element::Tet10) do not.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::Material;
    ///
    /// assert!(!Material::neo_hookean(10.0, 0.45)?.locks_linear_tets());
    /// assert!(Material::neo_hookean(10.0, 0.499)?.locks_linear_tets());
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn locks_linear_tets(&self) -> bool {
        let (_, poisson) = self.stiffness.fields();
        poisson.iter().any(|&nu| nu > LOCKING_POISSON)
    }

    /// Lamé constants where the law is the neo-Hookean one with logarithmic volumetric energy and
    /// no fibres.
    pub(crate) fn plain_neo_hookean(&self) -> Option<PlainLaws<'_>> {
        let plain = self.kind.is_plain(self.volumetric) && self.fibres.is_none();
        plain.then_some(PlainLaws { moduli: &self.moduli, layout: self.layout })
    }

    /// Check that the fields fit a body of `n_tets` tetrahedra of `n_points` points.
    pub(crate) fn check_size(&self, n_tets: usize, n_points: usize) -> Result<(), FemError> {
        let what =
            ["stiffness (one entry a tetrahedron)", "stiffness (one entry a quadrature point)"];
        self.layout.check(what, self.moduli.len(), n_tets, n_points)?;
        let Some(Fibres { directions, .. }) = &self.fibres else { return Ok(()) };
        let what = [
            "fibre directions (one row a tetrahedron)",
            "fibre directions (one row a quadrature point)",
        ];
        directions.layout().check(what, directions.vectors().len(), n_tets, n_points)
    }
}
