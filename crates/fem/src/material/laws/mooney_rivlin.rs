//! The law of Mooney and Rivlin: `½ ((1 − share) a + share b)` of shear modulus 1.

use crate::material::declaration::{Declaration, Range, ShapeParameter, Slopes};

pub(in crate::material) const DECLARATION: Declaration = Declaration {
    name: "mooney-rivlin",
    shape: &[ShapeParameter::number("share", Range::Finite).searched(0.0, 1.0)],
    starts: &[&[0.3]],
};

pub(in crate::material) const SECOND: bool = true;

#[inline]
pub(in crate::material) fn slopes([share]: [f64; 1], a: f64, b: f64) -> Slopes {
    Slopes {
        energy: 0.5 * ((1.0 - share) * a + share * b),
        a: 0.5 * (1.0 - share),
        b: 0.5 * share,
        aa: 0.0,
    }
}

pub(in crate::material) fn slopes_by(_: [f64; 1], _nth: usize, a: f64, b: f64) -> (f64, f64, f64) {
    (0.5 * (b - a), -0.5, 0.5)
}
