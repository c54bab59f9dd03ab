//! Sparse systems on nodes that are coupled in cliques: elimination order and symbolic factor, made once a
//! body, and the numeric factor made from them.

mod assemble;
mod cliques;
mod entry;
pub(crate) mod factor;
mod fronts;
mod graph;
mod groups;
mod operator;
mod ordering;
mod panel_solve;
mod panels;
pub(crate) mod pattern;
mod plain_order;
mod separator;
mod size;
mod substitute;
mod wide_solve;

pub(crate) use cliques::Cliques;
pub(crate) use fronts::Fronts;
pub(crate) use operator::Operator;
pub(crate) use plain_order::PlainOrder;
pub use size::FactorSize;
pub(crate) use substitute::{SolveScratch, WIDE, WIDE_SINGLE};
