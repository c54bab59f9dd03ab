//! Springs between facets of the surface and the place that these have undeformed, and their friction.

use crate::check::must;
use crate::error::FemError;

/// Springs on facets of the surface: a soft bed, or a base that slides with some resistance.
///
/// Energy `½ ∫ (k_n u_n² + k_t |u_t|²) dA` over the undeformed facets, `u_n` along their undeformed
/// normal. They pull as well as push.
///
/// # Examples
///
/// A tetrahedron that stands on springs alone and sinks by weight over stiffness:
///
/// ```
/// use tissuereg_fem::{Body, Element, Load, Material, Mesh, SolveSettings, Springs, Supports, solve};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let bed = Springs { triangles: vec![[0, 2, 1]], normal: 2.0, tangential: 1.0, friction: None };
/// let body = Body::new(
///     Mesh::new(nodes, vec![[0, 1, 2, 3]])?,
///     Element::Tet4,
///     Supports::new().rest_on(&bed),
/// )?;
/// let load = Load {
///     nodal_forces: Some(vec![[0.0, 0.0, -4.0]; 4]),
///     springs: vec![bed],
///     ..Load::default()
/// };
/// let answer = solve(&body, &Material::neo_hookean(1e4, 0.3)?, &load, &SolveSettings::default())?;
/// let pushed: f64 = answer.spring_forces[0].iter().map(|f| f[2]).sum();
/// assert!((pushed - 16.0).abs() < 1e-6);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Springs {
    /// Facets by their corner nodes, in any order.
    pub triangles: Vec<[usize; 3]>,
    /// Stiffness along the normal, kPa/mm; at least 0.
    pub normal: f64,
    /// Stiffness in the plane, kPa/mm; at least 0. With friction that of what sticks.
    pub tangential: f64,
    /// What the springs in the plane can hold; all where none is given.
    pub friction: Option<Friction>,
}

impl Springs {
    /// Check ranges.
    ///
    /// # Errors
    ///
    /// [`FemError::BadParameter`].
    pub(crate) fn check(&self) -> Result<(), FemError> {
        let fits = |k: f64| k >= 0.0 && k.is_finite();
        must("springs.normal", "finite and not negative", self.normal, fits(self.normal))?;
        let tangential = self.tangential;
        must("springs.tangential", "finite and not negative", tangential, fits(tangential))?;
        self.friction.map_or(Ok(()), |friction| friction.check())
    }
}

/// Coulomb's law with cohesion: springs in the plane pull with `cohesion` and `coefficient` times the
/// pressure at most.
///
/// The pressure is what the springs along the normal push with, none where they pull. It holds
/// within a time step: a [`History`](crate::History) makes it agree with the frame's end. A single
/// solve takes the body from rest, with cohesion alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Friction {
    /// What a pressure adds to the traction that holds, over it, dimensionless; at least 0.
    pub coefficient: f64,
    /// Traction in the plane that holds without pressure, kPa; at least 0.
    pub cohesion: f64,
}

impl Friction {
    /// Check ranges.
    ///
    /// # Errors
    ///
    /// [`FemError::BadParameter`].
    fn check(&self) -> Result<(), FemError> {
        let fits = |v: f64| v >= 0.0 && v.is_finite();
        let coefficient = self.coefficient;
        must("springs.friction", "finite and not negative", coefficient, fits(coefficient))?;
        must("springs.cohesion", "finite and not negative", self.cohesion, fits(self.cohesion))
    }
}

/// Refuse friction where derivatives are requested: slipping has none.
///
/// # Errors
///
/// [`FemError::BadParameter`].
pub(crate) fn must_stick(springs: &[Springs]) -> Result<(), FemError> {
    let friction = springs.iter().find_map(|set| set.friction);
    let name = "springs.friction";
    friction.map_or(Ok(()), |f| {
        must(name, "absent where derivatives are computed", f.coefficient, false)
    })
}
