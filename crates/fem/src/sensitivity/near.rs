//! Equilibria near one whose tangent is factored.

use std::borrow::Borrow;
use std::sync::Arc;

use super::linearised::Linearised;
use crate::body::Body;
use crate::error::FemError;
use crate::load::Load;
use crate::material::Material;
use crate::solve::{Metric, Solution, SolveSettings, Solver, Task};

impl<B: Borrow<Body> + Send + Sync> Linearised<B> {
    /// Find the equilibrium under another load, from here and with the factor that is at hand.
    ///
    /// The same material but for what is given; the factor guides the iteration, carried along by the
    /// deformation, until it converges slowly. The answer is that of [`solve_from`](crate::solve_from)
    /// within the tolerance.
    ///
    /// # Errors
    ///
    /// As [`solve`](crate::solve).
    ///
    /// # Cost
    ///
    /// No factorisation where the load is close; one solution and one evaluation an iteration.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::{Body, Element, Linearised, Load, Material, Mesh, SolveSettings, solve};
    ///
    /// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    /// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
    /// let material = Material::neo_hookean(10.0, 0.3)?;
    /// let pull = |size| Load { body_force: [0.0, 0.0, size], ..Load::default() };
    /// let settings = SolveSettings::default();
    /// let here = solve(&body, &material, &pull(0.2), &settings)?.displacement;
    /// let here = Linearised::new(&body, &material, &pull(0.2), &here, &settings)?;
    /// let near = here.solve_near(&pull(0.25), &settings)?;
    /// let alone = solve(&body, &material, &pull(0.25), &settings)?;
    /// assert!((near.displacement[3][2] - alone.displacement[3][2]).abs() < 1e-8);
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn solve_near(&self, load: &Load, settings: &SolveSettings) -> Result<Solution, FemError> {
        let (body, material): (&Body, &Material) = (self.body.borrow(), &self.material);
        let start = Some(self.state.displacement.as_chunks::<3>().0);
        settings.in_pool(|| {
            let parallel = settings.is_parallel();
            let factor = Arc::clone(&self.factored.factor);
            let metric = Metric::made_at(body, factor, &self.state.displacement, parallel);
            let mut solver = Solver::new(body, parallel);
            settings.awake(|| solver.solve(Task { material, load, start }, settings, || Ok(metric)))
        })
    }
}
