//! Derivatives of the frames of a [`Rig`](crate::Rig) through its history.
//!
//! A step leads from the memory `m` of the points to the equilibrium `r(u, m, p) = 0` and on to the
//! memory `m⁺ = M(u, m, p)`. With `ṙ|` and `Ṁ|` the rates at fixed displacement,
//!
//! ```text
//! forward   K_ff u̇_f = −(ṙ|_f + K_fc u̇_c),    ṁ⁺ = Ṁ| + ∂M/∂u u̇
//! adjoint   ū ← ū + (∂M/∂u)ᵀ m̄⁺,   K_ff v_f = −(ū_f + K_fc v_c),
//!           m̄ = (∂M/∂m)ᵀ m̄⁺ + (∂r/∂m)ᵀ v,   J̇ = m̄⁺ · Ṁ| + v · ṙ| + (ū_c + (K v)_c) · u̇_c
//! ```
//!
//! with one factor of `K` a step for all causes and all observations. The rates of held nodes are
//! those of the load, of the pads' motion and of the shape that a pad was bonded to.
//!
//! A point that switches (more load than ever before, fibres without strain) has the derivative of
//! the side that it is on. How a step was halved is taken as given, and so is the rest shape of a
//! body that hangs as it was given.
//!
//! # Reference
//!
//! Michaleris, Tortorelli and Vidal, *Int. J. Numer. Methods Eng.* 37, 2471 (1994).

mod adjoint;
mod followed;
mod forward;
mod step;

use super::cause::Cause;
use crate::history::BehaviourParameter;
use crate::load::Load;
pub use adjoint::{FrameAdjoint, FrameObservation};

/// Causes by which the frames of a rig can be differentiated.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum FrameCause {
    /// What the body is made of and what lies on its surface, in all frames alike. A
    /// [`Cause::Load`] acts in all frames.
    Always(Cause),
    /// A number of the behaviour.
    Behaviour(BehaviourParameter),
    /// Loads along other ones, one per frame: forces, body force and prescribed displacements as
    /// rates. Springs must be left out.
    Loads(Vec<Load>),
    /// The motion of a pad along another one, one row per frame, mm over the unit of the cause. Rows of
    /// frames in which it is gone do not count.
    Motion {
        /// Its number.
        pad: usize,
        /// Rates of its translation.
        rates: Vec<[f64; 3]>,
    },
}

/// Derivatives of one frame by a cause.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameDerivative {
    /// Of the displacement, one row per node of the body, mm over the unit of the cause.
    pub displacement: Vec<[f64; 3]>,
    /// Of the reactions of the body's own held nodes, mN over the unit of the cause.
    pub reactions: Vec<[f64; 3]>,
    /// Of the force of each pad on the body; none where it is gone.
    pub pads: Vec<Option<[f64; 3]>>,
}
