//! Two places that may have been pushed, and six observations: `cargo run --example first_contact`.

use tissuereg_contacts::faer::{Mat, Par};
use tissuereg_contacts::{
    ChainSettings, Contact, ContactsError, Dictionary, Observed, Patch, Prior, Problem, Wrong,
};

fn main() -> Result<(), ContactsError> {
    // Six observations (rows) answer unit pushes of two patches along three axes (columns).
    let dictionary = Dictionary::new(Mat::identity(6, 6), vec![Patch::default(); 2])?;
    let prior = Prior {
        n_slots: 1,                          // at most one push,
        variances: vec![1.0, 4.0],           // of one of two sizes,
        log_empty: 0.5_f64.ln(),             // none with a chance of one half,
        log_filled: vec![0.125_f64.ln(); 4], // every patch and size with the same chance
        families: Vec::new(),
        wrong: Wrong { rows: Vec::new(), variance: 1.0, log_odds: 0.0 },
    };
    let observed = Observed {
        innovation: vec![0.0, 0.0, 0.0, 2.0, 0.0, 0.0],
        noise: Mat::from_fn(6, 6, |i, j| if i == j { 0.01 } else { 0.0 }), // covariance
    };
    let problem = Problem::new(dictionary, prior, observed)?;

    // Chance is an argument, one row a chain. These numbers only look random; draw yours.
    let settings = ChainSettings::default();
    let uniforms = Mat::from_fn(4, problem.n_uniforms(&settings), |i, j| {
        (0.618_034 * (1 + i + 7 * j) as f64).fract()
    });
    let run = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq)?;
    let second = |slot: &Option<Contact>| slot.is_some_and(|contact| contact.patch == 1);
    let n = run.samples.iter().filter(|s| second(&s.configuration.slots[0])).count();
    println!("{n} of {} samples have pushed the second patch", run.samples.len());
    assert_eq!(n, run.samples.len());
    Ok(())
}
