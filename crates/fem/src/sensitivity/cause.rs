//! Causes of a change of an equilibrium, and their unbalanced forces at fixed displacement.

use crate::assembly::PointMap;
use crate::body::Body;
use crate::check::check_length;
use crate::error::FemError;
use crate::load::{Load, NodalLoad};
use crate::material::{Material, Matrix3, Parameter, det_f_minus_one};
use crate::springs::Springs;
use crate::surface::SurfaceTerms;

/// The input by which an equilibrium is differentiated.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Cause {
    /// A parameter of the law, changed uniformly (a field of moduli by the same amount).
    Parameter(Parameter),
    /// A field of rates of Young's modulus, one per quadrature point (`n_tets * n_points`); of an
    /// inclusion or a layer, 1 inside and 0 outside.
    YoungField(Vec<f64>),
    /// Poisson's ratio along such a field.
    PoissonField(Vec<f64>),
    /// A change of the load: forces, body force and prescribed displacements as rates. A
    /// pressure is given by [`Body::pressure_forces`]. Springs must be left out.
    Load(Load),
    /// Stiffness along the normal of a set of springs, by its place in the load, kPa/mm.
    SpringNormal(usize),
    /// Stiffness in the plane of a set of springs, kPa/mm.
    SpringTangential(usize),
}

/// Rates at fixed displacement.
pub(super) struct Rates {
    /// `ṙ` at all nodes, `(3 n_nodes)`, mN.
    pub(super) unbalanced: Vec<f64>,
    /// `u̇` of held components, `(3 n_nodes)`; none where they stay.
    pub(super) held: Option<Vec<f64>>,
}

/// Where causes are looked up.
pub(super) struct Scene<'a> {
    pub(super) body: &'a Body,
    pub(super) material: &'a Material,
    pub(super) springs: &'a [Springs],
    /// `(3 n_nodes)`, mm.
    pub(super) displacement: &'a [f64],
    /// Displacement gradient at all points.
    pub(super) gradients: &'a [Matrix3],
    pub(super) map: &'a PointMap,
}

/// Stresses by the moduli at every point, as far as some causes need them.
#[derive(Default)]
pub(super) struct Shared {
    young: Option<Vec<Matrix3>>,
    poisson: Option<Vec<Matrix3>>,
}

impl Scene<'_> {
    /// What fields of moduli among causes share.
    pub(super) fn shared_forces(&self, causes: &[Cause]) -> Result<Shared, FemError> {
        let any = |is: fn(&Cause) -> bool| causes.iter().any(is);
        let by = |parameter, wanted: bool| wanted.then(|| self.stresses_by(parameter)).transpose();
        Ok(Shared {
            young: by(Parameter::Young, any(|c| matches!(c, Cause::YoungField(_))))?,
            poisson: by(Parameter::Poisson, any(|c| matches!(c, Cause::PoissonField(_))))?,
        })
    }

    /// The same as [`Scene::rates`], with what fields share.
    pub(super) fn rates_with(&self, cause: &Cause, shared: &Shared) -> Result<Rates, FemError> {
        let (stresses, rates) = match (cause, shared) {
            (Cause::YoungField(rates), Shared { young: Some(stresses), .. })
            | (Cause::PoissonField(rates), Shared { poisson: Some(stresses), .. }) => {
                (stresses, rates)
            }
            _ => return self.rates(cause),
        };
        Ok(Rates { unbalanced: self.along_field(stresses.clone(), rates)?, held: None })
    }

    pub(super) fn rates(&self, cause: &Cause) -> Result<Rates, FemError> {
        let unbalanced = match cause {
            Cause::Parameter(parameter) => self.by_parameter(*parameter, None)?,
            Cause::YoungField(rates) => self.by_parameter(Parameter::Young, Some(rates))?,
            Cause::PoissonField(rates) => self.by_parameter(Parameter::Poisson, Some(rates))?,
            Cause::Load(rate) => return self.by_load(rate),
            Cause::SpringNormal(set) => self.by_springs(*set, 1.0, 0.0)?,
            Cause::SpringTangential(set) => self.by_springs(*set, 0.0, 1.0)?,
        };
        Ok(Rates { unbalanced, held: None })
    }

    /// `∂P/∂parameter` at every point, kPa over the unit of the parameter.
    ///
    /// # Errors
    ///
    /// [`FemError::NoSuchCause`] for a parameter that the material does not have,
    /// [`FemError::InvertedStart`] for a point that has no stress.
    pub(super) fn stresses_by(&self, parameter: Parameter) -> Result<Vec<Matrix3>, FemError> {
        if !self.material.parameters().contains(&parameter) {
            return Err(FemError::NoSuchCause { what: format!("{parameter} of this law") });
        }
        let n_points = self.body.element().n_points();
        let one = |(index, h): (usize, &Matrix3)| {
            let (tet, point) = (index / n_points, index % n_points);
            self.material
                .law_at(tet, point)
                .stress_by(h, parameter)
                .ok_or_else(|| FemError::InvertedStart { tet, det_f: 1.0 + det_f_minus_one(h) })
        };
        self.gradients.iter().enumerate().map(one).collect()
    }

    fn by_parameter(
        &self,
        parameter: Parameter,
        field: Option<&[f64]>,
    ) -> Result<Vec<f64>, FemError> {
        let stresses = self.stresses_by(parameter)?;
        match field {
            Some(rates) => self.along_field(stresses, rates),
            None => Ok(self.forces_of(&stresses)),
        }
    }

    fn along_field(&self, mut stresses: Vec<Matrix3>, rates: &[f64]) -> Result<Vec<f64>, FemError> {
        check_length("rates (one entry a quadrature point)", stresses.len(), rates.len())?;
        for (stress, rate) in stresses.iter_mut().zip(rates) {
            stress.iter_mut().flatten().for_each(|v| *v *= rate);
        }
        Ok(self.forces_of(&stresses))
    }

    fn forces_of(&self, stresses: &[Matrix3]) -> Vec<f64> {
        let mut unbalanced = vec![0.0; self.displacement.len()];
        self.map.add_forces(self.body.geometry(), stresses, &mut unbalanced);
        unbalanced
    }

    fn by_load(&self, rate: &Load) -> Result<Rates, FemError> {
        if !rate.springs.is_empty() {
            let what = "springs of a load; name them one by one".to_owned();
            return Err(FemError::NoSuchCause { what });
        }
        let NodalLoad { mut force, prescribed, moves_supports } = NodalLoad::new(self.body, rate)?;
        force.iter_mut().for_each(|f| *f = -*f);
        Ok(Rates { unbalanced: force, held: moves_supports.then_some(prescribed) })
    }

    /// Springs are linear in their stiffness.
    fn by_springs(&self, set: usize, normal: f64, tangential: f64) -> Result<Vec<f64>, FemError> {
        let Some(springs) = self.springs.get(set) else {
            let what = format!("springs {set} of {}", self.springs.len());
            return Err(FemError::NoSuchCause { what });
        };
        let unit = Springs { normal, tangential, ..springs.clone() };
        let mut force = vec![0.0; self.displacement.len()];
        SurfaceTerms::new(self.body, &[unit])?.add_force(self.displacement, &mut force);
        Ok(force)
    }
}
