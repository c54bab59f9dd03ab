//! How large a factor will be, before it is made.

use super::fronts::Fronts;

/// Size of the factor of a body's stiffness, known from its symbolic analysis alone.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::{Body, Element, Mesh};
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet10, [0, 1, 2])?;
/// let size = body.factor_size();
/// // One dense front of all unknowns: 1² + 2² + ... + 12².
/// assert_eq!((body.n_unknowns(), size.flops), (12, 650.0));
/// assert!(size.n_entries >= 12 * 13 / 2);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct FactorSize {
    /// Entries that are kept, those that fill up blocks included. An entry takes two bytes in the
    /// metric of a solve, four in a tangent of single precision, eight in one of double precision.
    pub n_entries: usize,
    /// Floating-point operations of a factorisation; a multiplication and its addition are two.
    pub flops: f64,
    /// Most entries that are held besides while one thread makes the factor: a front, its update
    /// and updates that wait, four bytes each, eight in double precision. More threads hold more.
    pub n_working: usize,
}

impl Fronts {
    /// Size of the factor.
    pub(crate) fn size(&self) -> FactorSize {
        let (mut waiting, mut n_working) = (0, 0);
        for front in &self.fronts {
            let update = front.n_rows * front.n_rows;
            n_working = n_working.max(waiting + front.size() * front.n_own + update);
            let below: usize = self
                .children_of(front)
                .iter()
                .map(|&child| self.fronts[child as usize].n_rows.pow(2))
                .sum();
            waiting += update;
            waiting -= below;
        }
        FactorSize { n_entries: self.n_entries, flops: 2.0 * self.work, n_working }
    }
}
