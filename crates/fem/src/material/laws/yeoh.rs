//! Yeoh's law, three terms: `½ (a + c₂/c₁ a² + c₃/c₁ a³)` of shear modulus 1.

use crate::material::declaration::{Declaration, Range, ShapeParameter, Slopes};

pub(in crate::material) const DECLARATION: Declaration = Declaration {
    name: "yeoh",
    shape: &[
        ShapeParameter::number("c2_over_c1", Range::Finite),
        ShapeParameter::number("c3_over_c1", Range::Finite),
    ],
    starts: &[&[0.1, 0.01]],
};

pub(in crate::material) const SECOND: bool = false;

#[inline]
pub(in crate::material) fn slopes([c2, c3]: [f64; 2], a: f64, _b: f64) -> Slopes {
    Slopes {
        energy: 0.5 * a * (1.0 + a * (c2 + a * c3)),
        a: 0.5 + a * (c2 + 1.5 * a * c3),
        b: 0.0,
        aa: c2 + 3.0 * a * c3,
    }
}

pub(in crate::material) fn slopes_by(_: [f64; 2], nth: usize, a: f64, _b: f64) -> (f64, f64, f64) {
    match nth {
        0 => (0.5 * a * a, a, 0.0),
        _ => (0.5 * a * a * a, 1.5 * a * a, 0.0),
    }
}
