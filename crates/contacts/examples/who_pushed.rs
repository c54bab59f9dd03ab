//! A stretched cord is pushed aside at one of thirty places; five beads on it were seen. Where was the push, and where
//! is the middle of the cord now?
//!
//! `cargo run --example who_pushed`: dictionary, prior, chains and moments.

use tissuereg_contacts::faer::{Mat, Par};
use tissuereg_contacts::{
    ChainSettings, Configuration, ContactsError, Dictionary, Observed, Patch, Prior, Problem, Wrong,
};

const N_PLACES: usize = 30;
const BEADS: [f64; 5] = [0.1, 0.3, 0.45, 0.7, 0.9];
const STD: f64 = 0.02; // mm
const PUSH: (usize, [f64; 3]) = (17, [0.0, 3.0, -1.0]);

/// Numbers in [0, 1), the same in every run (SplitMix64).
struct Uniforms(u64);

impl Uniforms {
    fn draw(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// How far the cord moves at one place, mm, by a unit push at another.
fn cord(at: f64, pushed: f64) -> f64 {
    4.0 * at.min(pushed) * (1.0 - at.max(pushed))
}

/// Responses (3 n, 90) of places along the cord.
fn responses(places: &[f64]) -> Mat<f64> {
    Mat::from_fn(3 * places.len(), 3 * N_PLACES, |i, j| {
        let pushed = (j / 3 + 1) as f64 / (N_PLACES + 1) as f64;
        if i % 3 == j % 3 { cord(places[i / 3], pushed) } else { 0.0 }
    })
}

/// Share of samples with a push within one place of the true one; mean and standard deviation of the middle, mm.
fn found() -> Result<(f64, [f64; 3], f64), ContactsError> {
    let columns = responses(&BEADS);
    let moved = |i: usize| PUSH.1[i % 3] * columns[(i, 3 * PUSH.0 + i % 3)];
    let innovation = (0..15).map(|i| moved(i) + STD * (7.0 * i as f64).sin()).collect();
    let noise = Mat::from_fn(15, 15, |i, j| if i == j { STD * STD } else { 0.0 });
    let mut patches = vec![Patch::default(); N_PLACES];
    for place in 1..N_PLACES {
        patches[place].neighbours.push(place - 1);
        patches[place - 1].neighbours.push(place);
    }
    let prior = Prior {
        n_slots: 1,
        variances: vec![1.0, 9.0],
        log_empty: 0.5_f64.ln(),
        log_filled: vec![(0.25 / N_PLACES as f64).ln(); 2 * N_PLACES],
        families: Vec::new(),
        wrong: Wrong { rows: Vec::new(), variance: 1.0, log_odds: 0.0 },
    };
    let problem =
        Problem::new(Dictionary::new(columns, patches)?, prior, Observed { innovation, noise })?;
    let settings = ChainSettings::default();
    // Chance is an argument: one row a chain, by any generator of uniform numbers.
    let mut numbers = Uniforms(1);
    let uniforms = Mat::from_fn(16, problem.n_uniforms(&settings), |_, _| numbers.draw());
    let samples = problem.run(&settings, uniforms.as_ref(), &[], Par::Seq)?.samples;
    let samples: Vec<Configuration> = samples.into_iter().map(|s| s.configuration).collect();
    let near = samples.iter().filter(|s| s.slots[0].is_some_and(|c| c.patch.abs_diff(PUSH.0) <= 1));
    let share = near.count() as f64 / samples.len() as f64;
    let middle = problem.moments(&samples, responses(&[0.5]).as_ref(), Par::Seq)?;
    Ok((share, middle.means[0], middle.covariances[0][1][1].sqrt()))
}

fn main() -> Result<(), ContactsError> {
    let (share, [x, y, z], std) = found()?;
    println!("pushed at place {} or next to it: {:.0} % of samples", PUSH.0, 100.0 * share);
    println!("the middle has moved by {x:.3}, {y:.3}, {z:.3} mm, known to {std:.3} mm");
    Ok(())
}

#[test]
fn the_push_is_found_and_the_middle_lies_within_three_deviations() {
    let (share, middle, std) = found().unwrap();
    assert!(share > 0.9, "{share}");
    let pushed = (PUSH.0 + 1) as f64 / (N_PLACES + 1) as f64;
    for axis in 0..3 {
        let wanted = PUSH.1[axis] * cord(0.5, pushed);
        assert!((middle[axis] - wanted).abs() < 3.0 * std, "{middle:?} {wanted} {std}");
    }
    // Better than one bead alone, no better than all beads at one place.
    assert!(std < 2.0 * STD && std > STD / 5.0_f64.sqrt() * 0.5, "{std}");
}
