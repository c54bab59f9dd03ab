//! Extended position-based dynamics: particles whose distances, volumes and observed places are constraints.
//!
//! Every constraint `C(p) = 0` has a compliance `a`: in the limit of many iterations the places minimise
//! `Σ m |p − p̂|² / (2 Δt²) + Σ C² / (2 a)` about the predicted places `p̂`. They are met one after another (Gauss-Seidel):
//!
//! ```text
//! Δλ = (−C − a' λ) / (Σ_k |∇_k C|² / m_k + a'),     a' = a / Δt²
//! Δp_k = ∇_k C Δλ / m_k
//! ```
//!
//! # Reference
//!
//! Macklin, Müller and Chentanez, *XPBD*, Motion in Games, 2016; observations after Liu et al., *Real-to-sim
//! registration of deformable soft tissue with position-based dynamics*, IEEE ICRA, 2021.

mod colour;
mod constraint;
mod given;

use tissuereg_fem::FemError;

use crate::check::{check_dt, check_finite, check_length};
use crate::error::PaperError;
use colour::colour_order;
use constraint::{Constraint, DistanceRule, PlaceRule, Rule, VolumeRule};
pub use given::{PbdConstraint, PbdObservation};

/// Particles with constraints.
///
/// # Cost
///
/// An iteration is one pass over all constraints, in one thread; some 50 ns each.
///
/// # Examples
///
/// Two particles of 1 kg, 2 mm apart, on a rigid spring of 1 mm: both move halfway.
///
/// ```
/// use tissuereg_paper::{Pbd, PbdConstraint};
///
/// let spring = PbdConstraint { particles: [0, 1], rest: 1.0, compliance: 0.0 };
/// let mut pbd = Pbd::new(vec![1.0, 1.0], &[spring], &[])?;
/// let mut places = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
/// pbd.project(&mut places, &[], 0.01, 1)?;
/// assert!((places[0][0] - 0.5).abs() < 1e-15 && (places[1][0] - 1.5).abs() < 1e-15);
/// # Ok::<(), tissuereg_paper::PaperError>(())
/// ```
#[derive(Debug)]
pub struct Pbd {
    inverse_masses: Vec<f64>,
    distances: Vec<Constraint<2>>,
    volumes: Vec<Constraint<4>>,
    /// Given number of each constraint, in the order of work.
    given_distance: Vec<u32>,
    given_volume: Vec<u32>,
}

impl Pbd {
    /// Particles and what they keep.
    ///
    /// # Shapes
    ///
    /// One inverse mass a particle, 1/kg; 0 holds it.
    ///
    /// # Errors
    ///
    /// [`FemError::BadParameter`] for an inverse mass or compliance that is negative or not finite, or a rest
    /// that is not finite; [`PaperError::NoSuchParticle`].
    pub fn new(
        inverse_masses: Vec<f64>,
        distances: &[PbdConstraint<2>],
        volumes: &[PbdConstraint<4>],
    ) -> Result<Self, PaperError> {
        for &found in &inverse_masses {
            check_not_negative("inverse mass", found)?;
        }
        let n = inverse_masses.len();
        check_all(distances, n)?;
        check_all(volumes, n)?;
        let given_distance = colour_order(distances.iter().map(|c| c.particles), n);
        let given_volume = colour_order(volumes.iter().map(|c| c.particles), n);
        Ok(Self {
            inverse_masses,
            distances: in_order(distances, &given_distance),
            volumes: in_order(volumes, &given_volume),
            given_distance,
            given_volume,
        })
    }

    /// Number of particles.
    pub fn n_particles(&self) -> usize {
        self.inverse_masses.len()
    }

    /// Keep the distances and volumes of other places.
    ///
    /// # Errors
    ///
    /// [`FemError::WrongLength`], [`FemError::NonFinite`]; nothing is changed then.
    pub fn set_rest(&mut self, places: &[[f64; 3]]) -> Result<(), PaperError> {
        check_length("places (one row a particle)", self.n_particles(), places.len())?;
        check_finite("places", places)?;
        for own in &mut self.distances {
            own.rest = DistanceRule::measure(&own.corners(places));
        }
        for own in &mut self.volumes {
            own.rest = VolumeRule::measure(&own.corners(places));
        }
        Ok(())
    }

    /// What each constraint keeps, in the order in which they were given: distances in mm, volumes in mm³.
    pub fn rest(&self) -> (Vec<f64>, Vec<f64>) {
        (given(&self.distances, &self.given_distance), given(&self.volumes, &self.given_volume))
    }

    /// Move predicted places, mm, until they meet the constraints and the observations.
    ///
    /// # Errors
    ///
    /// [`FemError::BadSetting`] for a `dt` that is not above 0, [`FemError::BadParameter`] for a negative
    /// compliance,
    /// [`FemError::WrongLength`], [`FemError::NonFinite`], [`PaperError::NoSuchParticle`].
    pub fn project(
        &mut self,
        places: &mut [[f64; 3]],
        observations: &[PbdObservation],
        dt: f64,
        n_iterations: usize,
    ) -> Result<(), PaperError> {
        check_length("places (one row a particle)", self.n_particles(), places.len())?;
        check_finite("places", places)?;
        check_dt(dt)?;
        for (row, seen) in observations.iter().enumerate() {
            check_not_negative("compliance", seen.compliance)?;
            let weights = seen.weights.iter();
            let wrong = weights.clone().find(|(particle, _)| *particle >= self.n_particles());
            if let Some(&(particle, _)) = wrong {
                let n_particles = self.n_particles();
                return Err(PaperError::NoSuchParticle { particle, n_particles });
            }
            let values = seen.place;
            let numbers = weights.map(|(_, weight)| weight).chain(&values);
            if !numbers.into_iter().all(|v| v.is_finite()) {
                return Err(FemError::NonFinite { what: "observations", row, values }.into());
            }
        }
        self.distances.iter_mut().for_each(|own| own.multiplier = 0.0);
        self.volumes.iter_mut().for_each(|own| own.multiplier = 0.0);
        let per_square = 1.0 / (dt * dt);
        let inverse_masses = &self.inverse_masses;
        let mut seen: Vec<PlaceRule> = observations
            .iter()
            .map(|one| PlaceRule::new(one, inverse_masses, per_square))
            .collect();
        for _ in 0..n_iterations {
            for own in &mut self.distances {
                own.meet::<DistanceRule>(places, inverse_masses, per_square);
            }
            for own in &mut self.volumes {
                own.meet::<VolumeRule>(places, inverse_masses, per_square);
            }
            for own in &mut seen {
                own.meet(places, inverse_masses);
            }
        }
        Ok(())
    }
}

fn check_not_negative(name: &'static str, found: f64) -> Result<(), FemError> {
    if found >= 0.0 && found.is_finite() {
        return Ok(());
    }
    Err(FemError::BadParameter { name, must: "0 or more", found })
}

fn check_all<const N: usize>(all: &[PbdConstraint<N>], n: usize) -> Result<(), PaperError> {
    for one in all {
        check_not_negative("compliance", one.compliance)?;
        if !one.rest.is_finite() {
            let must = "finite";
            return Err(FemError::BadParameter { name: "rest", must, found: one.rest }.into());
        }
        if let Some(&particle) = one.particles.iter().find(|&&particle| particle >= n) {
            return Err(PaperError::NoSuchParticle { particle, n_particles: n });
        }
    }
    Ok(())
}

fn in_order<const N: usize>(all: &[PbdConstraint<N>], order: &[u32]) -> Vec<Constraint<N>> {
    order.iter().map(|&given| Constraint::new(&all[given as usize])).collect()
}

fn given<const N: usize>(all: &[Constraint<N>], order: &[u32]) -> Vec<f64> {
    let mut rest = vec![0.0; all.len()];
    for (own, &given) in all.iter().zip(order) {
        rest[given as usize] = own.rest;
    }
    rest
}
