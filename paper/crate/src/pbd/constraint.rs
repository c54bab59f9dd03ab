//! One constraint, and how its particles move to meet it.

use super::given::{PbdConstraint, PbdObservation};
use crate::vectors::cross;

/// A constraint with its Lagrange multiplier.
#[derive(Debug)]
pub(super) struct Constraint<const N: usize> {
    particles: [u32; N],
    pub(super) rest: f64,
    compliance: f64,
    pub(super) multiplier: f64,
}

/// What is kept, as a function of the places of its particles.
pub(super) trait Rule<const N: usize> {
    fn measure(corners: &[[f64; 3]; N]) -> f64;

    /// The measure and its derivative by each place.
    fn measure_and_slopes(corners: &[[f64; 3]; N]) -> (f64, [[f64; 3]; N]);
}

/// Distance of two particles, mm.
pub(super) struct DistanceRule;

impl Rule<2> for DistanceRule {
    fn measure(corners: &[[f64; 3]; 2]) -> f64 {
        let d = difference(&corners[1], &corners[0]);
        dot(&d, &d).sqrt()
    }

    #[inline(always)]
    fn measure_and_slopes(corners: &[[f64; 3]; 2]) -> (f64, [[f64; 3]; 2]) {
        let d = difference(&corners[1], &corners[0]);
        let length = dot(&d, &d).sqrt();
        // Particles in one place have no direction to part in.
        let unit = d.map(|v| if length > 0.0 { v / length } else { 0.0 });
        (length, [unit.map(|v| -v), unit])
    }
}

/// Signed volume of a tetrahedron, mm³.
pub(super) struct VolumeRule;

impl Rule<4> for VolumeRule {
    fn measure(corners: &[[f64; 3]; 4]) -> f64 {
        Self::measure_and_slopes(corners).0
    }

    #[inline(always)]
    fn measure_and_slopes(corners: &[[f64; 3]; 4]) -> (f64, [[f64; 3]; 4]) {
        let [a, b, c] = [1, 2, 3].map(|k| difference(&corners[k], &corners[0]));
        let slopes = [cross(b, c), cross(c, a), cross(a, b)].map(|row| row.map(|v| v / 6.0));
        let first = std::array::from_fn(|i| -(slopes[0][i] + slopes[1][i] + slopes[2][i]));
        (dot(&a, &slopes[0]), [first, slopes[0], slopes[1], slopes[2]])
    }
}

impl<const N: usize> Constraint<N> {
    pub(super) fn new(given: &PbdConstraint<N>) -> Self {
        Self {
            particles: given.particles.map(|particle| particle as u32),
            rest: given.rest,
            compliance: given.compliance,
            multiplier: 0.0,
        }
    }

    #[inline(always)]
    pub(super) fn corners(&self, places: &[[f64; 3]]) -> [[f64; 3]; N] {
        self.particles.map(|particle| places[particle as usize])
    }

    /// Move the particles; `per_square` is `1/Δt²`.
    #[inline(always)]
    pub(super) fn meet<R: Rule<N>>(
        &mut self,
        places: &mut [[f64; 3]],
        inverse_masses: &[f64],
        per_square: f64,
    ) {
        let (measure, slopes) = R::measure_and_slopes(&self.corners(places));
        let inverse = self.particles.map(|particle| inverse_masses[particle as usize]);
        let softness = self.compliance * per_square;
        let mut sum = softness;
        for k in 0..N {
            sum += inverse[k] * dot(&slopes[k], &slopes[k]);
        }
        if sum <= 0.0 {
            return;
        }
        let change = (self.rest - measure - softness * self.multiplier) / sum;
        self.multiplier += change;
        for k in 0..N {
            let place = &mut places[self.particles[k] as usize];
            for i in 0..3 {
                place[i] += inverse[k] * change * slopes[k][i];
            }
        }
    }
}

/// An observed place: three constraints, one an axis, that share their slopes.
///
/// In the limit the same as one on the distance, and better for it where the place is met, as a distance
/// has no direction there.
pub(super) struct PlaceRule<'a> {
    given: &'a PbdObservation,
    softness: f64,
    /// `Σ b²/m + a'`
    sum: f64,
    multiplier: [f64; 3],
}

impl<'a> PlaceRule<'a> {
    pub(super) fn new(given: &'a PbdObservation, inverse_masses: &[f64], per_square: f64) -> Self {
        let softness = given.compliance * per_square;
        let own = given.weights.iter().map(|&(particle, b)| inverse_masses[particle] * b * b);
        Self { given, softness, sum: softness + own.sum::<f64>(), multiplier: [0.0; 3] }
    }

    pub(super) fn meet(&mut self, places: &mut [[f64; 3]], inverse_masses: &[f64]) {
        if self.sum <= 0.0 {
            return;
        }
        for i in 0..3 {
            let here: f64 = self.given.weights.iter().map(|&(p, b)| b * places[p][i]).sum();
            let off = self.given.place[i] - here;
            let change = (off - self.softness * self.multiplier[i]) / self.sum;
            self.multiplier[i] += change;
            for &(particle, b) in &self.given.weights {
                places[particle][i] += inverse_masses[particle] * b * change;
            }
        }
    }
}

#[inline(always)]
fn difference(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
