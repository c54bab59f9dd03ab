//! Causes of frames, checked against a rig.

use super::super::cause::{Cause, check_parameter};
use super::FrameCause;
use crate::error::FemError;
use crate::history::{Moved, Rig};
use crate::load::{Load, check_finite, check_length};
use crate::material::Parameter;

/// A cause, checked.
pub(super) struct Followed<'a> {
    pub(super) cause: &'a FrameCause,
    /// Rates of the load, one per frame or one for all.
    loads: &'a [Load],
}

impl<'a> Followed<'a> {
    pub(super) fn new(rig: &Rig, cause: &'a FrameCause) -> Result<Self, FemError> {
        let n_frames = rig.n_recorded_frames();
        let (history, body) = (rig.history(), rig.body());
        let mut loads: &[Load] = &[];
        match cause {
            FrameCause::Always(Cause::Parameter(parameter)) => {
                check_parameter(history.material(), *parameter)?;
            }
            FrameCause::Always(Cause::YoungField(rates) | Cause::PoissonField(rates)) => {
                let n = body.n_tets() * body.element().n_points();
                check_length("rates (one entry a quadrature point)", n, rates.len())?;
            }
            FrameCause::Always(Cause::Load(load)) => loads = std::slice::from_ref(load),
            FrameCause::Always(_) => {}
            FrameCause::Behaviour(parameter) => {
                if !history.behaviour().has(*parameter) {
                    let what = format!("{parameter:?} of this behaviour");
                    return Err(FemError::NoSuchCause { what });
                }
            }
            FrameCause::Loads(rates) => {
                check_length("loads (one a frame)", n_frames, rates.len())?;
                loads = rates;
            }
            FrameCause::Motion { pad, rates } => {
                if *pad >= rig.n_pads() {
                    let what = format!("the motion of pad {pad} of {}", rig.n_pads());
                    return Err(FemError::NoSuchCause { what });
                }
                check_length("motion of a pad (one row a frame)", n_frames, rates.len())?;
                check_finite("motion of a pad", rates)?;
            }
        }
        if loads.iter().any(|load| !load.springs.is_empty()) {
            let what = "springs of a load; name them one by one".to_owned();
            return Err(FemError::NoSuchCause { what });
        }
        Ok(Self { cause, loads })
    }

    /// Rates of the load in a frame.
    pub(super) fn load(&self, frame: usize) -> Option<&'a Load> {
        self.loads.get(if self.loads.len() == 1 { 0 } else { frame })
    }

    /// What of it moves at the points.
    pub(super) fn moved<'b>(&'b self, memory: &'b [f64]) -> Moved<'b> {
        let mut moved = Moved { memory, ..Moved::default() };
        match self.cause {
            FrameCause::Always(Cause::Parameter(parameter)) => {
                moved.parameter = Some((*parameter, None));
            }
            FrameCause::Always(Cause::YoungField(rates)) => {
                moved.parameter = Some((Parameter::Young, Some(rates)));
            }
            FrameCause::Always(Cause::PoissonField(rates)) => {
                moved.parameter = Some((Parameter::Poisson, Some(rates)));
            }
            FrameCause::Behaviour(parameter) => moved.behaviour = Some(*parameter),
            FrameCause::Always(_) | FrameCause::Loads(_) | FrameCause::Motion { .. } => {}
        }
        moved
    }
}
