//! A body through time frames, with pads that come and go.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use numpy::{PyArray2, PyArray4};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tissuereg_fem::{
    Behaviour, Body, Drainage, Element, FemError, FrameAdjoint, FrameCause, FrameObservation,
    Friction, History, Load, Material, Mesh, Observation, Pad, Part, Relaxation, Resultant, Set,
    Skin, Softening, SofteningForm, SolveSettings, Springs, Supports, Swelling,
};

use super::bed::Sheet;
use super::sensitivity::{Cause, Stack, weights_of};
use super::{Law, bad_choice, settings_of};
use crate::arrays::{self, View};
use crate::errors::{self, Class};
use crate::{lock, report};

/// A body, its history and its pads.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct Rig {
    rig: Arc<Mutex<tissuereg_fem::Rig>>,
    springs: Vec<Springs>,
    skins: Vec<Skin>,
    /// Given minus unloaded place of every node, mm; empty where both are the same.
    hung: Vec<[f64; 3]>,
    settings: SolveSettings,
    sizes: Sizes,
}

/// Elements, and numbers of rows of the arguments.
#[derive(Clone, Copy)]
struct Sizes {
    element: Element,
    nodes: usize,
    corners: usize,
    held: usize,
    pads: usize,
    /// Tets and quadrature points of each.
    points: [usize; 2],
}

#[pymethods]
impl Rig {
    /// Springs are triangles with (normal, tangential) stiffness in kPa/mm, and for friction (coefficient, cohesion kPa)
    /// behind it; skins with (thickness mm, Young kPa, Poisson). With `rests` the springs help to hold the body.
    /// `hangs_in` is a body force, mN/mm^3, that acts in the mesh as given already. With `record` the steps are kept for
    /// derivatives.
    #[new]
    #[pyo3(signature = (nodes, tets, held_nodes, young, poisson, *, law=None, element="tet4", pads=Vec::new(), behaviour=None,
                        springs=Vec::new(), rests=false, skins=Vec::new(), hangs_in=None, record=false,
                        tolerance=1e-9, max_iterations=1000, threads=0))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn new(
        py: Python<'_>,
        nodes: &Bound<'_, PyAny>,
        tets: &Bound<'_, PyAny>,
        held_nodes: &Bound<'_, PyAny>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        law: Option<&Law>,
        element: &str,
        pads: Vec<Bound<'_, PyAny>>,
        behaviour: Option<&Bound<'_, PyDict>>,
        springs: Vec<Sheet<'_>>,
        rests: bool,
        skins: Vec<Sheet<'_>>,
        hangs_in: Option<&Bound<'_, PyAny>>,
        record: bool,
        tolerance: f64,
        max_iterations: usize,
        threads: usize,
    ) -> PyResult<Self> {
        let mapped = |error: FemError| errors::from_fem(py, &error, None);
        let element = match element {
            "tet4" => Element::Tet4,
            "tet4-averaged" => Element::Tet4Averaged,
            "tet10" => Element::Tet10,
            other => {
                return Err(bad_choice(py, "element", "`tet4`, `tet4-averaged` or `tet10`", other));
            }
        };
        let mesh = super::mesh_of(py, nodes, tets)?;
        let skins: Vec<Skin> = skins
            .iter()
            .map(|(triangles, numbers)| {
                let triangles = triangles_of("skin triangles", triangles)?;
                let [thickness, young, poisson] = exactly(py, "skin", numbers)?;
                Ok(Skin { triangles, thickness, young, poisson })
            })
            .collect::<PyResult<_>>()?;
        let substance = Substance { law, element, points: [mesh.n_tets(), element.n_points()] };
        let material = substance.material(py, young, poisson, &skins)?;
        let springs: Vec<Springs> = springs
            .iter()
            .map(|(triangles, numbers)| {
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
            })
            .collect::<PyResult<_>>()?;
        let mut supports = Supports::new().hold(&nodes_of(py, "held_nodes", held_nodes)?);
        if rests {
            supports = springs.iter().fold(supports, Supports::rest_on);
        }
        let pads = pads
            .iter()
            .map(|nodes| Ok(Pad { nodes: nodes_of(py, "pads", nodes)? }))
            .collect::<PyResult<Vec<_>>>()?;
        let behaviour = behaviour_of(py, behaviour)?;
        let weight = View::<f64>::optional("hangs_in", hangs_in, &[&[Some(3)]])?;
        let weight = weight.and_then(|view| view.rows::<3>().first().copied());
        let settings = settings_of(py, tolerance, max_iterations, "auto", 0, threads)?;
        let cancel = Arc::new(AtomicBool::new(false));
        let watched = settings.clone().with_cancel(cancel.clone());
        let plan = Plan { mesh, element, supports, material, behaviour, pads, weight, record };
        let (own_springs, n_pads) = (springs.clone(), plan.pads.len());
        let work = move || plan.build(own_springs, &watched);
        let (rig, hung, sizes) =
            lock::run_watched(py, &cancel, |_| Ok(()), work)?.map_err(mapped)?;
        let sizes = Sizes { pads: n_pads, ..sizes };
        Ok(Self { rig: Arc::new(Mutex::new(rig)), springs, skins, hung, settings, sizes })
    }

    /// Equilibrium of the next frame. Rows of NaN in `motions` are pads that are absent; `change` is the change of the
    /// displacement since the last frame that is expected.
    #[pyo3(signature = (time, motions, *, forces=None, body_force=None, prescribed=None, change=None))]
    #[allow(clippy::too_many_arguments)] // keywords in Python
    fn advance(
        &self,
        py: Python<'_>,
        time: f64,
        motions: &Bound<'_, PyAny>,
        forces: Option<&Bound<'_, PyAny>>,
        body_force: Option<&Bound<'_, PyAny>>,
        prescribed: Option<&Bound<'_, PyAny>>,
        change: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<RigFrame> {
        let Sizes { nodes, corners, held, pads, .. } = self.sizes;
        let three = Some(3);
        let motions = View::<f64>::new("motions", motions, &[&[Some(pads), three]])?;
        let shapes: [&[Option<usize>]; 2] = [&[Some(nodes), three], &[Some(corners), three]];
        let forces = View::<f64>::optional("forces", forces, &shapes)?;
        let body_force = View::<f64>::optional("body_force", body_force, &[&[three]])?;
        let prescribed = View::<f64>::optional("prescribed", prescribed, &[&[Some(held), three]])?;
        let change = View::<f64>::optional("change", change, &[&[Some(nodes), three]])?;
        let change = change.map(|rows| rows.rows::<3>().to_vec());
        let load = Load {
            nodal_forces: forces.map(|rows| rows.rows::<3>().to_vec()),
            body_force: body_force.and_then(|v| v.rows().first().copied()).unwrap_or_default(),
            prescribed: prescribed.map(|rows| rows.rows::<3>().to_vec()),
            springs: self.springs.clone(),
        };
        let absent = |row: &[f64; 3]| row.iter().all(|v| v.is_nan());
        let motions: Vec<Option<[f64; 3]>> =
            motions.rows::<3>().iter().map(|row| (!absent(row)).then_some(*row)).collect();
        let cancel = Arc::new(AtomicBool::new(false));
        let settings = self.settings.clone().with_cancel(cancel.clone());
        let rig = self.rig.clone();
        let work = move || {
            let mut rig = rig.lock().unwrap_or_else(PoisonError::into_inner);
            rig.advance_by(&load, &motions, change.as_deref(), time, &settings)
        };
        let frame = lock::run_watched(py, &cancel, |_| Ok(()), work)?;
        let frame = frame.map_err(|error| errors::from_fem(py, &error, None))?;
        RigFrame::new(py, frame, &self.hung, self.settings.tolerance)
    }

    /// The same rig at its beginning with another material; analyses and factors are shared. Not of a rig that hangs in
    /// its weight, whose unloaded shape depends on the material.
    #[pyo3(signature = (young, poisson, *, law=None, behaviour=None))]
    fn again(
        &self,
        py: Python<'_>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        law: Option<&Law>,
        behaviour: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let mapped = |error: FemError| errors::from_fem(py, &error, None);
        if !self.hung.is_empty() {
            return Err(bad_choice(
                py,
                "rig",
                "one that does not hang in its weight",
                "a hung one",
            ));
        }
        let Sizes { element, points, .. } = self.sizes;
        let substance = Substance { law, element, points };
        let material = substance.material(py, young, poisson, &self.skins)?;
        let behaviour = behaviour_of(py, behaviour)?;
        let rig = self.rig.clone();
        let made = py
            .detach(move || {
                let rig = rig.lock().unwrap_or_else(PoisonError::into_inner);
                rig.afresh(material, behaviour)
            })
            .map_err(mapped)?;
        Ok(Self {
            rig: Arc::new(Mutex::new(made)),
            springs: self.springs.clone(),
            skins: self.skins.clone(),
            hung: Vec::new(),
            settings: self.settings.clone(),
            sizes: self.sizes,
        })
    }

    /// Derivatives of all frames that were found by each cause: displacement, float64 (n_causes, n_frames, n_nodes, 3) mm,
    /// reactions, (n_causes, n_frames, h, 3) mN, and forces of the pads, (n_causes, n_frames, n_pads, 3) mN, NaN where
    /// absent.
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        causes: Vec<PyRef<'py, Cause>>,
    ) -> PyResult<(Frames<'py>, Frames<'py>, Frames<'py>)> {
        let causes: Vec<FrameCause> = causes.iter().map(|cause| cause.0.clone()).collect();
        let n = causes.len();
        let found = self.call(py, move |rig, settings| {
            let n_frames = rig.n_recorded_frames();
            rig.derivatives(&causes, settings).map(|found| (found, n_frames))
        })?;
        let (found, n_frames) = found;
        let Sizes { nodes, held, pads, .. } = self.sizes;
        let (mut displacement, mut reactions, mut forces) = (Vec::new(), Vec::new(), Vec::new());
        for frame in found.into_iter().flatten() {
            displacement.extend(frame.displacement.into_flattened());
            reactions.extend(frame.reactions.into_flattened());
            forces.extend(frame.pads.iter().flat_map(|pad| pad.unwrap_or([f64::NAN; 3])));
        }
        Ok((
            arrays::from_vec(py, displacement, [n, n_frames, nodes, 3])?,
            arrays::from_vec(py, reactions, [n, n_frames, held, 3])?,
            arrays::from_vec(py, forces, [n, n_frames, pads, 3])?,
        ))
    }

    /// Derivatives of observations of frames by Young's modulus and Poisson's ratio of every quadrature point, two float64
    /// (n_obs, n_tets, n_points). Each is the number of its frame and three pairs of numbers and weights (k, 3): of nodes,
    /// of held nodes, and of pads.
    fn adjoints<'py>(
        &self,
        py: Python<'py>,
        observations: Vec<(usize, Pair<'py>, Pair<'py>, Pair<'py>)>,
    ) -> PyResult<(Stack<'py>, Stack<'py>)> {
        let observations = observations
            .iter()
            .map(|(frame, nodes, held, pads)| {
                Ok(FrameObservation {
                    frame: *frame,
                    observation: Observation {
                        displacement: weights_of(py, ["nodes", "weights"], &nodes.0, &nodes.1)?,
                        reactions: weights_of(
                            py,
                            ["held_nodes", "held_weights"],
                            &held.0,
                            &held.1,
                        )?,
                    },
                    pads: weights_of(py, ["pads", "pad_weights"], &pads.0, &pads.1)?,
                })
            })
            .collect::<PyResult<Vec<_>>>()?;
        let [tets, points] = self.sizes.points;
        let shape = [observations.len(), tets, points];
        let found = self.call(py, move |rig, settings| rig.adjoints(&observations, settings))?;
        let gathered = |pick: fn(&FrameAdjoint) -> &Vec<f64>| {
            let values = found.iter().flat_map(pick).copied().collect();
            arrays::from_vec(py, values, shape)
        };
        Ok((gathered(|one| &one.young)?, gathered(|one| &one.poisson)?))
    }

    /// Places of all nodes of the unloaded body, float64 (n_nodes, 3), mm.
    #[getter]
    fn rest_nodes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let rig = self.rig.clone();
        let nodes = py.detach(move || {
            rig.lock().unwrap_or_else(PoisonError::into_inner).body().nodes().to_vec()
        });
        arrays::from_points(py, nodes)
    }

    fn __repr__(&self) -> String {
        let Sizes { nodes, held, pads, .. } = self.sizes;
        format!("Rig(n_nodes={nodes}, n_held={held}, n_pads={pads})")
    }
}

/// Rows of every frame for every cause.
type Frames<'py> = Bound<'py, PyArray4<f64>>;

/// Numbers and weights.
type Pair<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);

impl Rig {
    /// Run a call that Ctrl-C ends and that leaves the rig as it is.
    fn call<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&tissuereg_fem::Rig, &SolveSettings) -> Result<T, FemError> + Send + 'static,
    ) -> PyResult<T> {
        let cancel = Arc::new(AtomicBool::new(false));
        let settings = self.settings.clone().with_cancel(cancel.clone());
        let rig = self.rig.clone();
        let watched = move || work(&rig.lock().unwrap_or_else(PoisonError::into_inner), &settings);
        lock::run_watched(py, &cancel, |_| Ok(()), watched)?
            .map_err(|error| errors::from_fem(py, &error, None))
    }
}

/// Input of a rig's material other than its moduli.
struct Substance<'a> {
    law: Option<&'a Law>,
    element: Element,
    /// Tets and quadrature points of each.
    points: [usize; 2],
}

impl Substance<'_> {
    /// The material with skins; warns where its elements lock.
    fn material(
        &self,
        py: Python<'_>,
        young: &Bound<'_, PyAny>,
        poisson: &Bound<'_, PyAny>,
        skins: &[Skin],
    ) -> PyResult<Material> {
        let mapped = |error: FemError| errors::from_fem(py, &error, None);
        let [tets, points] = self.points;
        let moduli: [&[Option<usize>]; 3] =
            [&[Some(1)], &[Some(tets)], &[Some(tets), Some(points)]];
        let young = View::<f64>::new("young", young, &moduli)?;
        let poisson = View::<f64>::new("poisson", poisson, &moduli)?;
        let mut material = self
            .law
            .map_or(&Law::default(), |law| law)
            .material(self.element, tets, young.slice(), poisson.slice())
            .map_err(mapped)?;
        errors::warn_of_locking(py, self.element, [&material].into_iter(), poisson.slice())?;
        for skin in skins {
            material = material.with_skin(skin.clone()).map_err(mapped)?;
        }
        Ok(material)
    }
}

/// What a rig is made of.
struct Plan {
    mesh: Mesh,
    element: Element,
    supports: Supports,
    material: Material,
    behaviour: Behaviour,
    pads: Vec<Pad>,
    weight: Option<[f64; 3]>,
    record: bool,
}

impl Plan {
    fn build(
        self,
        springs: Vec<Springs>,
        settings: &SolveSettings,
    ) -> Result<(tissuereg_fem::Rig, Vec<[f64; 3]>, Sizes), FemError> {
        let mut body = Body::new(self.mesh, self.element, self.supports)?;
        let mut hung = Vec::new();
        if let Some(body_force) = self.weight {
            let load = Load { body_force, springs, ..Load::default() };
            let rest = tissuereg_fem::rest_shape(&body, &self.material, &load, settings)?;
            let places = body.nodes().iter().zip(rest.body.nodes());
            hung = places.map(|(x, r)| std::array::from_fn(|i| x[i] - r[i])).collect();
            body = rest.body;
        }
        let sizes = Sizes {
            element: body.element(),
            nodes: body.n_nodes(),
            corners: body.n_corner_nodes(),
            held: body.held_nodes().len(),
            points: [body.n_tets(), body.element().n_points()],
            pads: 0,
        };
        let make = if self.record { History::recorded } else { History::new };
        let history = make(&body, self.material, self.behaviour)?;
        Ok((tissuereg_fem::Rig::new(body, history, self.pads)?, hung, sizes))
    }
}

/// One frame of a rig.
#[pyclass(frozen, module = "tissuereg._core")]
pub(crate) struct RigFrame {
    /// Displacement of all nodes from the mesh as given, float64 (n_nodes, 3), mm.
    #[pyo3(get)]
    displacement: Py<PyArray2<f64>>,
    /// Force of the support at each held node, float64 (h, 3), mN.
    #[pyo3(get)]
    reactions: Py<PyArray2<f64>>,
    /// Force of each pad on the body, float64 (n_pads, 3), mN; NaN where absent.
    #[pyo3(get)]
    pad_forces: Py<PyArray2<f64>>,
    /// Its moment about the mean place of the pad's nodes, float64 (n_pads, 3), mN mm; NaN where absent.
    #[pyo3(get)]
    pad_moments: Py<PyArray2<f64>>,
    /// Force of each set of springs on the body, float64 (n_springs, 3), mN.
    #[pyo3(get)]
    spring_forces: Py<PyArray2<f64>>,
    /// Work done.
    #[pyo3(get)]
    report: Py<PyDict>,
}

impl RigFrame {
    fn new(
        py: Python<'_>,
        frame: tissuereg_fem::RigFrame,
        hung: &[[f64; 3]],
        tolerance: f64,
    ) -> PyResult<Self> {
        let mut solution = frame.solution;
        for (row, hung) in solution.displacement.iter_mut().zip(hung) {
            for i in 0..3 {
                row[i] -= hung[i];
            }
        }
        let absent = Resultant { force: [f64::NAN; 3], moment: [f64::NAN; 3] };
        let pads: Vec<Resultant> = frame.pads.iter().map(|pad| pad.unwrap_or(absent)).collect();
        let sum = |rows: &Vec<[f64; 3]>| -> [f64; 3] {
            std::array::from_fn(|i| rows.iter().map(|row| row[i]).sum())
        };
        let points = |rows: Vec<[f64; 3]>| arrays::from_points(py, rows).map(Bound::unbind);
        Ok(Self {
            displacement: points(solution.displacement)?,
            reactions: points(solution.reactions)?,
            pad_forces: points(pads.iter().map(|pad| pad.force).collect())?,
            pad_moments: points(pads.iter().map(|pad| pad.moment).collect())?,
            spring_forces: points(solution.spring_forces.iter().map(sum).collect())?,
            report: report::of_solve(py, &solution.report, tolerance)?.unbind(),
        })
    }
}

#[pymethods]
impl RigFrame {
    fn __repr__(&self, py: Python<'_>) -> String {
        let [n, p] = [&self.displacement, &self.pad_forces].map(|a| rows_of(a.bind(py)));
        format!("RigFrame(n_nodes={n}, n_pads={p})")
    }
}

fn rows_of(array: &Bound<'_, PyArray2<f64>>) -> usize {
    use numpy::PyUntypedArrayMethods;
    array.shape()[0]
}

fn nodes_of(py: Python<'_>, name: &str, nodes: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    let view = View::<i64>::new(name, nodes, &[&[None]])?;
    Ok(view.indices::<1>(py, name, Class::Support)?.into_flattened())
}

pub(super) fn triangles_of(name: &str, triangles: &Bound<'_, PyAny>) -> PyResult<Vec<[usize; 3]>> {
    let view = View::<i64>::new(name, triangles, &[&[None, Some(3)]])?;
    view.indices::<3>(triangles.py(), name, Class::Load)
}

/// As many numbers as are wanted.
pub(super) fn exactly<const N: usize>(
    py: Python<'_>,
    name: &str,
    numbers: &[f64],
) -> PyResult<[f64; N]> {
    numbers.try_into().map_err(|_| {
        let message = format!("`{name}` must have {N} numbers a set, got {}", numbers.len());
        errors::raise(py, Class::Shape, &message, Some(name))
    })
}

/// A behaviour from its dictionary, in which what is absent does nothing.
fn behaviour_of(py: Python<'_>, given: Option<&Bound<'_, PyDict>>) -> PyResult<Behaviour> {
    let mut behaviour = Behaviour::default();
    for (key, value) in given.into_iter().flatten() {
        match key.extract::<String>()?.as_str() {
            "relaxation" => {
                let (g, tau_s, part): (Vec<f64>, Vec<f64>, String) = value.extract()?;
                let part = match part.as_str() {
                    "whole" => Part::Whole,
                    "isochoric" => Part::Isochoric,
                    other => return Err(bad_choice(py, "part", "`whole` or `isochoric`", other)),
                };
                behaviour.relaxation = Some(Relaxation { g, tau_s, part });
            }
            "viscosity_kpa_s" => behaviour.viscosity_kpa_s = value.extract()?,
            "softening" => {
                let (form, r, m_kpa, beta): (String, _, _, _) = value.extract()?;
                let form = match form.as_str() {
                    "ogden-roxburgh" => SofteningForm::OgdenRoxburgh,
                    "damage" => SofteningForm::Damage,
                    other => {
                        return Err(bad_choice(
                            py,
                            "softening",
                            "`ogden-roxburgh` or `damage`",
                            other,
                        ));
                    }
                };
                behaviour.softening = Some(Softening { form, r, m_kpa, beta });
            }
            "set" => behaviour.set = Some(Set { fraction: value.extract()? }),
            "drainage" => {
                let (share, tau_s) = value.extract()?;
                behaviour.drainage = Some(Drainage { share, tau_s });
            }
            "swelling" => {
                let (linear_strain, from_time_s, to_time_s) = value.extract()?;
                behaviour.swelling = Some(Swelling { linear_strain, from_time_s, to_time_s });
            }
            other => return Err(bad_choice(py, "behaviour", "known", other)),
        }
    }
    Ok(behaviour)
}
