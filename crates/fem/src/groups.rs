//! Disjoint groups of items that are joined pair by pair.

/// Items joined pair by pair: the representative of each item.
#[derive(Debug)]
pub(crate) struct Groups(Vec<usize>);

impl Groups {
    /// Every item in a group of its own.
    pub(crate) fn new(n: usize) -> Self {
        Self((0..n).collect())
    }

    fn root(&mut self, mut item: usize) -> usize {
        while self.0[item] != item {
            self.0[item] = self.0[self.0[item]];
            item = self.0[item];
        }
        item
    }

    /// Join the groups of two items.
    pub(crate) fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        let (low, high) = (a.min(b), a.max(b));
        self.0[high] = low;
    }

    /// Group of each item, numbered from 0 in order of appearance.
    pub(crate) fn numbered(mut self) -> Vec<usize> {
        let mut number = vec![usize::MAX; self.0.len()];
        let mut next = 0;
        (0..self.0.len())
            .map(|item| {
                let root = self.root(item);
                if number[root] == usize::MAX {
                    number[root] = next;
                    next += 1;
                }
                number[root]
            })
            .collect()
    }
}
