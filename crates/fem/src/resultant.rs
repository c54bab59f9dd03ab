//! Force and moment of many forces.

/// What many forces do together.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Resultant {
    /// Their sum, mN.
    pub force: [f64; 3],
    /// Their moment about the given point, mN mm.
    pub moment: [f64; 3],
}

/// Resultant of forces (mN) at places (mm), its moment about a point.
///
/// Reactions of a deformed body act at deformed places; of two lists, the shorter counts.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::resultant;
///
/// let pair = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
/// let twist = resultant(&[[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]], &pair, [0.0; 3]);
/// assert_eq!((twist.force, twist.moment), ([0.0; 3], [0.0, -4.0, 0.0]));
/// ```
pub fn resultant(places: &[[f64; 3]], forces: &[[f64; 3]], about: [f64; 3]) -> Resultant {
    let mut sum = Resultant::default();
    for (x, f) in places.iter().zip(forces) {
        let arm: [f64; 3] = std::array::from_fn(|i| x[i] - about[i]);
        for i in 0..3 {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            sum.force[i] += f[i];
            sum.moment[i] += arm[j] * f[k] - arm[k] * f[j];
        }
    }
    sum
}
