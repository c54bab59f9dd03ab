//! How chains run.

use crate::ContactsError;

/// How chains run.
///
/// Further settings may come: start from the default and change what differs.
///
/// # Examples
///
/// ```
/// use tissuereg_contacts::ChainSettings;
///
/// let long = ChainSettings::default().with_powers(vec![0.1, 1.0, 1.0, 1.0, 1.0]).with_n_kept(3);
/// assert_eq!(long.sharpness, 0.5);
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ChainSettings {
    /// Power of the likelihood in each sweep: small ones first let a chain leave what it began with. Sweeps whose
    /// configuration is kept must have power one.
    pub powers: Vec<f64>,
    /// Sweeps at the end whose configurations are kept.
    pub n_kept: usize,
    /// Power of the likelihood in the table that jumps are drawn from: the table leaves texture out and is too sure.
    pub sharpness: f64,
    /// Steps to neighbours a slot and sweep.
    pub n_local: usize,
    /// Steps of a family's level a sweep.
    pub n_level: usize,
}

impl Default for ChainSettings {
    fn default() -> Self {
        let mut powers = vec![0.03, 0.1, 0.3];
        powers.resize(9, 1.0);
        Self { powers, n_kept: 4, sharpness: 0.5, n_local: 4, n_level: 2 }
    }
}

impl ChainSettings {
    /// The same with other [`powers`](Self::powers), one a sweep.
    #[must_use]
    pub fn with_powers(self, powers: Vec<f64>) -> Self {
        Self { powers, ..self }
    }

    /// The same with another number of sweeps that are kept: [`n_kept`](Self::n_kept).
    #[must_use]
    pub fn with_n_kept(self, n_kept: usize) -> Self {
        Self { n_kept, ..self }
    }

    /// The same with another [`sharpness`](Self::sharpness).
    #[must_use]
    pub fn with_sharpness(self, sharpness: f64) -> Self {
        Self { sharpness, ..self }
    }

    /// The same with another number of steps to neighbours: [`n_local`](Self::n_local).
    #[must_use]
    pub fn with_n_local(self, n_local: usize) -> Self {
        Self { n_local, ..self }
    }

    /// The same with another number of steps of a family's level: [`n_level`](Self::n_level).
    #[must_use]
    pub fn with_n_level(self, n_level: usize) -> Self {
        Self { n_level, ..self }
    }

    /// Checks ranges.
    pub(crate) fn check(&self) -> Result<(), ContactsError> {
        let n_sweeps = self.powers.len();
        if self.n_kept == 0 || self.n_kept > n_sweeps {
            return Err(ContactsError::Shape {
                argument: "powers",
                wanted: self.n_kept.max(1),
                found: n_sweeps,
            });
        }
        let (argument, must) = ("powers", "lie in (0, 1], and be one where sweeps are kept");
        for (entry, &value) in self.powers.iter().enumerate() {
            let kept = entry >= n_sweeps - self.n_kept;
            if !(value > 0.0 && value <= 1.0) || (kept && value != 1.0) {
                return Err(ContactsError::Range { argument, must, entry, value });
            }
        }
        if !(self.sharpness > 0.0 && self.sharpness <= 1.0) {
            let (argument, must, value) = ("sharpness", "lie in (0, 1]", self.sharpness);
            return Err(ContactsError::Range { argument, must, entry: 0, value });
        }
        Ok(())
    }
}
