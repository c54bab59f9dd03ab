//! Two springs in a row hang from a ceiling, 10 N pulls at the end. From where the two ends went, how stiff is each?
//!
//! `cargo run --example two_springs`: the whole of an ES-MDA, with a nonlinear model.

use tissuereg_esmda::faer::Mat;
use tissuereg_esmda::{EsmdaError, NoiseCovariance, Schedule, Step, StepSettings, screen_members};

const FORCE: f64 = 10.0; // N
const STD: f64 = 0.05; // mm, of both measured displacements
const OBSERVED: [f64; 2] = [5.0, 7.0]; // mm: 10 N on 2 N/mm, and 10 N on 5 N/mm more

/// Standard normal numbers, the same in every run (SplitMix64 and Box-Muller); any generator of yours serves as well.
struct Normals(u64);

impl Normals {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn matrix(&mut self, n_rows: usize, n_columns: usize) -> Mat<f64> {
        Mat::from_fn(n_rows, n_columns, |_, _| {
            let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
            radius * (std::f64::consts::TAU * self.uniform()).cos()
        })
    }
}

/// Mean and standard deviation of one row.
fn moments(rows: &Mat<f64>, row: usize) -> [f64; 2] {
    let n = rows.ncols() as f64;
    let mean = rows.row(row).iter().sum::<f64>() / n;
    let squares: f64 = rows.row(row).iter().map(|value| (value - mean).powi(2)).sum();
    [mean, (squares / (n - 1.0)).sqrt()]
}

/// Displacements (2, n_members) of both ends, mm, from the logarithms of both stiffnesses.
fn displacements(log_stiffness: &Mat<f64>) -> Mat<f64> {
    let stretch = |spring, member| FORCE / f64::exp(log_stiffness[(spring, member)]);
    Mat::from_fn(2, log_stiffness.ncols(), |end, member| {
        (0..=end).map(|s| stretch(s, member)).sum()
    })
}

/// Means and standard deviations of both logarithms after all steps.
fn identified() -> Result<[[f64; 2]; 2], EsmdaError> {
    let (n_members, mut normals) = (200, Normals(1));
    // Before: 3 N/mm, within a factor of 1.6 either way.
    let prior = normals.matrix(2, n_members);
    let mut log_stiffness = Mat::from_fn(2, n_members, |i, j| 3.0_f64.ln() + 0.5 * prior[(i, j)]);
    let noise = NoiseCovariance::diagonal(&[STD; 2])?;
    for &alpha in Schedule::geometric(8, 2.0)?.alphas() {
        let predicted = displacements(&log_stiffness);
        screen_members(predicted.as_ref(), 1e3).at_least(n_members)?;
        let draws = normals.matrix(2, n_members);
        let (y, e, settings) = (predicted.as_ref(), draws.as_ref(), StepSettings::default());
        Step::prepare(y, &OBSERVED, &noise, alpha, e, &settings)?.apply(log_stiffness.as_mut())?;
    }
    Ok([0, 1].map(|row| moments(&log_stiffness, row)))
}

fn main() -> Result<(), EsmdaError> {
    for (name, [mean, std]) in ["upper", "lower"].iter().zip(identified()?) {
        println!("{name} spring: {:.2} N/mm, known to {:.1} %", mean.exp(), 100.0 * std);
    }
    Ok(())
}

#[test]
fn both_stiffnesses_are_found_within_two_standard_deviations() {
    let [upper, lower] = identified().unwrap();
    assert!((upper[0] - 2.0_f64.ln()).abs() < 2.0 * upper[1], "{upper:?}");
    assert!((lower[0] - 5.0_f64.ln()).abs() < 2.0 * lower[1], "{lower:?}");
    // By hand: 0.05 of 5 mm, and 0.07 of the 2 mm by which the lower spring stretches.
    assert!((upper[1] / 0.01 - 1.0).abs() < 0.3, "{upper:?}");
    assert!((lower[1] / 0.0354 - 1.0).abs() < 0.3, "{lower:?}");
}
