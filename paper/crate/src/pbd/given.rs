//! Constraints and observations as they are given.

/// What one family of constraints needs: the particles and the number to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PbdConstraint<const N: usize> {
    /// Two particles for a distance, four for the volume of their tetrahedron.
    pub particles: [usize; N],
    /// Distance in mm, or signed volume in mm³.
    pub rest: f64,
    /// Square of what the constraint is off by over twice its energy: mm/mN for a distance, mm⁵/mN for a
    /// volume; 0 is rigid.
    pub compliance: f64,
}

/// A place `Σ b_k p_k` that was observed, as on a triangle or in a tetrahedron.
#[derive(Debug, Clone, PartialEq)]
pub struct PbdObservation {
    /// Particles with their weights `b`.
    pub weights: Vec<(usize, f64)>,
    /// Where the place was observed, mm.
    pub place: [f64; 3],
    /// Square of the distance over twice its energy, mm/mN; 0 is rigid.
    pub compliance: f64,
}
