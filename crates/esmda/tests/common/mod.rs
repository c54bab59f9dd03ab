//! Problems with known answers, shared by tests, benches and examples.
#![allow(dead_code, missing_docs, clippy::unwrap_used)]

use faer::prelude::Solve;
use faer::{Mat, MatRef, Side};
use tissuereg_esmda::{EsmdaError, NoiseCovariance, Schedule, Step, StepSettings};

/// A small generator of standard normals (SplitMix64 and Box-Muller): the same numbers everywhere.
pub struct Normals(u64);

impl Normals {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x2545_F491_4F6C_DD1D) ^ 0x9E37_79B9_7F4A_7C15)
    }

    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn draw(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    pub fn matrix(&mut self, n_rows: usize, n_columns: usize) -> Mat<f64> {
        let mut matrix = Mat::zeros(n_rows, n_columns);
        for column in 0..n_columns {
            for row in 0..n_rows {
                matrix[(row, column)] = self.draw();
            }
        }
        matrix
    }

    pub fn vector(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.draw()).collect()
    }

    /// Draws with mean zero and sample covariance the identity, to rounding, and no sample correlation with the rows of
    /// `apart_from`. Needs more members than all rows together.
    pub fn exact(
        &mut self,
        n_rows: usize,
        n_members: usize,
        apart_from: &[MatRef<'_, f64>],
    ) -> Mat<f64> {
        let taken = 1 + apart_from.iter().map(|rows| rows.nrows()).sum::<usize>();
        assert!(n_members >= taken + n_rows, "too few members for exact draws");
        let mut columns =
            Mat::from_fn(
                n_members,
                taken + n_rows,
                |_, column| {
                    if column == 0 { 1.0 } else { self.draw() }
                },
            );
        let mut from = 1;
        for rows in apart_from {
            columns.get_mut(.., from..from + rows.nrows()).copy_from(rows.transpose());
            from += rows.nrows();
        }
        let q = columns.qr().compute_thin_Q();
        q.get(.., taken..).transpose() * faer::Scale(((n_members - 1) as f64).sqrt())
    }
}

/// `d = H z + noise` with the prior `z ~ N(0, I)`: the posterior is known.
pub struct LinearGaussian {
    pub operator: Mat<f64>,
    pub covariance: Mat<f64>,
    pub truth: Vec<f64>,
    pub observed: Vec<f64>,
}

impl LinearGaussian {
    /// Independent noise of one standard deviation.
    pub fn new(n_parameters: usize, n_obs: usize, std: f64, seed: u64) -> Self {
        let covariance = Mat::from_fn(n_obs, n_obs, |i, j| if i == j { std * std } else { 0.0 });
        Self::with_covariance(n_parameters, covariance, seed)
    }

    pub fn with_covariance(n_parameters: usize, covariance: Mat<f64>, seed: u64) -> Self {
        let mut normals = Normals::new(seed);
        let n_obs = covariance.nrows();
        let operator = normals.matrix(n_obs, n_parameters);
        let truth = normals.vector(n_parameters);
        let root = covariance.llt(Side::Lower).unwrap();
        let noise = root.L() * column(&normals.vector(n_obs));
        let clean = &operator * column(&truth);
        let observed = (0..n_obs).map(|obs| clean[(obs, 0)] + noise[(obs, 0)]).collect();
        Self { operator, covariance, truth, observed }
    }

    pub fn noise(&self) -> NoiseCovariance {
        NoiseCovariance::dense(self.covariance.as_ref()).unwrap()
    }

    /// Mean and covariance of the posterior when the data count `total` times, from the precision
    /// `I + total H' C_d^-1 H`.
    pub fn posterior(&self, total: f64) -> (Mat<f64>, Mat<f64>) {
        let n = self.operator.ncols();
        let lower = self.covariance.llt(Side::Lower).unwrap().L().to_owned();
        let mut whitened = self.operator.clone();
        lower.solve_lower_triangular_in_place(&mut whitened);
        let mut data = column(&self.observed);
        lower.solve_lower_triangular_in_place(&mut data);
        let gram = whitened.transpose() * &whitened;
        let precision = Mat::<f64>::identity(n, n) + gram * faer::Scale(total);
        let factor = precision.llt(Side::Lower).unwrap();
        let mean = factor.solve(whitened.transpose() * data * faer::Scale(total));
        (mean, factor.solve(Mat::<f64>::identity(n, n)))
    }

    /// Runs a whole schedule of square-root steps; the sum of their log evidences.
    pub fn run_square_root(
        &self,
        parameters: &mut Mat<f64>,
        schedule: &Schedule,
    ) -> Result<f64, EsmdaError> {
        let (settings, mut evidence) = (StepSettings::default(), 0.0);
        for &alpha in schedule.alphas() {
            let predicted = &self.operator * &*parameters;
            let step = Step::prepare_square_root(
                predicted.as_ref(),
                &self.observed,
                &self.noise(),
                alpha,
                &settings,
            )?;
            evidence += step.report().log_evidence.unwrap();
            step.apply(parameters.as_mut())?;
        }
        Ok(evidence)
    }

    /// Runs a whole schedule of stochastic steps, with draws from a function of the current ensemble.
    pub fn run_stochastic(
        &self,
        parameters: &mut Mat<f64>,
        schedule: &Schedule,
        settings: &StepSettings,
        mut draws: impl FnMut(&Mat<f64>) -> Mat<f64>,
    ) -> Result<(), EsmdaError> {
        for &alpha in schedule.alphas() {
            let predicted = &self.operator * &*parameters;
            let draws = draws(parameters);
            let (observed, noise) = (&self.observed, self.noise());
            Step::prepare(predicted.as_ref(), observed, &noise, alpha, draws.as_ref(), settings)?
                .apply(parameters.as_mut())?;
        }
        Ok(())
    }
}

/// A random update of the given size: predictions, observations, standard deviations, draws, parameters.
pub struct Case {
    pub predicted: Mat<f64>,
    pub observed: Vec<f64>,
    pub std: Vec<f64>,
    pub draws: Mat<f64>,
    pub parameters: Mat<f64>,
}

impl Case {
    /// Predictions a linear map of the parameters, with spread about one, noise `std`.
    pub fn new(n_parameters: usize, n_obs: usize, n_members: usize, std: f64, seed: u64) -> Self {
        let mut normals = Normals::new(seed);
        let parameters = normals.matrix(n_parameters, n_members);
        let scale = faer::Scale(1.0 / (n_parameters as f64).sqrt());
        let predicted = normals.matrix(n_obs, n_parameters) * &parameters * scale;
        let observed = normals.vector(n_obs);
        let draws = normals.matrix(n_obs, n_members);
        let std = (0..n_obs).map(|obs| std * (1.0 + 0.5 * (obs % 3) as f64)).collect();
        Self { predicted, observed, std, draws, parameters }
    }

    /// 15 markers, 26 latents, 100 members.
    pub fn surgical() -> Self {
        Self::new(26, 45, 100, 0.3, 1)
    }

    /// 100 markers, 26 latents, 1000 members.
    pub fn wide() -> Self {
        Self::new(26, 300, 1000, 0.3, 2)
    }

    pub fn noise(&self) -> NoiseCovariance {
        NoiseCovariance::diagonal(&self.std).unwrap()
    }

    pub fn step(&self, alpha: f64, settings: &StepSettings) -> Result<Step, EsmdaError> {
        let (predicted, draws) = (self.predicted.as_ref(), self.draws.as_ref());
        Step::prepare(predicted, &self.observed, &self.noise(), alpha, draws, settings)
    }

    pub fn updated(&self, alpha: f64, settings: &StepSettings) -> Result<Mat<f64>, EsmdaError> {
        let mut parameters = self.parameters.clone();
        self.step(alpha, settings)?.apply(parameters.as_mut())?;
        Ok(parameters)
    }
}

pub fn column(values: &[f64]) -> Mat<f64> {
    Mat::from_fn(values.len(), 1, |row, _| values[row])
}

/// Sample mean and covariance (over `n - 1`) of an ensemble, one column a member.
pub fn moments(ensemble: &Mat<f64>) -> (Mat<f64>, Mat<f64>) {
    let n = ensemble.ncols() as f64;
    let mean =
        Mat::from_fn(ensemble.nrows(), 1, |row, _| ensemble.row(row).iter().sum::<f64>() / n);
    let anomalies =
        Mat::from_fn(ensemble.nrows(), ensemble.ncols(), |i, j| ensemble[(i, j)] - mean[(i, 0)]);
    let covariance = &anomalies * anomalies.transpose() * faer::Scale(1.0 / (n - 1.0));
    (mean, covariance)
}

/// Largest absolute difference over the largest absolute entry of `b`.
pub fn relative_difference(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    (a - b).norm_max() / b.norm_max()
}
