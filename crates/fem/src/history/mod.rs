//! History through time frames: relaxation, rate, softening, set, drainage, swelling.
//!
//! All of it is variational. Within a time step from `t_n` to `t_n+1 = t_n + Δt` the state of the
//! material is fixed, and a point stores, per undeformed volume,
//!
//! ```text
//! Ψ(F) = s³ [ a_vol (ψ(Fe) − ψ_iso(Fe)) + a_iso (φ(ψ_iso(Fe)) + φ_d(ψ(Fe)) − ψ(Fe)) ]
//!        + ½ S_hist : (C − I) + (η J_n / Δt) tr (C_n⁻¹ ΔE C_n⁻¹ ΔE)
//! Fe = F Fp⁻¹ / s,     ψ_iso(F) = ψ(J^(−1/3) F),     ΔE = E − E_n
//! ```
//!
//! so the minimiser of the elastic problem finds the end of the step, and the state is updated
//! after it. `ψ` is any law. The terms, and where they are written:
//!
//! * `point`: chain rule of the first line, stress and tangent, once for all laws;
//! * `prony`: `a` and `S_hist`, the relaxed answer to all steps before (Simo's recursion);
//! * `softening`: `φ` or `φ_d`, of the largest energy so far (Mullins effect or damage; the other is
//!   its argument);
//! * `common`: what is remembered, and its update; `Fp` is the set, `s` the swelling; `state` for all
//!   points of a body;
//! * `scalar`, `numbers`: numbers that carry derivatives, and those of a behaviour;
//! * `record`, `follow`, `follow_back`, `tape`: steps as they went, and their derivatives at points;
//! * `run`: [`History`] itself; `rig`: pads that are bonded and released.
//!
//! # References
//!
//! Simo and Hughes, *Computational Inelasticity*, Springer 1998, section 10.3 (relaxation); Ogden
//! and Roxburgh, Proc. R. Soc. A 455, 2861 (1999), and Simo, Comput. Methods Appl. Mech. Eng. 60,
//! 153 (1987) (softening); Ortiz and Stainier, Comput. Methods
//! Appl. Mech. Eng. 171, 419 (1999) (variational updates).

mod behaviour;
mod common;
mod follow;
mod follow_back;
mod numbers;
mod point;
mod prony;
mod record;
mod rig;
mod run;
mod scalar;
mod softening;
mod state;
mod tape;
mod tensor;
#[cfg(test)]
mod tests;

pub(crate) use behaviour::must;
pub use behaviour::{
    Behaviour, Drainage, Part, Relaxation, Set, Softening, SofteningForm, Swelling,
};
pub(crate) use follow::{Moved, Substance};
pub(crate) use follow_back::Backward;
pub use numbers::BehaviourParameter;
pub(crate) use point::StepModel;
pub(crate) use record::StepRecord;
pub(crate) use rig::Phase;
pub use rig::{Pad, Rig, RigFrame};
pub use run::History;
pub(crate) use scalar::LANES;
