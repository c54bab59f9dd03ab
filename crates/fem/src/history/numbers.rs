//! The numbers of a behaviour, by name and with derivatives.

use super::behaviour::{Behaviour, Part, SofteningForm};
use super::prony::Term;
use super::scalar::Scalar;
use super::softening::Softness;

/// A number of a [`Behaviour`].
///
/// A derivative by one that a behaviour does not have is an error; [`Viscosity`](Self::Viscosity)
/// and those of a swelling of no strain may be 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BehaviourParameter {
    /// Share of one term of the relaxation.
    RelaxationShare(usize),
    /// Time of one term of the relaxation, s.
    RelaxationTime(usize),
    /// Viscosity, kPa s.
    Viscosity,
    /// `r` of the softening.
    SofteningR,
    /// `m` of the softening, kPa.
    SofteningM,
    /// `β` of the softening.
    SofteningBeta,
    /// Share of the largest strain that stays.
    SetFraction,
    /// Share that drains.
    DrainageShare,
    /// Time of the drainage, s.
    DrainageTime,
    /// Strain at the end of the swelling.
    SwellingStrain,
    /// Start of the swelling, s.
    SwellingFrom,
    /// End of the swelling, s.
    SwellingTo,
}

/// All numbers of a behaviour.
#[derive(Debug, Clone)]
pub(super) struct Numbers<S> {
    relaxation: Vec<Term<S>>,
    part: Part,
    pub(super) viscosity: S,
    pub(super) softening: Option<Softness<S>>,
    pub(super) set: Option<S>,
    drainage: Option<Term<S>>,
    swelling: Option<[S; 3]>,
}

impl Behaviour {
    /// All numbers, each as `of` makes it from its name and its value.
    pub(super) fn numbers<S: Scalar>(
        &self,
        of: impl Fn(BehaviourParameter, f64) -> S,
    ) -> Numbers<S> {
        use BehaviourParameter as P;
        let (mut relaxation, mut part) = (Vec::new(), Part::Whole);
        if let Some(series) = &self.relaxation {
            part = series.part;
            for (k, (&g, &tau)) in series.g.iter().zip(&series.tau_s).enumerate() {
                let (share, tau) = (of(P::RelaxationShare(k), g), of(P::RelaxationTime(k), tau));
                relaxation.push(Term { share, tau });
            }
        }
        Numbers {
            relaxation,
            part,
            viscosity: of(P::Viscosity, self.viscosity_kpa_s),
            softening: self.softening.map(|softening| Softness {
                form: softening.form,
                r: of(P::SofteningR, softening.r),
                m_kpa: of(P::SofteningM, softening.m_kpa),
                beta: of(P::SofteningBeta, softening.beta),
            }),
            set: self.set.map(|set| of(P::SetFraction, set.fraction)),
            drainage: self.drainage.map(|drainage| Term {
                share: of(P::DrainageShare, drainage.share),
                tau: of(P::DrainageTime, drainage.tau_s),
            }),
            swelling: self.swelling.map(|swelling| {
                [
                    of(P::SwellingStrain, swelling.linear_strain),
                    of(P::SwellingFrom, swelling.from_time_s),
                    of(P::SwellingTo, swelling.to_time_s),
                ]
            }),
        }
    }

    /// Whether there is such a number.
    pub(crate) fn has(&self, parameter: BehaviourParameter) -> bool {
        use BehaviourParameter as P;
        let n_terms = self.relaxation.as_ref().map_or(0, |relaxation| relaxation.g.len());
        match parameter {
            P::RelaxationShare(k) | P::RelaxationTime(k) => k < n_terms,
            P::Viscosity => true,
            P::SofteningR | P::SofteningM => self.softening.is_some(),
            P::SofteningBeta => self.softens_when_unloaded(),
            P::SetFraction => self.set.is_some(),
            P::DrainageShare | P::DrainageTime => self.drainage.is_some(),
            P::SwellingStrain | P::SwellingFrom | P::SwellingTo => self.swelling.is_some(),
        }
    }

    /// Whether what a body has been through matters.
    pub(crate) fn remembers(&self) -> bool {
        let relaxes = self.relaxation.as_ref().is_some_and(|relaxation| !relaxation.g.is_empty());
        relaxes
            || self.viscosity_kpa_s > 0.0
            || self.softening.is_some()
            || self.set.is_some()
            || self.drainage.is_some()
    }

    /// Whether the two parts of the energy have to be separated.
    pub(super) fn is_split(&self) -> bool {
        let isochoric = self.relaxation.as_ref().is_some_and(|relaxation| {
            relaxation.part == Part::Isochoric && !relaxation.g.is_empty()
        });
        self.softens_when_unloaded() || self.drainage.is_some() || isochoric
    }

    fn softens_when_unloaded(&self) -> bool {
        self.softening.is_some_and(|softening| softening.form == SofteningForm::OgdenRoxburgh)
    }
}

impl<S: Scalar> Numbers<S> {
    /// The terms of the volumetric and of the isochoric part.
    pub(super) fn series(&self) -> [Vec<Term<S>>; 2] {
        let isochoric = self.relaxation.clone();
        let mut volumetric = match self.part {
            Part::Whole => isochoric.clone(),
            Part::Isochoric => Vec::new(),
        };
        volumetric.extend(self.drainage);
        [volumetric, isochoric]
    }

    /// Stretch by swelling at a time, as [`Swelling::stretch`](super::Swelling::stretch). At the
    /// ends of the ramp, derivatives are those outside of it.
    pub(super) fn stretch(&self, time_s: f64) -> S {
        let one = S::constant(1.0);
        let Some([strain, from, to]) = self.swelling else { return one };
        let length = to - from;
        let done = if length.value() > 0.0 {
            let done = (S::constant(time_s) - from) / length;
            match done.value() {
                v if v <= 0.0 => S::constant(0.0),
                v if v >= 1.0 => one,
                _ => done,
            }
        } else {
            S::constant(if time_s >= to.value() { 1.0 } else { 0.0 })
        };
        one + done * strain
    }
}
