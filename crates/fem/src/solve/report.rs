//! What a solve returns.

/// Time of an evaluation of the forces over that of an iteration.
const EVALUATION: f64 = 0.4;

/// Equilibrium of a body under a load.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Displacement of every node of the body, mm.
    pub displacement: Vec<[f64; 3]>,
    /// Force that the support exerts at each held node, mN, in the order in which held nodes were
    /// given; zero along axes that are not held.
    pub reactions: Vec<[f64; 3]>,
    /// Forces of each set of springs of the load on the body, mN: one row per node of the body.
    pub spring_forces: Vec<Vec<[f64; 3]>>,
    /// Work done.
    pub report: SolveReport,
}

/// Record of the work of a solve.
///
/// All but `seconds` is the same at any number of threads.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct SolveReport {
    /// Accepted steps towards equilibrium, in all load steps.
    pub iterations: usize,
    /// Evaluations of the internal forces.
    pub evaluations: usize,
    /// Solutions with a factor.
    pub solves: usize,
    /// Different numeric factors used, one that was at hand already included.
    pub factorisations: usize,
    /// Symbolic analyses; one, made with the body.
    pub analyses: usize,
    /// Load steps; 1 where the whole load was applied at once.
    pub load_steps: usize,
    /// Fraction of the load that is in equilibrium: 1.
    pub load_fraction: f64,
    /// Load steps of [`Method::Auto`](crate::Method::Auto) that were found only by a long descent
    /// with a factor in every iteration, after shorter steps had failed. Where a body buckles or
    /// snaps through there is one; the answer then is the stable equilibrium met below.
    pub long_descents: usize,
    /// Norm of the residual over free unknowns, mN.
    pub residual: f64,
    /// Required norm, mN.
    pub tolerance: f64,
    /// Strain energy, µJ.
    pub strain_energy: f64,
    /// Smallest det F of all quadrature points, dimensionless.
    pub min_det_f: f64,
    /// Where the time went.
    pub seconds: StageSeconds,
}

impl SolveReport {
    /// Time of the iterations so far, trials included and factors not, in iterations.
    pub(super) fn work_of_iterations(&self) -> f64 {
        let trials = self.evaluations.saturating_sub(self.iterations) as f64;
        self.iterations as f64 + EVALUATION * trials
    }
}

/// Seconds by stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct StageSeconds {
    /// Assembling and factorising tangents.
    pub factor: f64,
    /// Everything else of the solve.
    pub iterate: f64,
}
