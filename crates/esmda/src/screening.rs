//! Members whose forward run failed: found, named, dropped.
//!
//! A failed run shows as NaN, as infinity, or as a finite number no working model gives (1e19). One such column makes
//! every mean and covariance meaningless, so it is dropped before a step, with its reason. It is never replaced by a
//! copy of a good one, which would shrink the spread.

use faer::MatRef;

use crate::error::{EsmdaError, Reason};

/// Who stays and who goes.
#[derive(Debug, Clone, PartialEq)]
pub struct Screening {
    /// Members whose predictions can be used, ascending.
    pub kept: Vec<usize>,
    /// Members that are dropped, ascending, each with its reason.
    pub dropped: Vec<(usize, Reason)>,
}

impl Screening {
    /// Returns the screening if at least `minimum` members remain.
    ///
    /// # Errors
    ///
    /// [`EsmdaError::TooFewMembers`] otherwise, with everyone who was dropped.
    pub fn at_least(self, minimum: usize) -> Result<Self, EsmdaError> {
        if self.kept.len() < minimum {
            let kept = self.kept.len();
            return Err(EsmdaError::TooFewMembers { kept, minimum, dropped: self.dropped });
        }
        Ok(self)
    }
}

/// Sorts members into kept and dropped by their predictions.
///
/// # Shapes
///
/// `predicted` is (`n_obs`, `n_members`), one column a member, in the unit of `limit`.
///
/// # Cost
///
/// One pass over `predicted`.
///
/// # Examples
///
/// ```
/// use tissuereg_esmda::faer::mat;
/// use tissuereg_esmda::{Reason, screen_members};
///
/// let predicted = mat![[1.0, f64::NAN, 2.0, 1e19], [3.0, 1.0, 4.0, 0.0]];
/// let screening = screen_members(predicted.as_ref(), 1e6).at_least(2)?;
/// assert_eq!(screening.kept, [0, 2]);
/// assert_eq!(screening.dropped[0], (1, Reason::NotANumber { obs: 0 }));
/// assert_eq!(screening.dropped[1].1.to_string(), "prediction 0 is 1e19, beyond 1e6");
/// # Ok::<(), tissuereg_esmda::EsmdaError>(())
/// ```
pub fn screen_members(predicted: MatRef<'_, f64>, limit: f64) -> Screening {
    let mut screening = Screening { kept: Vec::new(), dropped: Vec::new() };
    for member in 0..predicted.ncols() {
        let column = predicted.col(member);
        match column.iter().enumerate().find_map(|(obs, &value)| reason_of(obs, value, limit)) {
            None => screening.kept.push(member),
            Some(reason) => screening.dropped.push((member, reason)),
        }
    }
    screening
}

fn reason_of(obs: usize, value: f64, limit: f64) -> Option<Reason> {
    if value.is_nan() {
        Some(Reason::NotANumber { obs })
    } else if value.is_infinite() {
        Some(Reason::Infinite { obs })
    } else if value.abs() > limit {
        Some(Reason::TooLarge { obs, value, limit })
    } else {
        None
    }
}
