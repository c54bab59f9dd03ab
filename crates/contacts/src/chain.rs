//! One Markov chain over configurations.
//!
//! A sweep visits every slot (a draw from the table of all contents, accepted with its texture included; steps to
//! neighbouring patches and sizes; an exchange of the contact for a wrong group, or back), every family's level and every
//! group that may be wrong. All random numbers come from a row of uniform ones; every step takes its numbers whether it
//! uses them or not.

use faer::Mat;

use crate::gain::gain_of;
use crate::linalg::{backward, column, forward_in_place};
use crate::state::{Configuration, Contact, Evidence};
use crate::table::Table;
use crate::{ChainSettings, Problem};

/// How often steps were tried and taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Counters {
    /// Tables of all contents of a slot.
    pub tables: usize,
    /// Draws from them that were accepted.
    pub jumps: usize,
    /// Covariances factored.
    pub factorisations: usize,
    /// Steps to a neighbour or another size that were accepted.
    pub steps: usize,
}

/// One chain at work.
pub(crate) struct Chain<'a> {
    problem: &'a Problem,
    settings: &'a ChainSettings,
    uniforms: std::slice::Iter<'a, f64>,
    pub(crate) state: Configuration,
    evidence: Evidence,
    table: Table,
    pub(crate) counters: Counters,
}

/// Uniform numbers that a sweep takes.
pub(crate) fn uniforms_a_sweep(problem: &Problem, settings: &ChainSettings) -> usize {
    let prior = &problem.prior;
    prior.n_slots * (5 + 3 * settings.n_local)
        + 2 * settings.n_level * prior.families.len()
        + prior.wrong.rows.len()
}

impl<'a> Chain<'a> {
    /// The first bad pivot where the start's covariance cannot be factored.
    pub(crate) fn new(
        problem: &'a Problem,
        settings: &'a ChainSettings,
        start: Configuration,
        uniforms: &'a [f64],
    ) -> Result<Self, usize> {
        let evidence = Evidence::of_state(problem, &start)?;
        let counters = Counters::default();
        Ok(Self {
            problem,
            settings,
            uniforms: uniforms.iter(),
            state: start,
            evidence,
            table: Table::default(),
            counters,
        })
    }

    /// Logarithm of evidence and of prior.
    pub(crate) fn score(&self) -> (f64, f64) {
        (self.evidence.value, self.state.log_prior(self.problem))
    }

    fn uniform(&mut self) -> f64 {
        self.uniforms.next().copied().unwrap_or(0.5)
    }

    /// Visit everything once, with likelihoods raised to the power `power`.
    pub(crate) fn sweep(&mut self, power: f64) {
        for slot in 0..self.state.slots.len() {
            self.jump(slot, power);
            for _ in 0..self.settings.n_local {
                self.step(slot, power);
            }
            self.exchange(slot, power);
        }
        for family in 0..self.state.levels.len() {
            for _ in 0..self.settings.n_level {
                self.shift(family, power);
            }
        }
        self.question(power);
    }

    /// Draw a slot's content from all, weighed without texture, and correct for it.
    fn jump(&mut self, slot: usize, power: f64) {
        let (place, chance) = (self.uniform(), self.uniform());
        let rest = self.state.covariance(self.problem, Some(slot));
        let Ok(rest) = Evidence::of(self.problem, rest) else { return };
        self.table.fill(self.problem, &rest, power * self.settings.sharpness);
        self.counters.tables += 1;
        self.counters.factorisations += 1;
        let (now, proposed) = (self.state.slots[slot], self.table.draw(place));
        if now == proposed {
            return;
        }
        let correction = self.table.log_probability(now) - self.table.log_probability(proposed);
        let mut next = self.state.clone();
        next.slots[slot] = proposed;
        if self.accept(next, power, correction, chance) {
            self.counters.jumps += 1;
        }
    }

    /// Exchange a contact for a wrong group, or a wrong group for a contact.
    ///
    /// A single wrong group looks like a contact under it, and each explains the other away: changing one at a time does
    /// not lead from one explanation to the other. A filled slot is emptied while the group that its patch moves most becomes wrong; an empty one
    /// is filled from the table while a wrong group becomes right, if that group is the one that the patch moves most.
    fn exchange(&mut self, slot: usize, power: f64) {
        let (which, place, chance) = (self.uniform(), self.uniform(), self.uniform());
        let filled = self.state.slots[slot];
        let wrong: Vec<usize> =
            (0..self.state.wrong.len()).filter(|&group| self.state.wrong[group]).collect();
        let group = match filled {
            Some(contact) => self.problem.strongest_group(contact.patch),
            None => wrong.get((which * wrong.len() as f64) as usize).copied(),
        };
        let Some(group) = group.filter(|&g| self.state.wrong[g] == filled.is_none()) else {
            return;
        };
        let mut next = self.state.clone();
        next.wrong[group] = !next.wrong[group];
        if filled.is_some() {
            next.slots[slot] = None;
            let Some((evidence, change)) = self.change(&next, power) else { return };
            let bound = change - ((wrong.len() + 1) as f64).ln();
            // A probability is not above one: where even that would not do, the table is not needed.
            if chance.ln() < bound && self.fill_where_right(group, slot, power) {
                let taken = chance.ln() < bound + self.table.log_probability(filled);
                self.counters.jumps += usize::from(self.take_if(taken, next, evidence));
            }
            return;
        }
        if !self.fill_where_right(group, slot, power) {
            return;
        }
        next.slots[slot] = self.table.draw(place);
        let patch = next.slots[slot].map(|contact| contact.patch);
        if patch.is_none_or(|patch| self.problem.strongest_group(patch) != Some(group)) {
            return;
        }
        let correction = (wrong.len() as f64).ln() - self.table.log_probability(next.slots[slot]);
        if self.accept(next, power, correction, chance) {
            self.counters.jumps += 1;
        }
    }

    /// Fill the table of a slot where a group is right, which serves an exchange both ways; whether that could be done.
    fn fill_where_right(&mut self, group: usize, slot: usize, power: f64) -> bool {
        let mut right = self.state.clone();
        right.wrong[group] = false;
        let rest = Evidence::of(self.problem, right.covariance(self.problem, Some(slot)));
        let Ok(rest) = rest else { return false };
        self.table.fill(self.problem, &rest, power * self.settings.sharpness);
        self.counters.tables += 1;
        self.counters.factorisations += 1;
        true
    }

    /// Propose a neighbouring patch or the next size.
    fn step(&mut self, slot: usize, power: f64) {
        let (kind, which, chance) = (self.uniform(), self.uniform(), self.uniform());
        let Some(now) = self.state.slots[slot] else { return };
        let Some((proposed, correction)) = self.neighbour(now, kind, which) else { return };
        let mut next = self.state.clone();
        next.slots[slot] = Some(proposed);
        if self.accept(next, power, correction, chance) {
            self.counters.steps += 1;
        }
    }

    /// A neighbour of a contact with the logarithm of the proposals' ratio.
    fn neighbour(&self, now: Contact, kind: f64, which: f64) -> Option<(Contact, f64)> {
        if kind < 0.3 {
            let size = match which < 0.5 {
                true => now.size.checked_sub(1)?,
                false => now.size + 1,
            };
            let exists = size < self.problem.prior.variances.len();
            return exists.then_some((Contact { size, ..now }, 0.0));
        }
        let dictionary = &self.problem.dictionary;
        let around = &dictionary.patch(now.patch).neighbours;
        let patch = *around.get((which * around.len() as f64) as usize)?;
        let share = |list: &[usize], one: usize| {
            list.iter().filter(|&&entry| entry == one).count() as f64 / list.len() as f64
        };
        // Minus infinity where there is no way back.
        let back = share(&dictionary.patch(patch).neighbours, now.patch);
        Some((Contact { patch, ..now }, back.ln() - share(around, patch).ln()))
    }

    /// Propose the next level of a family.
    fn shift(&mut self, family: usize, power: f64) {
        let (way, chance) = (self.uniform(), self.uniform());
        let n_levels = self.problem.prior.families[family].factors.len();
        let now = self.state.levels[family];
        let proposed = if way < 0.5 { now.checked_sub(1) } else { Some(now + 1) };
        let Some(level) = proposed.filter(|&level| level < n_levels) else { return };
        let mut next = self.state.clone();
        next.levels[family] = level;
        self.accept(next, power, 0.0, chance);
    }

    /// Turn every group between right and wrong, given all others.
    ///
    /// A wrong group has one more variance on each of its rows: three or fewer are weighed in closed form, from a block
    /// of `C^-1`, and only what is taken is factored. Everything else, also the way back, is factored first.
    fn question(&mut self, power: f64) {
        let mut inverse = None;
        for group in 0..self.state.wrong.len() {
            let chance = self.uniform();
            let few = self.problem.prior.wrong.rows[group].len() <= 3;
            if few && !self.state.wrong[group] {
                let inverse = inverse.get_or_insert_with(|| Inverse::of(&self.evidence));
                let prior = self.problem.prior.wrong.log_odds;
                let change = inverse.gain(self.problem, group);
                // No chance at all of being taken: rounding of either way is far below one.
                if chance.ln() >= power * change + prior + 1e-3 {
                    continue;
                }
            }
            let mut next = self.state.clone();
            next.wrong[group] = !next.wrong[group];
            if self.accept(next, power, 0.0, chance) {
                inverse = None;
            }
        }
    }

    fn accept(&mut self, next: Configuration, power: f64, correction: f64, chance: f64) -> bool {
        let Some((evidence, change)) = self.change(&next, power) else { return false };
        self.take_if(chance.ln() < change + correction, next, evidence)
    }

    /// The evidence of another configuration, with the change of the logarithm of the posterior towards it; nothing
    /// where it cannot be.
    fn change(&mut self, next: &Configuration, power: f64) -> Option<(Evidence, f64)> {
        let after = next.log_prior(self.problem);
        if after == f64::NEG_INFINITY {
            return None;
        }
        let evidence = Evidence::of_state(self.problem, next).ok()?;
        self.counters.factorisations += 1;
        let before = self.state.log_prior(self.problem);
        let change = power * (evidence.value - self.evidence.value) + after - before;
        Some((evidence, change))
    }

    fn take_if(&mut self, taken: bool, next: Configuration, evidence: Evidence) -> bool {
        if taken {
            self.state = next;
            self.evidence = evidence;
        }
        taken
    }
}

/// What closed forms of groups need of `C^-1`.
struct Inverse {
    /// `L^-1` (`n_obs`, `n_obs`)
    root: Mat<f64>,
    /// `C^-1 d` (`n_obs`)
    dual: Vec<f64>,
}

impl Inverse {
    fn of(evidence: &Evidence) -> Self {
        let mut root = Mat::identity(evidence.white.len(), evidence.white.len());
        forward_in_place(evidence.factor.as_ref(), root.as_mut());
        Self { root, dual: backward(evidence.factor.as_ref(), &evidence.white) }
    }

    /// Change of the logarithm of the evidence where a group of at most three rows becomes wrong.
    fn gain(&self, problem: &Problem, group: usize) -> f64 {
        let wrong = &problem.prior.wrong;
        let rows = &wrong.rows[group];
        let mut data = [0.0; 3];
        for (entry, &row) in data.iter_mut().zip(rows) {
            *entry = self.dual[row];
        }
        let block = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]].map(|[a, b]| {
            let (Some(&a), Some(&b)) = (rows.get(a), rows.get(b)) else { return 0.0 };
            let (a, b) = (column(self.root.as_ref(), a), column(self.root.as_ref(), b));
            a.iter().zip(b).map(|(x, y)| x * y).sum()
        });
        let (exponent, determinant) = gain_of(&block, &data, wrong.variance);
        0.5 * (exponent - determinant.ln())
    }
}
