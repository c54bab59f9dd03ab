//! Sparse causes: the problem, its chains, and what their samples mean.

use faer::MatRef;
use numpy::{PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_boundary::views::View;
use tissuereg_boundary::{arrays, lock};
use tissuereg_contacts::{
    ChainSettings, Configuration, Contact, Dictionary, Family, Observed, Patch, Prior, Problem,
    Wrong,
};

use crate::errors;

/// Dictionary, prior and data of sparse causes.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Contacts(Problem);

/// Patch and size of every slot (-1: empty), levels of families, wrong groups.
type Rows<'py> = (Bound<'py, PyArray3<i64>>, Bound<'py, PyArray2<i64>>, Bound<'py, PyArray2<i64>>);

#[pymethods]
impl Contacts {
    /// Columns, float64 (n_obs, n_columns); lists of lists as two arrays each, first entries and entries; log_filled,
    /// float64 (n_patches, n_sizes); families as (variances, factors, log_prior).
    #[new]
    #[pyo3(signature = (columns, *, texture, neighbours, variances, log_filled, log_empty, n_slots, families, wrong,
                        innovation, noise))]
    #[expect(clippy::too_many_arguments, reason = "keywords of one Python call")]
    fn new(
        py: Python<'_>,
        columns: &Bound<'_, PyAny>,
        texture: (Bound<'_, PyAny>, Bound<'_, PyAny>, Bound<'_, PyAny>),
        neighbours: (Bound<'_, PyAny>, Bound<'_, PyAny>),
        variances: &Bound<'_, PyAny>,
        log_filled: &Bound<'_, PyAny>,
        log_empty: f64,
        n_slots: usize,
        families: Vec<(Bound<'_, PyAny>, Bound<'_, PyAny>, Bound<'_, PyAny>)>,
        wrong: (Vec<Vec<usize>>, f64, f64),
        innovation: &Bound<'_, PyAny>,
        noise: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let columns = View::<f64>::new("columns", columns, &[&[None, None]])?;
        let log_filled = View::<f64>::new("log_filled", log_filled, &[&[None, None]])?;
        let innovation = View::<f64>::new("innovation", innovation, &[&[None]])?;
        let noise = View::<f64>::new("noise", noise, &[&[None, None]])?;
        let patches = patches_of(log_filled.shape()[0], &texture, &neighbours)?;
        let vector = |name: &str, object: &Bound<'_, PyAny>| -> PyResult<Vec<f64>> {
            Ok(View::<f64>::new(name, object, &[&[None]])?.slice().to_vec())
        };
        let families = families.iter().map(|(variances, factors, log_prior)| {
            Ok(Family {
                variances: vector("variances", variances)?,
                factors: vector("factors", factors)?,
                log_prior: vector("log_prior", log_prior)?,
            })
        });
        let (rows, variance, log_odds) = wrong;
        let prior = Prior {
            n_slots,
            variances: vector("variances", variances)?,
            log_empty,
            log_filled: log_filled.slice().to_vec(),
            families: families.collect::<PyResult<_>>()?,
            wrong: Wrong { rows, variance, log_odds },
        };
        let (columns, noise, innovation) =
            (columns.matrix(), noise.matrix(), innovation.slice().to_vec());
        let made = lock::run_released(py, 1, |_| {
            let dictionary = Dictionary::new(columns.to_owned(), patches)?;
            Problem::new(dictionary, prior, Observed { innovation, noise: noise.to_owned() })
        });
        made.map(Self).map_err(|error| errors::from_contacts(py, &error))
    }

    /// Draw configurations; `uniforms`, float64 (n_chains, n_uniforms), with the work counted.
    #[pyo3(signature = (uniforms, *, powers, n_kept, sharpness, n_local, n_level, starts=None, threads=0))]
    #[expect(clippy::too_many_arguments, reason = "keywords of one Python call")]
    fn run<'py>(
        &self,
        py: Python<'py>,
        uniforms: &Bound<'_, PyAny>,
        powers: Vec<f64>,
        n_kept: usize,
        sharpness: f64,
        n_local: usize,
        n_level: usize,
        starts: Option<[Bound<'_, PyAny>; 3]>,
        threads: usize,
    ) -> PyResult<(Rows<'py>, Bound<'py, PyArray2<f64>>, Bound<'py, PyDict>)> {
        let settings = ChainSettings::default()
            .with_powers(powers)
            .with_n_kept(n_kept)
            .with_sharpness(sharpness)
            .with_n_local(n_local)
            .with_n_level(n_level);
        let uniforms = View::<f64>::new("uniforms", uniforms, &[&[None, None]])?;
        let starts = starts.map(|rows| configurations(&rows)).transpose()?.unwrap_or_default();
        let uniforms = uniforms.matrix();
        let run =
            lock::run_released(py, threads, |par| self.0.run(&settings, uniforms, &starts, par));
        let run = run.map_err(|error| errors::from_contacts(py, &error))?;
        let all: Vec<&Configuration> = run.samples.iter().map(|s| &s.configuration).collect();
        let scores = run.samples.iter().flat_map(|s| [s.log_evidence, s.log_prior]).collect();
        let counters = PyDict::new(py);
        counters.set_item("tables", run.counters.tables)?;
        counters.set_item("jumps", run.counters.jumps)?;
        counters.set_item("factorisations", run.counters.factorisations)?;
        counters.set_item("steps", run.counters.steps)?;
        Ok((rows_of(py, &all)?, arrays::from_vec(py, scores, [all.len(), 2])?, counters))
    }

    /// Uniform numbers that a chain takes.
    fn n_uniforms(&self, n_sweeps: usize, n_local: usize, n_level: usize) -> usize {
        let settings = ChainSettings::default()
            .with_powers(vec![1.0; n_sweeps])
            .with_n_kept(1)
            .with_sharpness(1.0)
            .with_n_local(n_local)
            .with_n_level(n_level);
        self.0.n_uniforms(&settings)
    }

    /// Moments over samples: coefficients, their gain, means, covariances and prior covariances of points, whose responses
    /// are float64 (3 n_points, n_columns), and the misfit.
    #[pyo3(signature = (samples, points, *, threads=0))]
    fn moments<'py>(
        &self,
        py: Python<'py>,
        samples: [Bound<'_, PyAny>; 3],
        points: &Bound<'_, PyAny>,
        threads: usize,
    ) -> PyResult<Moments<'py>> {
        let samples = configurations(&samples)?;
        let points = View::<f64>::new("points", points, &[&[None, None]])?;
        let points = points.matrix();
        let found = lock::run_released(py, threads, |par| self.0.moments(&samples, points, par));
        let found = found.map_err(|error| errors::from_contacts(py, &error))?;
        let n = found.means.len();
        let square = |all: Vec<[[f64; 3]; 3]>| {
            arrays::from_vec(py, all.into_flattened().into_flattened(), [n, 3, 3])
        };
        let (n_columns, n_obs) = found.gain.shape();
        Ok((
            arrays::from_vec(py, found.coefficients, [n_columns])?,
            arrays::from_vec(py, flattened(found.gain.transpose()), [n_columns, n_obs])?,
            arrays::from_points(py, found.means)?,
            square(found.covariances)?,
            square(found.prior_covariances)?,
            found.misfit,
        ))
    }

    /// Coefficients drawn from the posterior, float64 (n_draws, n_columns); `normals` (n_draws, n_columns + n_obs).
    #[pyo3(signature = (samples, normals, *, threads=0))]
    fn draws<'py>(
        &self,
        py: Python<'py>,
        samples: [Bound<'_, PyAny>; 3],
        normals: &Bound<'_, PyAny>,
        threads: usize,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let samples = configurations(&samples)?;
        let normals = View::<f64>::new("normals", normals, &[&[None, None]])?;
        let normals = normals.matrix().transpose();
        let drawn = lock::run_released(py, threads, |par| self.0.draws(&samples, normals, par));
        let drawn = drawn.map_err(|error| errors::from_contacts(py, &error))?;
        let (n_columns, n_draws) = drawn.shape();
        let flat = flattened(drawn.as_ref());
        arrays::from_vec(py, flat, [n_draws, n_columns])
    }

    fn __repr__(&self) -> String {
        let dictionary = self.0.dictionary();
        format!("Contacts(n_obs={}, n_patches={})", dictionary.n_obs(), dictionary.n_patches())
    }
}

/// Coefficients and their gain; means, covariances and prior covariances of points; misfit.
type Moments<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    f64,
);

/// Entries column by column.
fn flattened(matrix: MatRef<'_, f64>) -> Vec<f64> {
    (0..matrix.ncols()).flat_map(|j| matrix.col(j).iter().copied()).collect()
}

fn patches_of(
    n_patches: usize,
    texture: &(Bound<'_, PyAny>, Bound<'_, PyAny>, Bound<'_, PyAny>),
    neighbours: &(Bound<'_, PyAny>, Bound<'_, PyAny>),
) -> PyResult<Vec<Patch>> {
    let firsts = [Some(n_patches + 1)];
    let inner = View::<i64>::new("texture", &texture.1, &[&[None]])?;
    let n_inner = Some(inner.slice().len());
    let ratios = View::<f64>::new("texture", &texture.2, &[&[n_inner]])?;
    let around = View::<i64>::new("neighbours", &neighbours.1, &[&[None]])?;
    let texture = View::<i64>::new("texture", &texture.0, &[&firsts])?;
    let neighbours = View::<i64>::new("neighbours", &neighbours.0, &[&firsts])?;
    let part = |firsts: &View<'_, i64>, patch: usize, length: usize| {
        let [from, to] = [0, 1].map(|k| usize::try_from(firsts.slice()[patch + k]).unwrap_or(0));
        from.min(length)..to.min(length).max(from.min(length))
    };
    let index = |&value: &i64| usize::try_from(value).unwrap_or(usize::MAX);
    let patches = (0..n_patches).map(|patch| {
        let inside = part(&texture, patch, inner.slice().len());
        let near = part(&neighbours, patch, around.slice().len());
        let pairs = inner.slice()[inside.clone()].iter().zip(&ratios.slice()[inside]);
        Patch {
            texture: pairs.map(|(patch, &ratio)| (index(patch), ratio)).collect(),
            neighbours: around.slice()[near].iter().map(index).collect(),
        }
    });
    Ok(patches.collect())
}

fn configurations(rows: &[Bound<'_, PyAny>; 3]) -> PyResult<Vec<Configuration>> {
    let slots = View::<i64>::new("slots", &rows[0], &[&[None, None, Some(2)]])?;
    let n = Some(slots.shape()[0]);
    let levels = View::<i64>::new("levels", &rows[1], &[&[n, None]])?;
    let wrong = View::<i64>::new("wrong", &rows[2], &[&[n, None]])?;
    let (n_slots, n_levels, n_wrong) = (slots.shape()[1], levels.shape()[1], wrong.shape()[1]);
    let index = |value: i64| usize::try_from(value).unwrap_or(usize::MAX);
    let one = |sample: usize| {
        let own = &slots.slice()[2 * n_slots * sample..2 * n_slots * (sample + 1)];
        let contact = |pair: &[i64; 2]| match pair {
            [patch, _] if *patch < 0 => None,
            &[patch, size] => Some(Contact { patch: index(patch), size: index(size) }),
        };
        let levels = &levels.slice()[n_levels * sample..n_levels * (sample + 1)];
        let wrong = &wrong.slice()[n_wrong * sample..n_wrong * (sample + 1)];
        Configuration {
            slots: own.as_chunks::<2>().0.iter().map(contact).collect(),
            levels: levels.iter().map(|&level| index(level)).collect(),
            wrong: wrong.iter().map(|&value| value != 0).collect(),
        }
    };
    Ok((0..slots.shape()[0]).map(one).collect())
}

fn rows_of<'py>(py: Python<'py>, all: &[&Configuration]) -> PyResult<Rows<'py>> {
    let first = all.first();
    let n_slots = first.map_or(0, |one| one.slots.len());
    let n_levels = first.map_or(0, |one| one.levels.len());
    let n_wrong = first.map_or(0, |one| one.wrong.len());
    let pair = |slot: &Option<Contact>| match slot {
        Some(contact) => [contact.patch as i64, contact.size as i64],
        None => [-1, -1],
    };
    let slots = all.iter().flat_map(|one| one.slots.iter().flat_map(pair)).collect();
    let levels = all.iter().flat_map(|one| one.levels.iter().map(|&level| level as i64)).collect();
    let wrong = all.iter().flat_map(|one| one.wrong.iter().map(|&w| i64::from(w))).collect();
    Ok((
        arrays::from_vec(py, slots, [all.len(), n_slots, 2])?,
        arrays::from_vec(py, levels, [all.len(), n_levels])?,
        arrays::from_vec(py, wrong, [all.len(), n_wrong])?,
    ))
}
