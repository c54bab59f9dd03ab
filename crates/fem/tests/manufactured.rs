//! Is an equilibrium found that is known to exist? Smooth fields on random bodies, their internal
//! forces as the load; kept where the tangent is positive definite.
#![allow(clippy::expect_used, clippy::panic)]

mod common;

use common::cases::{Case, Manufactured, case, manufactured};
use common::{largest, largest_difference};
use tissuereg_fem::{Load, SolveSettings, solve};

/// Cases of the quick tier; `TISSUEREG_CASES` asks for more.
const CASES: u64 = 150;

#[test]
fn manufactured_equilibria_are_reached_from_rest() {
    let n = common::count_or(CASES);
    let first: u64 = std::env::var("FIRST").ok().and_then(|v| v.parse().ok()).unwrap_or(0);
    let mut failures = Vec::new();
    let (mut iterations, mut factors, mut rejected) = (0, 0, 0);
    for seed in first..first + n {
        let case = case(seed);
        let field = manufactured(&case);
        rejected += field.rejected;
        let started = std::time::Instant::now();
        let outcome = attempt(&case, &field);
        if std::env::var("VERBOSE").is_ok() {
            eprintln!(
                "{seed} {:?} {:?} J {:.2} supports move {} {} unknowns {} rejected {}",
                outcome,
                started.elapsed(),
                field.min_det_f,
                field.moves_supports,
                case.body.n_unknowns(),
                field.rejected,
                case.words
            );
        }
        match outcome {
            Ok((i, f)) => {
                iterations += i;
                factors += f;
            }
            Err(why) => failures.push(format!(
                "seed {seed}: {why}\n    {}; min det F {:.2}, supports move: {}",
                case.words, field.min_det_f, field.moves_supports
            )),
        }
    }
    eprintln!(
        "{} of {n} reached; {rejected} fields were unstable; a case took {:.1} iterations and {:.1} \
         factors\n{}",
        n - failures.len() as u64,
        iterations as f64 / n as f64,
        factors as f64 / n as f64,
        failures.join("\n")
    );
    assert!(failures.len() as u64 * 100 <= n, "{} of {n} failed", failures.len());
}

/// Iterations and factors, or why the field was not found.
fn attempt(case: &Case, field: &Manufactured) -> Result<(usize, usize), String> {
    let held = case.body.held_nodes().iter().map(|&n| field.displacement[n]).collect();
    let load = Load {
        nodal_forces: Some(field.forces.clone()),
        prescribed: field.moves_supports.then_some(held),
        ..Load::default()
    };
    let settings = SolveSettings { n_threads: 1, tolerance: 1e-11, ..SolveSettings::default() };
    let answer =
        solve(&case.body, &case.material, &load, &settings).map_err(|error| error.to_string())?;
    let error = largest_difference(&answer.displacement, &field.displacement)
        / largest(&field.displacement);
    if error < 1e-6 {
        Ok((answer.report.iterations, answer.report.factorisations))
    } else {
        Err(format!("another equilibrium, {error:.1e} away; {} steps", answer.report.load_steps))
    }
}
