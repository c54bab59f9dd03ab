//! A Gaussian by its mean and a triangular root of its covariance.

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatRef, Par};

use crate::check::{check_finite, check_shape, find_asymmetry};
use crate::{EsmdaError, linalg};

/// `N(m, C)` with `C = M M'`, `M` lower triangular.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::{Gaussian, faer::mat};
///
/// let gaussian = Gaussian::new(&[1.0, 2.0], mat![[4.0, 2.0], [2.0, 5.0]].as_ref())?;
/// assert_eq!(gaussian.root(), mat![[2.0, 0.0], [1.0, 2.0]]);
/// assert_eq!(gaussian.at(mat![[1.0], [-1.0]].as_ref())?, mat![[3.0], [1.0]]);
/// # Ok::<(), tissuereg_esmda::EsmdaError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussian {
    mean: Vec<f64>,
    root: Mat<f64>,
}

impl Gaussian {
    /// From a mean (n) and a covariance (n, n).
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`], [`EsmdaError::NotFinite`], [`EsmdaError::PriorNotSymmetric`],
    /// [`EsmdaError::PriorNotPositiveDefinite`] with the failing pivot.
    ///
    /// # Cost
    ///
    /// One Cholesky factorisation, `n^3 / 3` multiply-adds.
    pub fn new(mean: &[f64], covariance: MatRef<'_, f64>) -> Result<Self, EsmdaError> {
        let n = mean.len();
        check_shape("covariance", covariance.shape(), (n, n))?;
        check_finite("mean", MatRef::from_column_major_slice(mean, n, 1))?;
        check_finite("covariance", covariance)?;
        if let Some((row, column, value, mirrored)) = find_asymmetry(covariance) {
            return Err(EsmdaError::PriorNotSymmetric { row, column, value, mirrored });
        }
        let mut root = covariance.to_owned();
        linalg::cholesky_in_place(root.as_mut())
            .map_err(|pivot| EsmdaError::PriorNotPositiveDefinite { pivot })?;
        for column in 1..n {
            root.col_mut(column).get_mut(..column).fill(0.0);
        }
        Ok(Self { mean: mean.to_vec(), root })
    }

    /// From a mean and any square root of the covariance, (n, n): made triangular by QR, so that no digits are lost.
    pub(crate) fn from_root(mean: Vec<f64>, root: MatRef<'_, f64>) -> Self {
        let n = mean.len();
        let (_, upper) = linalg::thin_qr(root.transpose().to_owned());
        let root = Mat::from_fn(n, n, |row, column| {
            let sign = if upper[(column, column)] < 0.0 { -1.0 } else { 1.0 };
            if row < column { 0.0 } else { sign * upper[(column, row)] }
        });
        Self { mean, root }
    }

    /// Number of dimensions.
    pub fn n(&self) -> usize {
        self.mean.len()
    }

    /// Mean, (n).
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// Lower triangular `M` of `C = M M'`, (n, n).
    pub fn root(&self) -> MatRef<'_, f64> {
        self.root.as_ref()
    }

    /// `C`, (n, n).
    pub fn covariance(&self) -> Mat<f64> {
        let n = self.n();
        let mut covariance = Mat::zeros(n, n);
        matmul(
            covariance.as_mut(),
            BlockStructure::Rectangular,
            Accum::Replace,
            self.root.as_ref(),
            BlockStructure::TriangularLower,
            self.root.transpose(),
            BlockStructure::TriangularUpper,
            1.0,
            Par::Seq,
        );
        covariance
    }

    /// Places given in standard deviations, `m + M w` for every column `w`: draws, if the columns are standard normals.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::Shape`] unless `normals` has n rows.
    pub fn at(&self, normals: MatRef<'_, f64>) -> Result<Mat<f64>, EsmdaError> {
        let n = self.n();
        check_shape("normals", normals.shape(), (n, normals.ncols()))?;
        let mean = |row: usize, _: usize| self.mean[row];
        let mut places = Mat::from_fn(n, normals.ncols(), mean);
        matmul(
            places.as_mut(),
            BlockStructure::Rectangular,
            Accum::Add,
            self.root.as_ref(),
            BlockStructure::TriangularLower,
            normals,
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
        Ok(places)
    }

    /// `M^-1 (z - m)`
    pub(crate) fn whitened(&self, place: &[f64]) -> Mat<f64> {
        let mut away = Mat::from_fn(self.n(), 1, |row, _| place[row] - self.mean[row]);
        solve_lower_triangular_in_place(self.root.as_ref(), away.as_mut(), Par::Seq);
        away
    }
}
