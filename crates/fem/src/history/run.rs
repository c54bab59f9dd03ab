//! A body's history, frame by frame.

use std::borrow::Cow;
use std::sync::Arc;

use crate::assembly::gradients_at_points;
use crate::body::Body;
use crate::check::check_length;
use crate::error::{FemError, NoEquilibrium};
use crate::load::{Load, NodalLoad};
use crate::material::Material;
use crate::memory::{Behaviour, StepModel, StepState, fresh_states};
use crate::solve::{
    LoadSteps, Metric, Model, Problem, Solution, SolveReport, SolveSettings, Solver, State, norm,
    solution, surface_of,
};
use crate::surface::{Slip, SurfaceTerms};

/// Iterations after which a time step is halved.
const STEP_ITERATIONS: usize = 200;

/// Searches in which the pressure under which springs slip is made to agree with the end of a step, and
/// how far it may then be off, as a share of it.
const MOST_PRESSURES: usize = 12;
const SAME_PRESSURE: f64 = 1e-3;

/// Smallest part of the time between two frames.
const SMALLEST_PART: f64 = 1.0 / 64.0;

/// What a body of one material has been through, and the shape that it is in now.
///
/// Every [`advance`](Self::advance) leads to the equilibrium of a next time frame, starting from
/// the last one. Inertia plays no part. The supports may change between frames (see [`Rig`]); nodes
/// and tetrahedra stay the same.
///
/// [`Rig`]: crate::Rig
///
/// # Examples
///
/// A stretched body that relaxes to half of its first force:
///
/// ```
/// use tissuereg_fem::{Behaviour, Body, Element, History, Load, Material, Mesh, Relaxation};
/// use tissuereg_fem::SolveSettings;
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2, 3])?;
/// let relaxation = Relaxation { g: vec![0.5], tau_s: vec![2.0], ..Relaxation::default() };
/// let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
/// let mut history = History::new(&body, Material::neo_hookean(10.0, 0.4)?, behaviour)?;
///
/// let mut rows = vec![[0.0; 3]; 4];
/// rows[3][2] = 1.0;
/// let stretch = Load::from_prescribed(rows);
/// let settings = SolveSettings::default();
/// let first = history.advance(&body, &stretch, 0.0, &settings)?.reactions[3][2];
/// let last = history.advance(&body, &stretch, 100.0, &settings)?.reactions[3][2];
/// assert!((last / first - 0.5).abs() < 1e-12);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug, Clone)]
pub struct History {
    material: Material,
    behaviour: Behaviour,
    n_points: usize,
    now: Now,
    spare: Spare,
}

/// Room for the states at the end of a next step: those of an earlier one. A copy of a history begins without.
#[derive(Debug, Default)]
struct Spare(Vec<f64>);

impl Clone for Spare {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Where a history has come to.
#[derive(Debug, Clone)]
struct Now {
    /// None before the first frame.
    time_s: Option<f64>,
    /// `(3 n_nodes)`, mm.
    displacement: Vec<f64>,
    /// Loads of the last frame, `(3 n_nodes)`, mN.
    force: Vec<f64>,
    /// What the quadrature points remember; shared until the end of a step.
    states: Arc<Vec<f64>>,
    /// One per point of the springs that may slip; none before the first step with such.
    slips: Vec<Slip>,
    /// Largest norm of a load so far, mN: a residual small compared with it is no force.
    largest_load: f64,
}

impl History {
    /// A body that has been through nothing.
    ///
    /// # Errors
    ///
    /// Those of [`Behaviour::check`], and [`FemError::WrongLength`] where the material's field does
    /// not fit the body.
    pub fn new(body: &Body, material: Material, behaviour: Behaviour) -> Result<Self, FemError> {
        behaviour.check()?;
        material.check_size(body.n_tets(), body.element().n_points())?;
        let n = 3 * body.n_nodes();
        let n_points = body.n_tets() * body.element().n_points();
        let now = Now {
            time_s: None,
            displacement: vec![0.0; n],
            force: vec![0.0; n],
            states: Arc::new(fresh_states(&behaviour, n_points)),
            slips: Vec::new(),
            largest_load: 0.0,
        };
        Ok(Self { material, behaviour, n_points, now, spare: Spare::default() })
    }

    /// Time of the last frame, s; none before the first.
    pub fn time_s(&self) -> Option<f64> {
        self.now.time_s
    }

    /// Displacement of every node of the body at the last frame, mm.
    pub fn displacement(&self) -> &[[f64; 3]] {
        self.now.displacement.as_chunks::<3>().0
    }

    /// What the material does beyond its elastic law.
    pub fn behaviour(&self) -> &Behaviour {
        &self.behaviour
    }

    /// Go to the equilibrium of a next time frame.
    ///
    /// The first frame is reached at once, whatever its time: the answer is the elastic one. So is
    /// a frame at the time of the last one: nothing relaxes and nothing flows. Between frames,
    /// forces and prescribed displacements grow linearly; springs are those of the new load. Where
    /// no equilibrium is found the time step is halved, down to 1/64 of it; the report then counts
    /// several load steps. Where that fails as well, the history is left as it was.
    ///
    /// The report's energy is that of the incremental problem (its formula heads the module `memory` of the sources).
    ///
    /// # Errors
    ///
    /// As [`solve`](crate::solve), and [`FemError::TimeRunsBack`], [`FemError::WrongLength`] for a
    /// body with other nodes, [`FemError::NonFinite`] for a time that is no number. The fractions
    /// in [`FemError::NoEquilibrium`] are those of the time step.
    ///
    /// # Cost
    ///
    /// That of a solve from a good start, with two evaluations of the law a point where parts of
    /// the energy have to be separated.
    pub fn advance(
        &mut self,
        body: &Body,
        load: &Load,
        time_s: f64,
        settings: &SolveSettings,
    ) -> Result<Solution, FemError> {
        self.advance_held(body, load, Given::default(), time_s, settings)
    }

    /// The same with more that is given.
    pub(super) fn advance_held(
        &mut self,
        body: &Body,
        load: &Load,
        given: Given,
        time_s: f64,
        settings: &SolveSettings,
    ) -> Result<Solution, FemError> {
        self.check_frame(body, time_s)?;
        let mut target = NodalLoad::new(body, load)?;
        let Given { prescribed, guess } = given;
        if let Some(prescribed) = prescribed {
            target.moves_supports = prescribed.iter().any(|&v| v != 0.0);
            target.prescribed = prescribed;
        }
        let surface = surface_of(body, load)?;
        let mut now = self.now.clone();
        let mut spare = std::mem::take(&mut self.spare);
        let frame = Frame { history: self, body, load, target, guess, surface, time_s, settings };
        let answer = settings.in_pool(|| frame.reach(&mut now, &mut spare.0))?;
        let before = std::mem::replace(&mut self.now, now);
        self.spare = spare;
        self.make_room(before);
        Ok(answer)
    }

    /// A copy that goes on from here, in the room that this history has for next states.
    pub(super) fn branch(&mut self) -> Self {
        let spare = std::mem::take(&mut self.spare);
        Self { spare, ..self.clone() }
    }

    /// Go on as `next`, a branch that went on from here.
    pub(super) fn go_on_as(&mut self, next: Self) {
        let before = std::mem::replace(self, next);
        self.make_room(before.now);
    }

    /// Where its states are, and the room for the next ones.
    #[cfg(test)]
    pub(super) fn rooms(&self) -> [*const f64; 2] {
        [self.now.states.as_ptr(), self.spare.0.as_ptr()]
    }

    /// Keep the states of an earlier frame, if nothing else shares them, as room for the next ones.
    fn make_room(&mut self, before: Now) {
        if let Ok(states) = Arc::try_unwrap(before.states) {
            self.spare = Spare(states);
        }
    }

    fn check_frame(&self, body: &Body, time_s: f64) -> Result<(), FemError> {
        let n_nodes = self.now.displacement.len() / 3;
        check_length("body (nodes of the history)", n_nodes, body.n_nodes())?;
        let n_points = body.n_tets() * body.element().n_points();
        check_length("body (points of the history)", self.n_points, n_points)?;
        if !time_s.is_finite() {
            return Err(FemError::BadParameter { name: "time_s", must: "finite", found: time_s });
        }
        match self.now.time_s {
            Some(last_s) if time_s < last_s => Err(FemError::TimeRunsBack { time_s, last_s }),
            _ => Ok(()),
        }
    }
}

/// Input of a frame other than its load; each `(3 n_nodes)`, mm.
#[derive(Debug, Default)]
pub(super) struct Given {
    /// The displacement that all held nodes are given, in place of that of the load.
    pub(super) prescribed: Option<Vec<f64>>,
    /// The displacement that is expected.
    pub(super) guess: Option<Vec<f64>>,
}

/// A time frame to be reached.
struct Frame<'a> {
    history: &'a History,
    body: &'a Body,
    load: &'a Load,
    target: NodalLoad,
    guess: Option<Vec<f64>>,
    surface: SurfaceTerms,
    time_s: f64,
    settings: &'a SolveSettings,
}

impl Frame<'_> {
    /// Lead `now` to the frame, in as many steps as it takes; `spare`: room for states.
    fn reach(&self, now: &mut Now, spare: &mut Vec<f64>) -> Result<Solution, FemError> {
        let start = now.clone();
        let mut solver = Solver::new(self.body, self.settings.is_parallel());
        let mut total = SolveReport::default();
        let (mut done, mut part) = (0.0, 1.0);
        loop {
            let to = if done + 1.01 * part >= 1.0 { 1.0 } else { done + part };
            match self.step(&mut solver, &start, now, spare, to) {
                Ok(mut answer) => {
                    total = sum(&total, &answer.report);
                    done = to;
                    if done >= 1.0 {
                        answer.report = total;
                        return Ok(answer);
                    }
                }
                Err(FemError::NoEquilibrium(failure)) => {
                    total.iterations += failure.iterations;
                    part *= 0.5;
                    if part < SMALLEST_PART || start.time_s.is_none() {
                        let whole = start.time_s.is_none();
                        return Err(FemError::NoEquilibrium(Box::new(NoEquilibrium {
                            load_fraction: if whole { failure.load_fraction } else { done },
                            tried_fraction: if whole { failure.tried_fraction } else { to },
                            iterations: total.iterations,
                            ..*failure
                        })));
                    }
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// One time step: from `now` to the fraction `to` of the way from `start` to the frame.
    fn step(
        &self,
        solver: &mut Solver,
        start: &Now,
        now: &mut Now,
        spare: &mut Vec<f64>,
        to: f64,
    ) -> Result<Solution, FemError> {
        let parallel = self.settings.is_parallel();
        let time = match start.time_s {
            Some(before) => before + to * (self.time_s - before),
            None => self.time_s,
        };
        let length = now.time_s.map_or(0.0, |last| time - last);
        let n_points = self.body.element().n_points();
        let behaviour = &self.history.behaviour;
        let elastic = &self.history.material;
        let step =
            StepState::new(elastic, behaviour, &now.states, n_points, length, time, parallel);
        let model = StepModel { elastic, step: &step };
        let load = self.load_at(start, to);
        let settings = match start.time_s {
            Some(_) => SolveSettings {
                load_steps: LoadSteps::Equal(1),
                max_iterations: self.settings.max_iterations.min(STEP_ITERATIONS),
                ..self.settings.clone()
            },
            None => self.settings.clone(),
        };
        let mut surface = self.surface_after(now)?;
        let mut problem = Problem {
            body: self.body,
            model: Model::Step(&model),
            surface: &self.surface,
            load: &load,
            settings: &settings,
            parallel,
            least_load: now.largest_load,
        };
        let mut state = State::at_rest(self.body.n_nodes());
        state.displacement.clone_from(&now.displacement);
        let first = Problem { surface: &surface, ..problem };
        problem.least_load = solver.unbalanced(&first, &mut state).max(now.largest_load);
        let springs = &self.load.springs;
        let rest = || Metric::at_rest(self.body, elastic, springs, parallel);
        let guessed = self.guess.as_ref().filter(|_| to >= 1.0);
        let near = guessed.map(|guess| self.near(guess));
        let first = Problem { surface: &surface, ..problem };
        let found = match near.map(|near| solver.find(&first, Some(near), rest)) {
            // A guess that leads nowhere is none.
            None | Some(Err(FemError::NoEquilibrium(_))) => solver.find(&first, Some(state), rest),
            Some(found) => found,
        };
        let (mut state, mut report) = found?;
        for _ in 1..MOST_PRESSURES {
            let pressed = surface.slips_after(&state.displacement, false);
            if Slip::apart(&surface.slips(), &pressed) < SAME_PRESSURE {
                break;
            }
            surface.to_mut().go_on_from(&pressed);
            let (next, more) =
                solver.find(&Problem { surface: &surface, ..problem }, Some(state), rest)?;
            (state, report) = (next, sum(&report, &more));
        }
        let problem = Problem { surface: &surface, ..problem };

        let gradients = gradients_at_points(self.body.geometry(), &state.displacement);
        let Some(states) = step.updated(elastic, &gradients, std::mem::take(spare), parallel)
        else {
            let worst = problem.worst_tets(&state.displacement);
            let (tet, det_f) = worst.first().map_or((0, f64::NAN), |w| (w.tet, w.det_f));
            return Err(FemError::InvertedStart { tet, det_f });
        };
        now.states = Arc::new(states);
        now.largest_load = problem.load_norm(&state, 1.0);
        now.displacement.clone_from(&state.displacement);
        now.force.clone_from(&load.force);
        now.slips = surface.slips_after(&state.displacement, true);
        now.time_s = Some(time);
        Ok(solution(&problem, &state, report))
    }

    /// Springs, what may slip as it was left.
    fn surface_after(&self, now: &Now) -> Result<Cow<'_, SurfaceTerms>, FemError> {
        let mut surface = Cow::Borrowed(&self.surface);
        if !now.slips.is_empty() {
            let (before, here) = (now.slips.len(), surface.slips().len());
            check_length("springs with friction (points of the history)", before, here)?;
            surface.to_mut().go_on_from(&now.slips);
        }
        Ok(surface)
    }

    /// The state that is expected at the end of the frame, its held nodes in place.
    fn near(&self, guess: &[f64]) -> State {
        let mut state = State::at_rest(self.body.n_nodes());
        state.displacement.copy_from_slice(guess);
        for (flat, _) in self.body.held().as_flattened().iter().enumerate().filter(|(_, h)| **h) {
            state.displacement[flat] = self.target.prescribed[flat];
        }
        state
    }

    /// The load at a fraction of the way to the frame.
    fn load_at(&self, start: &Now, to: f64) -> NodalLoad {
        if to >= 1.0 || start.time_s.is_none() {
            return self.target.clone();
        }
        let between = |a: f64, b: f64| a + to * (b - a);
        let force =
            start.force.iter().zip(&self.target.force).map(|(&a, &b)| between(a, b)).collect();
        let held = self.body.held().as_flattened();
        let prescribed: Vec<f64> = (0..held.len())
            .map(|flat| match held[flat] {
                true => between(start.displacement[flat], self.target.prescribed[flat]),
                false => 0.0,
            })
            .collect();
        let moves_supports = prescribed.iter().any(|&v| v != 0.0);
        NodalLoad { force, prescribed, moves_supports }
    }
}

impl Solver<'_> {
    /// Norm of the unbalanced forces on free unknowns at a state, mN.
    fn unbalanced(&mut self, problem: &Problem, state: &mut State) -> f64 {
        let mut residual = vec![0.0; problem.body.n_unknowns()];
        if !self.evaluate(problem, state) {
            return 0.0;
        }
        problem.residual_into(state, 1.0, &mut residual);
        let size = norm(&residual);
        if size.is_finite() { size } else { 0.0 }
    }
}

/// Work of one step added to that of those before; qualities are those of the last.
fn sum(before: &SolveReport, last: &SolveReport) -> SolveReport {
    let mut total = *last;
    total.iterations += before.iterations;
    total.evaluations += before.evaluations;
    total.solves += before.solves;
    total.factorisations += before.factorisations;
    total.load_steps += before.load_steps;
    total.seconds.factor += before.seconds.factor;
    total.seconds.iterate += before.seconds.iterate;
    total
}
