//! Frames along causes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rayon::prelude::*;

use super::super::cause::{Cause, Rates};
use super::super::rates::Derivative;
use super::followed::Followed;
use super::step::{Arrived, inverted, recorded};
use super::{FrameCause, FrameDerivative};
use crate::error::FemError;
use crate::history::{LANES, Moved, Phase, Rig, StepRecord};
use crate::load::{Load, NodalLoad, check_finite, check_length};
use crate::material::Matrix3;
use crate::solve::SolveSettings;

impl Rig {
    /// Derivatives of every recorded frame by each cause.
    ///
    /// The history must have been made by [`History::recorded`](crate::History::recorded).
    ///
    /// # Shapes
    ///
    /// One entry per cause, each with one per frame. Of the settings, threads and the cancel flag count.
    ///
    /// # Errors
    ///
    /// [`FemError::NothingRecorded`]; [`FemError::NoSuchCause`] for something that the model does not
    /// have; [`FemError::NotInEquilibrium`] and [`FemError::NotStable`] for a step that has no
    /// derivative; [`FemError::WrongLength`] and [`FemError::NonFinite`] for rates that do not fit.
    ///
    /// # Cost
    ///
    /// One factorisation a step; a solution and a few passes over the elements a cause and step.
    ///
    /// # Examples
    ///
    /// The derivative of the force of a stretched, relaxing body by the relaxing share:
    ///
    /// ```
    /// use tissuereg_fem::{Behaviour, BehaviourParameter, Body, Element, FrameCause, History, Load};
    /// use tissuereg_fem::{Material, Mesh, Relaxation, Rig, SolveSettings};
    ///
    /// let nodes = vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
    /// let body = Body::new(Mesh::new(nodes, vec![[0, 1, 2, 3]])?, Element::Tet4, [0, 1, 2, 3])?;
    /// let relaxation = Relaxation { g: vec![0.5], tau_s: vec![2.0], ..Relaxation::default() };
    /// let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
    /// let history = History::recorded(&body, Material::neo_hookean(10.0, 0.4)?, behaviour)?;
    /// let mut rig = Rig::new(body, history, vec![])?;
    ///
    /// let mut rows = vec![[0.0; 3]; 4];
    /// rows[3][2] = 1.0;
    /// let stretch = Load::from_prescribed(rows);
    /// let settings = SolveSettings::default();
    /// let first = rig.advance(&stretch, &[], 0.0, &settings)?.solution.reactions[3][2];
    /// rig.advance(&stretch, &[], 100.0, &settings)?;
    ///
    /// let share = FrameCause::Behaviour(BehaviourParameter::RelaxationShare(0));
    /// let frames = &rig.derivatives(&[share], &settings)?[0];
    /// assert_eq!(frames[0].reactions[3][2], 0.0);
    /// assert!((frames[1].reactions[3][2] / first + 1.0).abs() < 1e-12);
    /// # Ok::<(), tissuereg_fem::FemError>(())
    /// ```
    pub fn derivatives(
        &self,
        causes: &[FrameCause],
        settings: &SolveSettings,
    ) -> Result<Vec<Vec<FrameDerivative>>, FemError> {
        settings.check_cancel()?;
        let steps = recorded(self)?;
        settings.in_pool(|| {
            let causes: Vec<Followed> =
                causes.iter().map(|cause| Followed::new(self, cause)).collect::<Result<_, _>>()?;
            let mut sweeps = vec![Sweep::default(); causes.len()];
            let mut frames = vec![Vec::new(); causes.len()];
            let kept: BTreeSet<usize> = kept_steps(self.phases(), steps);
            let mut begin = 0;
            for phase in self.phases() {
                for (k, step) in steps.iter().enumerate().take(phase.end).skip(begin) {
                    let arrived = Arrived::new(step, self.history())?;
                    let is_end = phase.is_last && k + 1 == phase.end;
                    let pass = Pass {
                        rig: self,
                        phase,
                        arrived: &arrived,
                        is_kept: kept.contains(&(k + 1)),
                        number: k + 1,
                    };
                    let next = arrived.with_tangent(settings, |tangent| {
                        let points = pass.point_forces(&causes, &sweeps)?;
                        let jobs: Vec<_> = causes.iter().zip(&sweeps).zip(&points).collect();
                        let found = tangent.each(&jobs, |job, buffers, parallel| {
                            settings.check_cancel()?;
                            let ((cause, sweep), forces) = job;
                            let rates = pass.rates(cause, sweep, forces)?;
                            tangent.follow(&rates, buffers, parallel)
                        })?;
                        settings.check_cancel()?;
                        pass.go_on(&causes, &sweeps, found, is_end)
                    })?;
                    for (c, (sweep, frame)) in next.into_iter().enumerate() {
                        sweeps[c] = sweep;
                        frames[c].extend(frame);
                    }
                }
                begin = phase.end;
            }
            Ok(frames)
        })
    }
}

/// Steps whose end is looked back at, counted from 1.
fn kept_steps(phases: &[Phase], steps: &[Arc<StepRecord>]) -> BTreeSet<usize> {
    let bonded = phases.iter().flat_map(|phase| phase.bonded.iter().flatten().copied());
    bonded.chain(steps.iter().map(|step| step.from)).collect()
}

/// What of causes moves at the points.
fn moved_by<'a>(causes: &'a [Followed], sweeps: &'a [Sweep]) -> Vec<Moved<'a>> {
    causes.iter().zip(sweeps).map(|(cause, sweep)| cause.moved(&sweep.memory)).collect()
}

/// How far a cause has been followed.
#[derive(Debug, Clone, Default)]
struct Sweep {
    /// Rates of the memory; empty where nothing moves.
    memory: Vec<f64>,
    /// Rates of the forces at the end of the last frame, `(3 n_nodes)`; empty where they stay.
    force: Vec<f64>,
    /// Rates of the displacement after steps that are looked back at, counted from 1.
    displacement: BTreeMap<usize, Arc<Vec<f64>>>,
}

/// One step of a sweep.
struct Pass<'a> {
    rig: &'a Rig,
    phase: &'a Phase,
    arrived: &'a Arrived<'a>,
    is_kept: bool,
    /// Of the step, counted from 1.
    number: usize,
}

impl Pass<'_> {
    /// Nodal forces of `Ṗ` at fixed displacement, one per cause; empty where there are none.
    fn point_forces(
        &self,
        causes: &[Followed],
        sweeps: &[Sweep],
    ) -> Result<Vec<Vec<f64>>, FemError> {
        let Arrived { step, substance, gradients, map, .. } = self.arrived;
        let mut all = Vec::with_capacity(causes.len());
        for (causes, sweeps) in causes.chunks(LANES).zip(sweeps.chunks(LANES)) {
            let moved = moved_by(causes, sweeps);
            if moved.iter().all(Moved::is_nothing) {
                all.resize(all.len() + moved.len(), Vec::new());
                continue;
            }
            let stresses =
                step.stress_rates(*substance, gradients, &moved).ok_or_else(|| inverted(step))?;
            let force = |k: usize| {
                let own: Vec<Matrix3> = stresses.iter().map(|lanes| lanes[k]).collect();
                let mut force = vec![0.0; step.displacement.len()];
                map.add_forces(step.body.geometry(), &own, &mut force);
                force
            };
            all.extend((0..moved.len()).into_par_iter().map(force).collect::<Vec<_>>());
        }
        Ok(all)
    }

    /// Rates at fixed displacement, with the forces of the points.
    fn rates(&self, followed: &Followed, sweep: &Sweep, points: &[f64]) -> Result<Rates, FemError> {
        let mut unbalanced = match followed.cause {
            FrameCause::Always(
                cause @ (Cause::SpringNormal(_)
                | Cause::SpringTangential(_)
                | Cause::SkinYoung(_)
                | Cause::SkinThickness(_)),
            ) => self.arrived.surface_rates(cause)?,
            _ => vec![0.0; self.arrived.step.displacement.len()],
        };
        unbalanced.iter_mut().zip(points).for_each(|(sum, force)| *sum += force);
        for (sum, force) in unbalanced.iter_mut().zip(self.force(followed, sweep)?) {
            *sum -= force;
        }
        Ok(Rates { unbalanced, held: self.held(followed, sweep)? })
    }

    /// Rates of the forces at the end of the step; empty where they stay.
    fn force(&self, followed: &Followed, sweep: &Sweep) -> Result<Vec<f64>, FemError> {
        let step = self.arrived.step;
        let Some(load) = followed.load(self.phase.frame) else { return Ok(Vec::new()) };
        let alone = Load { prescribed: None, ..load.clone() };
        let mut force = NodalLoad::new(&step.body, &alone)?.force;
        if step.part < 1.0 {
            let before = sweep.force.iter().chain(std::iter::repeat(&0.0));
            for (rate, before) in force.iter_mut().zip(before) {
                *rate = before + step.part * (*rate - before);
            }
        }
        Ok(force)
    }

    /// Rates of held displacements; none where they stay.
    fn held(&self, followed: &Followed, sweep: &Sweep) -> Result<Option<Vec<f64>>, FemError> {
        let step = self.arrived.step;
        let n_held = self.rig.body().held_nodes().len();
        let rows = match followed.load(self.phase.frame).and_then(|load| load.prescribed.as_ref()) {
            None => vec![[0.0; 3]; n_held],
            Some(rows) => {
                check_length("prescribed displacements (one row a held node)", n_held, rows.len())?;
                check_finite("prescribed displacements", rows)?;
                rows.clone()
            }
        };
        let places: Vec<Option<Vec<[f64; 3]>>> = (0..self.rig.n_pads())
            .map(|pad| {
                let shape = sweep.displacement.get(&self.phase.bonded[pad]?);
                let motion = match followed.cause {
                    FrameCause::Motion { pad: own, rates } if *own == pad => {
                        rates[self.phase.frame]
                    }
                    _ => [0.0; 3],
                };
                let (corners, middles) = self.rig.pad_nodes(pad);
                let place = |&node: &usize| {
                    let at = |i: usize| shape.map_or(0.0, |shape| shape[3 * node + i]);
                    std::array::from_fn(|i| at(i) + motion[i])
                };
                Some(corners.iter().chain(middles).map(place).collect())
            })
            .collect();
        let mut held = self.rig.held_displacement(&step.body, rows, &places);
        if step.part < 1.0 {
            let start = sweep.displacement.get(&step.from);
            for (flat, &is_held) in step.body.held().as_flattened().iter().enumerate() {
                if is_held {
                    let before = start.map_or(0.0, |start| start[flat]);
                    held[flat] = before + step.part * (held[flat] - before);
                }
            }
        }
        Ok(held.iter().any(|&rate| rate != 0.0).then_some(held))
    }

    /// The sweeps after the step, and the derivatives of its frame if it ends one.
    fn go_on(
        &self,
        causes: &[Followed],
        sweeps: &[Sweep],
        found: Vec<(Vec<f64>, Derivative)>,
        is_end: bool,
    ) -> Result<Vec<(Sweep, Option<FrameDerivative>)>, FemError> {
        let memories = self.memories(causes, sweeps, &found)?;
        let mut next = Vec::with_capacity(found.len());
        for (c, ((flat, derivative), memory)) in found.into_iter().zip(memories).enumerate() {
            let sweep = &sweeps[c];
            let force = match self.arrived.step.part < 1.0 {
                true => sweep.force.clone(),
                false => self.force(&causes[c], sweep)?,
            };
            let mut displacement = sweep.displacement.clone();
            if self.is_kept {
                displacement.insert(self.number, Arc::new(flat));
            }
            let frame = is_end.then(|| self.frame(derivative));
            next.push((Sweep { memory, force, displacement }, frame));
        }
        Ok(next)
    }

    /// Rates of the memory after the step, one list a cause.
    fn memories(
        &self,
        causes: &[Followed],
        sweeps: &[Sweep],
        found: &[(Vec<f64>, Derivative)],
    ) -> Result<Vec<Vec<f64>>, FemError> {
        let Arrived { step, substance, gradients, map, .. } = self.arrived;
        if !substance.behaviour.remembers() {
            return Ok(vec![Vec::new(); causes.len()]);
        }
        let mut all = Vec::with_capacity(causes.len());
        for (begin, causes) in causes.chunks(LANES).enumerate().map(|(k, some)| (k * LANES, some)) {
            let end = begin + causes.len();
            let moved = moved_by(causes, &sweeps[begin..end]);
            let own = found[begin..end].par_iter();
            let rates: Vec<Vec<Matrix3>> =
                own.map(|(flat, _)| map.gradients(step.body.geometry(), flat)).collect();
            let lanes = step
                .memory_rates(*substance, gradients, &rates, &moved)
                .ok_or_else(|| inverted(step))?;
            let memory = |k: usize| lanes.iter().map(|lanes| lanes[k]).collect();
            all.extend((0..moved.len()).into_par_iter().map(memory).collect::<Vec<_>>());
        }
        Ok(all)
    }

    /// The derivatives of the frame that the step ends.
    fn frame(&self, derivative: Derivative) -> FrameDerivative {
        let mut reactions = derivative.reactions;
        let rows = reactions.split_off(self.rig.body().held_nodes().len());
        let mut left = rows.as_slice();
        let pads = (0..self.rig.n_pads())
            .map(|pad| {
                self.phase.bonded[pad]?;
                let (own, rest) = left.split_at(self.rig.pad_nodes(pad).0.len());
                left = rest;
                Some(std::array::from_fn(|i| own.iter().map(|row| row[i]).sum()))
            })
            .collect();
        FrameDerivative { displacement: derivative.displacement, reactions, pads }
    }
}
