"""Estimates of the memory and time that a body will take, from its symbolic analysis, before anything is factored.

The rule for large bodies (``docs/large-bodies.md``): a body is refused if its estimated memory is more than what is
available; above half of that a warning is given. Numbers of bytes and operations below are properties of the code, set
by ``benchmarks/speed/large_bodies.py``; the speed is that of the machine, measured when it is first needed.
"""

import math
import time
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from tissuereg._base.choices import Element
from tissuereg._base.machine import LIMIT, available_bytes, n_cores, resident_bytes
from tissuereg._base.provenance import warn
from tissuereg.errors import LargeBodyError, LargeBodyWarning
from tissuereg.simulation.settings import SIZE

if TYPE_CHECKING:
    from tissuereg.simulation.solve import Simulator


@dataclass(frozen=True)
class BodySize:
    """Size of an analysed body: its mesh, and the Cholesky factor of its stiffness matrix.

    `n_nodes`: nodes of the mesh; `n_tets`: elements; `n_unknowns`: displacement components that are not held;
    `n_entries`: entries of the factor; `flops`: floating-point operations of one factorisation; `n_working`: largest
    number of temporary entries that one thread holds while it computes the factor; `element`: name of the element,
    "tet4", "tet4-averaged" or "tet10".
    """

    n_nodes: int
    n_tets: int
    n_unknowns: int
    n_entries: int
    flops: float
    n_working: int
    element: Element

    @classmethod
    def of(cls, simulator: "Simulator") -> "BodySize":
        """Return the size of the body that a simulator has analysed: nodes, elements, unknowns, factor entries."""
        body, mesh = simulator.body, simulator.mesh
        n_entries, flops, n_working = body.factor_size
        return cls(mesh.n_nodes, mesh.n_tets, body.n_unknowns, n_entries, flops, n_working, simulator.element)


@dataclass(frozen=True)
class Work:
    """The number of operations and stored arrays that a computation on a body needs.

    A factor is the Cholesky factor of the body's stiffness matrix. `factorisations`: expected number of numeric
    factorisations; `factors_held`: number of factors that are held in memory at the same time; `entry_bytes`: bytes per
    entry of a factor; `right_hand_sides`: expected number of solutions with a factor; `fields`: number of nodal vector
    fields (three float64 numbers per node) held at the same time; `tet_fields`: number of float64 numbers per tet held
    at the same time; `later_bytes`: bytes of modules imported and pictures drawn later. They are not part of the rule
    by which a body is refused, since they do not depend on the body; `tet_flops`: all other work per tet, as
    floating-point operations at the speed of matrix products.
    """

    factorisations: int
    factors_held: int
    entry_bytes: int
    right_hand_sides: int
    fields: int
    tet_fields: int
    later_bytes: int = 0
    tet_flops: float = 0.0


#: One static solve: the metric at rest, its factor kept as 16-bit integers, and the iterations of a large deformation.
SOLVE = Work(1, 1, 2, 60, 60, 60)


@dataclass(frozen=True)
class Estimate:
    """Estimated time and memory of a computation on a body.

    `size`: size of the body; `work`: operations and arrays of the computation; `seconds`: wall time in s, while nothing
    else runs on the machine; `added_bytes`: memory that the body takes in addition to what the process holds now;
    `peak_bytes`: largest memory of the whole process; `available_bytes`: memory that the process may still take; None
    if unknown.
    """

    size: BodySize
    work: Work
    seconds: float
    added_bytes: int
    peak_bytes: int
    available_bytes: int | None

    @classmethod
    def of(cls, size: BodySize, work: Work, threads: int) -> "Estimate":
        """Return the estimated time and memory of a computation on a body with a number of threads (0: all cores).

        Cost: about two milliseconds, once per process, to measure the speed of the machine.
        """
        n_threads = min(threads or n_cores(), n_cores())
        flops = work.factorisations * (size.flops + SIZE.per_tet * size.n_tets)
        flops += SIZE.per_entry * size.n_entries * work.right_hand_sides + work.tet_flops * size.n_tets
        element_nodes = size.n_nodes if size.element != "tet10" else max(size.n_nodes, size.n_unknowns // 3)
        # A factor that is kept in fewer bytes is made in single precision.
        making = max(work.entry_bytes, 4) * SIZE.working * size.n_working
        added = work.entry_bytes * work.factors_held * size.n_entries + making
        added += 24.0 * work.fields * element_nodes + 8.0 * work.tet_fields * size.n_tets
        held = work.later_bytes + (resident_bytes() or 0)
        return cls(size, work, flops / (n_threads * product_rate()), int(added), int(added) + held, available_bytes())

    @property
    def is_small(self) -> bool:
        """True if the computation takes less than 1 s and less than 1 GB of additional memory."""
        return self.seconds < 1.0 and self.added_bytes < 1e9

    @property
    def is_long(self) -> bool:
        """True if the computation takes longer than a minute."""
        return self.seconds > SIZE.long_seconds

    @property
    def is_too_large(self) -> bool:
        """True if the computation needs more additional memory than is known to be available."""
        return self.available_bytes is not None and self.added_bytes > self.available_bytes

    def duration(self) -> str:
        """Return the estimated wall time in words, such as "about 7 minutes"."""
        return _duration(self.seconds)

    def sentence(self) -> str:
        """Return one line of text with nodes and tets, and the time and memory that the computation needs."""
        there = "" if self.available_bytes is None else f", {_gb(self.available_bytes)} more are available"
        return (
            f"{self.size.n_nodes:,} nodes, {self.size.n_tets:,} tets: {self.duration()}, "
            f"peak memory {_gb(self.peak_bytes)}{there}"
        )

    def work_sentence(self) -> str:
        """Return one line of text on the work: elements, unknowns, entries of the factor, number of factorisations."""
        size, work = self.size, self.work
        times = f"about {work.factorisations} factorisation{'' if work.factorisations == 1 else 's'}"
        return (
            f"{size.element}, {size.n_unknowns:,} unknowns; a factor has {_count(size.n_entries)} entries "
            f"({_gb(work.entry_bytes * size.n_entries)}) and takes {_figure(size.flops / 1e9)} GFlop; {times}"
        )

    def check(self) -> None:
        """Refuse a body that does not fit into memory, and warn of one that takes more than half of it.

        Raises `LargeBodyError` if the estimated memory is more than what is available; the message names the size of a
        mesh that would fit.
        """
        there = self.available_bytes
        if there is None or self.added_bytes <= SIZE.warned_share * there:
            return
        need = (
            f"this body needs about {_gb(self.added_bytes)} more memory and {_gb(there)} are available "
            f"({self.size.n_nodes:,} nodes, {self.size.element}; a factor has {_count(self.size.n_entries)} "
            "entries)"
        )
        if self.added_bytes > there:
            message = f"a body must fit into memory; {need}: {self._advice(there)}"
            raise LargeBodyError(
                message, where="mesh", needed_bytes=self.added_bytes, available_bytes=self.available_bytes
            )
        warn(need, LargeBodyWarning)

    def _advice(self, there: int) -> str:
        """Return one sentence of advice for a body that does not fit into the available memory of `there` bytes."""
        # Entries of a factor grow with the power 4/3 of the nodes (nested dissection in space).
        share = (SIZE.room * there / self.added_bytes) ** 0.75
        fits = int(float(f"{share * self.size.n_nodes:.2g}"))
        more = f"a machine with more memory; where that is wrong, set {LIMIT} in the environment"
        if fits < SIZE.smallest:
            return f"use {more}"
        coarser = f"use a mesh of at most about {fits:,} nodes (edges {share ** (-1 / 3):.2g} times as long)"
        linear = ", or element 'tet4', which has an eighth of the unknowns" if self.size.element == "tet10" else ""
        return f"{coarser}{linear}, or {more}"


def check_fits(simulator: "Simulator") -> None:
    """Refuse a body of which not even the smallest Cholesky factor would fit into memory.

    `simulator`: the analysed body. The available memory is not looked up for a small body. Raises `LargeBodyError` if
    one factor of 16-bit integers, with the memory for making it, is more than what is available.
    """
    if simulator.body.factor_size[0] < SIZE.large_entries:
        return
    estimate = Estimate.of(BodySize.of(simulator), SOLVE, 0)
    if estimate.is_too_large:
        estimate.check()


@cache
def product_rate() -> float:
    """Return the speed of matrix products on one thread of this machine, in floating-point operations per s."""
    from threadpoolctl import threadpool_limits

    left = np.ones((SIZE.order, SIZE.order), np.float32)
    out = np.empty_like(left)
    spent = []
    with threadpool_limits(limits=1, user_api="blas"):
        for _ in range(SIZE.repeats):
            start = time.perf_counter()
            np.matmul(left, left, out=out)
            spent.append(time.perf_counter() - start)
    return 2.0 * SIZE.order**3 / max(sorted(spent)[SIZE.repeats // 2], 1e-9)


def _figure(value: float) -> str:
    """Return a positive number as text with at least two digits and without an exponent."""
    return f"{value:,.0f}" if value >= 10.0 else f"{max(value, 0.01):.2g}"


def _count(number: int) -> str:
    return f"{number:,}" if number < 1e6 else f"{_figure(number / 1e6)} million"


def _gb(size: float) -> str:
    """Return a number of bytes as text in GB (1e9 bytes)."""
    return f"{_figure(size / 1e9)} GB"


def _duration(seconds: float) -> str:
    """Return a time in s as text, rounded to two digits at most.

    Examples
    --------
    >>> _duration(0.2), _duration(33.0), _duration(400.0), _duration(9000.0)
    ('under a second', 'about 33 s', 'about 7 minutes', 'about 2.5 hours')
    """
    if seconds < 1.0:
        return "under a second"
    if seconds < 100.0:
        return f"about {seconds:.2g} s"
    minutes = seconds / 60.0
    return f"about {math.ceil(minutes)} minutes" if minutes < 100.0 else f"about {minutes / 60.0:.2g} hours"
