//! Many solves on one body: members in parallel, each on one thread.
//!
//! Members whose stiffness fields are proportional share one factor of the undeformed stiffness.
//! A member's bits do not depend on the number of threads nor on the other members.

use std::sync::atomic::Ordering;

use rayon::prelude::*;

use crate::body::Body;
use crate::error::FemError;
use crate::load::Load;
use crate::material::{Material, Shape};
use crate::solve::{SharedRest, Solution, SolveSettings, Solver, Task};

/// One member of an ensemble: what is loaded how.
#[derive(Debug, Clone, Copy)]
pub struct Member<'a> {
    /// Its material.
    pub material: &'a Material,
    /// Its load.
    pub load: &'a Load,
    /// Displacement to start from, mm, one row per node of the body; rest where none is given.
    pub start: Option<&'a [[f64; 3]]>,
}

/// What became of a member.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// Its equilibrium.
    Solved(Solution),
    /// Why there is none.
    Failed(FemError),
}

impl Outcome {
    /// The solution, where there is one.
    pub fn solution(&self) -> Option<&Solution> {
        match self {
            Self::Solved(solution) => Some(solution),
            Self::Failed(_) => None,
        }
    }

    /// The error, where there is one.
    pub fn error(&self) -> Option<&FemError> {
        match self {
            Self::Solved(_) => None,
            Self::Failed(error) => Some(error),
        }
    }
}

/// Find the equilibrium of every member.
///
/// Never fails as a whole: every member has its own [`Outcome`], in the order of `members`. Once
/// [`SolveSettings::cancel`] is raised, all that are not finished fail with
/// [`FemError::Cancelled`]. [`SolveSettings::progress`] counts finished members.
///
/// # Cost
///
/// One factorisation for each stiffness field that is no multiple of another's, and the iterations
/// of each member; memory of one factor and one set of buffers a thread.
///
/// # Examples
///
/// Two stiffnesses, one factor:
///
/// ```
/// use tissuereg_fem::{Body, Element, Load, Material, Member, Mesh, SolveSettings, solve_many};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
/// let load = Load::from_forces(vec![[0.0; 3], [0.0; 3], [0.0; 3], [0.0, 0.0, 2.0]]);
/// let (soft, stiff) = (Material::neo_hookean(5.0, 0.4)?, Material::neo_hookean(10.0, 0.4)?);
/// let members = [&soft, &stiff].map(|material| Member { material, load: &load, start: None });
/// let outcomes = solve_many(&body, &members, &SolveSettings::default());
/// let tips: Vec<f64> =
///     outcomes.iter().filter_map(|o| o.solution()).map(|s| s.displacement[3][2]).collect();
/// assert!(tips[0] > tips[1] && tips[1] > 0.0);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
pub fn solve_many(body: &Body, members: &[Member], settings: &SolveSettings) -> Vec<Outcome> {
    let groups = Groups::new(members);
    let one = |solver: &mut Solver, index: usize| {
        let member = members[index];
        let task = Task { material: member.material, load: member.load, start: member.start };
        let (group, young) = groups.of_member[index];
        let outcome =
            match solver.solve(task, settings, || groups.shared[group].metric(body, young)) {
                Ok(solution) => Outcome::Solved(solution),
                Err(error) => Outcome::Failed(error),
            };
        if let Some(counter) = &settings.progress {
            counter.fetch_add(1, Ordering::Relaxed);
        }
        (index, outcome)
    };
    let mut outcomes: Vec<(usize, Outcome)> = settings.in_pool(|| {
        if settings.is_parallel() {
            groups
                .order
                .par_iter()
                .map_init(|| Solver::new(body, false), |solver, &index| one(solver, index))
                .collect()
        } else {
            let mut solver = Solver::new(body, false);
            groups.order.iter().map(|&index| one(&mut solver, index)).collect()
        }
    });
    outcomes.sort_unstable_by_key(|(index, _)| *index);
    outcomes.into_iter().map(|(_, outcome)| outcome).collect()
}

/// Members by the shape of their stiffness.
struct Groups {
    shared: Vec<SharedRest>,
    /// Group and scale (kPa) of each member.
    of_member: Vec<(usize, f64)>,
    /// Members group after group, so that few factors are alive at a time.
    order: Vec<usize>,
}

impl Groups {
    fn new(members: &[Member]) -> Self {
        let mut shapes: Vec<(Shape, usize)> = Vec::new();
        let mut found = std::collections::HashMap::<u64, Vec<usize>>::new();
        let mut of_member = Vec::with_capacity(members.len());
        for member in members {
            let (shape, young) = Shape::of(member.material, &member.load.springs);
            let same = found.entry(shape.key()).or_default();
            let group = match same.iter().find(|&&g| shapes[g].0 == shape) {
                Some(&group) => group,
                None => {
                    same.push(shapes.len());
                    shapes.push((shape, 0));
                    shapes.len() - 1
                }
            };
            shapes[group].1 += 1;
            of_member.push((group, young));
        }
        let mut order: Vec<usize> = (0..members.len()).collect();
        order.sort_by_key(|&m| of_member[m].0);
        let shared = shapes.into_iter().map(|(shape, n)| SharedRest::new(shape, n)).collect();
        Self { shared, of_member, order }
    }
}
