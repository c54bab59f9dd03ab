r"""A prior fitted on the spot: what this body could be doing, from a few hundred solves of this mesh.

What is believed to act (load, material) or what a simulation says is the centre. Around it every member varies

* Young's modulus, log-normally, and the size and direction of the believed loads and pusher motions;
* a random event of unknown origin (`EventSampler`), added to the load.

The events' size is fitted to the markers: the prior's 90 % range must cover each marker's motion away from the
centre, along that motion. An event is simulated only as far as tissue strains; where the markers ask for more, the
field goes on linearly, since no equilibrium of such a load would look like tissue, and few would be found. The fields'
leading principal components about the centre are the latents.
"""

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg._version import __version__
from tissuereg.errors import EnsembleError
from tissuereg.latent.cache import load_cached, store_cached
from tissuereg.latent.pca import PcaModel
from tissuereg.load import Load
from tissuereg.material import Material
from tissuereg.mesh import Mesh
from tissuereg.simulate.sampling import Event, EventSampler, linear_answers
from tissuereg.simulate.solve import Simulations, Simulator
from tissuereg.simulate.variation import Variation, random_inclusion

#: Members take 10 to 40 iterations. One that needs more than these is beyond what tissue does; it fails instead of
#: holding up the others. The fields only span a prior: forces need not balance further.
_SOLVE = {"tolerance": 1e-4, "max_iterations": 200}

#: How often the random events are halved where the body cannot bear them.
_MOST_HALVINGS = 3

#: Strain up to which four-node members stand for ten-node ones. These give way sooner, and the true body bears its
#: load: where it asks for more, the held-out member is stiffer.
_BORNE_STRAIN = 0.4

#: Half-width of the central 90 % of a unit Gaussian.
_HALF_90 = 1.6449


@dataclass(frozen=True)
class FittedPriorSettings:
    """How a prior is fitted on the spot.

    Parameters
    ----------
    n_members : int
        Simulations.
    n_latent : int
        Principal components kept.
    n_held_out : int
        Further simulations, by another model, that measure what the components miss.
    most_nodes_of_tet10 : int
        Up to this many nodes that other model has ten-node elements.
    variation : Variation
        Spreads of what is believed.
    least_event_share : float
        Random events are at least this share of the centre's largest displacement.
    most_event_share : float
        Random events move no node by more than this share of the body's extent (linear answer).
    most_event_strain : float
        Random events are simulated up to this strain (linear answer, Frobenius norm, exceeded in 1 % of the
        elements); beyond it they are extended linearly.
    """

    n_members: int = 300
    n_latent: int = 26
    n_held_out: int = 16
    most_nodes_of_tet10: int = 2500
    variation: Variation = field(default_factory=Variation)
    least_event_share: float = 0.05
    most_event_share: float = 0.6
    most_event_strain: float = 0.3


@dataclass(frozen=True, eq=False)
class Motion:
    """What the markers saw, in the terms the prior needs.

    Attributes
    ----------
    predict : callable
        Fields (..., n_nodes, 3) to marker displacements (..., n_markers, 3), mm.
    measured : ndarray of float64, shape (n_markers, 3)
        Measured displacement in mm.
    names : tuple of str
        Marker names.
    std : float
        Typical standard deviation of a coordinate, mm.
    """

    predict: Callable[[FloatArray], FloatArray]
    measured: FloatArray
    names: tuple[str, ...]
    std: float


def fit_prior(
    simulator: Simulator,
    motion: Motion,
    *,
    load: Load | None = None,
    material: Material | None = None,
    simulation: FloatArray | None = None,
    settings: FittedPriorSettings | None = None,
    seed: int = 0,
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> PcaModel:
    """Return a latent model of this body around what is believed of this moment.

    Parameters
    ----------
    simulator : Simulator
        The analysed body.
    motion : Motion
        What the markers saw; sizes the random events.
    load : Load, optional
        What is believed to act; none where absent.
    material : Material, optional
        What is believed of the material.
    simulation : ndarray of float64, shape (n_nodes, 3), optional
        The centre; the solution under `load` where absent, the rest shape where that is absent too.
    settings : FittedPriorSettings, optional
        Sizes and spreads.
    seed : int
        Of the random events.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    progress : callable of (int, int), optional
        Called with members finished and members in all.

    Returns
    -------
    PcaModel
        About the centre.

    Raises
    ------
    EnsembleError
        If fewer than half of the members find equilibrium.
    ConvergenceError
        If the believed load itself finds none.

    Warns
    -----
    UserWarning
        Names the markers whose motion the prior's 90 % range cannot cover; says when the body could not bear the loads.

    Notes
    -----
    Cost: `n_members` solves. The result is cached by the content of everything it depends on.
    """
    settings = settings or FittedPriorSettings()
    material = material or Material()
    if simulation is None and load is not None:
        simulation = simulator.solve(load, material, threads=threads).displacement
    centre = np.zeros((simulator.mesh.n_nodes, 3)) if simulation is None else simulation
    rng = np.random.default_rng([seed, 1])
    sampler = EventSampler(simulator.mesh, held_nodes=simulator.held_nodes)
    events = [sampler.draw(rng) for _ in range(settings.n_held_out + settings.n_members)]
    answers, unit = linear_answers(simulator, events, material, threads=threads)
    share = rng.uniform(0.1, 1.0, len(events))
    size, uncovered = _event_size(simulator, motion, centre, answers * share[:, None, None], settings)
    if uncovered:
        _warn_uncovered(uncovered)
    key = _key(simulator, centre, load, material, settings, size, seed)
    cached = load_cached(key)
    if cached is not None:
        return cached
    variations = [settings.variation.draw(load or Load(), material, rng) for _ in events]
    young = [np.median(material.young_array), *(np.median(v[1].young_array) for v in variations)]
    softer = young[0] / np.array(young[1:])
    borne = np.minimum(share * size, settings.most_event_strain / (softer * _strains(simulator.mesh, answers)))
    n = settings.n_held_out
    found, loaded = _solve_members(simulator, events[n:], (borne * unit)[n:], variations[n:], threads, progress)
    beyond = (softer * (share * size - loaded * borne))[:, None, None] * answers
    fields = found.displacement[found.solved] + beyond[n:][found.solved]
    others = _held_out(simulator, events, loaded * borne * unit, variations, settings, rng, threads)
    if simulation is not None and load is None:
        # A foreign simulation's load is unknown: its own shape, softer or stiffer, stands for the modulus.
        softness = np.exp(settings.variation.young_log_std * rng.standard_normal(len(fields) + len(others)))
        fields = fields + softness[: len(fields), None, None] * simulation
        others = others + softness[len(fields) :, None, None] * simulation
    model = PcaModel.fit(
        fields,
        others,
        centre=centre,
        n_latent=settings.n_latent,
        card={
            "kind": "pca",
            "source": "fitted here",
            "members": len(fields),
            "held_out": len(others),
            "event_size_mm": size,
        },
    )
    model.card["pca26_test_error_mm"] = model.card.get("test_error_mm")
    store_cached(key, model)
    return model


def _solve_members(
    simulator: Simulator,
    events: list[Event],
    scale: FloatArray,
    variations: list[tuple[Load, Material]],
    threads: int,
    progress: Callable[[int, int], None] | None,
) -> tuple[Simulations, float]:
    """Return the members' solutions and the share of the events that the body could bear."""
    report = None if progress is None else (lambda done: progress(done, len(events)))
    for halvings in range(_MOST_HALVINGS + 1):
        share = 0.5**halvings
        loads = [e.load(simulator, share * s, v[0]) for e, s, v in zip(events, scale, variations, strict=True)]
        found = simulator.solve_many(loads, [v[1] for v in variations], threads=threads, progress=report, **_SOLVE)
        if len(found.solved) >= len(events) // 2:
            if halvings:
                warnings.warn(
                    f"the body cannot bear the loads that its markers' motion asks for: {len(events)} simulations "
                    f"were repeated at {share:.3g} of their size and extended linearly. Give the load or a "
                    "simulation",
                    stacklevel=4,
                )
            return found, share
    message = (
        f"at least half of the {len(events)} simulations behind the prior must find equilibrium, {len(found.solved)} "
        f"did; first failure: {found.failed[0][1]}"
    )
    raise EnsembleError(message, dropped=found.failed)


def _held_out(
    simulator: Simulator,
    events: list[Event],
    scale: FloatArray,
    variations: list[tuple[Load, Material]],
    settings: FittedPriorSettings,
    rng: np.random.Generator,
    threads: int,
) -> FloatArray:
    """Return fields of another model: a stiff ball somewhere and, on small meshes, ten-node elements."""
    mesh = simulator.mesh
    small = mesh.n_nodes <= settings.most_nodes_of_tet10
    other = Simulator(mesh, element="tet10", held_nodes=simulator.held_nodes) if small else simulator
    n = settings.n_held_out
    acting = list(zip(events[:n], scale[:n], variations[:n], strict=True))
    materials = [v[1].scaled(random_inclusion(mesh, rng, *_inclusion_range(mesh))) for v in variations[:n]]
    if other.element != simulator.element:
        twins = [e.load(simulator, s, v[0]) for e, s, v in acting]
        strains = _strains(mesh, simulator.solve_many(twins, materials, threads=threads, **_SOLVE).displacement)
        stiffer = np.fmax(1.0, strains / _BORNE_STRAIN)
        materials = [m.scaled(float(factor)) for m, factor in zip(materials, stiffer, strict=True)]
    loads = [e.load(other, s, v[0]) for e, s, v in acting]
    found = other.solve_many(loads, materials, threads=threads, **_SOLVE)
    return found.displacement[found.solved]


def _inclusion_range(mesh: Mesh) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return ranges of radius in mm and contrast of the stiff ball that a body may hide."""
    extent = mesh.extent
    return (0.05 * extent, 0.12 * extent), (1.0, 5.0)


def _strains(mesh: Mesh, fields: FloatArray) -> FloatArray:
    """Return the linear strain (Frobenius norm) that 1 % of the elements exceed in each field, (n_fields,)."""
    corners = mesh.nodes[mesh.tets]
    inverse = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    strains = np.empty(len(fields))
    for row, displacement in enumerate(fields):
        moved = displacement[mesh.tets]
        gradient = inverse @ (moved[:, 1:] - moved[:, :1])
        norm = np.linalg.norm(0.5 * (gradient + gradient.transpose(0, 2, 1)), axis=(1, 2))
        strains[row] = np.quantile(norm, 0.99)
    return np.maximum(strains, 1e-12)


def _event_size(
    simulator: Simulator,
    motion: Motion,
    centre: FloatArray,
    answers: FloatArray,
    settings: FittedPriorSettings,
) -> tuple[float, list[str]]:
    """Return the size of the largest events in mm and the markers that no size covers."""
    seen = motion.predict(centre)
    wanted = motion.measured - seen
    length = np.linalg.norm(wanted, axis=1)
    towards = wanted / np.maximum(length, 1e-12)[:, None]
    along = np.einsum("emx,mx->em", motion.predict(answers), towards)
    per_size = np.sqrt(np.mean(along**2, axis=0))
    # What the modulus alone explains: the centre's own motion, stretched.
    explained = settings.variation.young_log_std * np.abs(np.einsum("mx,mx->m", seen, towards))
    missing = np.sqrt(np.maximum((length / _HALF_90) ** 2 - explained**2, 0.0))
    extent = simulator.mesh.extent
    most = settings.most_event_share * extent
    least = max(settings.least_event_share * float(np.linalg.norm(centre, axis=1).max()), 3.0 * motion.std)
    needed = missing / np.maximum(per_size, 1e-12)
    size = float(np.clip(needed.max(initial=0.0), least, most))
    # Rounded up on a coarse scale, so that neighbouring frames share one cached prior.
    size = min(float(1.15 ** np.ceil(np.log(size) / np.log(1.15))), max(most, least))
    return size, [name for name, n in zip(motion.names, needed, strict=True) if n > size * (1 + 1e-9)]


def _warn_uncovered(names: list[str]) -> None:
    warnings.warn(
        f"the prior's 90 % range cannot cover the motion of: {', '.join(names)}; loads large enough would distort the "
        "body beyond use. Give the load or a simulation, or check these markers",
        stacklevel=3,
    )


def _key(
    simulator: Simulator,
    centre: FloatArray,
    load: Load | None,
    material: Material,
    settings: FittedPriorSettings,
    size: float,
    seed: int,
) -> str:
    digest = hashlib.sha256(f"{__version__} {settings} {size!r} {seed} {simulator.element}".encode())
    digest.update(simulator.mesh.digest().encode())
    digest.update(simulator.held_nodes.tobytes())
    digest.update(np.round(centre * 1e6).tobytes())
    digest.update(material.digest().encode())
    load = load or Load()
    parts: list[Any] = [load.forces, load.body_force, load.prescribed, *(load.traction or (None, None))]
    for part in parts:
        digest.update(b"|" if part is None else np.asarray(part, np.float64).tobytes())
    return digest.hexdigest()
