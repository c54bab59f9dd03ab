//! Bodies and their solves.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_boundary::errors::{self, Class};
use tissuereg_boundary::mesh::mesh_of;
use tissuereg_boundary::views::View;
use tissuereg_boundary::{arrays, lock};
use tissuereg_fem::{Precision, SolveSettings, Supports};

use super::bed::{Bed, Sheet, SheetOut};
use super::given::{bad_choice, element_of, nodes_of, settings_of};
use super::law::Law;
use super::many::{Loads, ManySolutions, Members};
use super::sensitivity::Linearised;
use super::solution::Solution;
use super::supported::{Problem, Supported};

/// A supported mesh, analysed once for any number of solves.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Body(pub(super) Supported);

#[pymethods]
impl Body {
    /// Springs are triangles with (normal, tangential) stiffness in kPa/mm, which every solve may give anew, and for friction
    /// (coefficient, cohesion kPa) behind it; with `rests` they help to hold the body.
    #[new]
    #[pyo3(signature = (nodes, tets, held_nodes, *, element="tet4", springs=Vec::new(), rests=false))]
    fn new(
        py: Python<'_>,
        nodes: &Bound<'_, PyAny>,
        tets: &Bound<'_, PyAny>,
        held_nodes: &Bound<'_, PyAny>,
        element: &str,
        springs: Vec<Sheet<'_>>,
        rests: bool,
    ) -> PyResult<Self> {
        let element = element_of(py, element)?;
        let held = nodes_of(py, "held_nodes", held_nodes)?;
        let bed = Bed::new(py, &springs, rests)?;
        let mesh = mesh_of(py, nodes, tets)?;
        let mut supports = Supports::from(held);
        if rests {
            supports = bed.springs.iter().fold(supports, Supports::rest_on);
        }
        let body = py.detach(|| tissuereg_fem::Body::new(mesh, element, supports));
        let body = body.map_err(|error| errors::from_fem(py, &error, None))?;
        Ok(Self(Supported { body: Arc::new(body), bed: Arc::new(bed) }))
    }

    /// Undeformed positions of all nodes, float64 (n_nodes, 3), mm: corner nodes, then mid-edge nodes.
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::from_points(py, self.0.body.nodes().to_vec())
    }

    /// Corners of every tet, int64 (n_tets, 4).
    #[getter]
    fn tets<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let tets = self.0.body.mesh().tets();
        let flat = tets.as_flattened().iter().map(|&node| node as i64).collect();
        arrays::from_vec(py, flat, [tets.len(), 4])
    }

    /// Held nodes as given, int64 (h,).
    #[getter]
    fn held_nodes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let held: Vec<i64> = self.0.body.held_nodes().iter().map(|&node| node as i64).collect();
        held.into_pyarray(py)
    }

    /// Ends of the edge in whose middle each node after the corner nodes lies, int64 (n_nodes - n_corner_nodes, 2).
    #[getter]
    fn mid_edges<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let edges = self.0.body.mid_edges();
        let flat = edges.as_flattened().iter().map(|&node| node as i64).collect();
        arrays::from_vec(py, flat, [edges.len(), 2])
    }

    /// Triangles of corner nodes, int64 (t, 3), normals outward.
    #[getter]
    fn surface_triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        arrays::from_triangles(py, self.0.body.mesh().surface_triangles())
    }

    /// Number of nodes, mid-edge nodes included.
    #[getter]
    fn n_nodes(&self) -> usize {
        self.0.body.n_nodes()
    }

    /// Number of nodes of the mesh.
    #[getter]
    fn n_corner_nodes(&self) -> usize {
        self.0.body.n_corner_nodes()
    }

    /// Number of tets.
    #[getter]
    fn n_tets(&self) -> usize {
        self.0.body.n_tets()
    }

    /// Number of unknown displacement components.
    #[getter]
    fn n_unknowns(&self) -> usize {
        self.0.body.n_unknowns()
    }

    /// Entries of the factor of its stiffness, floating-point operations of making it, and most entries that are held
    /// besides while one thread makes it; known from the symbolic analysis, no factor is made.
    #[getter]
    fn factor_size(&self) -> (usize, f64, usize) {
        let size = self.0.body.factor_size();
        (size.n_entries, size.flops, size.n_working)
    }

    /// "tet4", "tet4-averaged" or "tet10".
    #[getter]
    fn element(&self) -> &'static str {
        self.0.body.element().name()
    }

    /// Seconds that making it took.
    #[getter]
    fn analyse_seconds(&self) -> f64 {
        self.0.body.analyse_seconds()
    }

    /// Consistent nodal forces, float64 (n_nodes, 3) mN, of tractions, float64 (t, 3) kPa, on surface triangles.
    fn traction_forces<'py>(
        &self,
        py: Python<'py>,
        triangles: &Bound<'py, PyAny>,
        traction: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let triangles = View::<i64>::new("triangles", triangles, &[&[None, Some(3)]])?
            .indices::<3>(py, "triangles", Class::Load)?;
        let traction =
            View::<f64>::new("traction", traction, &[&[Some(triangles.len()), Some(3)]])?;
        let forces = self.0.body.traction_forces(&triangles, traction.rows::<3>());
        arrays::from_points(py, forces.map_err(|error| errors::from_fem(py, &error, None))?)
    }

    /// Equilibrium under one load. Moduli: one for all, float64 (1,), one per tet, (n_tets,), or one per quadrature point,
    /// (n_tets, n_points); without a law they are those of a neo-Hookean one.
    #[pyo3(signature = (young, poisson, *, law=None, forces=None, body_force=None, prescribed=None, springs=None, start=None,
                        tolerance=1e-9, max_iterations=1000, method="auto", load_steps=0, threads=0))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn solve(
        &self,
        py: Python<'_>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        law: Option<&Law>,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        springs: Option<&Bound<'_, PyAny>>,
        start: Option<&Bound<'_, PyAny>>,
        tolerance: f64,
        max_iterations: usize,
        method: &str,
        load_steps: usize,
        threads: usize,
    ) -> PyResult<Solution> {
        let settings = settings_of(py, tolerance, max_iterations, method, load_steps, threads)?;
        let (three, all) = (Some(3), Some(self.0.body.n_nodes()));
        let start = View::<f64>::optional("start", start, &[&[all, three]])?;
        let material = self.0.material([young, poisson], law)?;
        let load = self.0.load(forces, body_force, prescribed, springs)?;
        let start = start.map(|rows| rows.rows::<3>().to_vec());
        let body = self.0.body.clone();
        let cancel = Arc::new(AtomicBool::new(false));
        let settings = settings.with_cancel(cancel.clone());
        let work = move || match start {
            None => tissuereg_fem::solve(&body, &material, &load, &settings),
            Some(start) => tissuereg_fem::solve_from(&body, &material, &load, &start, &settings),
        };
        let answer = lock::run_watched(py, &cancel, |_| Ok(()), work)?;
        let answer = answer.map_err(|error| errors::from_fem(py, &error, None))?;
        Solution::new(py, answer, tolerance)
    }

    /// The exact tangent at an equilibrium, which answers derivatives; arguments as those of `solve`, `displacement` its
    /// answer, float64 (n_nodes, 3) mm. The factor is in "double" precision or in "single", made sooner in half the memory.
    #[pyo3(signature = (displacement, young, poisson, *, law=None, forces=None, body_force=None, prescribed=None,
                        springs=None, precision="double", threads=0))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn linearise(
        &self,
        py: Python<'_>,
        displacement: &Bound<'_, PyAny>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        law: Option<&Law>,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        springs: Option<&Bound<'_, PyAny>>,
        precision: &str,
        threads: usize,
    ) -> PyResult<Linearised> {
        let precision = match precision {
            "double" => Precision::Double,
            "single" => Precision::Single,
            other => return Err(bad_choice(py, "precision", "`double` or `single`", other)),
        };
        let displacement = self.0.field("displacement", displacement)?;
        let settings = SolveSettings::default().with_n_threads(threads);
        let problem = Problem {
            material: self.0.material([young, poisson], law)?,
            load: self.0.load(forces, body_force, prescribed, springs)?,
            displacement,
            precision,
            settings,
        };
        Linearised::new(py, &self.0, problem)
    }

    /// Nodal forces, float64 (n_nodes, 3) mN, under which a displacement, float64 (n_nodes, 3) mm, is in equilibrium, on its
    /// springs where the body has some; at held nodes the reactions of a body without load.
    #[pyo3(signature = (displacement, young, poisson, *, law=None, springs=None))]
    fn internal_forces<'py>(
        &self,
        py: Python<'py>,
        displacement: &Bound<'py, PyAny>,
        young: &Bound<'py, PyAny>,
        poisson: &Bound<'py, PyAny>,
        law: Option<&Law>,
        springs: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rows = self.0.field("displacement", displacement)?;
        let material = self.0.material([young, poisson], law)?;
        let springs = self.0.bed.given(springs)?;
        let body = &self.0.body;
        let found = py.detach(|| {
            let mut forces = tissuereg_fem::internal_forces(body, &material, &rows)?;
            for set in tissuereg_fem::spring_forces(body, &springs, &rows)? {
                for (sum, force) in forces.iter_mut().zip(set) {
                    (0..3).for_each(|i| sum[i] -= force[i]);
                }
            }
            Ok(forces)
        });
        arrays::from_points(py, found.map_err(|error| errors::from_fem(py, &error, None))?)
    }

    /// Forces of each set of springs on the body at a displacement, float64 (n_sets, n_nodes, 3), mN. Springs whose far
    /// ends move by a displacement pull as the negative of what they do at it.
    #[pyo3(signature = (displacement, springs=None))]
    fn spring_forces<'py>(
        &self,
        py: Python<'py>,
        displacement: &Bound<'py, PyAny>,
        springs: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let rows = self.0.field("displacement", displacement)?;
        let (springs, body) = (self.0.bed.given(springs)?, &self.0.body);
        let found = py.detach(|| tissuereg_fem::spring_forces(body, &springs, &rows));
        let found = found.map_err(|error| errors::from_fem(py, &error, None))?;
        let flat = found.into_iter().flat_map(|set| set.into_flattened()).collect();
        arrays::from_vec(py, flat, [springs.len(), body.n_nodes(), 3])
    }

    /// Equilibria of many members, in parallel, each on one thread. Moduli as for one, the member axis first; one law a
    /// member, or one for all; `start` one displacement a member, float64 (n_members, n_nodes, 3) mm, or one for all.
    #[pyo3(signature = (young, poisson, *, laws=None, forces=None, body_force=None, prescribed=None, springs=None, start=None,
                        tolerance=1e-9, max_iterations=1000, method="auto", load_steps=0, threads=0, progress=None))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn solve_many(
        &self,
        py: Python<'_>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        laws: Option<Vec<PyRef<'_, Law>>>,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        springs: Option<&Bound<'_, PyAny>>,
        start: Option<&Bound<'_, PyAny>>,
        tolerance: f64,
        max_iterations: usize,
        method: &str,
        load_steps: usize,
        threads: usize,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<ManySolutions> {
        let settings = settings_of(py, tolerance, max_iterations, method, load_steps, threads)?;
        let laws = laws.unwrap_or_default();
        let members = Members::new(
            &self.0,
            [young, poisson],
            &laws,
            Loads { forces, body_force, prescribed, springs, start },
        )?;
        members.solve(py, &self.0.body, settings, progress)
    }

    /// Sets of springs as given: triangles, int64 (t, 3), with (normal, tangential) stiffness, kPa/mm.
    #[getter]
    fn springs<'py>(&self, py: Python<'py>) -> PyResult<Vec<SheetOut<'py>>> {
        self.0.bed.sheets(py)
    }

    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<((Points<'py>, Tets<'py>, Nodes<'py>), Bound<'py, PyDict>)> {
        let corners = self.0.body.mesh().nodes().to_vec();
        let arguments = (arrays::from_points(py, corners)?, self.tets(py)?, self.held_nodes(py));
        let keywords = PyDict::new(py);
        keywords.set_item("element", self.element())?;
        keywords.set_item("springs", self.springs(py)?)?;
        keywords.set_item("rests", self.0.bed.rests)?;
        Ok((arguments, keywords))
    }

    fn __repr__(&self) -> String {
        format!(
            "Body(n_nodes={}, n_tets={}, n_held={}, element=\"{}\")",
            self.0.body.n_nodes(),
            self.0.body.n_tets(),
            self.0.body.held_nodes().len(),
            self.element()
        )
    }
}

type Points<'py> = Bound<'py, PyArray2<f64>>;
type Tets<'py> = Bound<'py, PyArray2<i64>>;
type Nodes<'py> = Bound<'py, PyArray1<i64>>;
