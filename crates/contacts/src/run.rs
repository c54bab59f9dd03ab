//! Many chains, each on its own row of uniform numbers.

use faer::{MatRef, Par};
use rayon::prelude::*;

use crate::chain::{Chain, Counters, uniforms_a_sweep};
use crate::dictionary::check_finite;
use crate::prior::check_length;
use crate::settings::ChainSettings;
use crate::{Configuration, ContactsError, Problem};

/// A configuration drawn from the posterior.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// What fills the slots, levels of families, wrong groups.
    pub configuration: Configuration,
    /// Logarithm of the evidence, up to a constant.
    pub log_evidence: f64,
    /// Logarithm of the prior probability, up to a constant.
    pub log_prior: f64,
}

/// Samples of all chains with the work that they took.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Chain by chain, sweep by sweep.
    pub samples: Vec<Sample>,
    /// Sum over all chains.
    pub counters: Counters,
}

impl Problem {
    /// Uniform numbers that one chain takes.
    pub fn n_uniforms(&self, settings: &ChainSettings) -> usize {
        settings.powers.len() * uniforms_a_sweep(self, settings)
    }

    /// Draw configurations from the posterior by independent chains.
    ///
    /// # Shapes
    ///
    /// `uniforms` (`n_chains`, [`n_uniforms`](Self::n_uniforms)), in [0, 1), one row per chain. `starts` is empty, or
    /// holds configurations that chains begin at in turn.
    ///
    /// # Errors
    ///
    /// [`ContactsError::Shape`], [`ContactsError::NotFinite`], [`ContactsError::Range`],
    /// [`ContactsError::NotPositiveDefinite`].
    ///
    /// # Cost
    ///
    /// A sweep costs, a slot, one triangular solve with all columns of patches and `n_local + 2` Cholesky factors of
    /// size `n_obs`.
    pub fn run(
        &self,
        settings: &ChainSettings,
        uniforms: MatRef<'_, f64>,
        starts: &[Configuration],
        par: Par,
    ) -> Result<Run, ContactsError> {
        settings.check()?;
        check_length("uniforms", self.n_uniforms(settings), uniforms.ncols())?;
        for start in starts {
            self.check_configuration(start)?;
            let value = start.log_prior(self);
            if !value.is_finite() {
                let (argument, must) = ("prior probability of a start", "not be zero");
                return Err(ContactsError::Range { argument, must, entry: 0, value });
            }
        }
        let rows = (0..uniforms.nrows())
            .map(|chain| uniforms.row(chain).iter().copied().collect::<Vec<f64>>());
        let rows: Vec<Vec<f64>> = rows.collect();
        for (entry, &value) in rows.iter().flatten().enumerate() {
            check_finite("uniforms", entry, value)?;
            if !(0.0..1.0).contains(&value) {
                let (argument, must) = ("uniforms", "lie in [0, 1)");
                return Err(ContactsError::Range { argument, must, entry, value });
            }
        }
        let one = |(chain, row): (usize, &Vec<f64>)| self.chain(settings, row, starts, chain);
        let chains: Vec<Result<Run, ContactsError>> = match par {
            Par::Seq => rows.iter().enumerate().map(one).collect(),
            _ => rows.par_iter().enumerate().map(one).collect(),
        };
        let mut all = Run { samples: Vec::new(), counters: Counters::default() };
        for chain in chains {
            let chain = chain?;
            all.samples.extend(chain.samples);
            all.counters.tables += chain.counters.tables;
            all.counters.jumps += chain.counters.jumps;
            all.counters.factorisations += chain.counters.factorisations;
            all.counters.steps += chain.counters.steps;
        }
        Ok(all)
    }

    fn chain(
        &self,
        settings: &ChainSettings,
        uniforms: &[f64],
        starts: &[Configuration],
        index: usize,
    ) -> Result<Run, ContactsError> {
        let start = match starts.is_empty() {
            true => Configuration::empty(self),
            false => starts[index % starts.len()].clone(),
        };
        let chain = Chain::new(self, settings, start, uniforms);
        let mut chain = chain.map_err(|pivot| ContactsError::NotPositiveDefinite { pivot })?;
        let first_kept = settings.powers.len() - settings.n_kept;
        let mut samples = Vec::with_capacity(settings.n_kept);
        for (sweep, &power) in settings.powers.iter().enumerate() {
            chain.sweep(power);
            if sweep >= first_kept {
                let (log_evidence, log_prior) = chain.score();
                let configuration = chain.state.clone();
                samples.push(Sample { configuration, log_evidence, log_prior });
            }
        }
        Ok(Run { samples, counters: chain.counters })
    }

    /// Check that a configuration has the sizes of this problem.
    pub(crate) fn check_configuration(&self, one: &Configuration) -> Result<(), ContactsError> {
        let prior = &self.prior;
        check_length("slots", prior.n_slots, one.slots.len())?;
        check_length("levels", prior.families.len(), one.levels.len())?;
        check_length("wrong", prior.wrong.rows.len(), one.wrong.len())?;
        for (patch, contact) in one.slots.iter().flatten().enumerate() {
            let (n_patches, n_sizes) = (self.dictionary.n_patches(), prior.variances.len());
            for (argument, index, limit) in
                [("slots", contact.patch, n_patches), ("sizes", contact.size, n_sizes)]
            {
                if index >= limit {
                    return Err(ContactsError::Index { argument, patch, index, limit });
                }
            }
        }
        for (patch, (&index, family)) in one.levels.iter().zip(&prior.families).enumerate() {
            let limit = family.factors.len();
            if index >= limit {
                return Err(ContactsError::Index { argument: "levels", patch, index, limit });
            }
        }
        Ok(())
    }
}
