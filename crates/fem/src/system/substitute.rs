//! Solutions with a factor: forward and back through the fronts.
//!
//! Every front has a local vector: its own unknowns, then its rows. Going forward it collects what
//! its children pass on; going back it reads its rows from its parent's. No two subtrees touch the
//! same numbers, so that they can run at the same time with the same bits.

use super::factor::{Factor, Numeric, Precision};
use super::fronts::{Front, Fronts, STEP, Step};

/// Numbers summed side by side.
const LANES: usize = 16;

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
            Self::Single(f) => {
                f.solve_into(fronts, scale, rhs, out, &mut scratch.single, parallel);
            }
            Self::Double(f) => {
                f.solve_into(fronts, scale, rhs, out, &mut scratch.double, parallel);
            }
        }
    }
}

impl<T: Precision> Numeric<T> {
    fn solve_into(
        &self,
        fronts: &Fronts,
        scale: f64,
        rhs: &[f64],
        out: &mut [f64],
        local: &mut Vec<T>,
        parallel: bool,
    ) {
        // Single precision has a narrow range of exponents: bring the right-hand side to size 1.
        let size = rhs.iter().fold(0.0_f64, |m, r| m.max(r.abs()));
        if size == 0.0 || !size.is_finite() {
            out.fill(if size == 0.0 { 0.0 } else { f64::NAN });
            return;
        }
        local.resize(fronts.n_local, T::default());
        let solving = Solving { fronts, panels: &self.panels, parallel, from: rhs, size };
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

struct Solving<'a, T> {
    fronts: &'a Fronts,
    panels: &'a [T],
    parallel: bool,
    from: &'a [f64],
    size: f64,
}

impl<T: Precision> Solving<'_, T> {
    fn splits(&self, front: &Front) -> bool {
        let first = &self.fronts.fronts[front.first_below];
        self.parallel && front.children.len() > 1 && front.panel - first.panel > PARALLEL_ENTRIES
    }

    /// Forward through a subtree with the local vectors `local`.
    fn forward(&self, root: u32, local: &mut [T]) {
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

    fn forward_children(&self, children: &[u32], local: &mut [T]) {
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

    fn forward_front(&self, front: &Front, local: &mut [T], base: usize) {
        let (below, own) = local.split_at_mut(front.local - base);
        let own = &mut own[..front.size()];
        for (x, r) in own.iter_mut().zip(&self.from[front.first..front.first + front.n_own]) {
            *x = T::from_f64(r / self.size);
        }
        own[front.n_own..].fill(T::default());
        for &child in self.fronts.children_of(front) {
            let child = &self.fronts.fronts[child as usize];
            let passed = &below[child.local - base + child.n_own..][..child.n_rows];
            for (&place, &value) in self.fronts.in_parent_of(child).iter().zip(passed) {
                own[place as usize] += value;
            }
        }
        let panel = &self.panels[front.panel..];
        pulp::Arch::new().dispatch(Eliminate { front, panel, x: own });
    }

    /// Back through a subtree; `above` is the local vector of its root's parent.
    fn backward(&self, root: u32, local: &mut [T], above: Option<&[T]>) {
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

    fn backward_children(&self, children: &[u32], local: &mut [T], above: &[T]) {
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

    fn backward_front(&self, front: &Front, own: &mut [T], above: Option<&[T]>) {
        if let Some(above) = above {
            let rows = &mut own[front.n_own..];
            for (x, &place) in rows.iter_mut().zip(self.fronts.in_parent_of(front)) {
                *x = above[place as usize];
            }
        }
        let panel = &self.panels[front.panel..];
        pulp::Arch::new().dispatch(Substitute { front, panel, x: &mut own[..front.size()] });
    }
}

/// Forward through one panel; as a type, so that it is compiled for the processor at hand.
struct Eliminate<'a, T> {
    front: &'a Front,
    panel: &'a [T],
    x: &'a mut [T],
}

impl<T: Precision> pulp::WithSimd for Eliminate<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        eliminate(self.front, self.panel, self.x);
    }
}

/// Back through one panel.
struct Substitute<'a, T> {
    front: &'a Front,
    panel: &'a [T],
    x: &'a mut [T],
}

impl<T: Precision> pulp::WithSimd for Substitute<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        substitute(self.front, self.panel, self.x);
    }
}

/// `x_own <- L_own⁻¹ x_own`, `x_rows <- x_rows − L_rows x_own`.
#[inline(always)]
fn eliminate<T: Precision>(front: &Front, panel: &[T], x: &mut [T]) {
    for step in front.steps() {
        let Step { first, n_columns, begin, n_rows } = step;
        let columns = &panel[begin..begin + n_columns * n_rows];
        let x = &mut x[first..];
        for c in 0..n_columns {
            let column = &columns[c * n_rows..(c + 1) * n_rows];
            let value = x[c] / column[c];
            x[c] = value;
            for i in c + 1..n_columns {
                x[i] -= column[i] * value;
            }
        }
        let (v, rest) = x.split_at_mut(n_columns);
        let column = |c: usize| &columns[c * n_rows + n_columns..(c + 1) * n_rows];
        if n_columns == STEP {
            for c in [0, 4] {
                subtract_columns(
                    rest,
                    [column(c), column(c + 1), column(c + 2), column(c + 3)],
                    [v[c], v[c + 1], v[c + 2], v[c + 3]],
                );
            }
        } else {
            for c in 0..n_columns {
                for (r, &l) in rest.iter_mut().zip(column(c)) {
                    *r -= l * v[c];
                }
            }
        }
    }
}

/// `x <- x − Σ_c columns_c v_c`
#[inline(always)]
fn subtract_columns<T: Precision>(x: &mut [T], columns: [&[T]; 4], v: [T; 4]) {
    let n = x.len();
    let [a, b, c, d] = columns;
    let (a, b, c, d) = (&a[..n], &b[..n], &c[..n], &d[..n]);
    for i in 0..n {
        x[i] -= (a[i] * v[0] + b[i] * v[1]) + (c[i] * v[2] + d[i] * v[3]);
    }
}

/// `x_own <- L_own⁻ᵀ (x_own − L_rowsᵀ x_rows)`.
#[inline(always)]
fn substitute<T: Precision>(front: &Front, panel: &[T], x: &mut [T]) {
    for step in front.steps().rev() {
        let Step { first, n_columns, begin, n_rows } = step;
        let columns = &panel[begin..begin + n_columns * n_rows];
        let (head, rest) = x[first..].split_at_mut(n_columns);
        let column = |c: usize| &columns[c * n_rows + n_columns..(c + 1) * n_rows];
        if n_columns == STEP {
            for c in [0, 4] {
                let sums = products([column(c), column(c + 1), column(c + 2), column(c + 3)], rest);
                for k in 0..4 {
                    head[c + k] -= sums[k];
                }
            }
        } else {
            for c in 0..n_columns {
                head[c] -= product(column(c), rest);
            }
        }
        for c in (0..n_columns).rev() {
            let column = &columns[c * n_rows..(c + 1) * n_rows];
            let mut value = head[c];
            for i in c + 1..n_columns {
                value -= column[i] * head[i];
            }
            head[c] = value / column[c];
        }
    }
}

/// Scalar products of four columns with a vector, summed in fixed lanes.
#[inline(always)]
fn products<T: Precision>(columns: [&[T]; 4], x: &[T]) -> [T; 4] {
    let mut sums = [T::default(); 4];
    let [a, b, c, d] = columns;
    let mut lanes = [[T::default(); LANES]; 4];
    let (x_chunks, x_rest) = x.as_chunks::<LANES>();
    let (a_chunks, a_rest) = a.as_chunks::<LANES>();
    let (b_chunks, b_rest) = b.as_chunks::<LANES>();
    let (c_chunks, c_rest) = c.as_chunks::<LANES>();
    let (d_chunks, d_rest) = d.as_chunks::<LANES>();
    for ((((y, a), b), c), d) in
        x_chunks.iter().zip(a_chunks).zip(b_chunks).zip(c_chunks).zip(d_chunks)
    {
        for k in 0..LANES {
            lanes[0][k] += a[k] * y[k];
            lanes[1][k] += b[k] * y[k];
            lanes[2][k] += c[k] * y[k];
            lanes[3][k] += d[k] * y[k];
        }
    }
    let rests = [a_rest, b_rest, c_rest, d_rest];
    for c in 0..4 {
        for k in 0..LANES {
            sums[c] += lanes[c][k];
        }
        for (l, y) in rests[c].iter().zip(x_rest) {
            sums[c] += *l * *y;
        }
    }
    sums
}

/// Scalar product, summed in fixed lanes.
#[inline(always)]
fn product<T: Precision>(column: &[T], x: &[T]) -> T {
    let mut lanes = [T::default(); LANES];
    let (x_chunks, x_rest) = x.as_chunks::<LANES>();
    let (chunks, rest) = column.as_chunks::<LANES>();
    for (y, a) in x_chunks.iter().zip(chunks) {
        for k in 0..LANES {
            lanes[k] += a[k] * y[k];
        }
    }
    let mut sum = T::default();
    for lane in lanes {
        sum += lane;
    }
    for (l, y) in rest.iter().zip(x_rest) {
        sum += *l * *y;
    }
    sum
}
