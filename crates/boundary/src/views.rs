//! Arrays in: C-ordered views of the dtype wanted, or a `ShapeError` that names the argument.

use faer::MatRef;
use numpy::{
    Element, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::errors::{self, Class};

/// Dtypes that arguments may have.
pub trait Dtype: Element {
    /// numpy's name.
    const NAME: &'static str;
}

impl Dtype for f64 {
    const NAME: &'static str = "float64";
}

impl Dtype for i64 {
    const NAME: &'static str = "int64";
}

/// A shape an argument may have: `None` for any length.
pub type Shape<'a> = &'a [Option<usize>];

/// A checked argument; keeps the array alive and unwritten by Rust.
pub struct View<'py, T: Dtype> {
    array: PyReadonlyArrayDyn<'py, T>,
    shape: Vec<usize>,
}

impl<'py, T: Dtype> View<'py, T> {
    /// Views `object` if it is a C-ordered array of one of the shapes.
    ///
    /// # Errors
    ///
    /// `ShapeError` with the name and both shapes.
    pub fn new(name: &str, object: &Bound<'py, PyAny>, wanted: &[Shape]) -> PyResult<Self> {
        let refuse = || {
            let message = format!(
                "`{name}` must be a C-ordered {} array of shape {}, got {}",
                T::NAME,
                described(wanted),
                found(object)
            );
            errors::raise(object.py(), Class::Shape, &message, Some(name))
        };
        let array = object.cast::<PyArrayDyn<T>>().map_err(|_| refuse())?;
        let shape = array.shape().to_vec();
        let fits = |shape: &[usize], wanted: &Shape| {
            shape.len() == wanted.len()
                && shape.iter().zip(wanted.iter()).all(|(n, w)| w.is_none_or(|w| w == *n))
        };
        if !array.is_c_contiguous() || !wanted.iter().any(|wanted| fits(&shape, wanted)) {
            return Err(refuse());
        }
        let array = array.try_readonly().map_err(|_| refuse())?;
        array.as_slice().map_err(|_| refuse())?;
        Ok(Self { array, shape })
    }

    /// The same for an argument that may be None.
    ///
    /// # Errors
    ///
    /// As [`View::new`].
    pub fn optional(
        name: &str,
        object: Option<&Bound<'py, PyAny>>,
        wanted: &[Shape],
    ) -> PyResult<Option<Self>> {
        object.map(|object| Self::new(name, object, wanted)).transpose()
    }

    /// All entries, last axis fastest.
    pub fn slice(&self) -> &[T] {
        // `new` has seen that there is a slice.
        self.array.as_slice().unwrap_or_default()
    }

    /// Shape, as checked.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Rows of `N` entries each.
    pub fn rows<const N: usize>(&self) -> &[[T; N]] {
        self.slice().as_chunks().0
    }
}

impl View<'_, f64> {
    /// A two-axis array as a matrix.
    pub fn matrix(&self) -> MatRef<'_, f64> {
        match *self.shape {
            [n_rows, n_columns] => MatRef::from_row_major_slice(self.slice(), n_rows, n_columns),
            _ => MatRef::from_row_major_slice(self.slice(), self.slice().len(), 1),
        }
    }
}

impl View<'_, i64> {
    /// Rows of node numbers.
    ///
    /// # Errors
    ///
    /// `class` for a negative one.
    pub fn indices<const N: usize>(
        &self,
        py: Python<'_>,
        name: &str,
        class: Class,
    ) -> PyResult<Vec<[usize; N]>> {
        let mut rows = vec![[0; N]; self.rows::<N>().len()];
        for (row, (target, source)) in rows.iter_mut().zip(self.rows::<N>()).enumerate() {
            for (index, &value) in target.iter_mut().zip(source) {
                *index = usize::try_from(value).map_err(|_| {
                    let message = format!(
                        "`{name}` must hold node numbers from 0 on, got {value} in row {row}"
                    );
                    errors::raise(py, class, &message, Some(name))
                })?;
            }
        }
        Ok(rows)
    }
}

/// `(n, 3) or (4,)`
fn described(wanted: &[Shape]) -> String {
    let one = |shape: &Shape| {
        let lengths: Vec<String> =
            shape.iter().map(|n| n.map_or("n".to_owned(), |n| n.to_string())).collect();
        match lengths.as_slice() {
            [only] => format!("({only},)"),
            _ => format!("({})", lengths.join(", ")),
        }
    };
    let mut shapes: Vec<String> = wanted.iter().map(one).collect();
    shapes.dedup();
    shapes.join(" or ")
}

/// What an object is, in the words of `described`.
fn found(object: &Bound<'_, PyAny>) -> String {
    let Ok(array) = object.cast::<PyUntypedArray>() else {
        return object.get_type().name().map_or("something else".to_owned(), |n| n.to_string());
    };
    let shape: Vec<Option<usize>> = array.shape().iter().copied().map(Some).collect();
    let order = if array.is_c_contiguous() { "" } else { ", not C-ordered" };
    let writer =
        if array.dtype().is_native_byteorder() == Some(false) { ", byte-swapped" } else { "" };
    format!("{} of shape {}{order}{writer}", array.dtype(), described(&[&shape]))
}
