"""Sensitivities of observations to nodal forces, as sums of rows that are kept, and what is linear in them."""

import threading
from collections.abc import Callable, Hashable, Iterator

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.simulation.sensitivity import Compliance

Row = tuple[IntArray, FloatArray]


class KeptRows:
    """Rows of observations whose sensitivities are kept, in the order of their first use, and what is linear in them.

    Rows that are sums of kept ones of the same nodes (a place seen along other axes) need no solution of their own.
    """

    def __init__(self) -> None:
        self._index: dict[bytes, int] = {}
        self._blocks: list[Compliance] = []
        self._by_nodes: dict[bytes, tuple[list[int], FloatArray, FloatArray]] = {}
        self._images: dict[Hashable, FloatArray] = {}
        self.lock = threading.Lock()

    def copy(self) -> "KeptRows":
        """Return the same rows, to which others can be added than to these; sensitivities are shared."""
        made = KeptRows()
        with self.lock:
            made._index, made._blocks = dict(self._index), list(self._blocks)
            made._by_nodes, made._images = dict(self._by_nodes), dict(self._images)
        return made

    def __len__(self) -> int:
        return len(self._index)

    def shares(self, rows: dict[bytes, Row]) -> dict[bytes, tuple[list[int], FloatArray]]:
        """Return the numbers of kept rows and the share of each, for those of some observations that are their sums."""
        found = {key: ([self._index[key]], np.ones(1)) for key in rows if key in self._index}
        for name, keys in _by_nodes({key: row for key, row in rows.items() if key not in found}).items():
            if name not in self._by_nodes:
                continue
            numbers, known, inverse = self._by_nodes[name]
            wanted = np.stack([rows[key][1].ravel() for key in keys])
            shares = wanted @ inverse
            off = np.abs(shares @ known - wanted).max(axis=1)
            # Shares are small unless the known rows are nearly alike: then their errors would be multiplied.
            sums = (off <= 1e-12 * np.abs(wanted).max(axis=1)) & (np.abs(shares).max(axis=1) <= 2.0)
            found |= {keys[i]: (numbers, shares[i]) for i in np.flatnonzero(sums)}
        return found

    def add(self, rows: dict[bytes, Row], parts: Compliance) -> None:
        """Keep further rows, with their sensitivities in the same order."""
        first = len(self)
        self._index |= {key: first + i for i, key in enumerate(rows)}
        self._blocks.append(parts)
        for name, keys in _by_nodes(rows).items():
            numbers, weights = [self._index[key] for key in keys], np.stack([rows[key][1].ravel() for key in keys])
            if name in self._by_nodes:
                before = self._by_nodes[name]
                numbers, weights = [*before[0], *numbers], np.concatenate([before[1], weights])
            self._by_nodes[name] = numbers, weights, np.asarray(np.linalg.pinv(weights), np.float64)

    def blocks(self) -> Iterator[tuple[int, Compliance]]:
        """Yield the kept sensitivities in parts, each with the number of its first row."""
        first = 0
        for block in self._blocks:
            yield first, block
            first += len(block.forces)

    def image(self, name: Hashable, make: Callable[[Compliance], FloatArray]) -> FloatArray:
        """Return what a function linear in the sensitivities makes of all kept rows, (n_kept, ...).

        `name`: the function's, under which its values are kept.
        """
        done = self._images.get(name)
        parts, n_done = ([], 0) if done is None else ([done], len(done))
        parts += [make(block) for first, block in self.blocks() if first >= n_done]
        whole = parts[0] if len(parts) == 1 else np.concatenate(parts)
        self._images[name] = whole
        return whole


class Sensed:
    """The sensitivities of observations to nodal forces, and what is linear in them.

    `own`: their sensitivities, where they are not kept; or `kept` and `shares` (n, n_kept): the observations as sums of
    kept rows.
    """

    def __init__(self, own: Compliance | None, kept: KeptRows | None = None, shares: FloatArray | None = None) -> None:
        self._own, self._kept = own, KeptRows() if kept is None else kept
        self._shares = shares = np.zeros((0, 0)) if shares is None else shares
        row, which = np.nonzero(shares)
        alone = np.array_equal(row, np.arange(len(shares))) and bool((shares[row, which] == 1.0).all())
        self._which = which if alone else None

    def image(self, name: Hashable | None, make: Callable[[Compliance], FloatArray]) -> FloatArray:
        """Return what a function linear in the sensitivities makes of them, (n, ...).

        `name`: the function's, under which its values for kept rows are kept; None not to keep them.
        """
        if self._own is not None:
            return make(self._own)
        if name is None:
            return self._made(make)
        whole = self._kept.image(name, make)
        if self._which is not None:
            return whole[self._which]
        return np.asarray(np.tensordot(self._shares, whole[: self._shares.shape[1]], 1))

    def _made(self, make: Callable[[Compliance], FloatArray]) -> FloatArray:
        """Return what a function makes of them, of no more kept rows at a time than were added together."""
        found: FloatArray | None = None
        for first, block in self._kept.blocks():
            shares = self._shares[:, first : first + len(block.forces)]
            rows = np.flatnonzero(shares.any(axis=1))
            if not len(rows) and found is not None:
                continue
            values = make(block)
            if found is None:
                found = np.zeros((len(self._shares), *values.shape[1:]))
            if self._which is not None:
                found[rows] = values[self._which[rows] - first]
            else:
                found[rows] += np.tensordot(shares[rows], values, 1)
        assert found is not None  # sums are of kept rows, of which there are some
        return found

    @property
    def compliance(self) -> Compliance:
        """The sensitivities themselves, one row per observation, mm per mN."""
        if self._own is not None:
            return self._own
        parts = (lambda one: one.forces, lambda one: one.body_force, lambda one: one.prescribed)
        return Compliance(*(self.image(None, part) for part in parts))


def matrix(keys: list[bytes], shares: dict[bytes, tuple[list[int], FloatArray]], n_kept: int) -> FloatArray:
    """Return the shares of kept rows in each of some observations, (n, n_kept)."""
    found = np.zeros((len(keys), n_kept))
    for row, key in enumerate(keys):
        numbers, share = shares[key]
        found[row, numbers] = share
    return found


def _by_nodes(rows: dict[bytes, Row]) -> dict[bytes, list[bytes]]:
    """Return the keys of observations by their nodes."""
    found: dict[bytes, list[bytes]] = {}
    for key, (nodes, _) in rows.items():
        found.setdefault(nodes.tobytes(), []).append(key)
    return found


def apart(whole: Compliance) -> list[Compliance]:
    """Return the sensitivities of many observations to nodal forces as a list with one entry for each observation."""
    return [
        Compliance(whole.forces[i : i + 1], whole.body_force[i : i + 1], whole.prescribed[i : i + 1])
        for i in range(len(whole.forces))
    ]


def together(parts: list[Compliance]) -> Compliance:
    """Return the sensitivities of all parts, one after the other."""
    if len(parts) == 1:
        return parts[0]
    return Compliance(
        np.concatenate([part.forces for part in parts]),
        np.concatenate([part.body_force for part in parts]),
        np.concatenate([part.prescribed for part in parts]),
    )


__all__ = ["KeptRows", "Row", "Sensed", "apart", "matrix", "together"]
