//! Solutions with a factor: forward and back through the fronts.
//!
//! Every front has a local vector: its own unknowns, then its rows. Going forward it collects what
//! its children pass on; going back it reads its rows from its parent's. No two subtrees touch the
//! same numbers, so that they can run at the same time with the same bits.

use super::entry::{Entry, Precision};
use super::factor::{Factor, Numeric};
use super::fronts::{Front, Fronts};
use super::panel_solve::{Eliminate, Substitute};

/// Subtrees whose panels hold fewer entries are not worth a second thread.
const PARALLEL_ENTRIES: usize = 150_000;

/// Buffers of a solve, kept between solves.
#[derive(Default)]
pub(crate) struct SolveScratch {
    single: Vec<f32>,
    double: Vec<f64>,
}

impl Factor {
    /// Write `scale K⁻¹ rhs` to `out`.
    pub(crate) fn solve_into(
        &self,
        fronts: &Fronts,
        scale: f64,
        rhs: &[f64],
        out: &mut [f64],
        scratch: &mut SolveScratch,
        parallel: bool,
    ) {
        match self {
            Self::Compact(f) => {
                f.solve_into(fronts, scale, rhs, out, &mut scratch.single, parallel);
            }
            Self::Double(f) => {
                f.solve_into(fronts, scale, rhs, out, &mut scratch.double, parallel);
            }
        }
    }
}

impl<E: Entry> Numeric<E> {
    fn solve_into(
        &self,
        fronts: &Fronts,
        scale: f64,
        rhs: &[f64],
        out: &mut [f64],
        local: &mut Vec<E::Real>,
        parallel: bool,
    ) {
        // Single precision has a narrow range of exponents: bring the right-hand side to size 1.
        let size = rhs.iter().fold(0.0_f64, |m, r| m.max(r.abs()));
        if size == 0.0 || !size.is_finite() {
            out.fill(if size == 0.0 { 0.0 } else { f64::NAN });
            return;
        }
        local.resize(fronts.n_local, E::Real::default());
        let solving = Solving { fronts, factor: self, parallel, from: rhs, size };
        let mut rest = local.as_mut_slice();
        for &root in &fronts.roots {
            let (own, after) = rest.split_at_mut(fronts.local_range(root).len());
            rest = after;
            solving.forward(root, own);
            solving.backward(root, own, None);
        }
        for front in &fronts.fronts {
            let own = &local[front.local..front.local + front.n_own];
            let target = &mut out[front.first..front.first + front.n_own];
            for (o, x) in target.iter_mut().zip(own) {
                *o = x.to_f64() * (size * scale);
            }
        }
    }
}

struct Solving<'a, E: Entry> {
    fronts: &'a Fronts,
    factor: &'a Numeric<E>,
    parallel: bool,
    from: &'a [f64],
    size: f64,
}

impl<E: Entry> Solving<'_, E> {
    fn splits(&self, front: &Front) -> bool {
        let first = &self.fronts.fronts[front.first_below];
        self.parallel && front.children.len() > 1 && front.panel - first.panel > PARALLEL_ENTRIES
    }

    /// Forward through a subtree with the local vectors `local`.
    fn forward(&self, root: u32, local: &mut [E::Real]) {
        let front = &self.fronts.fronts[root as usize];
        let base = self.fronts.fronts[front.first_below].local;
        if self.splits(front) {
            let below = front.local - base;
            self.forward_children(self.fronts.children_of(front), &mut local[..below]);
            self.forward_front(front, local, base);
        } else {
            for front in &self.fronts.fronts[front.first_below..=root as usize] {
                self.forward_front(front, local, base);
            }
        }
    }

    fn forward_children(&self, children: &[u32], local: &mut [E::Real]) {
        match *children {
            [] => {}
            [one] => self.forward(one, local),
            _ => {
                let (low, high) = children.split_at(children.len() / 2);
                let middle = self.middle(low, high);
                let (a, b) = local.split_at_mut(middle);
                rayon::join(|| self.forward_children(low, a), || self.forward_children(high, b));
            }
        }
    }

    /// Where the local vectors of `high` begin among those of both.
    fn middle(&self, low: &[u32], high: &[u32]) -> usize {
        self.fronts.local_range(high[0]).start - self.fronts.local_range(low[0]).start
    }

    fn forward_front(&self, front: &Front, local: &mut [E::Real], base: usize) {
        let (below, own) = local.split_at_mut(front.local - base);
        let own = &mut own[..front.size()];
        for (x, r) in own.iter_mut().zip(&self.from[front.first..front.first + front.n_own]) {
            *x = E::Real::from_f64(r / self.size);
        }
        own[front.n_own..].fill(E::Real::default());
        for &child in self.fronts.children_of(front) {
            let child = &self.fronts.fronts[child as usize];
            let passed = &below[child.local - base + child.n_own..][..child.n_rows];
            for (&place, &value) in self.fronts.in_parent_of(child).iter().zip(passed) {
                own[place as usize] += value;
            }
        }
        pulp::Arch::new()
            .dispatch(Eliminate { stored: self.factor.stored(self.fronts, front), x: own });
    }

    /// Back through a subtree; `above` is the local vector of its root's parent.
    fn backward(&self, root: u32, local: &mut [E::Real], above: Option<&[E::Real]>) {
        let front = &self.fronts.fronts[root as usize];
        let base = self.fronts.fronts[front.first_below].local;
        let (below, own) = local.split_at_mut(front.local - base);
        self.backward_front(front, own, above);
        if self.splits(front) {
            self.backward_children(self.fronts.children_of(front), below, own);
            return;
        }
        // Parents before children: the local vector of a parent stands behind its children's.
        for f in (front.first_below..root as usize).rev() {
            let front = &self.fronts.fronts[f];
            let parent = &self.fronts.fronts[front.parent as usize];
            let (until, after) = local.split_at_mut(front.local - base + front.size());
            let above = parent.local - base - until.len();
            self.backward_front(
                front,
                &mut until[front.local - base..],
                Some(&after[above..above + parent.size()]),
            );
        }
    }

    fn backward_children(&self, children: &[u32], local: &mut [E::Real], above: &[E::Real]) {
        match *children {
            [] => {}
            [one] => self.backward(one, local, Some(above)),
            _ => {
                let (low, high) = children.split_at(children.len() / 2);
                let middle = self.middle(low, high);
                let (a, b) = local.split_at_mut(middle);
                rayon::join(
                    || self.backward_children(low, a, above),
                    || self.backward_children(high, b, above),
                );
            }
        }
    }

    fn backward_front(&self, front: &Front, own: &mut [E::Real], above: Option<&[E::Real]>) {
        if let Some(above) = above {
            let rows = &mut own[front.n_own..];
            for (x, &place) in rows.iter_mut().zip(self.fronts.in_parent_of(front)) {
                *x = above[place as usize];
            }
        }
        let x = &mut own[..front.size()];
        pulp::Arch::new()
            .dispatch(Substitute { stored: self.factor.stored(self.fronts, front), x });
    }
}
