//! Observations of frames, backwards through all steps.

use std::collections::BTreeMap;

use super::super::adjoint::Observation;
use super::super::factored::Buffers;
use super::super::rates::Tangent;
use super::step::{Arrived, inverted, recorded};
use crate::assembly::point_volumes;
use crate::error::FemError;
use crate::history::{Backward, Phase, Rig, StepRecord};
use crate::material::Matrix3;
use crate::solve::SolveSettings;

/// A scalar observation of one frame of a rig.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameObservation {
    /// Number of the frame.
    pub frame: usize,
    /// Weights of displacements, and of reactions of the body's own held nodes.
    pub observation: Observation,
    /// Weights of the forces of pads, by their number.
    pub pads: Vec<(usize, [f64; 3])>,
}

/// Derivatives of an observation of a frame by the stiffness of all points.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameAdjoint {
    /// By Young's modulus of every quadrature point (`n_tets * n_points`), per kPa.
    pub young: Vec<f64>,
    /// By Poisson's ratio of every quadrature point.
    pub poisson: Vec<f64>,
}

/// Memory of points that is carried back at once, numbers.
const CARRIED: usize = 1 << 25;

impl Rig {
    /// Derivatives of observations of frames by the stiffness of every point, through all frames
    /// before them.
    ///
    /// The history must have been made by [`History::recorded`](crate::History::recorded). Of the
    /// settings, threads and the cancel flag count.
    ///
    /// # Errors
    ///
    /// [`FemError::NothingRecorded`]; [`FemError::BadParameter`] for a frame that is not there,
    /// [`FemError::BadObservation`] for a node that does not exist or is not held, also where a pad is
    /// gone; [`FemError::NotInEquilibrium`] and [`FemError::NotStable`] for a step that has no
    /// derivative.
    ///
    /// # Cost
    ///
    /// One factorisation a step; two passes over the points, and a solution an observation and step.
    /// Many observations that remember much are carried back in several turns.
    ///
    /// # Examples
    ///
    /// ```
    /// use tissuereg_fem::{Behaviour, Body, Element, FrameObservation, History, Load, Material, Mesh};
    /// use tissuereg_fem::{Observation, Relaxation, Rig, SolveSettings};
    ///
    /// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    /// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2])?;
    /// let relaxation = Relaxation { g: vec![0.5], tau_s: vec![2.0], ..Relaxation::default() };
    /// let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
    /// let history = History::recorded(&body, Material::neo_hookean(10.0, 0.4)?, behaviour)?;
    /// let mut rig = Rig::new(body, history, vec![])?;
    /// let (weight, settings) = (Load { body_force: [0.0, 0.0, -1e-3], ..Load::default() }, SolveSettings::default());
    /// for time in [0.0, 1.0, 100.0] {
    ///     rig.advance(&weight, &[], time, &settings)?;
    /// }
    /// let tip = Observation::of_displacement([(3, [0.0, 0.0, 1.0])]);
    /// let at = |frame| FrameObservation { frame, observation: tip.clone(), pads: vec![] };
    /// let adjoints = rig.adjoints(&[at(0), at(2)], &settings)?;
    /// // Half of the stiffness remains: it sinks twice as far, and its derivative is twice as large.
    /// assert!((adjoints[1].young[0] / adjoints[0].young[0] - 2.0).abs() < 0.05);
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn adjoints(
        &self,
        observations: &[FrameObservation],
        settings: &SolveSettings,
    ) -> Result<Vec<FrameAdjoint>, FemError> {
        settings.check_cancel()?;
        let steps = recorded(self)?;
        let n_frames = self.n_recorded_frames();
        for FrameObservation { frame, pads, .. } in observations {
            if *frame >= n_frames {
                let (name, must) = ("frame", "the number of a recorded frame");
                return Err(FemError::BadParameter { name, must, found: *frame as f64 });
            }
            if let Some((pad, _)) = pads.iter().find(|(pad, _)| *pad >= self.n_pads()) {
                let (name, must) = ("pad", "the number of a pad");
                return Err(FemError::BadParameter { name, must, found: *pad as f64 });
            }
        }
        let n_points = self.body().n_tets() * self.body().element().n_points();
        let width = match self.history().behaviour().remembers() {
            true => steps.first().map_or(0, |step| step.memory_len()),
            false => 0,
        };
        let at_once = (CARRIED / (n_points * width).max(1)).max(1);
        settings.in_pool(|| {
            let mut found = Vec::with_capacity(observations.len());
            for some in observations.chunks(at_once) {
                let mut sweep = Sweep {
                    rig: self,
                    observations: some,
                    back: Backward::new(some.len(), n_points, width),
                    pending: vec![BTreeMap::new(); some.len()],
                };
                let last = some.iter().map(|one| one.frame).max().unwrap_or_default();
                for (phase, begin) in with_begins(self.phases()).into_iter().rev() {
                    if phase.frame > last {
                        continue;
                    }
                    for number in (begin + 1..=phase.end).rev() {
                        let step = &steps[number - 1];
                        sweep.step_back(step, number, phase, settings)?;
                    }
                }
                found.extend(sweep.adjoints());
            }
            Ok(found)
        })
    }
}

/// Phases with the number of steps before them.
fn with_begins(phases: &[Phase]) -> Vec<(&Phase, usize)> {
    let begins = std::iter::once(0).chain(phases.iter().map(|phase| phase.end));
    phases.iter().zip(begins).collect()
}

/// How far observations have been carried back.
struct Sweep<'a> {
    rig: &'a Rig,
    observations: &'a [FrameObservation],
    back: Backward,
    /// Of each observation: weights of the displacement after earlier steps, counted from 1.
    pending: Vec<BTreeMap<usize, Vec<f64>>>,
}

/// What one observation feels of one step.
struct Felt {
    /// Weights of `Ṗ` at all points.
    pulls: Vec<Matrix3>,
    /// Weights of the rates of held components, `(3 n_nodes)`.
    held: Vec<f64>,
}

impl Sweep<'_> {
    fn step_back(
        &mut self,
        step: &StepRecord,
        number: usize,
        phase: &Phase,
        settings: &SolveSettings,
    ) -> Result<(), FemError> {
        let arrived = Arrived::new(step, self.rig.history())?;
        let Arrived { substance, gradients, map, .. } = &arrived;
        let geometry = step.body.geometry();
        let volumes = point_volumes(geometry);
        let by_gradient = step
            .memory_back(*substance, gradients, &mut self.back)
            .ok_or_else(|| inverted(step))?;
        let is_felt = by_gradient.iter().any(|point| !point.is_empty());
        let is_end = phase.is_last && number == phase.end;
        let mut jobs = Vec::with_capacity(self.back.n);
        for (k, seen) in self.observations.iter().enumerate() {
            let mut weights = match is_end && seen.frame == phase.frame {
                true => self.spread(seen, step)?,
                false => (vec![0.0; step.displacement.len()], vec![0.0; step.displacement.len()]),
            };
            if let Some(later) = self.pending[k].remove(&number) {
                weights.0.iter_mut().zip(&later).for_each(|(sum, v)| *sum += v);
            }
            if is_felt {
                let felt = |(point, volume): (&Vec<Matrix3>, &f64)| {
                    let by = point.get(k).copied().unwrap_or_default();
                    by.map(|row| row.map(|v| v / volume))
                };
                let own: Vec<Matrix3> = by_gradient.iter().zip(&volumes).map(felt).collect();
                map.add_forces(geometry, &own, &mut weights.0);
            }
            jobs.push(weights);
        }
        let felt = arrived.with_tangent(settings, |tangent| {
            tangent.each(&jobs, |(by_node, by_held), buffers, parallel| {
                settings.check_cancel()?;
                let (v, held) = solve_back(tangent, by_node, by_held, buffers, parallel)?;
                let mut pulls = map.gradients(geometry, &v);
                for (pull, volume) in pulls.iter_mut().zip(&volumes) {
                    pull.as_flattened_mut().iter_mut().for_each(|x| *x *= volume);
                }
                Ok(Felt { pulls, held })
            })
        })?;
        let (pulls, held): (Vec<_>, Vec<_>) =
            felt.into_iter().map(|felt| (felt.pulls, felt.held)).unzip();
        step.stress_back(*substance, gradients, &pulls, &mut self.back)
            .ok_or_else(|| inverted(step))?;
        for (pending, held) in self.pending.iter_mut().zip(held) {
            hand_on(self.rig, phase, step, held, pending);
        }
        Ok(())
    }

    /// Weights of displacements and of the reactions of all held nodes, flat.
    fn spread(
        &self,
        seen: &FrameObservation,
        step: &StepRecord,
    ) -> Result<(Vec<f64>, Vec<f64>), FemError> {
        let mut whole = seen.observation.clone();
        for &(pad, weights) in &seen.pads {
            let (corners, _) = self.rig.pad_nodes(pad);
            whole.reactions.extend(corners.iter().map(|&node| (node, weights)));
        }
        whole.spread(&step.body)
    }

    fn adjoints(&self) -> Vec<FrameAdjoint> {
        let by = |k: usize, modulus: usize| {
            self.back.points.iter().map(|point| point.moduli[k][modulus]).collect()
        };
        (0..self.back.n).map(|k| FrameAdjoint { young: by(k, 0), poisson: by(k, 1) }).collect()
    }
}

/// `v`, and the weights of the rates of held components.
fn solve_back(
    tangent: &Tangent,
    by_node: &[f64],
    by_held: &[f64],
    buffers: &mut Buffers,
    parallel: bool,
) -> Result<(Vec<f64>, Vec<f64>), FemError> {
    let mut rhs = by_node.to_vec();
    if by_held.iter().any(|&v| v != 0.0) {
        for (sum, value) in rhs.iter_mut().zip(tangent.product(by_held)?) {
            *sum += value;
        }
    }
    let mut v = tangent.solve(&rhs, buffers, parallel)?;
    v.iter_mut().zip(by_held).for_each(|(sum, value)| *sum += value);
    let mut at_held = tangent.product(&v)?;
    let held = tangent.problem.body.held().as_flattened();
    for ((sum, value), is_held) in at_held.iter_mut().zip(by_node).zip(held) {
        *sum = if *is_held { *sum + value } else { 0.0 };
    }
    Ok((v, at_held))
}

/// Hand weights of held rates on to the earlier displacements that these are made of: the start of
/// the frame, and the shapes that pads were bonded to. The transpose of `Rig::held_displacement`.
fn hand_on(
    rig: &Rig,
    phase: &Phase,
    step: &StepRecord,
    mut held: Vec<f64>,
    pending: &mut BTreeMap<usize, Vec<f64>>,
) {
    let n = held.len();
    let later =
        |pending: &mut BTreeMap<usize, Vec<f64>>, number: usize, flat: usize, weight: f64| {
            if number > 0 {
                pending.entry(number).or_insert_with(|| vec![0.0; n])[flat] += weight;
            }
        };
    if step.part < 1.0 {
        for (flat, weight) in held.iter_mut().enumerate().filter(|(_, weight)| **weight != 0.0) {
            later(pending, step.from, flat, (1.0 - step.part) * *weight);
            *weight *= step.part;
        }
    }
    for (pad, bonded) in phase.bonded.iter().enumerate() {
        for &node in bonded.iter().flat_map(|_| rig.pad_nodes(pad).1) {
            for flat in 3 * node..3 * node + 3 {
                later(pending, bonded.unwrap_or_default(), flat, held[flat]);
                held[flat] = 0.0;
            }
        }
    }
    let rows = step.body.reactions(&held);
    let mut rows = rows.iter().skip(rig.body().held_nodes().len());
    for (pad, bonded) in phase.bonded.iter().enumerate() {
        for &node in bonded.iter().flat_map(|_| rig.pad_nodes(pad).0) {
            for (i, &weight) in rows.next().into_iter().flatten().enumerate() {
                later(pending, bonded.unwrap_or_default(), 3 * node + i, weight);
            }
        }
    }
}
