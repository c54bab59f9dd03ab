//! Two unknown numbers of which only the sum is observed: `cargo run --example first_update`.

use tissuereg_esmda::faer::mat;
use tissuereg_esmda::{EsmdaError, NoiseCovariance, Schedule, Step, StepSettings, screen_members};

fn main() -> Result<(), EsmdaError> {
    // Two parameters (rows) of five members (columns), and a model that predicts their sum.
    let mut parameters = mat![[0.0, 1.0, 2.0, 3.0, 4.0], [1.0, 0.0, 1.0, 0.0, 1.0]];
    let noise = NoiseCovariance::diagonal(&[0.1])?; // standard deviations
    let observed = [3.0];

    for &alpha in Schedule::geometric(4, 2.0)?.alphas() {
        let predicted = parameters.row(0) + parameters.row(1);
        let predicted = predicted.as_mat();
        screen_members(predicted, 1e6).at_least(5)?;
        let settings = StepSettings::default();
        let step = Step::prepare_square_root(predicted, &observed, &noise, alpha, &settings)?;
        step.apply(parameters.as_mut())?;
    }

    let sum: f64 = (0..5).map(|member| parameters[(0, member)] + parameters[(1, member)]).sum();
    println!("the mean of the sum is {:.3}", sum / 5.0);
    assert!((sum / 5.0 - 3.0).abs() < 0.01);
    Ok(())
}
