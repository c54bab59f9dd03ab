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

/// A number and its rate along one cause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Dual {
    pub(crate) value: f64,
    pub(crate) rate: f64,
}

impl Scalar for Dual {
    const FOLLOWS: bool = true;

    fn constant(value: f64) -> Self {
        Self { value, rate: 0.0 }
    }

    fn value(self) -> f64 {
        self.value
    }

    fn is_constant(self) -> bool {
        self.rate == 0.0
    }

    fn chain(value: f64, slopes: impl IntoIterator<Item = (Self, f64)>) -> Self {
        let rate = slopes.into_iter().map(|(by, slope)| slope * by.rate).sum();
        Self { value, rate }
    }
}

impl Add for Dual {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, rate: self.rate + other.rate }
    }
}

impl Sub for Dual {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self { value: self.value - other.value, rate: self.rate - other.rate }
    }
}

impl Mul for Dual {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let rate = self.rate * other.value + self.value * other.rate;
        Self { value: self.value * other.value, rate }
    }
}

impl Div for Dual {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self { value, rate: (self.rate - value * other.rate) / other.value }
    }
}

impl Neg for Dual {
    type Output = Self;

    fn neg(self) -> Self {
        Self { value: -self.value, rate: -self.rate }
    }
}
