//! Pads that are bonded to a body for some frames and released again.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::run::{Given, History};
use crate::body::Body;
use crate::check::{check_finite, check_length};
use crate::error::FemError;
use crate::load::Load;
use crate::material::Material;
use crate::memory::Behaviour;
use crate::resultant::{Resultant, resultant};
use crate::solve::{Solution, SolveSettings};

/// A patch of nodes that an actuator may hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Pad {
    /// Its corner nodes. Those that the body's own supports hold stay with these.
    pub nodes: Vec<usize>,
}

/// A body with its history and pads that come and go.
///
/// A pad is bonded to the shape that the body has when it comes: in its first frame, without it.
/// From there its nodes move with it, by a translation; in a frame without motion it is gone and
/// they are free.
///
/// # Examples
///
/// ```
/// use tissuereg_fem::{Behaviour, Body, Element, History, Load, Material, Mesh, Pad, Rig};
/// use tissuereg_fem::SolveSettings;
///
/// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
/// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
/// let history = History::new(&body, Material::neo_hookean(10.0, 0.4)?, Behaviour::default())?;
/// let mut rig = Rig::new(body, history, vec![Pad { nodes: vec![3] }])?;
/// let (nothing, settings) = (Load::default(), SolveSettings::default());
/// let pushed = rig.advance(&nothing, &[Some([0.0, 0.0, -1.0])], 0.0, &settings)?;
/// assert!(pushed.pads[0].is_some_and(|force| force.force[2] < 0.0));
/// let free = rig.advance(&nothing, &[None], 1.0, &settings)?;
/// assert!(free.solution.displacement[3][2].abs() < 1e-8);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
#[derive(Debug)]
pub struct Rig {
    body: Arc<Body>,
    history: History,
    /// Nodes of each pad that the body's supports leave free.
    pads: Vec<Vec<usize>>,
    /// Nodes in the middle of edges within each pad, where elements have such.
    middles: Vec<Vec<usize>>,
    /// Displacement of each pad's nodes and middles when it was bonded, mm; none where it is gone.
    bonded: Vec<Option<Vec<[f64; 3]>>>,
    /// Bodies by the pads that are present, shared with the rigs that were made from this one.
    bodies: Arc<Mutex<BTreeMap<Vec<bool>, Arc<Body>>>>,
}

/// One frame of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigFrame {
    /// Equilibrium; reactions are those of the body's own held nodes, in their order.
    pub solution: Solution,
    /// Force of each pad on the body, and its moment about the mean place of the pad's corner nodes;
    /// none where the pad is gone. Middles of edges count as if half way between their ends.
    pub pads: Vec<Option<Resultant>>,
}

impl Rig {
    /// A body with its history and pads, none of them bonded yet.
    ///
    /// # Errors
    ///
    /// [`FemError::HeldNodeOutOfRange`], [`FemError::HeldNodeRepeated`] within a pad.
    pub fn new(
        body: impl Into<Arc<Body>>,
        history: History,
        pads: Vec<Pad>,
    ) -> Result<Self, FemError> {
        let body = body.into();
        let mut held = vec![false; body.n_corner_nodes()];
        body.held_nodes().iter().for_each(|&node| held[node] = true);
        let mut free = Vec::with_capacity(pads.len());
        for pad in pads {
            let mut seen = held.clone();
            let mut nodes = Vec::with_capacity(pad.nodes.len());
            for node in pad.nodes {
                let n_nodes = seen.len();
                let Some(taken) = seen.get_mut(node) else {
                    return Err(FemError::HeldNodeOutOfRange { node, n_nodes });
                };
                if !std::mem::replace(taken, true) {
                    nodes.push(node);
                } else if !held[node] {
                    return Err(FemError::HeldNodeRepeated { node });
                }
            }
            free.push(nodes);
        }
        let middles = free.iter().map(|nodes| middles_of(&body, nodes)).collect();
        let bonded = vec![None; free.len()];
        Ok(Self { body, history, pads: free, middles, bonded, bodies: Arc::default() })
    }

    /// The same rig at its beginning, with another material and behaviour.
    ///
    /// Bodies, their analyses and factors are shared: for many histories of one rig.
    ///
    /// # Errors
    ///
    /// As [`History::new`].
    pub fn afresh(&self, material: Material, behaviour: Behaviour) -> Result<Self, FemError> {
        Ok(Self {
            body: Arc::clone(&self.body),
            history: History::new(&self.body, material, behaviour)?,
            pads: self.pads.clone(),
            middles: self.middles.clone(),
            bonded: vec![None; self.pads.len()],
            bodies: Arc::clone(&self.bodies),
        })
    }

    /// The body with its own supports.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// The history so far.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// Go to the equilibrium of a next frame.
    ///
    /// The frame in which a pad comes is solved twice: at its time without the pad, which gives the
    /// shape that it is bonded to, and then, at once, with the pad's motion. Where the body cannot
    /// stand without the pad, it is bonded to the shape of the last frame.
    ///
    /// # Shapes
    ///
    /// `motions` one entry per pad: its translation since it was bonded, mm, or none where it is gone.
    /// Prescribed displacements of `load` are those of the body's own held nodes.
    ///
    /// # Errors
    ///
    /// As [`History::advance`]; [`FemError::Unconstrained`] where pads are gone that the body needs;
    /// [`FemError::HeldNodeRepeated`] where two pads that are present share a node. The rig is then
    /// left as it was.
    pub fn advance(
        &mut self,
        load: &Load,
        motions: &[Option<[f64; 3]>],
        time_s: f64,
        settings: &SolveSettings,
    ) -> Result<RigFrame, FemError> {
        self.advance_by(load, motions, None, time_s, settings)
    }

    /// The same with the change of the displacement since the last frame that is expected, as a
    /// similar body showed it: one row per node of the body, mm.
    ///
    /// The search begins there, and where that leads nowhere as without it. A good guess saves most
    /// iterations; what is found is the same up to the tolerance.
    ///
    /// # Errors
    ///
    /// As [`Rig::advance`], and [`FemError::WrongLength`] and [`FemError::NonFinite`] for `change`.
    pub fn advance_by(
        &mut self,
        load: &Load,
        motions: &[Option<[f64; 3]>],
        change: Option<&[[f64; 3]]>,
        time_s: f64,
        settings: &SolveSettings,
    ) -> Result<RigFrame, FemError> {
        check_length("motions (one a pad)", self.pads.len(), motions.len())?;
        let given: Vec<[f64; 3]> = motions.iter().map(|m| m.unwrap_or_default()).collect();
        check_finite("motion of a pad", &given)?;
        let guess = change.map(|rows| self.after(rows)).transpose()?;
        let mut history = self.history.branch();
        let mut bonded = self.bonded.clone();
        let mut comes = false;
        for (place, motion) in bonded.iter_mut().zip(motions) {
            match motion {
                None => *place = None,
                Some(_) => comes |= place.is_none(),
            }
        }
        if comes {
            if history.time_s().is_some() || acts(load, &history, time_s) {
                match self.settle(&mut history, &bonded, load, (&given, None), time_s, settings) {
                    Ok(_) | Err(FemError::Unconstrained(_)) => {}
                    Err(error) => return Err(error),
                }
            }
            let shape = history.displacement();
            for (pad, (place, motion)) in bonded.iter_mut().zip(motions).enumerate() {
                if motion.is_some() {
                    let nodes = self.pads[pad].iter().chain(&self.middles[pad]);
                    place.get_or_insert_with(|| nodes.map(|&n| shape[n]).collect());
                }
            }
        }
        let solution =
            self.settle(&mut history, &bonded, load, (&given, guess), time_s, settings)?;
        self.history.go_on_as(history);
        self.bonded = bonded;
        Ok(self.frame(solution))
    }

    /// The displacement of the last frame and a change, flat, mm.
    fn after(&self, change: &[[f64; 3]]) -> Result<Vec<f64>, FemError> {
        check_length("change (one row a node)", self.body.n_nodes(), change.len())?;
        check_finite("change", change)?;
        let before = self.history.displacement().as_flattened();
        Ok(before.iter().zip(change.as_flattened()).map(|(u, du)| u + du).collect())
    }

    /// One frame with the pads that are bonded; motions and the displacement that is expected.
    fn settle(
        &self,
        history: &mut History,
        bonded: &[Option<Vec<[f64; 3]>>],
        load: &Load,
        (motions, guess): (&[[f64; 3]], Option<Vec<f64>>),
        time_s: f64,
        settings: &SolveSettings,
    ) -> Result<Solution, FemError> {
        let n_own = self.body.held_nodes().len();
        let rows = match &load.prescribed {
            Some(rows) => {
                check_length("prescribed displacements (one row a held node)", n_own, rows.len())?;
                rows.clone()
            }
            None => vec![[0.0; 3]; n_own],
        };
        let present: Vec<bool> = bonded.iter().map(Option::is_some).collect();
        if !present.contains(&true) {
            let given = Given { guess, ..Given::default() };
            return history.advance_held(&self.body, load, given, time_s, settings);
        }
        let body = &*self.with_pads(present)?;
        let moved = |(rows, motion): (&Option<Vec<[f64; 3]>>, &[f64; 3])| {
            let place = |row: &[f64; 3]| std::array::from_fn(|i| row[i] + motion[i]);
            rows.as_ref().map(|rows| rows.iter().map(place).collect())
        };
        let places: Vec<Option<Vec<[f64; 3]>>> = bonded.iter().zip(motions).map(moved).collect();
        for place in places.iter().flatten() {
            check_finite("prescribed displacements", place)?;
        }
        check_finite("prescribed displacements", &rows)?;
        let prescribed = self.held_displacement(body, rows, &places);
        let load = Load { prescribed: None, ..load.clone() };
        let given = Given { prescribed: Some(prescribed), guess };
        history.advance_held(body, &load, given, time_s, settings)
    }

    /// The body held by the pads that are present, kept for all rigs that share it.
    fn with_pads(&self, present: Vec<bool>) -> Result<Arc<Body>, FemError> {
        let bodies = || self.bodies.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(body) = bodies().get(&present) {
            return Ok(Arc::clone(body));
        }
        let mut supports = self.body.supports().clone();
        for (nodes, _) in self.pads.iter().zip(&present).filter(|(_, there)| **there) {
            supports = supports.hold(nodes);
        }
        // Not under the lock: a thread that waits for its share of the analysis may take up another rig meanwhile.
        let body = Arc::new(self.body.with_supports(supports)?);
        Ok(Arc::clone(bodies().entry(present).or_insert(body)))
    }

    /// Displacement of all nodes, flat, from that of the body's own held nodes and of the nodes and
    /// middles of all pads that are present; zero where free. It is linear in both.
    fn held_displacement(
        &self,
        body: &Body,
        mut rows: Vec<[f64; 3]>,
        places: &[Option<Vec<[f64; 3]>>],
    ) -> Vec<f64> {
        for (place, nodes) in places.iter().zip(&self.pads) {
            rows.extend(place.iter().flatten().take(nodes.len()));
        }
        let mut all = body.held_displacement(&rows);
        // Middles keep the curvature that their edges had.
        for (pad, place) in places.iter().enumerate() {
            let middles = place.iter().flatten().skip(self.pads[pad].len());
            for (&node, row) in self.middles[pad].iter().zip(middles) {
                for i in (0..3).filter(|&i| body.held()[node][i]) {
                    all[3 * node + i] = row[i];
                }
            }
        }
        all
    }

    /// Tell the reactions of supports and pads apart.
    fn frame(&self, mut solution: Solution) -> RigFrame {
        let pad_rows = solution.reactions.split_off(self.body.held_nodes().len());
        let mut left = pad_rows.as_slice();
        let mut pads = Vec::with_capacity(self.pads.len());
        for (nodes, bonded) in self.pads.iter().zip(&self.bonded) {
            if bonded.is_none() {
                pads.push(None);
                continue;
            }
            let (own, rest) = left.split_at(nodes.len());
            left = rest;
            let places: Vec<[f64; 3]> = nodes
                .iter()
                .map(|&n| {
                    let (x, u) = (self.body.nodes()[n], solution.displacement[n]);
                    std::array::from_fn(|i| x[i] + u[i])
                })
                .collect();
            pads.push(Some(resultant(&places, own, mean(&places))));
        }
        RigFrame { solution, pads }
    }
}

/// Nodes in the middle of edges both of whose ends are among `nodes`.
fn middles_of(body: &Body, nodes: &[usize]) -> Vec<usize> {
    let mut inside = vec![false; body.n_corner_nodes()];
    nodes.iter().for_each(|&node| inside[node] = true);
    let edges = body.mid_edges().iter().enumerate();
    edges
        .filter(|(_, [a, b])| inside[*a] && inside[*b])
        .map(|(edge, _)| body.n_corner_nodes() + edge)
        .collect()
}

/// Whether anything can deform the body before the first pad comes.
fn acts(load: &Load, history: &History, time_s: f64) -> bool {
    let swells = history.behaviour().swelling.is_some_and(|s| s.stretch(time_s) != 1.0);
    let nothing = Load { springs: load.springs.clone(), ..Load::default() };
    swells || *load != nothing
}

fn mean(places: &[[f64; 3]]) -> [f64; 3] {
    let n = places.len().max(1) as f64;
    std::array::from_fn(|i| places.iter().map(|x| x[i]).sum::<f64>() / n)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used)]

    use super::*;
    use crate::element::Element;
    use crate::memory::Relaxation;
    use crate::mesh::Mesh;

    fn rig() -> Rig {
        let nodes =
            vec![[0.0; 3], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 9.0], [9.0, 9.0, 9.0]];
        let mesh = Mesh::new(nodes, vec![[0, 1, 2, 3], [1, 2, 3, 4]]).expect("sound");
        let body = Body::new(mesh, Element::Tet4, [0, 1, 2]).expect("held");
        let relaxation = Relaxation { g: vec![0.4], tau_s: vec![2.0], ..Relaxation::default() };
        let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
        let law = Material::neo_hookean(10.0, 0.4).expect("sound");
        let history = History::new(&body, law, behaviour).expect("sound");
        Rig::new(body, history, vec![Pad { nodes: vec![3] }, Pad { nodes: vec![4] }])
            .expect("sound")
    }

    fn push(rig: &mut Rig, down: [Option<f64>; 2], time_s: f64) -> Result<RigFrame, FemError> {
        let motions = down.map(|z| z.map(|z| [0.0, 0.0, z]));
        rig.advance(&Load::default(), &motions, time_s, &SolveSettings::default())
    }

    #[test]
    fn rigs_made_from_each_other_analyse_a_body_once() {
        let first = rig();
        let again = || {
            let material = Material::neo_hookean(10.0, 0.4).expect("sound");
            first.afresh(material, first.history.behaviour().clone()).expect("sound")
        };
        let (mut one, mut two) = (again(), again());
        push(&mut one, [Some(-0.5), None], 0.0).expect("stands");
        push(&mut two, [None, Some(-0.5)], 0.0).expect("stands");
        let (one, two) = (again(), again());
        for present in [[true, false], [false, true]] {
            let [a, b] = [&one, &two].map(|rig| rig.with_pads(present.to_vec()).expect("held"));
            assert!(Arc::ptr_eq(&a, &b));
        }
        assert_eq!(first.bodies.lock().expect("whole").len(), 2);
    }

    #[test]
    fn states_take_turns_in_two_rooms() {
        let mut rig = rig();
        for k in 0..2 {
            push(&mut rig, [Some(-0.1 * f64::from(k)), None], f64::from(k)).expect("stands");
        }
        for k in 2..5 {
            let [_, spare] = rig.history.rooms();
            push(&mut rig, [Some(-0.1 * f64::from(k)), None], f64::from(k)).expect("stands");
            assert_eq!(rig.history.rooms()[0], spare);
        }
    }

    #[test]
    fn a_frame_that_fails_leaves_the_rig_as_it_was() {
        let (mut tried, mut other) = (rig(), rig());
        for rig in [&mut tried, &mut other] {
            push(rig, [Some(-0.5), None], 0.0).expect("stands");
        }
        assert!(push(&mut tried, [Some(-40.0), None], 1.0).is_err());
        let [after, alone] = [&mut tried, &mut other].map(|rig| push(rig, [Some(-1.0), None], 2.0));
        assert_eq!(after.expect("stands").pads, alone.expect("stands").pads);
    }
}
