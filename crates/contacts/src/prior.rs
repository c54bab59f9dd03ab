//! The prior and the observations.

use faer::{Mat, MatRef};

use crate::dictionary::check_finite;
use crate::packed::Packed;
use crate::{ContactsError, Dictionary};

/// Causes that act together with one unknown size: a Gaussian whose variances share a factor.
#[derive(Debug, Clone, PartialEq)]
pub struct Family {
    /// Variance of every column's coefficient at factor one, (`n_columns`); zero for columns that are not in it.
    pub variances: Vec<f64>,
    /// Factors on the variances, the candidate levels.
    pub factors: Vec<f64>,
    /// Logarithm of each level's prior probability, up to a constant.
    pub log_prior: Vec<f64>,
}

/// Groups of observations of which each may be wrong as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Wrong {
    /// Observations of each group.
    pub rows: Vec<Vec<usize>>,
    /// Variance of a wrong group in addition to its noise.
    pub variance: f64,
    /// Logarithm of the odds that a group is wrong.
    pub log_odds: f64,
}

/// The prior: a few slots, each empty or one patch with one size, families, and groups that may be wrong.
///
/// A filled slot's three coefficients are independent normals with the variance of its size; its texture has the
/// same variance times the squared ratio.
#[derive(Debug, Clone, PartialEq)]
pub struct Prior {
    /// Number of slots.
    pub n_slots: usize,
    /// Variances that the coefficients of a contact may have.
    pub variances: Vec<f64>,
    /// Logarithm of the prior probability of an empty slot.
    pub log_empty: f64,
    /// Logarithm of the prior probability of patch `p` with variance `s` at entry `p * n_variances + s`.
    pub log_filled: Vec<f64>,
    /// Causes of unknown common size.
    pub families: Vec<Family>,
    /// Groups of observations that may be wrong.
    pub wrong: Wrong,
}

/// The observations: the innovation and the covariance of its noise.
#[derive(Debug, Clone)]
pub struct Observed {
    /// Observed minus predicted at zero coefficients, (`n_obs`).
    pub innovation: Vec<f64>,
    /// Covariance (`n_obs`, `n_obs`) of the noise and of all other uncertainty besides the causes.
    pub noise: Mat<f64>,
}

/// Dictionary, prior and data, checked against each other.
#[derive(Debug)]
pub struct Problem {
    pub(crate) dictionary: Dictionary,
    pub(crate) prior: Prior,
    pub(crate) observed: Observed,
    /// Covariance of the observations under each family at factor one.
    pub(crate) families: Vec<Mat<f64>>,
    /// Columns of patches in the order of tables.
    pub(crate) packed: Packed,
}

impl Problem {
    /// Put a dictionary, a prior and data together.
    ///
    /// # Errors
    ///
    /// [`ContactsError::Shape`], [`ContactsError::NotFinite`], [`ContactsError::Range`], and
    /// [`ContactsError::NotPositiveDefinite`] for the noise.
    ///
    /// # Cost
    ///
    /// One product (`n_obs`, `n_columns`) by (`n_columns`, `n_obs`) a family.
    pub fn new(
        dictionary: Dictionary,
        prior: Prior,
        observed: Observed,
    ) -> Result<Self, ContactsError> {
        let n_obs = dictionary.n_obs();
        check_length("innovation", n_obs, observed.innovation.len())?;
        check_length("noise", n_obs, observed.noise.nrows())?;
        check_length("noise", n_obs, observed.noise.ncols())?;
        for (entry, &value) in observed.innovation.iter().enumerate() {
            check_finite("innovation", entry, value)?;
        }
        for j in 0..n_obs {
            for i in 0..n_obs {
                check_finite("noise", i + j * n_obs, observed.noise[(i, j)])?;
            }
        }
        prior.check(&dictionary)?;
        let mut factor = observed.noise.clone();
        crate::linalg::cholesky_in_place(factor.as_mut())
            .map_err(|pivot| ContactsError::NotPositiveDefinite { pivot })?;
        let families = prior
            .families
            .iter()
            .map(|f| covariance(dictionary.columns(), dictionary.columns(), &f.variances))
            .collect();
        let packed = Packed::new(&dictionary);
        Ok(Self { dictionary, prior, observed, families, packed })
    }

    /// The group whose observations a patch moves most, over their noise; none without groups.
    pub(crate) fn strongest_group(&self, patch: usize) -> Option<usize> {
        let own = self.dictionary.own(patch);
        let moved = |rows: &[usize]| -> f64 {
            let square = |row: usize| (0..3).map(|axis| own[(row, axis)].powi(2)).sum::<f64>();
            rows.iter().map(|&row| square(row) / self.observed.noise[(row, row)]).sum()
        };
        let sizes = self.prior.wrong.rows.iter().map(|rows| moved(rows));
        sizes.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(group, _)| group)
    }

    /// The dictionary.
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }
}

impl Prior {
    fn check(&self, dictionary: &Dictionary) -> Result<(), ContactsError> {
        let n_sizes = self.variances.len();
        if n_sizes == 0 {
            return Err(ContactsError::Shape { argument: "variances", wanted: 1, found: 0 });
        }
        positive("variances", &self.variances)?;
        check_length("log_filled", dictionary.n_patches() * n_sizes, self.log_filled.len())?;
        not_nan("log_filled", &self.log_filled)?;
        check_finite("log_empty", 0, self.log_empty)?;
        for family in &self.families {
            check_length("variances of a family", dictionary.n_columns(), family.variances.len())?;
            if family.factors.is_empty() {
                return Err(ContactsError::Shape { argument: "factors", wanted: 1, found: 0 });
            }
            check_length("log_prior", family.factors.len(), family.log_prior.len())?;
            positive("factors", &family.factors)?;
            not_nan("log_prior", &family.log_prior)?;
            let bad = |v: &&f64| !(v.is_finite() && **v >= 0.0);
            if let Some((entry, &value)) = family.variances.iter().enumerate().find(|(_, v)| bad(v))
            {
                let (argument, must) = ("variances of a family", "be finite and not negative");
                return Err(ContactsError::Range { argument, must, entry, value });
            }
            possible("log_prior", &family.log_prior)?;
        }
        if !self.wrong.rows.is_empty() {
            positive("variance of a wrong group", &[self.wrong.variance])?;
            check_finite("log_odds", 0, self.wrong.log_odds)?;
        }
        for (patch, &index) in self.wrong.rows.iter().flatten().enumerate() {
            let limit = dictionary.n_obs();
            if index >= limit {
                return Err(ContactsError::Index { argument: "rows", patch, index, limit });
            }
        }
        Ok(())
    }
}

/// `left diag(variances) right'`; only columns with a variance are read.
pub(crate) fn covariance(
    left: MatRef<'_, f64>,
    right: MatRef<'_, f64>,
    variances: &[f64],
) -> Mat<f64> {
    let some: Vec<usize> = (0..variances.len()).filter(|&j| variances[j] > 0.0).collect();
    let part = |of: MatRef<'_, f64>, scaled: bool| {
        Mat::from_fn(of.nrows(), some.len(), |i, k| {
            of[(i, some[k])] * if scaled { variances[some[k]] } else { 1.0 }
        })
    };
    crate::linalg::product(part(left, true).as_ref(), part(right, false).transpose())
}

pub(crate) fn check_length(
    argument: &'static str,
    wanted: usize,
    found: usize,
) -> Result<(), ContactsError> {
    if wanted == found { Ok(()) } else { Err(ContactsError::Shape { argument, wanted, found }) }
}

fn positive(argument: &'static str, values: &[f64]) -> Result<(), ContactsError> {
    let bad = values.iter().enumerate().find(|(_, v)| !(v.is_finite() && **v > 0.0));
    match bad {
        Some((entry, &value)) => {
            Err(ContactsError::Range { argument, must: "be finite and positive", entry, value })
        }
        None => Ok(()),
    }
}

/// Of the levels of a family at least one can be.
fn possible(argument: &'static str, log_prior: &[f64]) -> Result<(), ContactsError> {
    if log_prior.iter().any(|value| value.is_finite()) {
        return Ok(());
    }
    let (must, value) = ("leave one level possible", f64::NEG_INFINITY);
    Err(ContactsError::Range { argument, must, entry: 0, value })
}

/// Logarithms of probabilities: minus infinity is allowed.
fn not_nan(argument: &'static str, values: &[f64]) -> Result<(), ContactsError> {
    let bad = values.iter().enumerate().find(|(_, v)| v.is_nan() || **v == f64::INFINITY);
    match bad {
        Some((entry, &value)) => Err(ContactsError::NotFinite { argument, entry, value }),
        None => Ok(()),
    }
}
