//! What a point remembers: a row of numbers, only those that its behaviour asks for.

use std::ops::Range;

use super::behaviour::Behaviour;
use crate::material::Matrix3;

/// Numbers of a matrix.
pub(super) const NINE: usize = 9;

/// Where the numbers are in the row of a point. All of them are zero at first.
#[derive(Debug, Clone, Default)]
pub(super) struct Layout {
    /// Numbers of a point.
    pub(super) width: usize,
    /// Of the whole stress, or of its volumetric part where parts relax differently, and of its isochoric part
    /// then: the elastic stress at the end of the last step, then the stress of each term (`prony`), kPa.
    pub(super) series: [Option<Range<usize>>; 2],
    /// Displacement gradient at the end of the last step.
    pub(super) gradient: Option<usize>,
    /// Squared norm of the largest logarithmic strain so far, then what the set takes off it: `Fp⁻¹`.
    pub(super) set: Option<usize>,
    /// Largest energy so far that softens, kPa.
    pub(super) largest_energy: Option<usize>,
}

impl Layout {
    /// That of a behaviour.
    pub(super) fn new(behaviour: &Behaviour) -> Self {
        let mut layout = Self::default();
        let [volumetric, isochoric] = behaviour.series().map(|terms| terms.len());
        let apart = if behaviour.is_split() { isochoric } else { 0 };
        layout.series = [volumetric, apart].map(|n_terms| {
            let numbers = if n_terms > 0 { NINE * (1 + n_terms) } else { 0 };
            layout.take(numbers).map(|first| first..first + numbers)
        });
        let flows = behaviour.viscosity_kpa_s != 0.0;
        layout.gradient = layout.take(if flows { NINE } else { 0 });
        layout.set = layout.take(if behaviour.set.is_some() { 1 + NINE } else { 0 });
        layout.largest_energy = layout.take(usize::from(behaviour.softening.is_some()));
        layout
    }

    /// Whether stresses are remembered.
    pub(super) fn remembers(&self) -> bool {
        self.series.iter().any(Option::is_some)
    }

    /// Numbers of a point where rows are gone through as chunks, which have one at least.
    pub(super) fn stride(&self) -> usize {
        self.width.max(1)
    }

    /// The row of a point, of those of all points.
    pub(super) fn row<'a>(&self, rows: &'a [f64], point: usize) -> &'a [f64] {
        rows.get(self.width * point..self.width * (point + 1)).unwrap_or(&[])
    }

    /// Add numbers; none of none.
    fn take(&mut self, numbers: usize) -> Option<usize> {
        let first = self.width;
        self.width += numbers;
        (numbers > 0).then_some(first)
    }
}

/// The matrix that begins at a place of a row.
pub(super) fn matrix(row: &[f64], first: usize) -> Matrix3 {
    let mut matrix = [[0.0; 3]; 3];
    matrix.as_flattened_mut().copy_from_slice(&row[first..first + NINE]);
    matrix
}

/// Write a matrix to a place of a row.
pub(super) fn set_matrix(row: &mut [f64], first: usize, matrix: &Matrix3) {
    row[first..first + NINE].copy_from_slice(matrix.as_flattened());
}
