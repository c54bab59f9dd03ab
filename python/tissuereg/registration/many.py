"""Registration of one body at many moments of a recording, each on its own, in this process or in several.

All that depends only on the body and the reference places of its markers is computed once in every process, in a
`Registrar`.
"""

import hashlib
import inspect
import pickle
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from tissuereg._base.arguments import called, check_choice, check_running, found, maybe, of_kind
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg._base.provenance import derived, note_origins, recorded
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError
from tissuereg.parallel import Executor, Failed, Finished, InProcess, in_order
from tissuereg.registration.body import Body
from tissuereg.registration.contacts.result import ContactRegistration
from tissuereg.registration.inputs import as_markers
from tissuereg.registration.learned.registration import as_model
from tissuereg.registration.register import register
from tissuereg.registration.registrar import Registrar
from tissuereg.registration.result import Registration
from tissuereg.registration.settings import RegisterSettings

#: Arguments of `register` that belong to one moment, or to a caller in the same process.
_OF_ONE = {"mesh", "markers", "surface", "progress"}
_OPTIONS = tuple(name for name in inspect.signature(register).parameters if name not in _OF_ONE)

#: What registers the last body of this process, by its fingerprint.
_KEPT: dict[str, "_Moments"] = {}
_KEEPING = threading.Lock()


def register_many(
    mesh: Mesh | Body | tuple[Any, Any, Any],
    markers: Markers | tuple[Any, Any] | Iterable[Markers | tuple[Any, Any]],
    measured: Any = None,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
    **options: Any,
) -> Iterator[Registration | Failed]:
    """Register one body at many moments, each on its own; every result equals that of `register`, bit for bit.

    Parameters
    ----------
    mesh : Mesh, Body or (nodes, tets, fixed_nodes)
        Undeformed body in mm; a `Body` is a mesh with its assumed material, elements and supports.
    markers : iterable of Markers or (reference, measured); or Markers or (reference, measured) alone
        The markers of each moment, mm; the iterable is read as moments are needed. With `measured`, a single set of
        markers, whose measured places are replaced by those of each moment.
    measured : array_like of float, shape (n_moments, n_markers, 3), optional
        Measured places of every moment in mm; NaN = not seen.
    executor : tissuereg.parallel.Executor, optional
        Computes the registrations, in other processes or on other machines; by default in this process, one after
        another.
    progress : callable of int, optional
        Called with the number of moments that are registered.
    **options
        Further arguments of `register`: ``model``, ``simulation``, ``targets``, ``load``, ``seed``, ``settings``; the
        same for every moment. Where there is an `executor`, registrations on all cores (``threads`` 0) take one thread
        each, and a ``model`` must be given by its folder.

    Yields
    ------
    Registration or Failed
        One for each moment, in the order of the moments; a `Failed` holds the error of a moment that could not be
        registered. The standard deviations of the nodes are computed with each; `Registration.draws` registers that
        moment again, in this process.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or is out of its range, or an option is unknown or cannot be sent to another
        process.
    MeshError, MarkerError, ShapeError
        If `mesh` is not a mesh, `markers` are not markers, or they do not fit each other.
    ClusterError
        If the executor loses its workers.

    Notes
    -----
    To other processes pass, for each moment, mesh and options as well, and back displacement and covariances of the
    nodes: less than 1 MB each way for 4,000 nodes, beside a registration of some tenths of a second or more.

    Examples
    --------
    >>> from tissuereg.phantom.event import make_event
    >>> event = make_event(seed=0, size="small")
    >>> moved = [event.markers.measured, event.markers.measured + 0.05]
    >>> [result.trust.ok for result in register_many(event.mesh, event.markers, moved)]
    [True, True]
    """
    for name in options:
        check_choice("option", name, _OPTIONS, ArgumentError)
    check_running(seed=options.get("seed", 0))
    called("progress", progress)
    how = maybe("settings", options.get("settings"), RegisterSettings) or RegisterSettings()
    if executor is not None:
        of_kind("executor", executor, Executor)
        how = replace(how, threads=how.threads or 1)
    if options.get("model") is not None:
        how = replace(how, readings="always")  # each moment is a first one
    run = _Moments(Body.of(mesh), {**options, "settings": how})
    return _registered(run, _moments(markers, measured), executor, progress)


@dataclass(frozen=True)
class _Task:
    """The registration of one moment as a task that is sent to another process.

    `mark`: fingerprint (SHA-256, hexadecimal) of body and options; `packed`: body and options as bytes, for a process
    that has not kept them; `markers`: reference and measured places at this moment, mm.
    """

    mark: str
    packed: bytes
    markers: Markers


class _Moments:
    """Function that registers one body at any moment; its results can be sent to another process.

    `body`: prior assumptions about the undeformed body; `options`: further arguments of `register` by name, among them
    ``settings``.
    """

    def __init__(self, body: Body, options: dict[str, Any]) -> None:
        self.body, self.options = body, options
        self._registrar: Registrar | None = None

    def packed(self) -> bytes:
        """Return body and options as bytes (pickle); raise `ArgumentError` if an option cannot be sent to a process."""
        try:
            return pickle.dumps((self.body, self.options), protocol=pickle.HIGHEST_PROTOCOL)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            message = f"options must be values that other processes can be sent, a model by its folder; {error}"
            raise ArgumentError(message, where="options") from error

    def with_model(self) -> "_Moments":
        """Return the same function with the files of the trained model read into memory; or itself without a model."""
        if self.options.get("model") is None:
            return self
        model = as_model(self.options["model"], self.body.mesh, self.options["settings"].threads)
        return _Moments(self.body, {**self.options, "model": model})

    def register(self, markers: Markers) -> Registration:
        """Return the registration of `markers` at one moment; the registrar is kept while reference places stay."""
        if self._registrar is None:
            options = {name: value for name, value in self.options.items() if name != "simulation"}
            self._registrar = Registrar(self.body, markers, **options)
        self._registrar = self._registrar.made_for(markers)
        return self._registrar.register(markers, self.options.get("simulation"))

    def __call__(self, markers: Markers) -> Registration:
        """Return the registration of the moment of `markers`, without the parts that cannot or need not be sent.

        The body and the function that draws posterior fields are left out; spread of the nodes and linear elastic
        estimate are computed.
        """
        result = self.register(markers)
        parts: dict[str, Any] = {
            "body": None,
            "deviations": _Computed(result.uncertainty),
            "linear": _Computed(result.fallback),
        }
        if isinstance(result, ContactRegistration):
            parts |= {"draw": None, "search": _Computed(result.contacts)}
        return replace(result, **parts)

    def completed(self, result: Registration, markers: Markers) -> Registration:
        """Return `result` with its body, and, without a trained model, with a function that draws posterior fields."""
        if isinstance(result, ContactRegistration):
            result = replace(result, draw=_Again(self, markers))
        # Another process does not know from which files it was sent what it registers.
        with recorded() as record:
            note_origins(self.body.mesh, self.body.material, markers, *self.options.values())
        return replace(result, body=self.body, provenance=result.provenance.also_of(record))


@dataclass(frozen=True)
class _Computed:
    """Function without arguments that returns `values`, in place of one that would compute them when it is called."""

    values: Any

    def __call__(self) -> Any:
        return self.values


@dataclass(frozen=True, eq=False)
class _Again:
    """Function that draws posterior displacement fields, (count, n_nodes, 3), mm, by registering a moment again.

    `moments`: registers the body in this process; `markers`: reference and measured places at the moment, mm.
    """

    moments: _Moments
    markers: Markers

    def __call__(self, count: int) -> FloatArray:
        return self.moments.register(self.markers).draws(count)


def _moments(markers: Any, measured: Any) -> Iterator[Markers]:
    """Return an iterator over the markers of each moment; an error of a single moment is raised when it is reached.

    `markers`: iterable of `Markers` or pairs (reference, measured), mm; or, if `measured` (n_moments, n_markers, 3), in
    mm, is given, the markers whose measured places it replaces. Raises `ArgumentError` if they do not give many
    moments.
    """
    if measured is not None:
        base = as_markers(of_kind("markers", markers, (Markers, tuple)))
        places = float_array("measured", measured, (None, len(base), 3))
        return (derived(Markers(base.reference, moment, base.axis_std, base.names), base) for moment in places)
    if isinstance(markers, Markers | str | bytes) or not isinstance(markers, Iterable):
        message = f"`markers` must be those of many moments, or `measured` be given; got {found(markers)}"
        raise ArgumentError(message, where="markers")
    return map(as_markers, markers)


def _registered(
    run: _Moments, moments: Iterator[Markers], executor: Executor | None, progress: Callable[[int], None] | None
) -> Iterator[Registration | Failed]:
    taken: dict[int, Markers] = {}
    here = InProcess() if executor is None else executor

    def noted() -> Iterator[Markers]:
        for index, markers in enumerate(moments):
            taken[index] = markers
            yield markers

    if executor is None:
        outcomes = here.run(run.with_model(), noted())
    else:
        packed = run.packed()
        mark = hashlib.sha256(packed).hexdigest()
        outcomes = here.run(_register_moment, (_Task(mark, packed, markers) for markers in noted()))
    for outcome in in_order(_without_slips(outcomes), progress):
        markers = taken.pop(outcome.index)
        yield outcome if isinstance(outcome, Failed) else run.completed(outcome.result, markers)


def _without_slips(outcomes: Iterator[Finished | Failed]) -> Iterator[Finished | Failed]:
    """Yield the outcomes of registrations unchanged, but raise an `ArgumentError`, which concerns all moments."""
    for outcome in outcomes:
        if isinstance(outcome, Failed) and isinstance(outcome.error, ArgumentError):
            raise outcome.error
        yield outcome


def _register_moment(task: _Task) -> Registration:
    """Return the registration of one moment, computed in a worker process with the registrar that it has kept."""
    with _KEEPING:
        kept = _KEPT.get(task.mark)
        if kept is None:
            _KEPT.clear()  # a worker is busy with one body
            kept = _KEPT[task.mark] = _Moments(*pickle.loads(task.packed))
    return kept(task.markers)
