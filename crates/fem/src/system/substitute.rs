//! Solutions with a factor: forward and back through the fronts.
//!
//! Every front has a local vector: its own unknowns, then its rows. Going forward it collects what
//! its children pass on; going back it reads its rows from its parent's. No two subtrees touch the
//! same numbers, so that they can run at the same time with the same bits. Many right-hand sides go
//! through together, `W` numbers a row, so that the factor is read once for all of them.

use super::entry::{Entry, Precision};
use super::factor::{Factor, Numeric};
use super::fronts::{Front, Fronts};
use super::panel_solve::{Eliminate, Substitute};
use super::wide_solve::{EliminateWide, SubstituteWide};

/// Subtrees whose panels hold fewer entries are not worth a second thread.
const PARALLEL_ENTRIES: usize = 150_000;

/// Right-hand sides that are carried through a factor in double precision together: two vectors of four.
pub(crate) const WIDE: usize = 8;

/// The same in single precision.
pub(crate) const WIDE_SINGLE: usize = 16;

/// Buffers of a solve, kept between solves.
#[derive(Default)]
pub(crate) struct SolveScratch {
    single: Vec<f32>,
    double: Vec<f64>,
    active: Vec<bool>,
}

/// The buffers of one precision.
struct Buffers<'a, T> {
    local: &'a mut Vec<T>,
    active: &'a mut Vec<bool>,
}

impl SolveScratch {
    fn single(&mut self) -> Buffers<'_, f32> {
        Buffers { local: &mut self.single, active: &mut self.active }
    }

    fn double(&mut self) -> Buffers<'_, f64> {
        Buffers { local: &mut self.double, active: &mut self.active }
    }
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
        let (rhs, out) = (rhs.as_chunks::<1>().0, out.as_chunks_mut::<1>().0);
        self.solve_wide_into(fronts, scale, rhs, out, scratch, parallel);
    }

    /// The same for `W` right-hand sides, one per column. The bits of a column do not depend on the
    /// others, as long as there are others.
    pub(crate) fn solve_wide_into<const W: usize>(
        &self,
        fronts: &Fronts,
        scale: f64,
        rhs: &[[f64; W]],
        out: &mut [[f64; W]],
        scratch: &mut SolveScratch,
        parallel: bool,
    ) {
        match self {
            Self::Compact(f) if W == 1 => {
                let (rhs, out) = (rhs.as_flattened(), out.as_flattened_mut());
                let (rhs, out) = (rhs.as_chunks::<1>().0, out.as_chunks_mut::<1>().0);
                f.solve_into(fronts, scale, rhs, out, scratch.single(), parallel);
            }
            // A metric has one right-hand side at a time.
            Self::Compact(f) => {
                let mut found = vec![[0.0]; out.len()];
                for w in 0..W {
                    let column: Vec<[f64; 1]> = rhs.iter().map(|row| [row[w]]).collect();
                    f.solve_into(fronts, scale, &column, &mut found, scratch.single(), parallel);
                    out.iter_mut().zip(&found).for_each(|(row, [x])| row[w] = *x);
                }
            }
            Self::Single(f) => {
                f.solve_into(fronts, scale, rhs, out, scratch.single(), parallel);
            }
            Self::Double(f) => {
                f.solve_into(fronts, scale, rhs, out, scratch.double(), parallel);
            }
        }
    }
}

impl<E: Entry> Numeric<E> {
    fn solve_into<const W: usize>(
        &self,
        fronts: &Fronts,
        scale: f64,
        rhs: &[[f64; W]],
        out: &mut [[f64; W]],
        Buffers { local, active }: Buffers<E::Real>,
        parallel: bool,
    ) {
        // Single precision has a narrow range of exponents: bring right-hand sides to size 1.
        let mut sizes = [0.0_f64; W];
        for row in rhs {
            for (size, r) in sizes.iter_mut().zip(row) {
                *size = size.max(r.abs());
            }
        }
        if sizes.iter().all(|&size| size == 0.0) {
            return out.fill([0.0; W]);
        }
        let back = sizes.map(|size| if size.is_finite() { size * scale } else { f64::NAN });
        let sizes = sizes.map(|size| if size == 0.0 { 1.0 } else { size });
        local.resize(W * fronts.n_local, E::Real::default());
        mark_active(fronts, rhs, active);
        let solving = Solving { fronts, factor: self, parallel, from: rhs, sizes, active };
        let local = local.as_chunks_mut::<W>().0;
        let mut rest = &mut *local;
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
                for ((o, x), back) in o.iter_mut().zip(x).zip(&back) {
                    *o = x.to_f64() * back;
                }
            }
        }
    }
}

/// Note whether anything but zero arrives at each front on the way forward. Loads of a few nodes reach few
/// of them.
fn mark_active<const W: usize>(fronts: &Fronts, rhs: &[[f64; W]], active: &mut Vec<bool>) {
    active.clear();
    active.resize(fronts.fronts.len(), W == 1);
    for (f, front) in fronts.fronts.iter().enumerate() {
        let own = &rhs[front.first..front.first + front.n_own];
        active[f] = active[f]
            || own.as_flattened().iter().any(|&r| r != 0.0)
            || fronts.children_of(front).iter().any(|&child| active[child as usize]);
    }
}

struct Solving<'a, E: Entry, const W: usize> {
    fronts: &'a Fronts,
    factor: &'a Numeric<E>,
    parallel: bool,
    from: &'a [[f64; W]],
    sizes: [f64; W],
    active: &'a [bool],
}

impl<E: Entry, const W: usize> Solving<'_, E, W> {
    fn splits(&self, front: &Front) -> bool {
        let first = &self.fronts.fronts[front.first_below];
        self.parallel && front.children.len() > 1 && front.panel - first.panel > PARALLEL_ENTRIES
    }

    /// Forward through a subtree with the local vectors `local`.
    fn forward(&self, root: u32, local: &mut [[E::Real; W]]) {
        let front = &self.fronts.fronts[root as usize];
        let base = self.fronts.fronts[front.first_below].local;
        if self.splits(front) {
            let below = front.local - base;
            self.forward_children(self.fronts.children_of(front), &mut local[..below]);
            self.forward_front(root as usize, local, base);
        } else {
            for f in front.first_below..=root as usize {
                self.forward_front(f, local, base);
            }
        }
    }

    fn forward_children(&self, children: &[u32], local: &mut [[E::Real; W]]) {
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

    fn forward_front(&self, f: usize, local: &mut [[E::Real; W]], base: usize) {
        let front = &self.fronts.fronts[f];
        let (below, own) = local.split_at_mut(front.local - base);
        let own = &mut own[..front.size()];
        if !self.active[f] {
            own[..front.n_own].fill([E::Real::default(); W]);
            return;
        }
        for (x, r) in own.iter_mut().zip(&self.from[front.first..front.first + front.n_own]) {
            *x = std::array::from_fn(|w| E::Real::from_f64(r[w] / self.sizes[w]));
        }
        own[front.n_own..].fill([E::Real::default(); W]);
        for &child in self.fronts.children_of(front) {
            if !self.active[child as usize] {
                continue;
            }
            let child = &self.fronts.fronts[child as usize];
            let passed = &below[child.local - base + child.n_own..][..child.n_rows];
            for (&place, values) in self.fronts.in_parent_of(child).iter().zip(passed) {
                for (sum, &value) in own[place as usize].iter_mut().zip(values) {
                    *sum += value;
                }
            }
        }
        let stored = self.factor.stored(self.fronts, front);
        if W == 1 {
            pulp::Arch::new().dispatch(Eliminate { stored, x: own.as_flattened_mut() });
        } else {
            pulp::Arch::new().dispatch(EliminateWide { stored, x: own });
        }
    }

    /// Back through a subtree; `above` is the local vector of its root's parent.
    fn backward(&self, root: u32, local: &mut [[E::Real; W]], above: Option<&[[E::Real; W]]>) {
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

    fn backward_children(
        &self,
        children: &[u32],
        local: &mut [[E::Real; W]],
        above: &[[E::Real; W]],
    ) {
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

    fn backward_front(
        &self,
        front: &Front,
        own: &mut [[E::Real; W]],
        above: Option<&[[E::Real; W]]>,
    ) {
        if let Some(above) = above {
            let rows = &mut own[front.n_own..];
            for (x, &place) in rows.iter_mut().zip(self.fronts.in_parent_of(front)) {
                *x = above[place as usize];
            }
        }
        let x = &mut own[..front.size()];
        let stored = self.factor.stored(self.fronts, front);
        if W == 1 {
            pulp::Arch::new().dispatch(Substitute { stored, x: x.as_flattened_mut() });
        } else {
            pulp::Arch::new().dispatch(SubstituteWide { stored, x });
        }
    }
}
