//! Material laws by name.

use std::collections::BTreeMap;

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use tissuereg_boundary::errors::{self, Class};
use tissuereg_boundary::views::View;
use tissuereg_fem::material as fem;
use tissuereg_fem::material::homogeneous::{Compressibility, Mode, nominal_stress};
use tissuereg_fem::material::{
    Declaration, Directions, Fibres, LawKind, ShapeParameter, Volumetric,
};
use tissuereg_fem::{Element, FemError, Material, Stiffness, stress_history};

use super::behaviour::Behaviour;
use super::given::bad_choice;

/// A law, its shape and its fibres; moduli come with each solve.
#[pyclass(frozen, module = "tissuereg._core")]
#[derive(Debug, Clone, Default)]
pub(crate) struct Law {
    kind: LawKind,
    volumetric: Volumetric,
    fibres: Option<Fibres>,
}

#[pymethods]
impl Law {
    #[new]
    #[pyo3(signature = (name, shape, *, volumetric="log", direction=None, k1_over_mu=0.0, k2=0.0, tension_only=true))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn new(
        py: Python<'_>,
        name: &str,
        shape: BTreeMap<String, Vec<f64>>,
        volumetric: &str,
        direction: Option<&Bound<'_, PyAny>>,
        k1_over_mu: f64,
        k2: f64,
        tension_only: bool,
    ) -> PyResult<Self> {
        let kind = kind_of(py, name, shape)?;
        let volumetric = match volumetric {
            "log" => Volumetric::Log,
            "quadratic" => Volumetric::Quadratic,
            "coupled" => Volumetric::Coupled,
            other => {
                return Err(refuse(py, "volumetric", "`log`, `quadratic` or `coupled`", other));
            }
        };
        let three = Some(3);
        let wanted: [&[Option<usize>]; 3] = [&[three], &[None, three], &[None, None, three]];
        let directions =
            View::<f64>::optional("direction", direction, &wanted)?.map(|view| {
                match (view.shape(), view.rows::<3>()) {
                    (_, &[direction]) => Directions::Uniform(direction),
                    (&[_, n_points, _], rows) => {
                        Directions::PerPoint { n_points, directions: rows.to_vec() }
                    }
                    (_, rows) => Directions::PerTet(rows.to_vec()),
                }
            });
        let fibres =
            directions.map(|directions| Fibres { k1_over_mu, k2, tension_only, directions });
        let law = Self { kind, volumetric, fibres };
        // The crate checks what it is given, with any moduli.
        match law.with_moduli(Stiffness::Uniform { young: 1.0, poisson: 0.0 }) {
            Ok(_) => Ok(law),
            Err(error) => Err(errors::from_fem(py, &error, None)),
        }
    }

    /// Nominal stress, float64 (n,) kPa, of a homogeneous test at stretches or amounts of shear, float64 (n,);
    /// NaN where the law has none.
    #[pyo3(signature = (mode, amounts, young, poisson, *, incompressible=false))]
    fn nominal_stress<'py>(
        &self,
        py: Python<'py>,
        mode: &str,
        amounts: &Bound<'py, PyAny>,
        young: f64,
        poisson: f64,
        incompressible: bool,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let mode = mode_of(py, mode)?;
        let limit = if incompressible { Compressibility::Limit } else { Compressibility::OfLaw };
        let amounts = View::<f64>::new("amounts", amounts, &[&[None]])?;
        let law = self.point_law(py, young, poisson)?;
        let stress: Vec<f64> = amounts
            .slice()
            .iter()
            .map(|&amount| nominal_stress(&law, mode, amount, limit).unwrap_or(f64::NAN))
            .collect();
        Ok(stress.into_pyarray(py))
    }

    /// Nominal stress, float64 (n,) kPa, of a homogeneous test through stretches or amounts of shear, float64 (n,), at
    /// times, float64 (n,) s: the first row is reached at once. NaN from a row on where there is none.
    #[pyo3(signature = (mode, amounts, times, young, poisson, behaviour))]
    #[allow(clippy::too_many_arguments)] // one function in Python
    fn stress_history<'py>(
        &self,
        py: Python<'py>,
        mode: &str,
        amounts: &Bound<'py, PyAny>,
        times: &Bound<'py, PyAny>,
        young: f64,
        poisson: f64,
        behaviour: &Behaviour,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let mode = mode_of(py, mode)?;
        let amounts = View::<f64>::new("amounts", amounts, &[&[None]])?;
        let times = View::<f64>::new("times", times, &[&[None]])?;
        let law = self.point_law(py, young, poisson)?;
        let (amounts, times) = (amounts.slice(), times.slice());
        let stress = py.detach(|| stress_history(&law, &behaviour.0, mode, amounts, times));
        let stress = stress.map_err(|error| errors::from_fem(py, &error, None))?;
        Ok(stress.into_pyarray(py))
    }

    fn __repr__(&self) -> String {
        format!("Law({:?}, {:?}, {:?})", self.kind, self.volumetric, self.fibres)
    }
}

impl Law {
    /// The law at the one point of a homogeneous body.
    fn point_law(&self, py: Python<'_>, young: f64, poisson: f64) -> PyResult<fem::Law> {
        let material = self
            .with_moduli(Stiffness::Uniform { young, poisson })
            .map_err(|error| errors::from_fem(py, &error, None))?;
        Ok(material.law_at(0, 0))
    }

    fn with_moduli(&self, stiffness: Stiffness) -> Result<Material, FemError> {
        let material =
            Material::new(stiffness)?.with_law(self.kind)?.with_volumetric(self.volumetric)?;
        match &self.fibres {
            Some(fibres) => material.with_fibres(fibres.clone()),
            None => Ok(material),
        }
    }

    /// The law with one modulus for all, one per tet or one per quadrature point.
    pub(super) fn material(
        &self,
        element: Element,
        n_tets: usize,
        young: &[f64],
        poisson: &[f64],
    ) -> Result<Material, FemError> {
        let young = match (young, poisson.len()) {
            (&[young], n) => vec![young; n],
            (young, _) => young.to_vec(),
        };
        let n_points = element.n_points();
        self.with_moduli(match (young.as_slice(), poisson) {
            (&[young], &[poisson]) => Stiffness::Uniform { young, poisson },
            (field, poisson) if field.len() == n_tets => {
                Stiffness::PerTet { young, poisson: poisson.to_vec() }
            }
            (_, poisson) => Stiffness::PerPoint { n_points, young, poisson: poisson.to_vec() },
        })
    }
}

fn mode_of(py: Python<'_>, name: &str) -> PyResult<Mode> {
    match name {
        "uniaxial" => Ok(Mode::Uniaxial),
        "equibiaxial" => Ok(Mode::Equibiaxial),
        "simple-shear" => Ok(Mode::SimpleShear),
        other => {
            let wanted = "`uniaxial`, `equibiaxial` or `simple-shear`";
            Err(bad_choice(py, "mode", wanted, other))
        }
    }
}

/// Name of a law; name, whether it is a series, least and largest value of a fit of each shape parameter; shapes at
/// which fits begin.
type Declared = (&'static str, Vec<(&'static str, bool, f64, f64)>, Vec<Vec<f64>>);

/// Every law that there is, as the crate declares it.
#[pyfunction]
pub(crate) fn laws() -> Vec<Declared> {
    let declared = LawKind::declarations();
    let shape = |law: &Declaration| {
        law.shape.iter().map(|p| (p.name, p.series, p.searched[0], p.searched[1])).collect()
    };
    declared
        .iter()
        .map(|law| (law.name, shape(law), law.starts.iter().map(|start| start.to_vec()).collect()))
        .collect()
}

/// Takes the shape parameters of a law out of a table, and refuses the other entries.
fn kind_of(py: Python<'_>, name: &str, mut shape: BTreeMap<String, Vec<f64>>) -> PyResult<LawKind> {
    let all = LawKind::declarations();
    let Some(law) = all.iter().find(|law| law.name == name) else {
        let names: Vec<&str> = all.iter().map(|law| law.name).collect();
        let wanted = format!("one of {}", names.join(", "));
        return Err(refuse(py, "law", &wanted, &format!("'{name}'")));
    };
    let mut take = |one: &ShapeParameter| match (one.series, shape.remove(one.name)) {
        (_, None) => Err(refuse(py, one.name, &format!("given for the law `{name}`"), "nothing")),
        (false, Some(list)) if list.len() != 1 => {
            Err(refuse(py, one.name, "one number", &format!("{} numbers", list.len())))
        }
        (_, Some(list)) => Ok(list),
    };
    let lists = law.shape.iter().map(&mut take).collect::<PyResult<Vec<_>>>()?;
    let kind = LawKind::from_shape(name, &lists)
        .map_err(|error| errors::from_fem(py, &error, None))?
        .ok_or_else(|| refuse(py, "law", "a law of the catalogue", &format!("'{name}'")))?;
    match shape.keys().next() {
        None => Ok(kind),
        Some(key) => {
            let message = format!("the law `{name}` has no parameter `{key}`");
            Err(errors::raise(py, Class::Material, &message, Some(key)))
        }
    }
}

/// Warn, once a call, of linear tets that lock with one of these materials, whose largest Poisson's ratio is among
/// `poisson`.
pub(super) fn warn_of_locking<'a>(
    py: Python<'_>,
    element: Element,
    mut materials: impl Iterator<Item = &'a Material>,
    poisson: &[f64],
) -> PyResult<()> {
    if element == Element::Tet4 && materials.any(Material::locks_linear_tets) {
        let largest = poisson.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        py.import("tissuereg._base.locking")?.call_method1("warn_of_locking", (largest,))?;
    }
    Ok(())
}

fn refuse(py: Python<'_>, name: &str, wanted: &str, found: &str) -> PyErr {
    let message = format!("`{name}` must be {wanted}, got {found}");
    errors::raise(py, Class::Material, &message, Some(name))
}
