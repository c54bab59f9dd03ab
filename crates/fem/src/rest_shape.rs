//! The shape without load of a body that is given as it hangs.
//!
//! Sought are corner nodes `X` whose equilibrium under the load brings them to the given places
//! `x`: `X + u(X) = x`. The fixed point `X ← x − u(X)` is accelerated by Anderson's method on the
//! last few iterates (Walker and Ni, SIAM J. Numer. Anal. 49, 1715, 2011). All iterates share the
//! elimination order of the given body and the factor of its stiffness.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use crate::body::Body;
use crate::error::FemError;
use crate::load::Load;
use crate::material::Material;
use crate::solve::{Metric, Solution, SolveSettings, Solver, Task, dot};

/// Largest distance between loaded and given nodes, mm.
const TOLERANCE: f64 = 1e-6;

/// Iterations allowed.
const MOST_ITERATIONS: usize = 60;

/// Iterates that the next one is extrapolated from.
const MEMORY: usize = 6;

/// Steps that lead to a broken mesh are halved this often.
const HALVINGS: usize = 8;

/// A body without load, and how it hangs under it.
#[derive(Debug)]
pub struct RestShape {
    /// The unloaded body, with the supports of the given one.
    pub body: Body,
    /// Its equilibrium under the load: `body.nodes() + loaded.displacement` are the given corner
    /// nodes to 1e-6 mm. Mid-edge nodes lie where the ten-node elements put them: edges that are
    /// straight without load may be curved under it.
    pub loaded: Solution,
    /// Equilibria that it took.
    pub iterations: usize,
}

/// Find the unloaded shape of a body whose mesh is given as it hangs under a load.
///
/// # Errors
///
/// [`FemError::NoRestShape`] where a tetrahedron inverts on the way, an iterate has no equilibrium
/// or the search does not end; [`FemError::Cancelled`]; input errors as [`solve`](crate::solve).
///
/// # Cost
///
/// One factorisation, and five to fifteen solves that start from the one before.
///
/// # Examples
///
/// A tetrahedron that hangs: without its weight it is shorter.
///
/// ```
/// use tissuereg_fem::{Body, Element, Load, Material, Mesh, SolveSettings, rest_shape, solve};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [3.0, 3.0, -20.0]];
/// let body = Body::new(Mesh::new(nodes, vec![[0, 2, 1, 3]])?, Element::Tet4, [0, 1, 2])?;
/// let weight = Load { body_force: [0.0, 0.0, -0.05], ..Load::default() };
/// let (fat, settings) = (Material::neo_hookean(5.0, 0.45)?, SolveSettings::default());
/// let rest = rest_shape(&body, &fat, &weight, &settings)?;
/// assert!(rest.body.nodes()[3][2] > -19.99);
///
/// let hangs = solve(&rest.body, &fat, &weight, &settings)?;
/// assert!((rest.body.nodes()[3][2] + hangs.displacement[3][2] + 20.0).abs() < 1e-6);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
pub fn rest_shape(
    body: &Body,
    material: &Material,
    load: &Load,
    settings: &SolveSettings,
) -> Result<RestShape, FemError> {
    settings.in_pool(|| Search { given: body, material, load, settings }.run())
}

struct Search<'a> {
    given: &'a Body,
    material: &'a Material,
    load: &'a Load,
    settings: &'a SolveSettings,
}

/// An unloaded shape that was tried.
struct Tried {
    body: Body,
    loaded: Solution,
    /// `x − X − u(X)`, flat, mm.
    off: Vec<f64>,
}

impl Search<'_> {
    fn run(&self) -> Result<RestShape, FemError> {
        let wanted = self.given.mesh().nodes().as_flattened();
        let mut memory = VecDeque::new();
        let mut place = wanted.to_vec();
        let mut last: Option<(Vec<f64>, Tried)> = None;
        let mut halvings = 0;
        for iteration in 1..=MOST_ITERATIONS {
            let start = last.as_ref().map(|(_, tried)| tried.loaded.displacement.as_slice());
            match self.hang(&place, start) {
                Ok(tried) => {
                    let distance = farthest(&tried.off);
                    if distance <= TOLERANCE {
                        let Tried { body, loaded, .. } = tried;
                        return Ok(RestShape { body, loaded, iterations: iteration });
                    }
                    if let Some((before, earlier)) = &last {
                        memory.push_back((
                            difference(&place, before),
                            difference(&tried.off, &earlier.off),
                        ));
                        if memory.len() > MEMORY {
                            memory.pop_front();
                        }
                    }
                    let next = extrapolated(&place, &tried.off, &memory);
                    last = Some((std::mem::replace(&mut place, next), tried));
                    halvings = 0;
                }
                // Too far: half way back to the last shape that hangs.
                Err(error) if is_broken(&error) => {
                    let distance = last.as_ref().map_or(f64::NAN, |(_, t)| farthest(&t.off));
                    halvings += 1;
                    let Some((good, _)) = last.as_ref().filter(|_| halvings <= HALVINGS) else {
                        return Err(failure(iteration, distance, Some(error)));
                    };
                    place.iter_mut().zip(good).for_each(|(p, g)| *p = 0.5 * (*p + g));
                    memory.clear();
                }
                Err(error) => return Err(error),
            }
        }
        let distance = last.as_ref().map_or(f64::NAN, |(_, tried)| farthest(&tried.off));
        Err(failure(MOST_ITERATIONS, distance, None))
    }

    /// Equilibrium of an unloaded shape.
    fn hang(&self, place: &[f64], start: Option<&[[f64; 3]]>) -> Result<Tried, FemError> {
        let body = self.given.moved_to(place.as_chunks::<3>().0.to_vec())?;
        let parallel = self.settings.is_parallel();
        let task = Task { material: self.material, load: self.load, start };
        let metric = || Metric::at_rest(self.given, self.material, &self.load.springs, parallel);
        let loaded = Solver::new(&body, parallel).solve(task, self.settings, metric)?;
        let wanted = self.given.mesh().nodes().as_flattened();
        let off = (0..wanted.len())
            .map(|k| wanted[k] - place[k] - loaded.displacement[k / 3][k % 3])
            .collect();
        Ok(Tried { body, loaded, off })
    }
}

fn failure(iterations: usize, distance: f64, cause: Option<FemError>) -> FemError {
    let cause = cause.map(Box::new);
    FemError::NoRestShape { iterations, distance, tolerance: TOLERANCE, cause }
}

/// Whether an error means that a shape was no valid body or had no equilibrium.
fn is_broken(error: &FemError) -> bool {
    matches!(error, FemError::InvertedTet { .. } | FemError::DegenerateTet { .. })
        || error.is_recoverable()
}

/// Anderson's next iterate: `X + r − Σ γ_j (ΔX_j + Δr_j)`, with `γ` minimising `|r − Σ γ_j Δr_j|`.
fn extrapolated(place: &[f64], off: &[f64], memory: &VecDeque<(Vec<f64>, Vec<f64>)>) -> Vec<f64> {
    let mut next: Vec<f64> = place.iter().zip(off).map(|(x, r)| x + r).collect();
    let n = memory.len();
    if n == 0 {
        return next;
    }
    let normal = DMatrix::from_fn(n, n, |a, b| dot(&memory[a].1, &memory[b].1));
    let right = DVector::from_fn(n, |a, _| dot(&memory[a].1, off));
    let svd = normal.svd(true, true);
    // Changes that are nearly dependent carry nothing new.
    let least = 1e-12 * svd.singular_values.max();
    let Ok(weights) = svd.solve(&right, least) else { return next };
    for (weight, (step, change)) in weights.iter().zip(memory) {
        for (x, (s, c)) in next.iter_mut().zip(step.iter().zip(change)) {
            *x -= weight * (s + c);
        }
    }
    next
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(x, y)| x - y).collect()
}

/// Largest length of the rows of three.
fn farthest(flat: &[f64]) -> f64 {
    flat.as_chunks::<3>().0.iter().map(|r| dot(r, r).sqrt()).fold(0.0, f64::max)
}
