//! What can go wrong, with the numbers and the place.

/// Why a dictionary, a prior or a run of chains was refused.
///
/// # Examples
///
/// ```
/// use tissuereg_contacts::faer::Mat;
/// use tissuereg_contacts::{ContactsError, Dictionary};
///
/// let error = Dictionary::new(Mat::zeros(5, 4), vec![Default::default(); 2]).unwrap_err();
/// assert_eq!(error, ContactsError::Shape { argument: "columns", wanted: 6, found: 4 });
/// ```
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ContactsError {
    /// An array does not have the size that the others require.
    #[error("`{argument}` must have {wanted} entries along its free axis, got {found}")]
    Shape {
        /// The argument.
        argument: &'static str,
        /// Size that fits (a lower bound for columns of a dictionary).
        wanted: usize,
        /// Size found.
        found: usize,
    },
    /// A number is not finite.
    #[error("`{argument}` must be finite, got {value} at entry {entry}")]
    NotFinite {
        /// The argument.
        argument: &'static str,
        /// Entry, in the order of storage.
        entry: usize,
        /// The number.
        value: f64,
    },
    /// A number lies outside its range.
    #[error("`{argument}` must {must}, got {value} at entry {entry}")]
    Range {
        /// The argument.
        argument: &'static str,
        /// What must hold.
        must: &'static str,
        /// Entry, in the order of storage.
        entry: usize,
        /// The number.
        value: f64,
    },
    /// An index points outside the dictionary.
    #[error("`{argument}` must be below {limit}, got {index} in patch {patch}")]
    Index {
        /// The argument.
        argument: &'static str,
        /// Patch whose list holds the index.
        patch: usize,
        /// The index.
        index: usize,
        /// First index that does not exist.
        limit: usize,
    },
    /// The covariance of the observations is not positive definite.
    #[error(
        "the covariance of the observations must be positive definite, pivot {pivot} is not positive"
    )]
    NotPositiveDefinite {
        /// First bad pivot.
        pivot: usize,
    },
}

impl ContactsError {
    /// Return what the error is about.
    pub fn class(&self) -> ErrorClass {
        match self {
            Self::Shape { .. } | Self::Index { .. } => ErrorClass::Shape,
            Self::NotFinite { argument: "innovation", .. } => ErrorClass::Observed,
            Self::NotFinite { .. } | Self::Range { .. } => ErrorClass::Setting,
            Self::NotPositiveDefinite { .. } => ErrorClass::Noise,
        }
    }

    /// Return the argument that the error concerns.
    pub fn place(&self) -> &'static str {
        match self {
            Self::Shape { argument, .. }
            | Self::NotFinite { argument, .. }
            | Self::Range { argument, .. }
            | Self::Index { argument, .. } => argument,
            Self::NotPositiveDefinite { .. } => "noise",
        }
    }
}

/// What an error is about. The list is complete: every [`ContactsError`] has one of these.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorClass {
    /// The size of an array, or an index in one.
    Shape,
    /// What was observed.
    Observed,
    /// A number of the dictionary, the prior or the chains.
    Setting,
    /// The covariance of the observations.
    Noise,
}
