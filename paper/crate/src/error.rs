//! What can go wrong, with the numbers and the place.

use tissuereg_fem::FemError;

/// Why a body, particles or a step was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PaperError {
    /// A constraint or an observation names a particle that does not exist.
    #[error("particle {particle} does not exist: there are {n_particles}")]
    NoSuchParticle {
        /// The index that is out of range.
        particle: usize,
        /// Number of particles.
        n_particles: usize,
    },
    /// Anything that the solver has an error for: meshes, moduli, lengths, numbers.
    #[error(transparent)]
    Fem(#[from] FemError),
}
