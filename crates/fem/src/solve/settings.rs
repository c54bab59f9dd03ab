//! How a solve is done; all settings have defaults.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::error::FemError;

/// Which iteration finds the equilibrium.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// Quasi-Newton on the factor of the undeformed stiffness, with a fresh factor where it
    /// converges slowly, and load steps where it fails.
    #[default]
    Auto,
    /// A double-precision factor of the current tangent in every iteration.
    Newton,
    /// Limited-memory BFGS on the factor of the undeformed stiffness alone.
    QuasiNewton,
}

/// In how many steps the load is applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum LoadSteps {
    /// All at once; where that fails, in steps that grow and shrink by themselves.
    #[default]
    Auto,
    /// In this many equal steps, none of which may fail.
    Equal(usize),
}

/// In which precision the tangent at an equilibrium is factored for derivatives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// Double: a solution needs no refinement.
    #[default]
    Double,
    /// Single, in less time and half the memory; solutions are refined with the tangent in double
    /// precision until they are right to 1e-9. Double is taken where the tangent is too close to
    /// singular for that.
    Single,
}

/// Settings of [`solve`](crate::solve) and [`solve_many`](crate::solve_many).
///
/// Further settings may come: start from the default and change what differs.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::{Method, SolveSettings};
///
/// let settings = SolveSettings::default().with_method(Method::Newton);
/// assert_eq!(settings.tolerance, 1e-9);
/// ```
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SolveSettings {
    /// Largest admissible `|residual| / |load|`, both over free unknowns. Where supports are
    /// moved, the norm of the reactions counts as load if it is larger. A residual at the rounding
    /// of the forces is accepted in any case. Dimensionless.
    pub tolerance: f64,
    /// Iterations allowed in all load steps together. With [`LoadSteps::Auto`] the attempt at the
    /// full load also ends once it has taken the time of twice as many iterations, factorisations and
    /// trials included, and the steps after it once they have taken the same again (by
    /// their size, not by the clock, so that results stay the same).
    pub max_iterations: usize,
    /// Which iteration is used.
    pub method: Method,
    /// In how many steps the load is applied.
    pub load_steps: LoadSteps,
    /// Threads: 0 means all of the current rayon pool. Results do not depend on it.
    pub n_threads: usize,
    /// Raised by the caller to end a solve early with [`FemError::Cancelled`]. Looked at in every
    /// iteration, so within the time of one factorisation.
    pub cancel: Option<Arc<AtomicBool>>,
    /// Counts members that [`solve_many`](crate::solve_many) has finished.
    pub progress: Option<Arc<AtomicUsize>>,
}

impl Default for SolveSettings {
    fn default() -> Self {
        Self {
            tolerance: 1e-9,
            max_iterations: 1000,
            method: Method::Auto,
            load_steps: LoadSteps::Auto,
            n_threads: 0,
            cancel: None,
            progress: None,
        }
    }
}

impl SolveSettings {
    /// The same with another [`tolerance`](Self::tolerance).
    #[must_use]
    pub fn with_tolerance(self, tolerance: f64) -> Self {
        Self { tolerance, ..self }
    }

    /// The same with another [`max_iterations`](Self::max_iterations).
    #[must_use]
    pub fn with_max_iterations(self, max_iterations: usize) -> Self {
        Self { max_iterations, ..self }
    }

    /// The same with another [`method`](Self::method).
    #[must_use]
    pub fn with_method(self, method: Method) -> Self {
        Self { method, ..self }
    }

    /// The same with other [`load_steps`](Self::load_steps).
    #[must_use]
    pub fn with_load_steps(self, load_steps: LoadSteps) -> Self {
        Self { load_steps, ..self }
    }

    /// The same on this many threads, see [`n_threads`](Self::n_threads).
    #[must_use]
    pub fn with_n_threads(self, n_threads: usize) -> Self {
        Self { n_threads, ..self }
    }

    /// The same with a flag, or none, that ends the solve early: [`cancel`](Self::cancel).
    #[must_use]
    pub fn with_cancel(self, cancel: impl Into<Option<Arc<AtomicBool>>>) -> Self {
        Self { cancel: cancel.into(), ..self }
    }

    /// The same with a counter, or none, of finished members: [`progress`](Self::progress).
    #[must_use]
    pub fn with_progress(self, progress: impl Into<Option<Arc<AtomicUsize>>>) -> Self {
        Self { progress: progress.into(), ..self }
    }

    /// Check ranges.
    pub(crate) fn check(&self) -> Result<(), FemError> {
        if !(self.tolerance > 0.0 && self.tolerance < 1.0) {
            return Err(FemError::BadSetting {
                name: "tolerance",
                must: "above 0 and below 1",
                found: self.tolerance,
            });
        }
        if self.max_iterations == 0 {
            return Err(FemError::BadSetting {
                name: "max_iterations",
                must: "at least 1",
                found: 0.0,
            });
        }
        if self.load_steps == LoadSteps::Equal(0) {
            return Err(FemError::BadSetting {
                name: "load_steps",
                must: "at least 1",
                found: 0.0,
            });
        }
        Ok(())
    }

    /// Fail where the caller has raised the cancel flag.
    pub(crate) fn check_cancel(&self) -> Result<(), FemError> {
        match &self.cancel {
            Some(flag) if flag.load(Ordering::Relaxed) => Err(FemError::Cancelled),
            _ => Ok(()),
        }
    }

    /// Run on the requested number of threads; on the current pool if no other can be made.
    pub(crate) fn in_pool<R: Send>(&self, run: impl FnOnce() -> R + Send) -> R {
        if self.n_threads <= 1 {
            return run();
        }
        match rayon::ThreadPoolBuilder::new().num_threads(self.n_threads).build() {
            Ok(pool) => pool.install(run),
            Err(_) => run(),
        }
    }

    /// Run with the other threads of the pool kept awake.
    ///
    /// The parallel parts of an iteration take a fraction of a millisecond, about as long as it
    /// takes to wake a sleeping thread.
    pub(crate) fn awake<R: Send>(&self, run: impl FnOnce() -> R + Send) -> R {
        if !self.is_parallel() {
            return run();
        }
        let done = AtomicBool::new(false);
        let look_for_work = || {
            while !done.load(Ordering::Relaxed) {
                if rayon::yield_now() != Some(rayon::Yield::Executed) {
                    std::hint::spin_loop();
                }
            }
        };
        rayon::in_place_scope(|scope| {
            for _ in 1..rayon::current_num_threads() {
                scope.spawn(|_| look_for_work());
            }
            let end = RaiseOnDrop(&done);
            let result = run();
            drop(end);
            result
        })
    }

    /// Whether a solve may use more than one thread.
    pub(crate) fn is_parallel(&self) -> bool {
        self.n_threads != 1 && rayon::current_num_threads() > 1
    }
}

/// Raises a flag when it goes, also by a panic.
struct RaiseOnDrop<'a>(&'a AtomicBool);

impl Drop for RaiseOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
