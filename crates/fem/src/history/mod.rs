//! Bodies through time: `run` leads one from frame to frame ([`History`]), `rig` bonds pads to it and
//! releases them ([`Rig`]). What its material remembers is that of `memory`.

mod rig;
mod run;

pub use rig::{Pad, Rig, RigFrame};
pub use run::History;
