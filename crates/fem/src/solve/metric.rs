//! The metric of the iteration: a factor of a tangent, times a scale.
//!
//! The undeformed stiffness is linear in Young's modulus. Its factor is made for the *shape* of a
//! stiffness field: moduli divided by the largest and rounded to 24 bits, so that proportional
//! fields share a factor and its bits depend on nothing but the shape. A metric need not be exact.
//! It follows the body as `carrier` describes.
//!
//! That of averaged linear tets is the stiffness of plain ones with a moderate Poisson's ratio, as
//! long as their own is not above [`PLAIN_LIMIT`]: averaging takes the energy of volume changes that
//! alternate from element to element, so that of both the softer is the better guide. It costs a
//! third of a solve and a sixth of a factor.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use crate::assembly::{ElementTangents, TangentKind};
use crate::body::Body;
use crate::element::Element;
use crate::error::FemError;
use crate::material::{Material, Matrix3, Shape};
use crate::solve::carrier::inverse_deformations;
use crate::solve::problem::{Problem, State, Workspace};
use crate::springs::Springs;
use crate::surface::{SurfaceTerms, WithFacets};
use crate::system::factor::{Entries, Factor, Making};
use crate::system::{Fronts, PlainOrder};

/// Largest Poisson's ratio at which plain tets serve averaged ones as a metric. Measured on a dome of
/// 4,000 nodes (to 1e-6): 24 iterations instead of 19 at 0.45, 53 instead of 14 with one more factor
/// at 0.49, 250 instead of 43 at 0.4995; carried along, 21 at 0.45 and 45 at 0.49.
const PLAIN_LIMIT: f64 = 0.491;

/// Largest Poisson's ratio of the plain tets. Measured from 0.3 to 0.49: iterations are fewest
/// between 0.4 and 0.45.
const PLAIN_POISSON: f64 = 0.42;

/// Factor of `K / scale⁻¹`: a solve with it is multiplied by `scale`.
#[derive(Debug, Clone)]
pub(crate) struct Metric {
    factor: Arc<Factor>,
    scale: f64,
    /// Whether the factor is that of plain tets, on a body of averaged ones.
    plain: bool,
    /// Inverse deformations at the nodes where the factor was made; none at rest.
    made_at: Option<Arc<Vec<Matrix3>>>,
}

impl Metric {
    /// The factor of the undeformed stiffness of a material, that which the body keeps or a new one,
    /// which it keeps then.
    pub(crate) fn at_rest(
        body: &Body,
        material: &Material,
        springs: &[Springs],
        parallel: bool,
    ) -> Result<Self, FemError> {
        let (shape, young) = Shape::of(material, springs);
        let (scale, plain) = (1.0 / young, is_plain(&shape, body));
        let factor = match body.kept_factor(&shape) {
            Some(factor) => factor,
            None => {
                let factor = Arc::new(rest_factor(&shape, body, parallel)?);
                body.keep_factor(shape, &factor);
                factor
            }
        };
        Ok(Self { factor, scale, plain, made_at: None })
    }

    /// A factor of the tangent at a displacement, `(3 n_nodes)` mm.
    pub(crate) fn made_at(
        body: &Body,
        factor: Arc<Factor>,
        displacement: &[f64],
        parallel: bool,
    ) -> Self {
        let maps = inverse_deformations(body.nodal_gradients(), displacement, parallel);
        Self { factor, scale: 1.0, plain: false, made_at: Some(Arc::new(maps)) }
    }

    /// Carry the metric along to a state.
    pub(crate) fn follow(&self, problem: &Problem, state: &State, workspace: &mut Workspace) {
        let gradients = problem.body.nodal_gradients();
        let made_at = self.made_at.as_ref().map(|maps| maps.as_slice());
        workspace.carrier.lead_to(gradients, &state.displacement, made_at, problem.parallel);
    }

    /// Write `F K⁻¹ Fᵀ rhs` to `out`, with the maps of the state that was followed last.
    pub(crate) fn apply_into(
        &self,
        problem: &Problem,
        rhs: &[f64],
        out: &mut [f64],
        workspace: &mut Workspace,
    ) {
        let unknowns = &problem.body.pattern().unknown2flat;
        let mut carrier = std::mem::take(&mut workspace.carrier);
        carrier.carry_back(unknowns, rhs);
        self.solve_into(problem, &carrier.carried, out, workspace);
        carrier.carry_on(unknowns, out);
        workspace.carrier = carrier;
    }

    /// Write `K⁻¹ rhs` to `out`.
    fn solve_into(
        &self,
        problem: &Problem,
        rhs: &[f64],
        out: &mut [f64],
        workspace: &mut Workspace,
    ) {
        workspace.report.solves += 1;
        let Workspace { solve_scratch, reordered: [own_rhs, own_out], .. } = workspace;
        let parallel = problem.parallel;
        let Some(order) = self.order(problem.body) else {
            let fronts = &problem.body.pattern().fronts;
            return self.factor.solve_into(fronts, self.scale, rhs, out, solve_scratch, parallel);
        };
        order.take(rhs, own_rhs);
        own_out.resize(rhs.len(), 0.0);
        let fronts = &order.pattern.fronts;
        self.factor.solve_into(fronts, self.scale, own_rhs, own_out, solve_scratch, parallel);
        order.give(own_out, out);
    }

    /// Order of the unknowns of the factor, where it is not that of the body.
    fn order<'b>(&self, body: &'b Body) -> Option<&'b PlainOrder> {
        // There is one: the factor was made with it.
        if self.plain { body.plain_order().ok() } else { None }
    }

    fn fronts<'b>(&self, body: &'b Body) -> &'b Fronts {
        self.order(body).map_or(&body.pattern().fronts, |order| &order.pattern.fronts)
    }

    /// Euclidean norm of the diagonal of the matrix, mN/mm.
    pub(crate) fn diagonal_norm(&self, problem: &Problem) -> f64 {
        self.factor.diagonal_norm(self.fronts(problem.body)) / self.scale
    }

    /// Time of a solve with a renewed metric over that of one with this.
    pub(crate) fn lightness(&self, problem: &Problem) -> f64 {
        let entries = |fronts: &Fronts| fronts.n_entries as f64;
        match self.order(problem.body) {
            Some(order) => entries(&problem.body.pattern().fronts) / entries(&order.pattern.fronts),
            None => 1.0,
        }
    }

    /// Replace by the tangent at a state; carried along to it where no factor of that can be made.
    ///
    /// # Errors
    ///
    /// [`FemError::TooLarge`].
    pub(crate) fn renew(
        &mut self,
        problem: &Problem,
        state: &State,
        workspace: &mut Workspace,
    ) -> Result<(), FemError> {
        match Self::at_state(problem, state, workspace) {
            Ok(metric) => *self = metric,
            Err(FemError::SingularStiffness { .. }) => {}
            Err(error) => return Err(error),
        }
        self.follow(problem, state, workspace);
        Ok(())
    }

    /// Metric of the tangent at a state; positive definite by clamping where the tangent is not.
    fn at_state(
        problem: &Problem,
        state: &State,
        workspace: &mut Workspace,
    ) -> Result<Self, FemError> {
        let start = Instant::now();
        let mut result = Err(FemError::SingularStiffness { pivot: 0, n_dofs: 0 });
        for kind in [TangentKind::Exact, TangentKind::Clamped] {
            workspace.report.factorisations += 1;
            result = problem.factor(state, kind);
            if !matches!(result, Err(FemError::SingularStiffness { .. })) {
                break;
            }
        }
        let gradients = problem.body.nodal_gradients();
        let (u, parallel) = (&state.displacement, problem.parallel);
        let made_at = Some(Arc::new(inverse_deformations(gradients, u, parallel)));
        workspace.report.seconds.factor += start.elapsed().as_secs_f64();
        Ok(Self { factor: Arc::new(result?), scale: 1.0, plain: false, made_at })
    }
}

/// Whether plain tets make the factor of a shape on a body.
fn is_plain(shape: &Shape, body: &Body) -> bool {
    body.element() == Element::Tet4Averaged
        && shape.springs.is_empty()
        && shape.poisson.iter().all(|&nu| nu <= PLAIN_LIMIT)
}

/// Factor of the undeformed stiffness of a shape.
fn rest_factor(shape: &Shape, body: &Body, parallel: bool) -> Result<Factor, FemError> {
    let at_rest = vec![0.0; 3 * body.n_nodes()];
    let kind = TangentKind::Exact;
    let making = Making { parallel, cancel: None };
    if is_plain(shape, body) {
        let material = shape.material(PLAIN_POISSON)?;
        let elements = ElementTangents::without_patches(body.geometry(), &material, &at_rest, kind);
        let fronts = &body.plain_order()?.pattern.fronts;
        return Factor::new(fronts, &elements, Entries::CompactOrDouble, making);
    }
    let material = shape.material(1.0)?;
    let elements = ElementTangents::new(body.geometry(), &material, &at_rest, kind);
    let surface = SurfaceTerms::new(body, &shape.springs)?;
    let matrix = WithFacets { elements, facets: &surface.blocks(None) };
    Factor::new(&body.pattern().fronts, &matrix, Entries::CompactOrDouble, making)
}

/// Rest factor shared by the members of one group of an ensemble.
#[derive(Debug)]
pub(crate) struct SharedRest {
    shape: Shape,
    slot: Mutex<(Option<Arc<Factor>>, usize)>,
}

impl SharedRest {
    /// For `n_members` members; the factor is dropped after the last has taken it.
    pub(crate) fn new(shape: Shape, n_members: usize) -> Self {
        Self { shape, slot: Mutex::new((None, n_members)) }
    }

    /// The factor, made by the first member that needs it while the others wait.
    pub(crate) fn metric(&self, body: &Body, young: f64) -> Result<Metric, FemError> {
        let mut slot = match self.slot.lock() {
            Ok(slot) => slot,
            Err(poisoned) => poisoned.into_inner(),
        };
        let factor = match slot.0.take() {
            Some(factor) => factor,
            None => Arc::new(rest_factor(&self.shape, body, false)?),
        };
        slot.1 = slot.1.saturating_sub(1);
        if slot.1 > 0 {
            slot.0 = Some(Arc::clone(&factor));
        }
        let (scale, plain) = (1.0 / young, is_plain(&self.shape, body));
        Ok(Metric { factor, scale, plain, made_at: None })
    }
}
