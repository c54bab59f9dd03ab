//! One equilibrium problem and the state it is in.

use crate::assembly::{
    ElementTangents, Energy, TangentKind, det_f_by_element, internal_force_into,
    tangent_product_into,
};
use crate::body::Body;
use crate::element::Element;
use crate::error::{FemError, WorstTet};
use crate::load::NodalLoad;
use crate::material::Material;
use crate::memory::StepModel;
use crate::solve::carrier::Carrier;
use crate::solve::report::SolveReport;
use crate::solve::settings::{Method, SolveSettings};
use crate::surface::{SurfaceTerms, WithFacets};
use crate::system::factor::{Entries, Factor, Making};
use crate::system::{Operator, SolveScratch};

/// What the body is made of, and what of its past matters.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Model<'a> {
    /// An elastic material.
    Elastic(&'a Material),
    /// A time step of a material with a history.
    Step(&'a StepModel<'a, Material>),
}

/// What does not change during a solve.
#[derive(Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub(crate) body: &'a Body,
    pub(crate) model: Model<'a>,
    pub(crate) surface: &'a SurfaceTerms,
    pub(crate) load: &'a NodalLoad,
    pub(crate) settings: &'a SolveSettings,
    pub(crate) parallel: bool,
    /// Force below which the norm of the load does not count as smaller, mN.
    pub(crate) least_load: f64,
}

/// A displacement with its internal forces and energy.
#[derive(Debug, Clone)]
pub(crate) struct State {
    /// `(3 n_nodes)`, mm.
    pub(crate) displacement: Vec<f64>,
    /// Internal forces, `(3 n_nodes)`, mN.
    pub(crate) force: Vec<f64>,
    pub(crate) energy: Energy,
}

impl State {
    pub(crate) fn at_rest(n_nodes: usize) -> Self {
        Self {
            displacement: vec![0.0; 3 * n_nodes],
            force: vec![0.0; 3 * n_nodes],
            energy: Energy { total: 0.0, min_det_f: 1.0 },
        }
    }
}

/// Buffers and counters of a solve; reused from member to member.
#[derive(Default)]
pub(crate) struct Workspace {
    pub(crate) report: SolveReport,
    pub(crate) solve_scratch: SolveScratch,
    /// Right-hand side and solution in another order of the unknowns.
    pub(crate) reordered: [Vec<f64>; 2],
    pub(super) carrier: Carrier,
    element_forces: Vec<f64>,
}

impl Problem<'_> {
    /// Evaluate the forces and energy of `state.displacement`; false where an element is inverted.
    pub(crate) fn evaluate(&self, state: &mut State, workspace: &mut Workspace) -> bool {
        workspace.report.evaluations += 1;
        let (geometry, buffer) = (self.body.geometry(), &mut workspace.element_forces);
        let (u, force) = (&state.displacement, &mut state.force);
        let inner = match self.model {
            Model::Elastic(model) => {
                internal_force_into(geometry, model, u, force, buffer, self.parallel)
            }
            Model::Step(model) => {
                internal_force_into(geometry, model, u, force, buffer, self.parallel)
            }
        };
        let Some(mut energy) = inner else { return false };
        energy.total += self.surface.add_force(u, force);
        state.energy = energy;
        energy.total.is_finite()
    }

    /// Residual `f_int − fraction f_ext` on the unknowns.
    pub(crate) fn residual_into(&self, state: &State, fraction: f64, residual: &mut [f64]) {
        for (r, &flat) in residual.iter_mut().zip(&self.body.pattern().unknown2flat) {
            *r = state.force[flat as usize] - fraction * self.load.force[flat as usize];
        }
    }

    /// Potential energy `W − fraction fᵀu`, µJ.
    pub(crate) fn potential(&self, state: &State, fraction: f64) -> f64 {
        state.energy.total - fraction * dot(&self.load.force, &state.displacement)
    }

    /// Norm against which the residual is measured: that of the load on free unknowns, or of the
    /// reactions where supports are moved and these are larger.
    pub(crate) fn load_norm(&self, state: &State, fraction: f64) -> f64 {
        let mut applied = 0.0;
        let mut reaction = 0.0;
        for (flat, &held) in self.body.held().as_flattened().iter().enumerate() {
            let external = fraction * self.load.force[flat];
            if held {
                reaction += (state.force[flat] - external).powi(2);
            } else {
                applied += external * external;
            }
        }
        let largest = if self.load.moves_supports { applied.max(reaction) } else { applied };
        largest.sqrt().max(fraction * self.least_load)
    }

    /// Factor of the tangent at a state, in the entries that the method wants.
    pub(crate) fn factor(&self, state: &State, kind: TangentKind) -> Result<Factor, FemError> {
        let averaged = self.body.element() == Element::Tet4Averaged;
        let entries = match self.settings.method {
            Method::Newton => Entries::Double,
            // Near incompressibility the exact tangent of averaged elements is indefinite on the
            // way, and a second look in double precision finds the same.
            _ if averaged && kind == TangentKind::Exact => Entries::Compact,
            Method::Auto | Method::QuasiNewton => Entries::CompactOrDouble,
        };
        self.factor_in(state, kind, entries)
    }

    /// The same in chosen entries.
    pub(crate) fn factor_in(
        &self,
        state: &State,
        kind: TangentKind,
        entries: Entries,
    ) -> Result<Factor, FemError> {
        let (geometry, u) = (self.body.geometry(), state.displacement.as_slice());
        let fronts = &self.body.pattern().fronts;
        let facets = self.surface.blocks(Some(u));
        let making = Making { parallel: self.parallel, cancel: self.settings.cancel.as_deref() };
        match self.model {
            Model::Elastic(model) => {
                let elements = ElementTangents::new(geometry, model, u, kind);
                let matrix = WithFacets { elements, facets: &facets };
                Factor::new(fronts, &matrix, entries, making)
            }
            Model::Step(model) => {
                let elements = ElementTangents::new(geometry, model, u, kind);
                let matrix = WithFacets { elements, facets: &facets };
                Factor::new(fronts, &matrix, entries, making)
            }
        }
    }

    /// Rows of the exact tangent at a state, of the nodes that are wanted; none where an element is
    /// inverted.
    pub(crate) fn operator(&self, state: &State, wanted: &[bool]) -> Option<Operator> {
        let (geometry, u) = (self.body.geometry(), state.displacement.as_slice());
        let kind = TangentKind::Exact;
        let facets = self.surface.blocks(Some(u));
        match self.model {
            Model::Elastic(model) => {
                let elements = ElementTangents::new(geometry, model, u, kind);
                let matrix = WithFacets { elements, facets: &facets };
                Operator::new(geometry.cliques(), &matrix, wanted)
            }
            Model::Step(model) => {
                let elements = ElementTangents::new(geometry, model, u, kind);
                let matrix = WithFacets { elements, facets: &facets };
                Operator::new(geometry.cliques(), &matrix, wanted)
            }
        }
    }

    /// Tangent at a state times a direction `(3 n_nodes)`; none where an element is inverted.
    pub(crate) fn tangent_product(&self, state: &State, direction: &[f64]) -> Option<Vec<f64>> {
        let all: Vec<usize> = (0..self.body.n_tets()).collect();
        self.product_of(state, direction, &all)
    }

    /// The same, right in rows of held nodes; in all rows where only held components move.
    pub(crate) fn product_at_supports(&self, state: &State, direction: &[f64]) -> Option<Vec<f64>> {
        let (geometry, held) = (self.body.geometry(), self.body.held());
        let is_held = |&node: &u32| held[node as usize].contains(&true);
        let touched = |element: &usize| geometry.nodes_of(*element).iter().any(is_held);
        let elements: Vec<usize> = (0..self.body.n_tets()).filter(touched).collect();
        self.product_of(state, direction, &elements)
    }

    fn product_of(&self, state: &State, direction: &[f64], elements: &[usize]) -> Option<Vec<f64>> {
        let mut product = vec![0.0; direction.len()];
        let (geometry, u) = (self.body.geometry(), &state.displacement);
        let upright = match self.model {
            Model::Elastic(model) => {
                tangent_product_into(geometry, model, u, direction, elements, &mut product)
            }
            Model::Step(model) => {
                tangent_product_into(geometry, model, u, direction, elements, &mut product)
            }
        };
        self.surface.add_product(u, direction, &mut product);
        upright.then_some(product)
    }

    /// The five tetrahedra closest to inversion, worst first.
    pub(crate) fn worst_tets(&self, displacement: &[f64]) -> Vec<WorstTet> {
        let mut all: Vec<WorstTet> = det_f_by_element(self.body.geometry(), displacement)
            .into_iter()
            .enumerate()
            .map(|(tet, det_f)| WorstTet { tet, det_f })
            .collect();
        all.sort_by(|a, b| a.det_f.total_cmp(&b.det_f));
        all.truncate(5);
        all
    }

    pub(crate) fn check_cancel(&self) -> Result<(), FemError> {
        self.settings.check_cancel()
    }
}

/// Scalar product, summed in eight fixed lanes.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f64 = a_chunks.remainder().iter().zip(b_chunks.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a_chunks.zip(b_chunks) {
        for k in 0..8 {
            lanes[k] += x[k] * y[k];
        }
    }
    lanes.iter().sum::<f64>() + tail
}

/// Euclidean norm.
pub(crate) fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}
