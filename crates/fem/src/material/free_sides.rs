//! The free sides of a test piece: the stretches across the pull that leave no stress there.
//!
//! Their logarithms minimise the energy. Near the minimum, steps use the stiffness of steps before, corrected by
//! what these have shown (Powell's symmetric form of Broyden's method); where they do not shrink
//! fast, a step has the tangent, and is damped so that the energy falls. The tangent of the place itself says
//! whether it is a minimum.
//!
//! Powell, "A new algorithm for unconstrained optimization", in *Nonlinear Programming*, Academic
//! Press 1970.

use super::{Hyperelastic, Law, Matrix3, Response, Tangent};

/// Steps of one search; a few are enough from nearby.
const MOST_STEPS: usize = 200;
/// Step below which an old stiffness has nothing more to say.
const EXACT: f64 = 1e-12;
/// Error of a logarithm that is left, by the tangent.
const SETTLED: f64 = 1e-11;
/// The same where rounding lets no step shrink any more.
const ROUNDED: f64 = 1e-9;
/// Largest step with an old stiffness, and share of it that the next one may be.
const NEAR: f64 = 1e-2;
const SHRINKS: f64 = 0.05;
/// Step below which a change of slopes is too much rounding to correct the stiffness by.
const TELLS: f64 = 1e-11;
/// Step below which the energy need not be seen to fall, which rounding would spoil.
const SURE: f64 = 1e-6;
/// Largest pull by which the change of volume is prolonged, over the pull before.
const PROLONGED: f64 = 4.0;

/// A point of a test piece, as the search sees it.
pub(crate) trait PiecePoint {
    /// What is known of the point beside its response.
    type Rest;

    /// Energy and stress at a displacement gradient, with the rest; none where there are none.
    fn at(&self, h: &Matrix3) -> Option<(Response, Self::Rest)>;

    /// Tangent at a displacement gradient.
    fn tangent_at(&self, h: &Matrix3) -> Option<Tangent>;
}

impl PiecePoint for Law {
    type Rest = ();

    fn at(&self, h: &Matrix3) -> Option<(Response, ())> {
        self.response(h).filter(is_finite).map(|response| (response, ()))
    }

    fn tangent_at(&self, h: &Matrix3) -> Option<Tangent> {
        self.tangent(h)
    }
}

pub(crate) fn is_finite(found: &Response) -> bool {
    found.stress.as_flattened().iter().all(|stress| stress.is_finite())
}

/// A piece under principal stretches, the last ones of which are free.
#[derive(Debug, Clone)]
pub(crate) struct FreeSides {
    /// Stretches minus 1.
    strains: [f64; 3],
    /// Pulled stretch and volumes before the last pull.
    before: (f64, [f64; 2]),
    /// The first of those that are free: 1 or 2.
    first: usize,
    /// That of the last steps, where they shrank.
    stiffness: Option<Stiffness>,
}

impl FreeSides {
    /// At rest, with one or two free sides.
    pub(crate) fn new(n_free: usize) -> Self {
        Self { strains: [0.0; 3], before: (1.0, [1.0; 2]), first: 3 - n_free, stiffness: None }
    }

    /// Pull to a stretch. The volume goes on as it went, or is kept where it has not gone that far.
    pub(crate) fn pull(&mut self, stretch: f64) {
        let (now, volumes) = (1.0 + self.strains[0], self.volumes());
        let (change, last) = (stretch - now, now - self.before.0);
        let prolonged = last != 0.0 && change.abs() <= PROLONGED * last.abs();
        let by = if prolonged { change / last } else { 0.0 };
        let gone = [0, 1].map(|i| volumes[i] + by * (volumes[i] - self.before.1[i]));
        self.before = (now, volumes);
        self.strains[..self.first].fill(stretch - 1.0);
        // Far from the volume before, a line says nothing.
        let near = |i: usize| (0.5..=2.0).contains(&(gone[i] / volumes[i]));
        self.set_volumes(if near(0) && near(1) { gone } else { volumes });
    }

    fn set_volumes(&mut self, volumes: [f64; 2]) {
        let stretch = 1.0 + self.strains[0];
        for i in self.first..3 {
            let square = volumes[i - 1] / stretch;
            let side = if self.first == 1 { square.sqrt() } else { square / stretch };
            self.strains[i] = side - 1.0;
        }
    }

    /// Volume over that at rest, for each side as if the other was like it.
    fn volumes(&self) -> [f64; 2] {
        let [pulled, y, z] = self.strains.map(|v| 1.0 + v);
        if self.first == 1 { [pulled * y * y, pulled * z * z] } else { [1.0, pulled * pulled * z] }
    }

    /// `h`
    pub(crate) fn gradient(&self) -> Matrix3 {
        let [x, y, z] = self.strains;
        [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]]
    }

    /// Let the sides go where the energy is least, and say what the point is there; none where they
    /// find no place.
    pub(crate) fn settle<P: PiecePoint>(&mut self, point: &P) -> Option<(Response, P::Rest)> {
        let mut found = point.at(&self.gradient())?;
        let mut most = NEAR;
        for _ in 0..MOST_STEPS {
            let slopes = self.slopes(&found.0);
            let step = self.stiffness.map(|stiffness| stiffness.newton(slopes));
            let Some(step) = step.filter(|&step| (EXACT..=most).contains(&largest(step))) else {
                match self.damped_step(point, slopes, &mut found)? {
                    Damped::Settled => return Some(found),
                    Damped::Moved(size) => most = SHRINKS * size,
                }
                continue;
            };
            let size = largest(step);
            let pulled = found.0.stress[0][0];
            let tried = self.moved(1.0, step);
            let Some(there) = point.at(&tried.gradient()) else {
                self.stiffness = None;
                continue;
            };
            (*self, found) = (tried, there);
            if size > TELLS {
                let [r, s] = self.slopes(&found.0);
                let change = [r - slopes[0], s - slopes[1], found.0.stress[0][0] - pulled];
                self.stiffness = self.stiffness.and_then(|old| old.corrected(step, change));
            }
            most = SHRINKS * size;
        }
        let slopes = self.slopes(&found.0);
        let own = self.stiffness_at(&point.tangent_at(&self.gradient())?, slopes);
        self.stiffness = Some(own);
        (own.is_positive() && largest(own.newton(slopes)) <= ROUNDED).then_some(found)
    }

    /// Nominal stress of the pull at a response that the sides have settled at, with what a step
    /// further would change it by; none where that overflows.
    pub(crate) fn pulled_stress(&self, found: &Response) -> Option<f64> {
        let further = self.stiffness.map_or(0.0, |last| {
            let ([x, y], [p, q]) = (last.newton(self.slopes(found)), last.pull);
            p * x + q * y
        });
        Some(found.stress[0][0] + further).filter(|stress| stress.is_finite())
    }

    /// A step with the tangent, along which the energy falls; none where it does not.
    fn damped_step<P: PiecePoint>(
        &mut self,
        point: &P,
        slopes: [f64; 2],
        found: &mut (Response, P::Rest),
    ) -> Option<Damped> {
        let stiffness = self.stiffness_at(&point.tangent_at(&self.gradient())?, slopes);
        let positive = stiffness.is_positive();
        let step = if positive { stiffness.newton(slopes) } else { stiffness.fall(slopes) };
        let size = largest(step);
        if !size.is_finite() {
            return None;
        }
        self.stiffness = positive.then_some(stiffness);
        if positive && size <= SETTLED {
            return Some(Damped::Settled);
        }
        // A stretch may change by a half at a time, and the energy must not rise beyond rounding.
        let mut share = (0.5 / size).min(1.0);
        let energy = found.0.energy;
        while share * size > 1e-15 {
            let tried = self.moved(share, step);
            if let Some(there) = point.at(&tried.gradient()) {
                let rise = there.0.energy - energy;
                if (positive && size < SURE) || rise <= 1e-12 * energy.abs() {
                    (*self, *found) = (tried, there);
                    // A step that is not Newton's says nothing of what is left.
                    return Some(Damped::Moved(if positive {
                        share * size
                    } else {
                        f64::INFINITY
                    }));
                }
            }
            share *= 0.5;
        }
        None
    }

    fn moved(&self, share: f64, step: [f64; 2]) -> Self {
        let mut moved = self.clone();
        for i in self.first..3 {
            // An exponential to second order, which is positive as well.
            let x = share * step[i - 1];
            moved.strains[i] += (1.0 + self.strains[i]) * x * (1.0 + 0.5 * x);
        }
        moved
    }

    /// Derivatives of the energy by the logarithms of the free sides.
    fn slopes(&self, Response { stress, .. }: &Response) -> [f64; 2] {
        let slope = |i: usize| (1.0 + self.strains[i]) * stress[i][i];
        [if self.first == 1 { slope(1) } else { 0.0 }, slope(2)]
    }

    fn stiffness_at(&self, tangent: &Tangent, slopes: [f64; 2]) -> Stiffness {
        let stretch = self.strains.map(|strain| 1.0 + strain);
        let entry = |i: usize, j: usize| tangent[4 * i][4 * j] * stretch[i] * stretch[j];
        let pull = |j: usize| tangent[0][4 * j] * stretch[j];
        let c = entry(2, 2) + slopes[1];
        match self.first {
            1 => Stiffness {
                a: entry(1, 1) + slopes[0],
                b: entry(1, 2),
                c,
                pull: [pull(1), pull(2)],
            },
            _ => Stiffness { a: c.abs(), b: 0.0, c, pull: [0.0, pull(2)] },
        }
    }
}

/// What a step with the tangent did.
enum Damped {
    /// Nothing: there is none to speak of.
    Settled,
    /// It moved the sides by so much.
    Moved(f64),
}

/// Second derivatives of the energy by the logarithms of the sides, kPa: 11, 12 and 22. Where
/// side 1 is not free, the size of the last and 0 stand for the first two.
#[derive(Debug, Clone, Copy)]
struct Stiffness {
    a: f64,
    b: f64,
    c: f64,
    /// Derivatives of the nominal stress of the pull.
    pull: [f64; 2],
}

impl Stiffness {
    /// Whether the energy has a minimum near.
    fn is_positive(&self) -> bool {
        self.a > 0.0 && self.a * self.c - self.b * self.b > 0.0
    }

    /// Step that makes slopes vanish.
    fn newton(&self, [r, s]: [f64; 2]) -> [f64; 2] {
        let Self { a, b, c, .. } = *self;
        let det = a * c - b * b;
        [-(c * r - b * s) / det, -(a * s - b * r) / det]
    }

    /// Step along which the energy falls.
    fn fall(&self, slopes: [f64; 2]) -> [f64; 2] {
        let scale = self.a.abs() + self.b.abs() + self.c.abs();
        slopes.map(|slope| -slope / scale)
    }

    /// The nearest symmetric stiffness with these changes of slopes, and of the stress of the pull,
    /// along a step; none where it is that of no minimum.
    fn corrected(&self, [x, y]: [f64; 2], change: [f64; 3]) -> Option<Self> {
        let Self { a, b, c, pull: [p, q] } = *self;
        let square = x * x + y * y;
        let (r, s) = (change[0] - (a * x + b * y), change[1] - (b * x + c * y));
        let along = (r * x + s * y) / square;
        let t = (change[2] - (p * x + q * y)) / square;
        let better = Self {
            a: a + (2.0 * r - along * x) * x / square,
            b: b + (r * y + s * x - along * x * y) / square,
            c: c + (2.0 * s - along * y) * y / square,
            pull: [p + t * x, q + t * y],
        };
        better.is_positive().then_some(better)
    }
}

fn largest([a, b]: [f64; 2]) -> f64 {
    a.abs().max(b.abs())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used)]

    use std::cell::Cell;

    use super::*;
    use crate::Material;

    /// A law that counts what is asked of it.
    struct Counted {
        law: Law,
        responses: Cell<u32>,
        tangents: Cell<u32>,
    }

    impl PiecePoint for Counted {
        type Rest = ();

        fn at(&self, h: &Matrix3) -> Option<(Response, ())> {
            self.responses.set(self.responses.get() + 1);
            self.law.at(h)
        }

        fn tangent_at(&self, h: &Matrix3) -> Option<Tangent> {
            self.tangents.set(self.tangents.get() + 1);
            self.law.tangent_at(h)
        }
    }

    #[test]
    fn a_fine_path_takes_a_few_responses_and_a_tangent_a_row() {
        let law = Material::neo_hookean(3.0, 0.45).expect("sound").law_at(0, 0);
        for n_free in [1, 2] {
            let point = Counted { law, responses: Cell::new(0), tangents: Cell::new(0) };
            let mut sides = FreeSides::new(n_free);
            for row in 1..=100 {
                sides.pull(1.0 + 0.004 * f64::from(row));
                sides.settle(&point).expect("stretched");
            }
            let (responses, tangents) = (point.responses.get(), point.tangents.get());
            assert!(responses <= 350, "{responses} responses of 100 rows");
            assert!(tangents <= 150, "{tangents} tangents of 100 rows");
        }
    }
}
