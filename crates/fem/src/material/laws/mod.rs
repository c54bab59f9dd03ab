//! One file per law in invariants; each is registered in the catalogue (`material/kind.rs`).
//!
//! A file holds the law's [`DECLARATION`](yeoh::DECLARATION), whether its energy has the second
//! invariant (`SECOND`), its energy with slopes (`slopes`) and their derivatives by a shape
//! parameter (`slopes_by`).

pub(super) mod fung;
pub(super) mod mooney_rivlin;
pub(super) mod veronda_westmann;
pub(super) mod yeoh;
