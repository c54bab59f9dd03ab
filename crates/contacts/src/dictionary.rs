//! What may act: columns of responses, three a patch, with how patches lie to each other.

use std::sync::OnceLock;

use faer::{Mat, MatRef};

use crate::ContactsError;
use crate::linalg::product;

/// How a patch lies to others.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Patch {
    /// Smaller patches inside, each with the standard deviation of its coefficients over that of this patch: a
    /// contact is not uniform.
    pub texture: Vec<(usize, f64)>,
    /// Patches that are much alike: those close by, and those at the same place of the next radii. A step is proposed
    /// along an entry only where the other patch lists this one as well.
    pub neighbours: Vec<usize>,
}

/// Responses of the observations to unit causes.
///
/// Columns `3 p .. 3 p + 3` belong to patch `p` (one per direction); columns behind those of all patches are further
/// causes that no slot can choose (such as a body force), which a [`Family`](crate::Family) may hold.
///
/// # Examples
///
/// ```
/// use tissuereg_contacts::faer::Mat;
/// use tissuereg_contacts::{Dictionary, Patch};
///
/// let dictionary = Dictionary::new(Mat::identity(6, 6), vec![Patch::default(); 2])?;
/// assert_eq!((dictionary.n_obs(), dictionary.n_patches(), dictionary.n_columns()), (6, 2, 6));
/// # Ok::<(), tissuereg_contacts::ContactsError>(())
/// ```
#[derive(Debug)]
pub struct Dictionary {
    columns: Mat<f64>,
    patches: Vec<Patch>,
    /// Covariance of the observations under each patch with unit variance, made when first used.
    covariances: Vec<OnceLock<Mat<f64>>>,
}

impl Dictionary {
    /// Checked columns (`n_obs`, `n_columns`) and patches.
    ///
    /// # Errors
    ///
    /// [`ContactsError::Shape`] where there are fewer columns than three a patch, [`ContactsError::NotFinite`],
    /// [`ContactsError::Index`] where a patch names one that does not exist.
    pub fn new(columns: Mat<f64>, patches: Vec<Patch>) -> Result<Self, ContactsError> {
        if columns.ncols() < 3 * patches.len() {
            let (wanted, found) = (3 * patches.len(), columns.ncols());
            return Err(ContactsError::Shape { argument: "columns", wanted, found });
        }
        for j in 0..columns.ncols() {
            for i in 0..columns.nrows() {
                check_finite("columns", i + j * columns.nrows(), columns[(i, j)])?;
            }
        }
        let limit = patches.len();
        for (patch, lies) in patches.iter().enumerate() {
            let outside = |index: &&usize| **index >= limit;
            for (entry, &(_, ratio)) in lies.texture.iter().enumerate() {
                check_finite("texture", entry, ratio)?;
            }
            let inner: Vec<usize> = lies.texture.iter().map(|&(index, _)| index).collect();
            if let Some(&index) = inner.iter().find(outside) {
                return Err(ContactsError::Index { argument: "texture", patch, index, limit });
            }
            if let Some(&index) = lies.neighbours.iter().find(outside) {
                return Err(ContactsError::Index { argument: "neighbours", patch, index, limit });
            }
        }
        let covariances = patches.iter().map(|_| OnceLock::new()).collect();
        Ok(Self { columns, patches, covariances })
    }

    /// Number of observations.
    pub fn n_obs(&self) -> usize {
        self.columns.nrows()
    }

    /// Number of columns.
    pub fn n_columns(&self) -> usize {
        self.columns.ncols()
    }

    /// Number of patches.
    pub fn n_patches(&self) -> usize {
        self.patches.len()
    }

    /// All columns (`n_obs`, `n_columns`).
    pub fn columns(&self) -> MatRef<'_, f64> {
        self.columns.as_ref()
    }

    /// How a patch lies to others.
    pub(crate) fn patch(&self, patch: usize) -> &Patch {
        &self.patches[patch]
    }

    /// The three columns of a patch.
    pub(crate) fn own(&self, patch: usize) -> MatRef<'_, f64> {
        self.columns.get(.., 3 * patch..3 * patch + 3)
    }

    /// Columns that a contact at a patch moves, each with its standard deviation over that of the contact.
    pub(crate) fn shares(&self, patch: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        std::iter::once((patch, 1.0)).chain(self.patches[patch].texture.iter().copied())
    }

    /// Covariance (`n_obs`, `n_obs`) under a contact of unit variance at a patch, its texture included.
    pub(crate) fn covariance(&self, patch: usize) -> MatRef<'_, f64> {
        self.covariances[patch]
            .get_or_init(|| {
                let shares: Vec<(usize, f64)> = self.shares(patch).collect();
                let scaled = Mat::from_fn(self.n_obs(), 3 * shares.len(), |i, j| {
                    let (inner, ratio) = shares[j / 3];
                    ratio * self.columns[(i, 3 * inner + j % 3)]
                });
                product(scaled.as_ref(), scaled.transpose())
            })
            .as_ref()
    }
}

pub(crate) fn check_finite(
    argument: &'static str,
    entry: usize,
    value: f64,
) -> Result<(), ContactsError> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(ContactsError::NotFinite { argument, entry, value })
    }
}
