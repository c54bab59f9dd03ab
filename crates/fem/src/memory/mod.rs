//! Materials with a memory: relaxation, rate, softening, set, drainage, swelling.
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
//! * `behaviour`: what a user chooses;
//! * `prony`: `a` and `S_hist`, the relaxed answer to all steps before (Simo's recursion);
//! * `softening`: `φ` or `φ_d`, of the largest energy so far (Mullins effect or damage; the other is
//!   its argument);
//! * `layout`: what is remembered; `common`: what holds within a step; `Fp` is the set, `s` the swelling;
//! * `point`: chain rule of the first line, stress and tangent, once for all laws, and the update of
//!   what is remembered; `state`: all points of a body, as the element loops see them; `test_piece`:
//!   one point through a material test.
//!
//! # References
//!
//! Simo and Hughes, *Computational Inelasticity*, Springer 1998, section 10.3 (relaxation); Ogden
//! and Roxburgh, Proc. R. Soc. A 455, 2861 (1999), and Simo, Comput. Methods Appl. Mech. Eng. 60,
//! 153 (1987) (softening); Ortiz and Stainier, Comput. Methods
//! Appl. Mech. Eng. 171, 419 (1999) (variational updates).

mod behaviour;
mod common;
mod layout;
mod point;
mod prony;
mod softening;
mod state;
mod tensor;
mod test_piece;
#[cfg(test)]
mod tests;

pub use behaviour::{
    Behaviour, Drainage, Part, Relaxation, Set, Softening, SofteningForm, Swelling,
};
pub(crate) use state::{StepModel, StepState, fresh_states};
pub use test_piece::stress_history;
