//! What a given displacement means: the forces that hold it, and whether it is stable.

use super::problem::State;
use crate::assembly::{ElementTangents, TangentKind, det_f_by_element, internal_force_into};
use crate::body::Body;
use crate::check::{check_finite, check_length};
use crate::error::FemError;
use crate::material::Material;
use crate::springs::Springs;
use crate::surface::SurfaceTerms;
use crate::system::factor::{Entries, Factor, Making};

/// Internal forces of a displacement: the nodal forces under which it is in equilibrium.
///
/// # Shapes
///
/// `displacement` one row per node of the body, mm; the result one row per node, mN. At held nodes
/// they are the reactions of a body without load.
///
/// # Errors
///
/// [`FemError::WrongLength`], [`FemError::NonFinite`], and [`FemError::InvertedStart`] where an
/// element is inverted or its energy overflows.
///
/// # Cost
///
/// One pass over the elements on one thread.
///
/// # Examples
///
/// A displacement is the answer to its own internal forces:
///
/// ```
/// use tissuereg_fem::{Body, Element, Load, Material, Mesh, SolveSettings};
/// use tissuereg_fem::{internal_forces, is_stable, solve};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
/// let material = Material::neo_hookean(10.0, 0.45)?;
/// let field = [[0.0; 3], [0.0; 3], [0.0; 3], [3.0, 1.0, 2.0]];
///
/// let forces = internal_forces(&body, &material, &field)?;
/// assert!(is_stable(&body, &material, &field)?);
/// let answer = solve(&body, &material, &Load::from_forces(forces), &SolveSettings::default())?;
/// assert!((answer.displacement[3][0] - 3.0).abs() < 1e-6);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
pub fn internal_forces(
    body: &Body,
    material: &Material,
    displacement: &[[f64; 3]],
) -> Result<Vec<[f64; 3]>, FemError> {
    let mut state = checked_state(body, material, displacement)?;
    let energy = internal_force_into(
        body.geometry(),
        material,
        &state.displacement,
        &mut state.force,
        &mut Vec::new(),
        false,
    );
    match energy {
        Some(energy) if energy.total.is_finite() => Ok(state.force.as_chunks::<3>().0.to_vec()),
        _ => Err(inverted(body, &state.displacement)),
    }
}

/// Forces of springs on a body at a displacement.
///
/// Without friction they are linear in the displacement: springs whose far ends move by `a` pull at a
/// body at `u` as springs that stay do at `u − a`.
///
/// # Shapes
///
/// `displacement` one row per node of the body, mm; the result likewise for each set of springs, mN.
///
/// # Errors
///
/// [`FemError::NotOnSurface`], [`FemError::BadParameter`], [`FemError::WrongLength`],
/// [`FemError::NonFinite`].
pub fn spring_forces(
    body: &Body,
    springs: &[Springs],
    displacement: &[[f64; 3]],
) -> Result<Vec<Vec<[f64; 3]>>, FemError> {
    check_length("displacement (one row a node)", body.n_nodes(), displacement.len())?;
    check_finite("displacement", displacement)?;
    let terms = SurfaceTerms::new(body, springs)?;
    Ok(terms.spring_forces(displacement.as_flattened()))
}

/// Whether a displacement is a stable equilibrium of its own internal forces: the tangent there is
/// positive definite on the unknowns.
///
/// # Shapes
///
/// `displacement` one row per node of the body, mm.
///
/// # Errors
///
/// As [`internal_forces`], and [`FemError::TooLarge`].
///
/// # Cost
///
/// One factorisation in double precision.
pub fn is_stable(
    body: &Body,
    material: &Material,
    displacement: &[[f64; 3]],
) -> Result<bool, FemError> {
    let state = checked_state(body, material, displacement)?;
    if det_f_by_element(body.geometry(), &state.displacement)
        .iter()
        .any(|&j| j.is_nan() || j <= 0.0)
    {
        return Err(inverted(body, &state.displacement));
    }
    let (kind, making) = (TangentKind::Exact, Making { parallel: false, cancel: None });
    let matrix = ElementTangents::new(body.geometry(), material, &state.displacement, kind);
    match Factor::new(&body.pattern().fronts, &matrix, Entries::Double, making) {
        Ok(_) => Ok(true),
        Err(FemError::SingularStiffness { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

fn checked_state(
    body: &Body,
    material: &Material,
    displacement: &[[f64; 3]],
) -> Result<State, FemError> {
    material.check_size(body.n_tets(), body.element().n_points())?;
    check_length("displacement (one row a node)", body.n_nodes(), displacement.len())?;
    check_finite("displacement", displacement)?;
    let mut state = State::at_rest(body.n_nodes());
    state.displacement.copy_from_slice(displacement.as_flattened());
    Ok(state)
}

fn inverted(body: &Body, displacement: &[f64]) -> FemError {
    let (tet, det_f) = det_f_by_element(body.geometry(), displacement)
        .into_iter()
        .enumerate()
        .fold((0, f64::INFINITY), |worst, new| if new.1 < worst.1 { new } else { worst });
    FemError::InvertedStart { tet, det_f }
}
