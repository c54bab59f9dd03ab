//! Static equilibrium of one body under one load.
//!
//! Sought is the displacement `u (3 n_nodes)` with prescribed values at held nodes that minimises
//! the potential energy `Π(u) = W(u) − fᵀu`; its residual `r = f_int(u) − f` vanishes on the free
//! unknowns. Modules, from the inside out: `problem` evaluates a state, `metric` holds factors
//! and `carrier` carries them along, `lbfgs` and `line_search` make a step, `minimise` repeats it,
//! `load_steps` leads to the load.

mod carrier;
mod inspect;
mod lbfgs;
mod line_search;
mod load_steps;
mod metric;
mod minimise;
mod problem;
mod report;
mod settings;
mod support_path;

use std::time::Instant;

pub use inspect::{internal_forces, is_stable, spring_forces};
pub(crate) use metric::{Metric, SharedRest};
pub use report::{Solution, SolveReport, StageSeconds};
pub use settings::{LoadSteps, Method, Precision, SolveSettings};

use crate::body::Body;
use crate::check::{check_finite, check_length};
use crate::error::FemError;
use crate::load::{Load, NodalLoad};
use crate::material::Material;
use crate::surface::SurfaceTerms;
use load_steps::Path;
use minimise::Minimiser;
use problem::Workspace;
pub(crate) use problem::{Model, Problem, State, dot, norm};
use support_path::SupportPath;

/// Find the equilibrium of a body under a load, from rest.
///
/// # Units
///
/// mm, mN, kPa.
///
/// # Errors
///
/// [`FemError::NoEquilibrium`] with the last good load fraction and the worst tetrahedra;
/// [`FemError::Cancelled`]; [`FemError::SingularStiffness`] and [`FemError::TooLarge`] from the
/// first factor; [`FemError::WrongLength`], [`FemError::NonFinite`] and [`FemError::BadSetting`]
/// for wrong input.
///
/// # Cost
///
/// One factorisation (none where the body keeps the factor of a proportional stiffness) and, per
/// iteration, one solve with it and one pass over the elements; 20 to 60 iterations to 1e-9.
///
/// # Examples
///
/// A cube of 10 mm, clamped below, its top pulled up by 1 mm:
///
/// ```
/// use tissuereg_fem::{Body, Element, Load, Material, Mesh, SolveSettings, solve};
///
/// let corner = |i: usize| [10.0 * (i & 1) as f64, 5.0 * (i & 2) as f64, 2.5 * (i & 4) as f64];
/// let nodes: Vec<[f64; 3]> = (0..8).map(corner).collect();
/// let tets = vec![[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];
/// let body = Body::new(Mesh::new(nodes, tets)?, Element::Tet4, [0, 1, 2, 3, 4, 5, 6, 7])?;
/// let up = |z: f64| if z > 0.0 { [0.0, 0.0, 1.0] } else { [0.0; 3] };
/// let load = Load::from_prescribed(body.nodes().iter().map(|x| up(x[2])).collect());
/// let answer = solve(&body, &Material::neo_hookean(10.0, 0.3)?, &load, &SolveSettings::default())?;
/// let pull: f64 = answer.reactions[4..].iter().map(|r| r[2]).sum();
/// assert!(pull > 100.0, "the top is pulled with {pull} mN");
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
pub fn solve(
    body: &Body,
    material: &Material,
    load: &Load,
    settings: &SolveSettings,
) -> Result<Solution, FemError> {
    settings.in_pool(|| {
        let parallel = settings.is_parallel();
        let mut solver = Solver::new(body, parallel);
        settings.awake(|| {
            solver.solve(Task { material, load, start: None }, settings, || {
                Metric::at_rest(body, material, &load.springs, parallel)
            })
        })
    })
}

/// Find the equilibrium of a body under a load, starting from a displacement.
///
/// A start close to the answer saves iterations; where it leads nowhere, the search begins again
/// at rest. Where several equilibria exist, the start may decide which is found.
///
/// # Shapes
///
/// `start` one row per node of the body, mm. Its held nodes are moved to where the load has them.
///
/// # Errors
///
/// As [`solve`], and [`FemError::InvertedStart`].
pub fn solve_from(
    body: &Body,
    material: &Material,
    load: &Load,
    start: &[[f64; 3]],
    settings: &SolveSettings,
) -> Result<Solution, FemError> {
    settings.in_pool(|| {
        let parallel = settings.is_parallel();
        let mut solver = Solver::new(body, parallel);
        solver.solve(Task { material, load, start: Some(start) }, settings, || {
            Metric::at_rest(body, material, &load.springs, parallel)
        })
    })
}

/// What one solve is about.
#[derive(Clone, Copy)]
pub(crate) struct Task<'a> {
    pub(crate) material: &'a Material,
    pub(crate) load: &'a Load,
    pub(crate) start: Option<&'a [[f64; 3]]>,
}

/// A body with the buffers of a solve; made once a thread.
pub(crate) struct Solver<'a> {
    body: &'a Body,
    parallel: bool,
    minimiser: Minimiser,
    workspace: Workspace,
}

impl<'a> Solver<'a> {
    pub(crate) fn new(body: &'a Body, parallel: bool) -> Self {
        let minimiser = Minimiser::new(body.n_nodes(), body.n_unknowns());
        Self { body, parallel, minimiser, workspace: Workspace::default() }
    }

    /// Solve one task with the metric that `rest_metric` returns.
    pub(crate) fn solve(
        &mut self,
        task: Task,
        settings: &SolveSettings,
        rest_metric: impl FnOnce() -> Result<Metric, FemError>,
    ) -> Result<Solution, FemError> {
        let load = NodalLoad::new(self.body, task.load)?;
        let surface = surface_of(self.body, task.load)?;
        task.material.check_size(self.body.n_tets(), self.body.element().n_points())?;
        let problem = Problem {
            body: self.body,
            model: Model::Elastic(task.material),
            surface: &surface,
            load: &load,
            settings,
            parallel: self.parallel,
            least_load: 0.0,
        };
        let start = start_state(&problem, task.start)?;
        let (state, report) = self.find(&problem, start, rest_metric)?;
        Ok(solution(&problem, &state, report))
    }

    /// Evaluate the forces of a state; false where an element is inverted.
    pub(crate) fn evaluate(&mut self, problem: &Problem, state: &mut State) -> bool {
        problem.evaluate(state, &mut self.workspace)
    }

    /// Find the equilibrium of a problem from a state; from rest where none is given.
    pub(crate) fn find(
        &mut self,
        problem: &Problem,
        start: Option<State>,
        rest_metric: impl FnOnce() -> Result<Metric, FemError>,
    ) -> Result<(State, SolveReport), FemError> {
        let begin = Instant::now();
        problem.settings.check()?;
        problem.settings.check_cancel()?;
        let workspace = &mut self.workspace;
        workspace.report = SolveReport { analyses: 1, factorisations: 1, ..SolveReport::default() };
        let metric = rest_metric()?;
        workspace.report.seconds.factor = begin.elapsed().as_secs_f64();

        let minimiser = &mut self.minimiser;
        let allowed = 2.0 * problem.settings.max_iterations as f64;
        let supports = SupportPath::new(self.body, problem.load);
        let state = Path { problem, minimiser, workspace, metric, supports, allowed }.run(start)?;
        let mut report = self.workspace.report;
        report.seconds.iterate = begin.elapsed().as_secs_f64() - report.seconds.factor;
        Ok((state, report))
    }
}

/// Springs of a load, checked against a body.
pub(crate) fn surface_of(body: &Body, load: &Load) -> Result<SurfaceTerms, FemError> {
    body.supports().check_springs(&load.springs)?;
    SurfaceTerms::new(body, &load.springs)
}

/// What a state in equilibrium means to the caller.
pub(crate) fn solution(problem: &Problem, state: &State, report: SolveReport) -> Solution {
    let unbalanced: Vec<f64> =
        state.force.iter().zip(&problem.load.force).map(|(inner, outer)| inner - outer).collect();
    Solution {
        displacement: state.displacement.as_chunks::<3>().0.to_vec(),
        reactions: problem.body.reactions(&unbalanced),
        spring_forces: problem.surface.spring_forces(&state.displacement),
        report,
    }
}

/// Checked state to start from; none where nothing is given.
fn start_state(problem: &Problem, start: Option<&[[f64; 3]]>) -> Result<Option<State>, FemError> {
    let Some(rows) = start else { return Ok(None) };
    check_length("start displacement (one row a node)", problem.body.n_nodes(), rows.len())?;
    check_finite("start displacement", rows)?;
    let mut state = State::at_rest(problem.body.n_nodes());
    state.displacement.copy_from_slice(rows.as_flattened());
    let worst = problem.worst_tets(&state.displacement);
    if let Some(worst) = worst.first().filter(|w| w.det_f.is_nan() || w.det_f <= 0.0) {
        return Err(FemError::InvertedStart { tet: worst.tet, det_f: worst.det_f });
    }
    Ok(Some(state))
}
