//! Nodal fields at the points of a grid: an image's voxels lie in tetrahedra.
//!
//! Nodes are given in the coordinates of the grid, so that any affine grid (oblique, anisotropic)
//! is the integer lattice here: the point in column i of row j of slice k is at (i, j, k).

use rayon::prelude::*;

use crate::check::{check_finite, check_length};
use crate::error::FemError;

/// Slices of a grid, and how many rows and columns each has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slab {
    /// Number of the first slice.
    pub first: usize,
    /// Number of slices.
    pub slices: usize,
    /// Rows of a slice.
    pub rows: usize,
    /// Columns of a slice.
    pub columns: usize,
}

/// Points just outside a tetrahedron belong to it, by this much of a barycentric coordinate:
/// no point between two of them is left out.
const ROUNDING: f64 = 1e-9;

/// A slice by number: values and marks of its points, and the tetrahedra that reach it.
type Slice<'a> = (usize, ((&'a mut [f32], &'a mut [u8]), &'a Vec<u32>));

/// A tetrahedron of the grid: half spaces and a linear field.
struct Cell {
    /// Barycentric coordinates: constant, then slopes along columns, rows and slices.
    shares: [[f64; 4]; 4],
    /// Components of the field, likewise.
    field: [[f64; 4]; 3],
    /// Extent along rows and slices.
    low: [f64; 3],
    high: [f64; 3],
    mark: u8,
}

/// Values of a nodal field at the points of a slab, three components each, by slice, row and
/// column; and by which tetrahedra: 0 none, else the mark of the last one that holds the point.
///
/// Where tetrahedra overlap, a later one decides. Points in none keep the value zero. `marks` has
/// one entry a tetrahedron. Slices are filled side by side where `parallel` is true, to the same bits.
///
/// # Errors
///
/// [`FemError::WrongLength`], [`FemError::NonFinite`], and [`FemError::NodeOutOfRange`].
pub fn rasterise(
    nodes: &[[f64; 3]],
    tets: &[[usize; 4]],
    values: &[[f64; 3]],
    marks: &[u8],
    slab: Slab,
    parallel: bool,
) -> Result<(Vec<f32>, Vec<u8>), FemError> {
    check_length("values", nodes.len(), values.len())?;
    check_length("marks", tets.len(), marks.len())?;
    check_finite("nodes", nodes)?;
    check_finite("values", values)?;
    for (tet, corners) in tets.iter().enumerate() {
        if let Some(&node) = corners.iter().find(|&&node| node >= nodes.len()) {
            return Err(FemError::NodeOutOfRange { tet, node, n_nodes: nodes.len() });
        }
    }
    let in_slice = slab.rows * slab.columns;
    let mut found = vec![0.0_f32; 3 * in_slice * slab.slices];
    let mut by = vec![0_u8; in_slice * slab.slices];
    if by.is_empty() {
        return Ok((found, by));
    }
    let cells: Vec<Cell> = tets
        .iter()
        .zip(marks)
        .filter_map(|(tet, &mark)| Cell::of(tet.map(|n| nodes[n]), tet.map(|n| values[n]), mark))
        .collect();
    let mut through: Vec<Vec<u32>> = vec![Vec::new(); slab.slices];
    for (number, cell) in cells.iter().enumerate() {
        for slice in
            between(cell.low[2] - slab.first as f64, cell.high[2] - slab.first as f64, slab.slices)
        {
            through[slice].push(number as u32);
        }
    }
    let one = |(slice, ((found, by), through)): Slice<'_>| {
        let z = (slab.first + slice) as f64;
        for &number in through {
            cells[number as usize].fill(z, slab, found, by);
        }
    };
    if parallel {
        let points = found.par_chunks_mut(3 * in_slice).zip(by.par_chunks_mut(in_slice));
        points.zip(&through).enumerate().for_each(one);
    } else {
        let points = found.chunks_mut(3 * in_slice).zip(by.chunks_mut(in_slice));
        points.zip(&through).enumerate().for_each(one);
    }
    Ok((found, by))
}

/// Whole numbers below `count` from `low` to `high`, both of which may be just missed.
fn between(low: f64, high: f64, count: usize) -> std::ops::Range<usize> {
    let first = (low - ROUNDING).ceil().max(0.0);
    let last = (high + ROUNDING).floor().min(count as f64 - 1.0);
    if first > last { 0..0 } else { first as usize..last as usize + 1 }
}

impl Cell {
    /// A tetrahedron by its corners and the values there; none where it is flat.
    fn of(corners: [[f64; 3]; 4], values: [[f64; 3]; 4], mark: u8) -> Option<Self> {
        let edge = |k: usize| [0, 1, 2].map(|x| corners[k][x] - corners[0][x]);
        let (a, b, c) = (edge(1), edge(2), edge(3));
        let volume = dot(a, cross(b, c));
        let size = corners.iter().flatten().fold(1.0_f64, |most, v| most.max(v.abs()));
        if volume.abs() < 1e-14 * size.powi(3) {
            return None;
        }
        let slopes = [cross(b, c), cross(c, a), cross(a, b)].map(|s| s.map(|v| v / volume));
        let mut shares = [[0.0; 4]; 4];
        for (share, slope) in shares[1..].iter_mut().zip(slopes) {
            *share = [-dot(slope, corners[0]), slope[0], slope[1], slope[2]];
        }
        for k in 0..4 {
            shares[0][k] = f64::from(k == 0) - shares[1][k] - shares[2][k] - shares[3][k];
        }
        let field = [0, 1, 2]
            .map(|x| [0, 1, 2, 3].map(|k| (0..4).map(|n| values[n][x] * shares[n][k]).sum()));
        let extreme = |pick: fn(f64, f64) -> f64| {
            [0, 1, 2].map(|x| {
                corners[1..].iter().fold(corners[0][x], |most, corner| pick(most, corner[x]))
            })
        };
        Some(Self { shares, field, low: extreme(f64::min), high: extreme(f64::max), mark })
    }

    /// Write the field to the points of one slice that lie inside.
    fn fill(&self, z: f64, slab: Slab, found: &mut [f32], by: &mut [u8]) {
        for row in between(self.low[1], self.high[1], slab.rows) {
            let y = row as f64;
            let (mut low, mut high) = (self.low[0], self.high[0]);
            for share in &self.shares {
                let (at_zero, slope) =
                    (share[0] + share[2] * y + share[3] * z + ROUNDING, share[1]);
                if slope.abs() < 1e-300 {
                    if at_zero < 0.0 {
                        high = f64::NEG_INFINITY;
                    }
                } else if slope > 0.0 {
                    low = low.max(-at_zero / slope);
                } else {
                    high = high.min(-at_zero / slope);
                }
            }
            let line = self.field.map(|f| (f[0] + f[2] * y + f[3] * z, f[1]));
            for column in between(low, high, slab.columns) {
                let point = row * slab.columns + column;
                by[point] = self.mark;
                for (entry, (start, slope)) in found[3 * point..3 * point + 3].iter_mut().zip(line)
                {
                    *entry = (start + slope * column as f64) as f32;
                }
            }
        }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [[f64; 3]; 4] =
        [[0.2, 0.1, 0.3], [9.1, 1.0, 0.7], [2.0, 8.3, 1.1], [1.5, 2.5, 7.9]];

    fn linear(p: [f64; 3]) -> [f64; 3] {
        [1.0 + 0.5 * p[0] - p[1], 2.0 * p[2], p[0] - 0.25 * p[2]]
    }

    #[test]
    fn a_linear_field_is_found_at_every_point_inside_and_nothing_outside() {
        let slab = Slab { first: 1, slices: 7, rows: 10, columns: 11 };
        let values = CORNERS.map(linear);
        let (found, by) = rasterise(&CORNERS, &[[0, 1, 2, 3]], &values, &[2], slab, true).unwrap();
        assert_eq!(
            rasterise(&CORNERS, &[[0, 1, 2, 3]], &values, &[2], slab, false).unwrap(),
            (found.clone(), by.clone())
        );
        let cell = Cell::of(CORNERS, values, 2).unwrap();
        let mut inside = 0;
        for (point, mark) in by.iter().enumerate() {
            let (i, j, k) = (point % 11, point / 11 % 10, 1 + point / 110);
            let at = [i as f64, j as f64, k as f64];
            let least = cell
                .shares
                .iter()
                .map(|s| s[0] + s[1] * at[0] + s[2] * at[1] + s[3] * at[2])
                .fold(f64::INFINITY, f64::min);
            assert_eq!(*mark, if least >= -1e-12 { 2 } else { 0 }, "{at:?}");
            let wanted = if *mark == 0 { [0.0; 3] } else { linear(at) };
            for (entry, value) in found[3 * point..3 * point + 3].iter().zip(wanted) {
                assert!((f64::from(*entry) - value).abs() < 1e-5);
            }
            inside += usize::from(*mark == 2);
        }
        assert!(inside > 40, "{inside}");
    }

    #[test]
    fn a_point_on_a_shared_face_is_in_the_later_tetrahedron_and_none_is_left_out() {
        // Two halves of a prism share the face x = y.
        let nodes = [[0.0; 3], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0], [2.0, 2.0, 4.0]];
        let values = nodes.map(linear);
        let slab = Slab { first: 0, slices: 1, rows: 5, columns: 5 };
        let (found, by) =
            rasterise(&nodes, &[[0, 1, 2, 4], [0, 2, 3, 4]], &values, &[1, 2], slab, true).unwrap();
        for point in 0..25 {
            let (i, j) = (point % 5, point / 5);
            assert_eq!(by[point], if i > j { 1 } else { 2 }, "{i} {j}");
            assert!((f64::from(found[3 * point + 2]) - i as f64).abs() < 1e-6);
        }
    }

    #[test]
    fn what_cannot_be_a_mesh_is_refused_and_a_flat_tetrahedron_holds_nothing() {
        let slab = Slab { first: 0, slices: 2, rows: 2, columns: 2 };
        let flat = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
        let (found, by) = rasterise(&flat, &[[0, 1, 2, 3]], &flat, &[1], slab, true).unwrap();
        assert!(by.iter().all(|&mark| mark == 0) && found.iter().all(|&v| v == 0.0));
        let none = Slab { slices: 0, ..slab };
        assert_eq!(
            rasterise(&flat, &[[0, 1, 2, 3]], &flat, &[1], none, false),
            Ok((vec![], vec![]))
        );
        let wrong = rasterise(&flat, &[[0, 1, 2, 4]], &flat, &[1], slab, true);
        assert_eq!(wrong, Err(FemError::NodeOutOfRange { tet: 0, node: 4, n_nodes: 4 }));
        assert!(matches!(
            rasterise(&flat, &[], &flat[1..], &[], slab, true),
            Err(FemError::WrongLength { .. })
        ));
        assert!(matches!(
            rasterise(&flat, &[[0, 1, 2, 3]], &flat, &[], slab, true),
            Err(FemError::WrongLength { .. })
        ));
        let nan = [[f64::NAN; 3]; 4];
        assert!(matches!(
            rasterise(&nan, &[], &flat, &[], slab, true),
            Err(FemError::NonFinite { .. })
        ));
    }
}
