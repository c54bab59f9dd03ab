//! Meshes, bodies and solves.

mod admm;
mod bed;
mod law;
mod many;
mod pbd;
mod rig;
mod sensitivity;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use numpy::IntoPyArray;
use numpy::{PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_fem::{
    Element, Load, LoadSteps, Material, Mesh, Method, Precision, SolveSettings, Supports,
};

pub(crate) use self::admm::PyAdmmBody;
use self::bed::{Bed, Sheet, SheetOut};
pub(crate) use self::law::{Law, laws};
pub(crate) use self::many::ManySolutions;
pub(crate) use self::pbd::PyPbd;
pub(crate) use self::rig::{Rig, RigFrame};
pub(crate) use self::sensitivity::{Adjoints, Cause, Compliance, Linearised};
use crate::arrays::{self, View};
use crate::errors::{self, Class};
use crate::{lock, report};

/// Raises MeshError unless nodes, float64 (n, 3) mm, and tets, int64 (m, 4), make a mesh.
#[pyfunction]
pub(crate) fn check_mesh(
    py: Python<'_>,
    nodes: &Bound<'_, PyAny>,
    tets: &Bound<'_, PyAny>,
) -> PyResult<()> {
    mesh_of(py, nodes, tets).map(|_| ())
}

/// Surface triangles of a mesh, int64 (t, 3), normals outward.
#[pyfunction]
pub(crate) fn surface_triangles<'py>(
    py: Python<'py>,
    nodes: &Bound<'py, PyAny>,
    tets: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<i64>>> {
    arrays::from_triangles(py, mesh_of(py, nodes, tets)?.surface_triangles())
}

/// Signed volumes of tets, float64 (m,) mm^3, with their nodes at any places.
#[pyfunction]
pub(crate) fn tet_volumes<'py>(
    py: Python<'py>,
    nodes: &Bound<'py, PyAny>,
    tets: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let nodes = View::<f64>::new("nodes", nodes, &[&[None, Some(3)]])?;
    let tets = tets_of(py, tets)?;
    let volumes = tissuereg_fem::tet_volumes(nodes.rows::<3>(), &tets);
    Ok(volumes.map_err(|error| errors::from_fem(py, &error, None))?.into_pyarray(py))
}

fn tets_of(py: Python<'_>, tets: &Bound<'_, PyAny>) -> PyResult<Vec<[usize; 4]>> {
    View::<i64>::new("tets", tets, &[&[None, Some(4)]])?.indices::<4>(py, "tets", Class::Mesh)
}

fn mesh_of(py: Python<'_>, nodes: &Bound<'_, PyAny>, tets: &Bound<'_, PyAny>) -> PyResult<Mesh> {
    let nodes = View::<f64>::new("nodes", nodes, &[&[None, Some(3)]])?.rows::<3>().to_vec();
    let tets = tets_of(py, tets)?;
    let mesh = py.detach(|| Mesh::new(nodes, tets));
    mesh.map_err(|error| errors::from_fem(py, &error, None))
}

/// A supported mesh, analysed once for any number of solves.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Body(Arc<tissuereg_fem::Body>, Arc<Bed>);

#[pymethods]
impl Body {
    /// Springs are triangles with (normal, tangential) stiffness in kPa/mm, which every solve may give anew; with `rests`
    /// they help to hold the body.
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
        let element = match element {
            "tet4" => Element::Tet4,
            "tet4-averaged" => Element::Tet4Averaged,
            "tet10" => Element::Tet10,
            other => {
                return Err(bad_choice(py, "element", "`tet4`, `tet4-averaged` or `tet10`", other));
            }
        };
        let held = View::<i64>::new("held_nodes", held_nodes, &[&[None]])?;
        let held = held.indices::<1>(py, "held_nodes", Class::Support)?.into_flattened();
        let bed = Bed::new(py, &springs, rests)?;
        let mesh = mesh_of(py, nodes, tets)?;
        let mut supports = Supports::from(held);
        if rests {
            supports = bed.springs.iter().fold(supports, Supports::rest_on);
        }
        let body = py.detach(|| tissuereg_fem::Body::new(mesh, element, supports));
        body.map(|body| Self(Arc::new(body), Arc::new(bed)))
            .map_err(|error| errors::from_fem(py, &error, None))
    }

    /// Undeformed positions of all nodes, float64 (n_nodes, 3), mm: corner nodes, then mid-edge nodes.
    #[getter]
    fn nodes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::from_points(py, self.0.nodes().to_vec())
    }

    /// Corners of every tet, int64 (n_tets, 4).
    #[getter]
    fn tets<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let tets = self.0.mesh().tets();
        let flat = tets.as_flattened().iter().map(|&node| node as i64).collect();
        arrays::from_vec(py, flat, [tets.len(), 4])
    }

    /// Held nodes as given, int64 (h,).
    #[getter]
    fn held_nodes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let held: Vec<i64> = self.0.held_nodes().iter().map(|&node| node as i64).collect();
        held.into_pyarray(py)
    }

    /// Ends of the edge in whose middle each node after the corner nodes lies, int64 (n_nodes - n_corner_nodes, 2).
    #[getter]
    fn mid_edges<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let edges = self.0.mid_edges();
        let flat = edges.as_flattened().iter().map(|&node| node as i64).collect();
        arrays::from_vec(py, flat, [edges.len(), 2])
    }

    /// Triangles of corner nodes, int64 (t, 3), normals outward.
    #[getter]
    fn surface_triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        arrays::from_triangles(py, self.0.mesh().surface_triangles())
    }

    /// Number of nodes, mid-edge nodes included.
    #[getter]
    fn n_nodes(&self) -> usize {
        self.0.n_nodes()
    }

    /// Number of nodes of the mesh.
    #[getter]
    fn n_corner_nodes(&self) -> usize {
        self.0.n_corner_nodes()
    }

    /// Number of tets.
    #[getter]
    fn n_tets(&self) -> usize {
        self.0.n_tets()
    }

    /// Number of unknown displacement components.
    #[getter]
    fn n_unknowns(&self) -> usize {
        self.0.n_unknowns()
    }

    /// Entries of the factor of its stiffness, floating-point operations of making it, and most entries that are held
    /// besides while one thread makes it; known from the symbolic analysis, no factor is made.
    #[getter]
    fn factor_size(&self) -> (usize, f64, usize) {
        let size = self.0.factor_size();
        (size.n_entries, size.flops, size.n_working)
    }

    /// "tet4", "tet4-averaged" or "tet10".
    #[getter]
    fn element(&self) -> &'static str {
        self.0.element().name()
    }

    /// Seconds that making it took.
    #[getter]
    fn analyse_seconds(&self) -> f64 {
        self.0.analyse_seconds()
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
        let forces = self.0.traction_forces(&triangles, traction.rows::<3>());
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
        let (three, all) = (Some(3), Some(self.0.n_nodes()));
        let start = View::<f64>::optional("start", start, &[&[all, three]])?;
        let material = self.material([young, poisson], law)?;
        let load = self.load(forces, body_force, prescribed, springs)?;
        let start = start.map(|rows| rows.rows::<3>().to_vec());
        let body = self.0.clone();
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
        let displacement = self.field("displacement", displacement)?;
        let settings = SolveSettings::default().with_n_threads(threads);
        let problem = Problem {
            material: self.material([young, poisson], law)?,
            load: self.load(forces, body_force, prescribed, springs)?,
            displacement,
            precision,
            settings,
        };
        Linearised::new(py, self, problem)
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
        let rows = self.field("displacement", displacement)?;
        let material = self.material([young, poisson], law)?;
        let springs = self.1.given(springs)?;
        let body = &self.0;
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
        let rows = self.field("displacement", displacement)?;
        let (springs, body) = (self.1.given(springs)?, &self.0);
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
        let members = many::Members::new(
            self,
            [young, poisson],
            &laws,
            many::Loads { forces, body_force, prescribed, springs, start },
        )?;
        members.solve(py, &self.0, settings, progress)
    }

    /// Sets of springs as given: triangles, int64 (t, 3), with (normal, tangential) stiffness, kPa/mm.
    #[getter]
    fn springs<'py>(&self, py: Python<'py>) -> PyResult<Vec<SheetOut<'py>>> {
        self.1.sheets(py)
    }

    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<((Points<'py>, Tets<'py>, Nodes<'py>), Bound<'py, PyDict>)> {
        let corners = self.0.mesh().nodes().to_vec();
        let arguments = (arrays::from_points(py, corners)?, self.tets(py)?, self.held_nodes(py));
        let keywords = PyDict::new(py);
        keywords.set_item("element", self.element())?;
        keywords.set_item("springs", self.springs(py)?)?;
        keywords.set_item("rests", self.1.rests)?;
        Ok((arguments, keywords))
    }

    fn __repr__(&self) -> String {
        format!(
            "Body(n_nodes={}, n_tets={}, n_held={}, element=\"{}\")",
            self.0.n_nodes(),
            self.0.n_tets(),
            self.0.held_nodes().len(),
            self.element()
        )
    }
}

type Points<'py> = Bound<'py, PyArray2<f64>>;
type Tets<'py> = Bound<'py, PyArray2<i64>>;
type Nodes<'py> = Bound<'py, PyArray1<i64>>;

/// An equilibrium.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Solution {
    /// Displacement of all nodes, float64 (n_nodes, 3), mm.
    #[pyo3(get)]
    displacement: Py<PyArray2<f64>>,
    /// Force of the support at each held node, float64 (h, 3), mN.
    #[pyo3(get)]
    reactions: Py<PyArray2<f64>>,
    /// Work done.
    #[pyo3(get)]
    report: Py<PyDict>,
}

impl Solution {
    fn new(py: Python<'_>, solution: tissuereg_fem::Solution, tolerance: f64) -> PyResult<Self> {
        Ok(Self {
            displacement: arrays::from_points(py, solution.displacement)?.unbind(),
            reactions: arrays::from_points(py, solution.reactions)?.unbind(),
            report: report::of_solve(py, &solution.report, tolerance)?.unbind(),
        })
    }
}

#[pymethods]
impl Solution {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let report = self.report.bind(py);
        let iterations = report.get_item("iterations")?;
        Ok(format!("Solution(iterations={})", iterations.map_or("?".to_owned(), |n| n.to_string())))
    }
}

/// An equilibrium and what it is one of, checked and copied.
struct Problem {
    material: Material,
    load: Load,
    displacement: Vec<[f64; 3]>,
    precision: Precision,
    settings: SolveSettings,
}

impl Body {
    fn material(
        &self,
        [young, poisson]: [&Bound<'_, PyAny>; 2],
        law: Option<&Law>,
    ) -> PyResult<Material> {
        let (py, body) = (young.py(), &self.0);
        let (n_tets, n_points) = (Some(body.n_tets()), Some(body.element().n_points()));
        let moduli: [&[Option<usize>]; 3] = [&[Some(1)], &[n_tets], &[n_tets, n_points]];
        let young = View::<f64>::new("young", young, &moduli)?;
        let poisson = View::<f64>::new("poisson", poisson, &moduli)?;
        let material = law
            .map_or(&Law::default(), |law| law)
            .material(body.element(), body.n_tets(), young.slice(), poisson.slice())
            .map_err(|error| errors::from_fem(py, &error, None))?;
        errors::warn_of_locking(py, body.element(), [&material].into_iter(), poisson.slice())?;
        Ok(material)
    }

    fn load(
        &self,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        springs: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Load> {
        let (body, three) = (&self.0, Some(3));
        let (all, corners) = (Some(body.n_nodes()), Some(body.n_corner_nodes()));
        let forces = View::<f64>::optional("forces", forces, &[&[all, three], &[corners, three]])?;
        let body_force = View::<f64>::optional("body_force", body_force, &[&[three]])?;
        let n_held = Some(body.held_nodes().len());
        let prescribed = View::<f64>::optional("prescribed", prescribed, &[&[n_held, three]])?;
        Ok(Load {
            nodal_forces: forces.map(|rows| rows.rows::<3>().to_vec()),
            body_force: body_force.and_then(|v| v.rows().first().copied()).unwrap_or_default(),
            prescribed: prescribed.map(|rows| rows.rows::<3>().to_vec()),
            springs: self.1.given(springs)?,
        })
    }

    /// One row per node.
    fn field(&self, name: &str, rows: &Bound<'_, PyAny>) -> PyResult<Vec<[f64; 3]>> {
        let wanted: [&[Option<usize>]; 1] = [&[Some(self.0.n_nodes()), Some(3)]];
        Ok(View::<f64>::new(name, rows, &wanted)?.rows::<3>().to_vec())
    }
}

fn settings_of(
    py: Python<'_>,
    tolerance: f64,
    max_iterations: usize,
    method: &str,
    load_steps: usize,
    threads: usize,
) -> PyResult<SolveSettings> {
    let method = match method {
        "auto" => Method::Auto,
        "newton" => Method::Newton,
        "quasi-newton" => Method::QuasiNewton,
        other => return Err(bad_choice(py, "method", "`auto`, `newton` or `quasi-newton`", other)),
    };
    let load_steps = if load_steps == 0 { LoadSteps::Auto } else { LoadSteps::Equal(load_steps) };
    let settings = SolveSettings::default()
        .with_tolerance(tolerance)
        .with_max_iterations(max_iterations)
        .with_method(method)
        .with_load_steps(load_steps);
    Ok(settings.with_n_threads(threads))
}

fn bad_choice(py: Python<'_>, name: &str, wanted: &str, found: &str) -> PyErr {
    errors::raise(py, Class::Base, &format!("`{name}` must be {wanted}, got `{found}`"), Some(name))
}
