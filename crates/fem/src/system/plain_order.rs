//! Plain linear tets on the unknowns of a body whose volume ratios are averaged.
//!
//! Their stiffness couples a node with its own elements alone; a factor has a third of the entries
//! and a sixth of the operations.

use super::cliques::Cliques;
use super::pattern::Pattern;
use crate::error::FemError;

/// Elimination order and fronts of plain tets, and how they are reached from the body's own order.
#[derive(Debug)]
pub(crate) struct PlainOrder {
    pub(crate) pattern: Pattern,
    /// Place in the body's own order of each unknown.
    own: Vec<u32>,
}

impl PlainOrder {
    /// Analyse the elements of a body with the given order.
    ///
    /// # Errors
    ///
    /// [`FemError::TooLarge`].
    pub(crate) fn new(
        points: &[[f64; 3]],
        elements: Cliques,
        held: &[[bool; 3]],
        body: &Pattern,
    ) -> Result<Self, FemError> {
        let pattern = Pattern::new(points, elements, held)?;
        let mut place = vec![0; 3 * points.len()];
        for (own, &flat) in body.unknown2flat.iter().enumerate() {
            place[flat as usize] = own as u32;
        }
        let own = pattern.unknown2flat.iter().map(|&flat| place[flat as usize]).collect();
        Ok(Self { pattern, own })
    }

    /// Write values in the body's order to `out`, in this one.
    pub(crate) fn take(&self, values: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.own.iter().map(|&own| values[own as usize]));
    }

    /// Write values in this order to `out`, in the body's.
    pub(crate) fn give(&self, values: &[f64], out: &mut [f64]) {
        for (&own, &value) in self.own.iter().zip(values) {
            out[own as usize] = value;
        }
    }
}
