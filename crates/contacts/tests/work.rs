//! Work: a run of a registration's size is as cheap as it was.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Case, run};
use faer::Par;
use tissuereg_contacts::{ChainSettings, Counters};

/// Rounding differs between machines and may turn a decision here and there: one part in twenty.
fn near(found: usize, pinned: usize) -> bool {
    20 * found.abs_diff(pinned) <= pinned
}

#[test]
fn sixteen_chains_of_nine_sweeps_take_the_pinned_work() {
    let problem = Case::organ(15).problem();
    let Counters { tables, jumps, factorisations, steps, .. } =
        run(&problem, &ChainSettings::default(), 16, Par::Seq).counters;
    // One table a chain, sweep and slot, and at most one more for an exchange: only for those that it may allow.
    assert!((16 * 9 * 3..=2 * 16 * 9 * 3).contains(&tables), "{tables}");
    let found = [tables, jumps, factorisations, steps];
    assert!(
        found.iter().zip([602, 163, 2620, 242]).all(|(&found, pinned)| near(found, pinned)),
        "tables, jumps, factorisations, steps: {found:?}"
    );
}

#[test]
fn groups_that_fit_are_asked_without_a_factorisation() {
    let mut case = Case::organ(15);
    case.prior.n_slots = 0;
    case.prior.families.clear();
    // Nothing moved, and everything was seen as it is. Of 2,160 questions hardly any is worth a factorisation: those of
    // the first sweeps, whose likelihood hardly counts, at odds of one in two hundred, and their way back.
    case.observed.innovation = vec![0.05; 45];
    let mut counters = run(&case.problem(), &ChainSettings::default(), 16, Par::Seq).counters;
    assert!(counters.factorisations < 30, "{counters:?}");
    counters.factorisations = 0;
    assert_eq!(counters, Counters::default());
}
