//! Meshes, bodies and solves.

mod bed;
mod behaviour;
mod body;
mod given;
mod law;
mod many;
mod mesh;
mod rig;
mod sensitivity;
mod solution;
mod supported;

pub(crate) use self::behaviour::Behaviour;
pub(crate) use self::body::Body;
pub(crate) use self::law::{Law, laws};
pub(crate) use self::many::ManySolutions;
pub(crate) use self::mesh::{
    check_mesh, closest_rotations, rasterise, surface_triangles, tet_volumes,
};
pub(crate) use self::rig::{Rig, RigFrame};
pub(crate) use self::sensitivity::{Adjoints, Cause, Compliance, Linearised};
pub(crate) use self::solution::Solution;
