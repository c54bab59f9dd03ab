//! What the extension modules of tissuereg share.
//!
//! A wrapper checks, views, releases the lock, calls and maps, and does nothing else. Arrays come in as C-ordered
//! views ([`views`]) and leave as their own ([`arrays`]), long calls run where Ctrl-C is heard ([`lock`]), errors leave
//! as the classes of `tissuereg/errors.py` ([`errors`]).
#![deny(unsafe_code)]

pub mod arrays;
pub mod errors;
pub mod lock;
pub mod mesh;
pub mod report;
pub mod views;
