//! Fung's isotropic exponential law: `(exp(rate a) − 1) / (2 rate)` of shear modulus 1.

use crate::material::declaration::{Declaration, Range, ShapeParameter, Slopes};
use crate::material::tensor::{phi1, phi2};

pub(in crate::material) const DECLARATION: Declaration = Declaration {
    name: "fung",
    shape: &[ShapeParameter::number("b", Range::NotNegative).searched(0.0, 1e3)],
    starts: &[&[0.3], &[5.0]],
};

pub(in crate::material) const SECOND: bool = false;

#[inline]
pub(in crate::material) fn slopes([rate]: [f64; 1], a: f64, _b: f64) -> Slopes {
    Slopes {
        energy: 0.5 * a * phi1(rate * a),
        a: 0.5 * (rate * a).exp(),
        b: 0.0,
        aa: 0.5 * rate * (rate * a).exp(),
    }
}

pub(in crate::material) fn slopes_by(
    [rate]: [f64; 1],
    _nth: usize,
    a: f64,
    _b: f64,
) -> (f64, f64, f64) {
    let stiffened = a * a * (phi1(rate * a) - phi2(rate * a));
    (0.5 * stiffened, 0.5 * a * (rate * a).exp(), 0.0)
}
