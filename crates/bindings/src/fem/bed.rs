//! Springs under a body: triangles that stay, stiffness that each solve may give anew.

use numpy::PyArray2;
use pyo3::prelude::*;
use tissuereg_boundary::arrays;
use tissuereg_boundary::views::View;
use tissuereg_fem::{Friction, Springs};

use super::given::{exactly, triangles_of};

/// Triangles with numbers that describe what lies on them.
pub(super) type Sheet<'py> = (Bound<'py, PyAny>, Vec<f64>);

/// The same as Python gets them back.
pub(super) type SheetOut<'py> = (Bound<'py, PyArray2<i64>>, Vec<f64>);

/// Sets of springs of a body.
#[derive(Debug, Default)]
pub(super) struct Bed {
    pub(super) springs: Vec<Springs>,
    /// Whether they help to hold the body.
    pub(super) rests: bool,
}

impl Bed {
    pub(super) fn new(py: Python<'_>, springs: &[Sheet<'_>], rests: bool) -> PyResult<Self> {
        let one = |(triangles, numbers): &Sheet<'_>| {
            let (stiffness, rest) = numbers.split_at(numbers.len().min(2));
            let [normal, tangential] = exactly(py, "springs", stiffness)?;
            let friction = match rest {
                [] => None,
                rest => {
                    let [coefficient, cohesion] = exactly(py, "friction", rest)?;
                    Some(Friction { coefficient, cohesion })
                }
            };
            let triangles = triangles_of("spring triangles", triangles)?;
            Ok(Springs { triangles, normal, tangential, friction })
        };
        Ok(Self { springs: springs.iter().map(one).collect::<PyResult<_>>()?, rests })
    }

    /// The springs with stiffness `(n_sets, 2)`, kPa/mm; their own where none is given.
    pub(super) fn with(&self, stiffness: Option<&[[f64; 2]]>) -> Vec<Springs> {
        let mut springs = self.springs.clone();
        for (set, &[normal, tangential]) in springs.iter_mut().zip(stiffness.unwrap_or_default()) {
            (set.normal, set.tangential) = (normal, tangential);
        }
        springs
    }

    /// The same from an argument of Python.
    pub(super) fn given(&self, stiffness: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Springs>> {
        let shape: [&[Option<usize>]; 1] = [&[Some(self.springs.len()), Some(2)]];
        let stiffness = View::<f64>::optional("springs", stiffness, &shape)?;
        Ok(self.with(stiffness.as_ref().map(View::rows::<2>)))
    }

    /// As given to a body.
    pub(super) fn sheets<'py>(&self, py: Python<'py>) -> PyResult<Vec<SheetOut<'py>>> {
        let one = |set: &Springs| {
            let triangles = arrays::from_triangles(py, &set.triangles)?;
            let friction = set.friction.iter().flat_map(|one| [one.coefficient, one.cohesion]);
            Ok((triangles, [set.normal, set.tangential].into_iter().chain(friction).collect()))
        };
        self.springs.iter().map(one).collect()
    }
}
