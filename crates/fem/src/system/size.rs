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
            let update = front.update_len();
            n_working = n_working.max(waiting + front.size() * front.n_own + update);
            waiting += update;
            waiting -= self.passed_to(front);
        }
        FactorSize { n_entries: self.n_entries, flops: 2.0 * self.work, n_working }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used)]

    use crate::body::Body;
    use crate::element::Element;
    use crate::mesh::Mesh;

    /// A row of `n` prisms of three tetrahedra each, its first three nodes held.
    fn rod(n: usize) -> Body {
        let layer = |k: usize| [[0.0, 0.0, k as f64], [1.0, 0.0, k as f64], [0.0, 1.0, k as f64]];
        let nodes = (0..=n).flat_map(layer).collect();
        let prism = |k: usize| {
            let [a, b, c, d, e, f] = std::array::from_fn(|i| 3 * k + i);
            [[a, b, c, d], [b, c, d, e], [c, d, e, f]]
        };
        let mesh = Mesh::new(nodes, (0..n).flat_map(prism).collect()).expect("sound");
        Body::new(mesh, Element::Tet4, [0, 1, 2]).expect("held")
    }

    #[test]
    fn few_updates_wait_at_the_same_time() {
        let body = rod(400);
        let fronts = &body.pattern().fronts;
        let [root] = fronts.roots[..] else { unreachable!("one body, one root") };
        let lens = || fronts.fronts.iter().map(|front| front.update_len());
        let (all, largest) = (lens().sum::<usize>(), lens().max().unwrap_or(0));
        let stack = fronts.stack_of(root);
        // One a level of a tree of halves, not one a front.
        assert!(fronts.fronts.len() > 30, "{}", fronts.fronts.len());
        assert!(largest <= stack && 4 * stack < all, "{largest} {stack} {all}");
        assert!(stack <= fronts.size().n_working);
    }
}
