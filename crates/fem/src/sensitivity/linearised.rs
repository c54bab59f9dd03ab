//! An equilibrium and its tangent.

use std::borrow::Borrow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use super::adjoint::{Adjoint, Observation};
use super::cause::{Cause, Scene};
use super::factored::{Buffers, Factored};
use super::held::HeldRows;
use super::rates::{Derivative, Tangent, exact, factor};
use crate::assembly::{PointMap, gradients_at_points, point_volumes};
use crate::body::Body;
use crate::check::{check_finite, check_length};
use crate::error::FemError;
use crate::load::{Load, NodalLoad};
use crate::material::{Material, Matrix3, Parameter};
use crate::solve::{Model, Precision, Problem, SolveSettings, Solver, State, dot, surface_of};
use crate::springs::{Springs, must_stick};
use crate::surface::SurfaceTerms;
use crate::system::factor::Factor;

/// An equilibrium with the exact tangent there, factored once; it answers derivatives.
///
/// The body may be borrowed (`&Body`) or shared (`Arc<Body>`); everything else is copied.
///
/// # Examples
///
/// The derivative of the tip of a stretched bar by its stiffness, forward and by the adjoint:
///
/// ```
/// use tissuereg_fem::material::Parameter;
/// use tissuereg_fem::{Body, Cause, Element, Linearised, Load, Material, Mesh, Observation};
/// use tissuereg_fem::{SolveSettings, solve};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet10, [0, 1, 2])?;
/// let material = Material::neo_hookean(10.0, 0.3)?;
/// let load = Load { body_force: [0.0, 0.0, -0.01], ..Load::default() };
/// let settings = SolveSettings::default();
/// let answer = solve(&body, &material, &load, &settings)?;
///
/// let at = Linearised::new(&body, &material, &load, &answer.displacement, &settings)?;
/// let by_young = &at.derivatives(&[Cause::Parameter(Parameter::Young)])?[0];
/// assert!(by_young.displacement[3][2] > 0.0, "stiffer tissue sinks less");
///
/// let tip = Observation::of_displacement([(3, [0.0, 0.0, 1.0])]);
/// let adjoint = &at.adjoints(&[tip])?[0];
/// assert_eq!(adjoint.young.len(), 4);
/// let sum: f64 = adjoint.young.iter().sum();
/// assert!((sum - by_young.displacement[3][2]).abs() < 1e-10 * sum.abs());
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug)]
pub struct Linearised<B> {
    pub(super) body: B,
    pub(super) material: Material,
    springs: Vec<Springs>,
    surface: SurfaceTerms,
    load: NodalLoad,
    pub(super) settings: SolveSettings,
    pub(super) state: State,
    gradients: Vec<Matrix3>,
    map: PointMap,
    pub(super) factored: Factored,
    /// Computed at first use; none where that fails.
    pub(super) held_rows: OnceLock<Option<HeldRows>>,
    pub(super) right_hand_sides: AtomicUsize,
    pub(super) corrections: AtomicUsize,
}

/// Work of a [`Linearised`] so far; the same at any number of threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct TangentReport {
    /// Precision of the factor: double also where a single one did not suffice.
    pub precision: Precision,
    /// Factors made.
    pub factorisations: usize,
    /// Right-hand sides of [`Linearised::compliance`] and [`Linearised::responses`].
    pub right_hand_sides: usize,
    /// Corrections of their solutions in double precision.
    pub corrections: usize,
}

impl<B: Borrow<Body> + Send + Sync> Linearised<B> {
    /// Factor the tangent at an equilibrium.
    ///
    /// # Shapes
    ///
    /// `displacement` one row per node of the body, mm: the answer of a solve with this material and
    /// load. Of the settings, threads and the cancel flag count.
    ///
    /// # Errors
    ///
    /// [`FemError::NotInEquilibrium`] with the residual, [`FemError::NotStable`] where the tangent is
    /// not positive definite; [`FemError::BadParameter`] for springs with friction, and those of
    /// [`solve`](crate::solve) for wrong input.
    ///
    /// # Cost
    ///
    /// One factorisation in double precision.
    pub fn new(
        body: B,
        material: &Material,
        load: &Load,
        displacement: &[[f64; 3]],
        settings: &SolveSettings,
    ) -> Result<Self, FemError> {
        Self::in_precision(body, material, load, displacement, settings, Precision::Double)
    }

    /// The same with a factor in a chosen precision.
    ///
    /// # Errors
    ///
    /// As [`Linearised::new`]. With a single factor, calls that solve may also fail with
    /// [`FemError::BadSetting`] where it turns out not to suffice.
    ///
    /// # Cost
    ///
    /// A single factor takes half of the memory and, with the tangent that refines its solutions, 60 to
    /// 80 % of the time of a double one (4,000 to 20,000 nodes). Its solutions take about as long.
    pub fn in_precision(
        body: B,
        material: &Material,
        load: &Load,
        displacement: &[[f64; 3]],
        settings: &SolveSettings,
        precision: Precision,
    ) -> Result<Self, FemError> {
        settings.check()?;
        settings.check_cancel()?;
        let own = body.borrow();
        material.check_size(own.n_tets(), own.element().n_points())?;
        check_length("displacement (one row a node)", own.n_nodes(), displacement.len())?;
        check_finite("displacement", displacement)?;
        let surface = surface_of(own, load)?;
        must_stick(&load.springs)?;
        let nodal = NodalLoad::new(own, load)?;
        let settings = exact(settings);
        let mut state = State::at_rest(own.n_nodes());
        state.displacement.copy_from_slice(displacement.as_flattened());
        let problem = Problem {
            body: own,
            model: Model::Elastic(material),
            surface: &surface,
            load: &nodal,
            settings: &settings,
            parallel: settings.is_parallel(),
            least_load: 0.0,
        };
        let upright = Solver::new(own, problem.parallel).evaluate(&problem, &mut state);
        let map = PointMap::new(own.geometry(), &state.displacement).filter(|_| upright);
        let Some(map) = map else {
            let worst = problem.worst_tets(&state.displacement);
            let (tet, det_f) = worst.first().map_or((0, f64::NAN), |w| (w.tet, w.det_f));
            return Err(FemError::InvertedStart { tet, det_f });
        };
        let factored = settings.in_pool(|| factor(&problem, &state, precision))?;
        let gradients = gradients_at_points(own.geometry(), &state.displacement);
        let (material, springs) = (material.clone(), load.springs.clone());
        Ok(Self {
            body,
            material,
            springs,
            surface,
            load: nodal,
            settings,
            state,
            gradients,
            map,
            factored,
            held_rows: OnceLock::new(),
            right_hand_sides: AtomicUsize::new(0),
            corrections: AtomicUsize::new(0),
        })
    }

    /// The work done so far.
    pub fn report(&self) -> TangentReport {
        let precision = match *self.factored.factor {
            Factor::Double(_) => Precision::Double,
            Factor::Single(_) | Factor::Compact(_) => Precision::Single,
        };
        TangentReport {
            precision,
            factorisations: self.factored.factorisations,
            right_hand_sides: self.right_hand_sides.load(Ordering::Relaxed),
            corrections: self.corrections.load(Ordering::Relaxed),
        }
    }

    /// Take another flag that ends calls with [`FemError::Cancelled`] where it is raised.
    pub fn cancel_by(&mut self, flag: Option<Arc<AtomicBool>>) {
        self.settings.cancel = flag;
    }

    /// Derivatives of displacement and reactions by each cause.
    ///
    /// # Errors
    ///
    /// [`FemError::NoSuchCause`] for something that the model does not have;
    /// [`FemError::WrongLength`] and [`FemError::NonFinite`] for rates that do not fit.
    ///
    /// # Cost
    ///
    /// One solution with the factor and one or two passes over the elements a cause.
    pub fn derivatives(&self, causes: &[Cause]) -> Result<Vec<Derivative>, FemError> {
        self.settings.in_pool(|| {
            self.tangent().each(causes, |cause, buffers, parallel| {
                self.settings.check_cancel()?;
                let rates = self.scene().rates(cause)?;
                self.tangent().follow(&rates, buffers, parallel)
            })
        })
    }

    /// Derivatives of each observation by everything.
    ///
    /// # Errors
    ///
    /// [`FemError::BadObservation`], [`FemError::NonFinite`].
    ///
    /// # Cost
    ///
    /// One solution with the factor and two passes over the elements an observation.
    pub fn adjoints(&self, observations: &[Observation]) -> Result<Vec<Adjoint>, FemError> {
        let scene = self.scene();
        let volumes = point_volumes(self.body.borrow().geometry());
        let by = |parameter: Parameter| -> Result<Vec<Matrix3>, FemError> {
            let mut stresses = scene.stresses_by(parameter)?;
            for (stress, volume) in stresses.iter_mut().zip(&volumes) {
                stress.iter_mut().flatten().for_each(|v| *v *= volume);
            }
            Ok(stresses)
        };
        let sources = Sources {
            young: by(Parameter::Young)?,
            poisson: by(Parameter::Poisson)?,
            springs: (0..self.springs.len())
                .map(|set| {
                    let normal = scene.rates(&Cause::SpringNormal(set))?.unbalanced;
                    Ok([normal, scene.rates(&Cause::SpringTangential(set))?.unbalanced])
                })
                .collect::<Result<_, FemError>>()?,
        };
        self.settings.in_pool(|| {
            self.tangent().each(observations, |observation, buffers, parallel| {
                self.settings.check_cancel()?;
                self.adjoint(observation, &sources, buffers, parallel)
            })
        })
    }

    fn adjoint(
        &self,
        observation: &Observation,
        sources: &Sources,
        buffers: &mut Buffers,
        parallel: bool,
    ) -> Result<Adjoint, FemError> {
        let (body, tangent) = (self.body.borrow(), self.tangent());
        let (by_node, by_held) = observation.spread(body)?;
        let mut rhs = by_node.clone();
        if by_held.iter().any(|&v| v != 0.0) {
            for (sum, value) in rhs.iter_mut().zip(tangent.product(&by_held)?) {
                *sum += value;
            }
        }
        let mut v = tangent.solve(&rhs, buffers, parallel)?;
        for (sum, value) in v.iter_mut().zip(&by_held) {
            *sum += value;
        }
        let mut at_held = tangent.product(&v)?;
        for (sum, value) in at_held.iter_mut().zip(&by_node) {
            *sum += value;
        }
        let gradients = self.map.gradients(body.geometry(), &v);
        let along = |stresses: &[Matrix3]| {
            let pairs = stresses.iter().zip(&gradients);
            pairs.map(|(p, g)| dot(p.as_flattened(), g.as_flattened())).collect()
        };
        let nodal_forces: Vec<[f64; 3]> =
            v.as_chunks::<3>().0.iter().map(|row| row.map(|x| -x)).collect();
        let mut body_force = [0.0; 3];
        for element in 0..body.n_tets() {
            for (node, weight) in body.geometry().volume_weights(element) {
                (0..3).for_each(|i| body_force[i] += weight * nodal_forces[node][i]);
            }
        }
        Ok(Adjoint {
            young: along(&sources.young),
            poisson: along(&sources.poisson),
            nodal_forces,
            body_force,
            prescribed: body.reactions(&at_held),
            springs: sources.springs.iter().map(|pair| [0, 1].map(|k| dot(&pair[k], &v))).collect(),
        })
    }

    pub(super) fn scene(&self) -> Scene<'_> {
        Scene {
            body: self.body.borrow(),
            material: &self.material,
            springs: &self.springs,
            displacement: &self.state.displacement,
            gradients: &self.gradients,
            map: &self.map,
        }
    }

    pub(super) fn tangent(&self) -> Tangent<'_> {
        let problem = Problem {
            body: self.body.borrow(),
            model: Model::Elastic(&self.material),
            surface: &self.surface,
            load: &self.load,
            settings: &self.settings,
            parallel: self.settings.is_parallel(),
            least_load: 0.0,
        };
        Tangent { problem, state: &self.state, factored: &self.factored }
    }
}

/// What every observation is weighed with.
struct Sources {
    /// `∂P/∂E` and `∂P/∂ν` times the volume of each point.
    young: Vec<Matrix3>,
    poisson: Vec<Matrix3>,
    /// Forces by the stiffness of springs along the normal and in the plane.
    springs: Vec<[Vec<f64>; 2]>,
}
