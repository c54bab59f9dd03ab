//! A material test through time: one point with memory, no mesh.

use super::behaviour::Behaviour;
use super::common::{Common, PointStep};
use super::point::Parts;
use super::state::fresh_states;
use crate::check::check_length;
use crate::error::FemError;
use crate::material::homogeneous::{Mode, sheared};
use crate::material::{
    FreeSides, Hyperelastic, Law, Matrix3, PiecePoint, Response, Tangent, is_finite,
};

/// Nominal stress of a homogeneous test piece, row by row through time, kPa: `P₀₀` at stretches,
/// `P₀₁` at amounts of shear (`amounts`, dimensionless, one a row).
///
/// Rows are the time frames of a [`History`](crate::History): the first is reached at once,
/// whatever its time, and so is one at the time (`times_s`, s) of the row before. A piece that is at
/// rest at first has a row that says so. Sides that are free
/// ([`nominal_stress`](crate::material::homogeneous::nominal_stress)) bear no stress at the end of
/// any step.
///
/// NaN from the first row on at which the law has no stress, or the sides no stable place.
///
/// # Errors
///
/// Those of [`Behaviour::check`]; [`FemError::WrongLength`] where the rows of `times_s` are not as
/// many, [`FemError::NonFinite`] and [`FemError::TimeRunsBack`] for times that are no sequence.
///
/// # Cost
///
/// Per row two or three evaluations of the law (twice as many where its parts are remembered apart),
/// a tangent where sides are free, and no allocation.
///
/// # Examples
///
/// A bar that is pulled at once and held relaxes to its share:
///
/// ```
/// use tissuereg_fem::material::homogeneous::Mode;
/// use tissuereg_fem::{Behaviour, Material, Relaxation, stress_history};
///
/// let law = Material::neo_hookean(3.0, 0.45)?.law_at(0, 0);
/// let relaxation = Relaxation { g: vec![0.4], tau_s: vec![2.0], ..Relaxation::default() };
/// let behaviour = Behaviour { relaxation: Some(relaxation), ..Behaviour::default() };
/// let stress =
///     stress_history(&law, &behaviour, Mode::Uniaxial, &[1.2, 1.2, 1.2], &[0.0, 2.0, 1e3])?;
/// let left = |row: usize| stress[row] / stress[0];
/// assert!((left(1) - (0.6 + 0.4 * (-1.0_f64).exp())).abs() < 1e-9);
/// assert!((left(2) - 0.6).abs() < 1e-9);
/// # Ok::<(), tissuereg_fem::FemError>(())
/// ```
pub fn stress_history(
    law: &Law,
    behaviour: &Behaviour,
    mode: Mode,
    amounts: &[f64],
    times_s: &[f64],
) -> Result<Vec<f64>, FemError> {
    behaviour.check()?;
    check_length("times (one an amount)", amounts.len(), times_s.len())?;
    check_order(times_s)?;
    let mut stress = vec![f64::NAN; amounts.len()];
    if let Some(&start_s) = times_s.first() {
        let mut piece = Piece::new(law, behaviour, mode, start_s);
        for ((stress, &amount), &time_s) in stress.iter_mut().zip(amounts).zip(times_s) {
            match piece.advance(amount, time_s) {
                Some(found) => *stress = found,
                None => break,
            }
        }
    }
    Ok(stress)
}

fn check_order(times_s: &[f64]) -> Result<(), FemError> {
    let mut last_s = f64::NEG_INFINITY;
    for (row, &time_s) in times_s.iter().enumerate() {
        if !time_s.is_finite() {
            return Err(FemError::NonFinite { what: "times", row, values: [time_s, 0.0, 0.0] });
        }
        if time_s < last_s {
            return Err(FemError::TimeRunsBack { time_s, last_s });
        }
        last_s = time_s;
    }
    Ok(())
}

/// A piece on its way through a test.
struct Piece<'a> {
    law: &'a Law,
    common: Common,
    state: Vec<f64>,
    time_s: f64,
    /// None in simple shear.
    sides: Option<FreeSides>,
}

impl<'a> Piece<'a> {
    fn new(law: &'a Law, behaviour: &Behaviour, mode: Mode, start_s: f64) -> Self {
        Self {
            law,
            common: Common::new(behaviour, 0.0, start_s),
            state: fresh_states(behaviour, 1),
            time_s: start_s,
            sides: mode.n_free().map(FreeSides::new),
        }
    }

    /// Go to the next row, and answer its nominal stress.
    fn advance(&mut self, amount: f64, time_s: f64) -> Option<f64> {
        self.common.set_step(time_s - self.time_s, time_s);
        let at = self.common.point(&self.state);
        let step = Step { law: self.law, common: &self.common, at: &at };
        let (h, stress, parts) = match &mut self.sides {
            None => {
                let h = sheared(amount);
                let (found, parts) = step.at(&h)?;
                (h, found.stress[0][1], parts)
            }
            Some(_) if !(amount > 0.0 && amount.is_finite()) => return None,
            Some(sides) => {
                sides.pull(amount);
                let (found, parts) = sides.settle(&step)?;
                (sides.gradient(), sides.pulled_stress(&found)?, parts)
            }
        };
        self.common.update_stresses(&at, &h, &parts, &mut self.state);
        self.common.update_strains(&h, &mut self.state);
        self.time_s = time_s;
        Some(stress)
    }
}

/// A step of the point.
struct Step<'a> {
    law: &'a Law,
    common: &'a Common,
    at: &'a PointStep,
}

impl PiecePoint for Step<'_> {
    type Rest = Parts;

    fn at(&self, h: &Matrix3) -> Option<(Response, Parts)> {
        let parts = self.common.parts(self.at, h, |he| self.law.response(he))?;
        let found = self.common.response_of(self.at, h, &parts);
        is_finite(&found).then_some((found, parts))
    }

    fn tangent_at(&self, h: &Matrix3) -> Option<Tangent> {
        let law = |he: &Matrix3| self.law.response(he);
        self.common.tangent(self.at, h, law, |he| self.law.tangent(he))
    }
}
