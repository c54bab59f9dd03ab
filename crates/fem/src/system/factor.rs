//! Numeric Cholesky factors of a body's stiffness, in single or double precision.
//!
//! The matrix is scaled to unit diagonal first, `S K S` with `S = diag(K)^-1/2`, so that single
//! precision neither overflows nor loses pivots to a wide range of stiffness. A single-precision
//! factor serves as a metric (its errors are corrected by the iteration around it) and costs half
//! the memory and time. Everything runs on one thread: the bits do not depend on the number of
//! threads, and faer's supernodal factor gains nothing from more.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::sparse::linalg::cholesky::{LltRef, SymbolicCholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, Mat, Par, Side};

use super::pattern::Pattern;
use crate::error::FemError;

/// Number type of a factor.
pub(crate) trait Precision: faer::traits::RealField + Copy {
    fn from_f64(value: f64) -> Self;
    fn to_f64(self) -> f64;
}

impl Precision for f64 {
    fn from_f64(value: f64) -> Self {
        value
    }
    fn to_f64(self) -> f64 {
        self
    }
}

impl Precision for f32 {
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
}

/// Factor of a positive definite matrix, in the precision that sufficed.
#[derive(Debug)]
pub(crate) enum Factor {
    Single(Numeric<f32>),
    Double(Numeric<f64>),
}

impl Factor {
    /// Factor in single precision, in double where that finds no positive pivots.
    pub(crate) fn single_or_double(pattern: &Pattern, values: &[f64]) -> Result<Self, FemError> {
        match Numeric::new(pattern, values) {
            Ok(factor) => Ok(Self::Single(factor)),
            Err(FemError::SingularStiffness { .. }) => Self::double(pattern, values),
            Err(error) => Err(error),
        }
    }

    /// Factor in double precision.
    pub(crate) fn double(pattern: &Pattern, values: &[f64]) -> Result<Self, FemError> {
        Numeric::new(pattern, values).map(Self::Double)
    }

    /// Euclidean norm of the diagonal of the matrix.
    pub(crate) fn diagonal_norm(&self) -> f64 {
        let scaling = match self {
            Self::Single(factor) => &factor.scaling,
            Self::Double(factor) => &factor.scaling,
        };
        scaling.iter().map(|s| s.powi(-4)).sum::<f64>().sqrt()
    }

    /// Write `scale K⁻¹ rhs` to `out`.
    pub(crate) fn solve_into(
        &self,
        pattern: &Pattern,
        scale: f64,
        rhs: &[f64],
        out: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        let Some(symbolic) = &pattern.symbolic else { return };
        match self {
            Self::Single(factor) => {
                factor.solve_into(symbolic, scale, rhs, out, &mut scratch.single)
            }
            Self::Double(factor) => {
                factor.solve_into(symbolic, scale, rhs, out, &mut scratch.double)
            }
        }
    }
}

/// Buffers of a solve, kept between solves.
#[derive(Default)]
pub(crate) struct SolveScratch {
    single: Scratch<f32>,
    double: Scratch<f64>,
}

struct Scratch<T: Precision> {
    rhs: Mat<T>,
    memory: Option<MemBuffer>,
}

impl<T: Precision> Default for Scratch<T> {
    fn default() -> Self {
        Self { rhs: Mat::new(), memory: None }
    }
}

/// Values of a factor with the scaling of its matrix.
#[derive(Debug)]
pub(crate) struct Numeric<T: Precision> {
    /// One column; a matrix for its aligned storage.
    values: Mat<T>,
    scaling: Vec<f64>,
}

impl<T: Precision> Numeric<T> {
    fn new(pattern: &Pattern, values: &[f64]) -> Result<Self, FemError> {
        let n = pattern.n_unknowns();
        let too_large = || FemError::TooLarge { n_dofs: n };
        let scaling = scaling(pattern, values)?;
        let Some(symbolic) = &pattern.symbolic else {
            return Ok(Self { values: Mat::new(), scaling });
        };
        let scaled = scaled_values::<T>(pattern, values, &scaling);
        let matrix = SparseColMatRef::new(
            SymbolicSparseColMatRef::new_checked(n, n, &pattern.column_start, None, &pattern.rows),
            scaled.col_as_slice(0),
        );
        let mut factor = Mat::<T>::zeros(symbolic.len_val(), 1);
        let request = symbolic.factorize_numeric_llt_scratch::<T>(Par::Seq, faer::Spec::default());
        let mut memory = MemBuffer::try_new(request).map_err(|_| too_large())?;
        symbolic
            .factorize_numeric_llt(
                factor.col_as_slice_mut(0),
                matrix,
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut memory),
                faer::Spec::default(),
            )
            .map_err(|LltError::NonPositivePivot { index }| FemError::SingularStiffness {
                pivot: index,
                n_dofs: n,
            })?;
        Ok(Self { values: factor, scaling })
    }

    fn solve_into(
        &self,
        symbolic: &SymbolicCholesky<u32>,
        scale: f64,
        rhs: &[f64],
        out: &mut [f64],
        scratch: &mut Scratch<T>,
    ) {
        let n = rhs.len();
        if scratch.rhs.nrows() != n {
            scratch.rhs = Mat::zeros(n, 1);
            scratch.memory = None;
        }
        let memory = scratch.memory.get_or_insert_with(|| {
            MemBuffer::new(symbolic.solve_in_place_scratch::<T>(1, Par::Seq))
        });
        // Single precision has a narrow range of exponents: bring the right-hand side to size 1.
        let size = rhs.iter().zip(&self.scaling).fold(0.0_f64, |m, (r, s)| m.max((r * s).abs()));
        if size == 0.0 {
            out.fill(0.0);
            return;
        }
        for ((x, r), s) in scratch.rhs.col_as_slice_mut(0).iter_mut().zip(rhs).zip(&self.scaling) {
            *x = T::from_f64(r * s / size);
        }
        LltRef::new(symbolic, self.values.col_as_slice(0)).solve_in_place_with_conj(
            Conj::No,
            scratch.rhs.as_mut(),
            Par::Seq,
            MemStack::new(memory),
        );
        for ((o, x), s) in out.iter_mut().zip(scratch.rhs.col_as_slice(0)).zip(&self.scaling) {
            *o = x.to_f64() * s * (size * scale);
        }
    }
}

/// `diag(K)^-1/2`; fails where a diagonal entry is not positive.
fn scaling(pattern: &Pattern, values: &[f64]) -> Result<Vec<f64>, FemError> {
    let n_dofs = pattern.n_unknowns();
    (0..n_dofs)
        .map(|j| {
            let diagonal = values[pattern.column_start[j] as usize];
            if diagonal > 0.0 && diagonal.is_finite() {
                Ok(1.0 / diagonal.sqrt())
            } else {
                Err(FemError::SingularStiffness { pivot: j, n_dofs })
            }
        })
        .collect()
}

fn scaled_values<T: Precision>(pattern: &Pattern, values: &[f64], scaling: &[f64]) -> Mat<T> {
    let mut scaled = Mat::<T>::zeros(pattern.n_entries(), 1);
    let slots = scaled.col_as_slice_mut(0);
    for j in 0..pattern.n_unknowns() {
        let column = pattern.column_start[j] as usize..pattern.column_start[j + 1] as usize;
        for k in column {
            slots[k] = T::from_f64(values[k] * scaling[j] * scaling[pattern.rows[k] as usize]);
        }
    }
    scaled
}
