//! Numbers that may carry a derivative with them.
//!
//! What a point does within a time step is written once, over any [`Scalar`]: plain numbers for the
//! solver, [`Dual`] ones for derivatives along one cause, and those of a tape for adjoints.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::material::Matrix3;

/// A number, plain or with a derivative.
pub(crate) trait Scalar:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// Whether derivatives are carried at all.
    const FOLLOWS: bool;

    /// A number that nothing moves.
    fn constant(value: f64) -> Self;

    fn value(self) -> f64;

    /// Whether nothing moves it.
    fn is_constant(self) -> bool;

    /// A function of numbers, by its value and its slopes.
    fn chain(value: f64, slopes: impl IntoIterator<Item = (Self, f64)>) -> Self;

    /// A function of this number.
    fn apply(self, value: f64, slope: f64) -> Self {
        Self::chain(value, [(self, slope)])
    }

    /// Whether it is this value and stays so.
    fn stays(self, value: f64) -> bool {
        self.value() == value && self.is_constant()
    }
}

/// A matrix of three rows, `[i][j]`.
pub(crate) type Matrix<S> = [[S; 3]; 3];

/// A matrix that nothing moves.
pub(crate) fn constant<S: Scalar>(m: &Matrix3) -> Matrix<S> {
    m.map(|row| row.map(S::constant))
}

pub(crate) fn values<S: Scalar>(m: &Matrix<S>) -> Matrix3 {
    m.map(|row| row.map(S::value))
}

impl Scalar for f64 {
    const FOLLOWS: bool = false;

    #[inline(always)]
    fn constant(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn value(self) -> f64 {
        self
    }

    #[inline(always)]
    fn is_constant(self) -> bool {
        true
    }

    #[inline(always)]
    fn chain(value: f64, _: impl IntoIterator<Item = (Self, f64)>) -> Self {
        value
    }
}

/// Causes or observations that are followed at once: a row of processor lanes.
pub(crate) const LANES: usize = 8;

/// A number and its rates along several causes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Dual {
    pub(crate) value: f64,
    pub(crate) rates: [f64; LANES],
}

impl Dual {
    #[inline(always)]
    fn from_rates(value: f64, rate: impl Fn(usize) -> f64) -> Self {
        Self { value, rates: std::array::from_fn(rate) }
    }
}

impl Scalar for Dual {
    const FOLLOWS: bool = true;

    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self { value, rates: [0.0; LANES] }
    }

    #[inline(always)]
    fn value(self) -> f64 {
        self.value
    }

    #[inline]
    fn is_constant(self) -> bool {
        self.rates.iter().all(|&rate| rate == 0.0)
    }

    #[inline(always)]
    fn chain(value: f64, slopes: impl IntoIterator<Item = (Self, f64)>) -> Self {
        let mut sum = Self::constant(value);
        for (by, slope) in slopes {
            for k in 0..LANES {
                sum.rates[k] += slope * by.rates[k];
            }
        }
        sum
    }
}

impl Add for Dual {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::from_rates(self.value + other.value, |k| self.rates[k] + other.rates[k])
    }
}

impl Sub for Dual {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::from_rates(self.value - other.value, |k| self.rates[k] - other.rates[k])
    }
}

impl Mul for Dual {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self::chain(self.value * other.value, [(self, other.value), (other, self.value)])
    }
}

impl Div for Dual {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, over) = (self.value / other.value, 1.0 / other.value);
        Self::from_rates(value, |k| over * (self.rates[k] - value * other.rates[k]))
    }
}

impl Neg for Dual {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::from_rates(-self.value, |k| -self.rates[k])
    }
}
