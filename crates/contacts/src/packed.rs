//! The columns of a dictionary in single precision, side by side for the table.

use crate::dictionary::Dictionary;

/// Patches processed together; a multiple of every machine's lanes.
pub(crate) const LANES: usize = 16;

/// Rows that one step of the triangular solve finishes: with their three directions, what they are solved by and one
/// factor they fill 13 of 16 registers; with four rows one of them is kept in memory.
pub(crate) const ROWS: usize = 3;

/// Columns of all patches as the table reads them: blocks of `LANES` patches, in them row by row the three directions.
#[derive(Debug)]
pub(crate) struct Packed {
    pub(crate) blocks: Vec<[f32; LANES]>,
    pub(crate) n_patches: usize,
    /// Rows with those that fill up the last step.
    pub(crate) n_rows: usize,
}

impl Packed {
    pub(crate) fn new(dictionary: &Dictionary) -> Self {
        let n_patches = dictionary.n_patches();
        let n_rows = dictionary.n_obs().next_multiple_of(ROWS);
        let mut blocks = vec![[0.0; LANES]; n_patches.div_ceil(LANES) * n_rows * 3];
        for patch in 0..n_patches {
            let (block, lane) = (patch / LANES, patch % LANES);
            for (axis, column) in dictionary.own(patch).col_iter().enumerate() {
                for (row, &value) in column.iter().enumerate() {
                    blocks[(block * n_rows + row) * 3 + axis][lane] = value as f32;
                }
            }
        }
        Self { blocks, n_patches, n_rows }
    }
}
