"""Is the spread honest?  -> archive/, RESULTS.md.

    python -m spread.spread --make-foreign FOREIGN     # shapes with other physics, resumable (spread-foreign.toml)
    python -m spread.spread --model MODEL --data DATA --foreign FOREIGN
    python -m spread.spread --page                     # write the page of the figures that are there

Every shape is registered from 15 random markers on its free surface (noise 0.1 mm), with 20 random inner
points. The shapes: the test split of DATA, and foreign ones, registered with the believed model's simulation of the
same event. FOREIGN has those that calibrate in `development`, and those that are registered in `test`.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import beta
from scipy.stats import chi2, f, norm
from scipy.stats import t as student

import tissuereg as tr
from common import read_archive, write_archive
from tissuereg._base.machine import machine, versions
from tissuereg.body.mesh import free_surface
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.errors import EnsembleError, MarkerError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.fields import read_pairs
from tissuereg.registration.learned.assimilate import AssimilationSettings, assimilate
from tissuereg.registration.learned.calibrate import RehearsalSettings, calibrate, codes_of
from tissuereg.registration.learned.calibration_file import CALIBRATION_NAME
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.pca import PcaModel
from tissuereg.registration.learned.spread_law import COMMON, squared_radius
from tissuereg.simulation.chunks import ChunkMaker
from tissuereg.simulation.pairs import simulated_pairs
from tissuereg.simulation.recipe import read_recipe

HERE = Path(__file__).resolve().parent
OUT, TABLES = HERE / "archive", ("sets/<set>/<method>",)
#: Folders of foreign pairs: those that calibrate, and those that are asked.
FOREIGN_PARTS = ("development", "test")

RECIPE = HERE / "spread-foreign.toml"

N_MARKERS, N_TARGETS, STD = 15, 20, 0.1
LEVELS = (0.5, 0.9, 0.95)

#: C_d of the paper, mm^2, read as cm^2; its ensemble and assimilations.
PAPER = {"variance": 0.1, "n_members": 100, "n_steps": 5}

#: Iterations after which a foreign truth fails.
_ITERATIONS = 60


@dataclass(frozen=True)
class Event:
    """A true shape with random markers and targets, and the simulation of it where there is one; mm."""

    truth: np.ndarray
    simulation: np.ndarray | None
    reference: np.ndarray
    measured: np.ndarray
    targets: np.ndarray
    moved: np.ndarray
    start: np.ndarray


@dataclass(frozen=True)
class Answer:
    """Targets' displacement (n, 3) and covariance (n, 3, 3), mm, and what the answer says of itself."""

    mean: np.ndarray
    covariance: np.ndarray
    ok: bool | None = None
    p_value: float | None = None
    inverted: int | None = None
    reasons: tuple[str, ...] = ()
    flagged: float = 0.0
    tail: float | None = None

    @property
    def doubts(self) -> bool:
        """Whether the answer says that it may be no better than the start: not trusted, or half its targets flagged."""
        return self.ok is False or self.flagged >= 0.5


Method = Callable[[Event], Answer]


def places(mesh: tr.Mesh, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return random places of markers on the free surface and of targets inside, mm."""
    free, shares = free_surface(mesh)
    chosen = mesh.nodes[free[rng.choice(len(free), N_MARKERS, p=shares)]]
    markers = np.einsum("pc,pcx->px", rng.dirichlet(np.ones(3), N_MARKERS), chosen)
    inside = mesh.nodes[mesh.tets[rng.choice(mesh.n_tets, N_TARGETS, p=mesh.volumes / mesh.volumes.sum())]]
    return markers, np.einsum("pc,pcx->px", rng.dirichlet(np.ones(4), N_TARGETS), inside)


def event(mesh: tr.Mesh, truth: np.ndarray, simulation: np.ndarray | None, seed: list[int]) -> Event:
    """Return a shape as it is measured."""
    rng = np.random.default_rng(seed)
    reference, inner = places(mesh, rng)
    markers = MarkerObservation(mesh, reference, tuple(str(i) for i in range(N_MARKERS)))
    targets = TargetObservation(mesh, {str(i): place for i, place in enumerate(inner)})
    truth = truth.astype(np.float64)
    simulated = None if simulation is None else simulation.astype(np.float64)
    measured = reference + markers.predict(truth[markers.nodes]) + STD * rng.standard_normal(reference.shape)
    moved = targets.predict(truth[targets.nodes])
    start = np.zeros_like(moved) if simulated is None else targets.predict(simulated[targets.nodes])
    return Event(truth, simulated, reference, measured, inner, moved, start)


def registered(mesh: tr.Mesh, model: Any, *, simulated: bool = True) -> Method:
    """Return `tissuereg.register` with a model as a method."""
    settings = tr.RegisterSettings(threads=1)

    def method(one: Event) -> Answer:
        result = tr.register(
            mesh,
            tr.Markers(one.reference, one.measured, std=STD),
            model=model,
            simulation=one.simulation if simulated else None,
            targets={str(i): place for i, place in enumerate(one.targets)},
            settings=settings,
        )
        found = [result.target(str(i)) for i in range(N_TARGETS)]
        return Answer(
            np.array([target.mean for target in found]) - one.targets,
            np.array([target.covariance for target in found]),
            result.trust.ok,
            result.trust.p_value,
            result.inverted_tets,
            tuple(result.trust.reasons),
            float(np.mean([target.flag is not None for target in found])),
            found[0].tail,
        )

    return method


def paper(mesh: tr.Mesh, model: NetworkModel) -> Method:
    """Return Algorithm 1 as the paper has it: prior q(z | M_t), M_t the simulation or the undeformed body."""

    def method(one: Event) -> Answer:
        mean, variance = model.encode(np.zeros_like(one.truth) if one.simulation is None else one.simulation)
        markers = MarkerObservation(mesh, one.reference, tuple(str(i) for i in range(N_MARKERS)))
        targets = TargetObservation(mesh, {str(i): place for i, place in enumerate(one.targets)})

        def predict(latents: np.ndarray) -> np.ndarray:
            moved = markers.predict(model.decode(latents, markers.nodes))
            return np.ascontiguousarray(moved.reshape(len(moved), -1).T)

        found = assimilate(
            predict,
            (one.measured - one.reference).ravel(),
            PAPER["variance"] * np.eye(3 * N_MARKERS),
            Gaussian(mean, np.diag(variance)),
            rng=np.random.default_rng(0),
            settings=AssimilationSettings(int(PAPER["n_members"]), int(PAPER["n_steps"]), threads=1),
        )
        inner = targets.predict(model.decode(found.latents, targets.nodes))
        away = inner - inner.mean(axis=0)
        centre = targets.predict(model.decode(found.mean[:, None], targets.nodes))[0]
        return Answer(centre, np.einsum("epi,epj->pij", away, away) / (len(inner) - 1))

    return method


def measures(events: list[Event], answers: list[Answer], rng: np.random.Generator) -> dict[str, Any]:
    """Return what a method is worth on some events."""
    off = np.array([one.moved - answer.mean for one, answer in zip(events, answers, strict=True)])
    spread = np.array([answer.covariance for answer in answers])
    before = np.array([np.linalg.norm(one.moved - one.start, axis=1) for one in events])
    after = np.linalg.norm(off, axis=2)
    tiny = 1e-12 * np.eye(3)
    squares = np.einsum("eti,etij,etj->et", off, np.linalg.inv(spread + tiny), off)
    std = np.sqrt(np.maximum(np.einsum("etii->eti", spread), 1e-24))
    tail = answers[0].tail
    ranks, crps = law_of_coordinates(off, std, tail)
    radii = np.sqrt(chi2.ppf(0.9, 3)) * np.maximum(np.linalg.det(spread), 0.0) ** (1 / 6)
    coverage = {}
    for level in LEVELS:
        inside = (squares <= squared_radius(level, tail)).mean(axis=1)
        again = inside[rng.integers(0, len(inside), (2000, len(inside)))].mean(axis=1)
        coverage[f"{level:.2f}"] = [inside.mean(), *np.quantile(again, (0.025, 0.975))]
    worse = after.mean(axis=1) > before.mean(axis=1)
    found: dict[str, Any] = {
        "events": len(events),
        "coverage": coverage,
        "crps_mm": crps.mean(),
        "ranks": np.histogram(ranks, np.linspace(0, 1, 21))[0].tolist(),
        "radius90_mm": {"mean": radii.mean(), "median": np.median(radii)},
        "before_mm": {"mean": before.mean(), "median": np.median(before)},
        "after_mm": {"mean": after.mean(), "median": np.median(after), "95": np.quantile(after, 0.95)},
        "worse": int(worse.sum()),
        "half_missed": float(((squares <= chi2.ppf(0.9, 3)).mean(axis=1) < 0.5).mean()),
    }
    if answers[0].ok is not None:
        ok = np.array([bool(answer.ok) for answer in answers])
        doubts = np.array([answer.doubts for answer in answers])
        chances = [float(answer.p_value or 0.0) for answer in answers]
        kinds = [reason.split(":")[0] for answer in answers for reason in {*answer.reasons}]
        found |= {
            "worse_without_a_word": int((worse & ~doubts).sum()),
            "doubts": float(doubts.mean()),
            "flagged_targets": float(np.mean([answer.flagged for answer in answers])),
            "alarms": float((~ok).mean()),
            "alarms_by_kind": {kind: kinds.count(kind) for kind in sorted(set(kinds))},
            "p_values": np.histogram(chances, np.linspace(0, 1, 21))[0].tolist(),
            "inverted_bodies": int(sum((answer.inverted or 0) > 0 for answer in answers)),
        }
    return _rounded(found)


def law_of_coordinates(off: np.ndarray, std: np.ndarray, tail: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return ranks and CRPS of errors in each coordinate, by a Gaussian or by the t law with the same 90 % region.

    The CRPS of a t law: A. Jordan, F. Krueger and S. Lerch, Journal of Statistical Software 90 (12), 2019.
    """
    if tail is None:
        z = off / std
        return norm.cdf(z), std * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    scale = std * np.sqrt(chi2.ppf(COMMON, 3) / (3.0 * f.ppf(COMMON, 3, tail)))
    z = off / scale
    ranks = student.cdf(z, tail)
    last = 2.0 * np.sqrt(tail) / (tail - 1.0) * beta(0.5, tail - 0.5) / beta(0.5, 0.5 * tail) ** 2
    return ranks, scale * (z * (2 * ranks - 1) + 2 * student.pdf(z, tail) * (tail + z**2) / (tail - 1.0) - last)


def worse_on_average(
    mesh: tr.Mesh, method: Method, events: list[Event], answers: list[Answer], n_noises: int = 8
) -> dict[str, int]:
    """Return how many events end worse than they began on average over noise, and how many of them say nothing."""
    worse = silent = 0
    for i, (one, answer) in enumerate(zip(events, answers, strict=True)):
        before = np.linalg.norm(one.moved - one.start, axis=1).mean()
        if np.linalg.norm(one.moved - answer.mean, axis=1).mean() <= before:
            continue
        markers = MarkerObservation(mesh, one.reference, tuple(str(i) for i in range(N_MARKERS)))
        exact = one.reference + markers.predict(one.truth[markers.nodes])
        after, doubts = [], []
        for noise in range(n_noises):
            off = STD * np.random.default_rng([43, i, noise]).standard_normal(exact.shape)
            again = method(replace(one, measured=exact + off))
            after.append(np.linalg.norm(one.moved - again.mean, axis=1).mean())
            doubts.append(again.doubts)
        if np.mean(after) > before:
            worse += 1
            silent += np.mean(doubts) < 0.5
    return {"worse_on_average": worse, "worse_on_average_without_a_word": int(silent)}


def rows(mesh: tr.Mesh, methods: dict[str, Method], events: list[Event], n_rivals: int, say: str) -> dict[str, Any]:
    """Return the measures of every method on the same events."""
    found = {}
    for name, method in methods.items():
        begun = time.perf_counter()
        some = events if name == "ours" else events[:n_rivals]
        answers = [method(one) for one in some]
        found[name] = measures(some, answers, np.random.default_rng(1))
        if name == "ours":
            found[name] |= worse_on_average(mesh, method, some, answers)
        print(f"{say}, {name}: {found[name]} in {time.perf_counter() - begun:.0f} s", flush=True)
    return found


def other_organ(seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return markers (reference, measured) of events on a body of another shape."""
    from tissuereg.phantom.breast import breast_mesh
    from tissuereg.simulation.recipe import recipe_of

    small = breast_mesh(700)
    turned = np.stack([-small.nodes[:, 1], small.nodes[:, 0], small.nodes[:, 2]], axis=1) * np.array([0.85, 1.15, 0.9])
    body = tr.Mesh(turned, small.tets, {"fixed": small.fixed_nodes})
    raw = {**read_recipe(RECIPE).raw, "data": {**read_recipe(RECIPE).raw["data"], "members": 60, "chunk": 60}}
    chunk = ChunkMaker(recipe_of(raw, "recipe"), body, seed).make(0, threads=1)
    found = []
    for i, field in enumerate(chunk.displacement):
        one = event(body, field, None, [seed, 31, i])
        found.append((one.reference, one.measured))
    return found


def alarms(mesh: tr.Mesh, model: Any, events: list[Event], simulated: list[Event], seed: int) -> dict[str, Any]:
    """Return how often the answer warns, or is refused, where it should; `simulated` are events with a simulation."""

    def fired(reference: np.ndarray, measured: np.ndarray, simulation: np.ndarray | None = None) -> bool:
        markers = tr.Markers(reference, measured, std=STD)
        try:
            return not tr.register(
                mesh, markers, model=model, simulation=simulation, settings=tr.RegisterSettings(threads=1)
            ).trust.ok
        except MarkerError:
            return True

    rng = np.random.default_rng([seed, 32])
    swapped = []
    for one in events:
        a, b = rng.choice(N_MARKERS, 2, replace=False)
        measured = one.measured.copy()
        measured[[a, b]] = measured[[b, a]]
        swapped.append((one.reference, measured))
    cases = {
        "another organ's markers": other_organ(seed),
        "two markers swapped": swapped,
        "centimetres given as millimetres": [(one.reference / 10.0, one.measured / 10.0) for one in events],
        "measured places in centimetres": [(one.reference, one.measured / 10.0) for one in events],
        "the simulation reversed": [(one.reference, one.measured, -one.simulation) for one in simulated],
        "the simulation of another event": [
            (one.reference, one.measured, other.simulation)
            for one, other in zip(simulated, simulated[1:] + simulated[:1], strict=True)
        ],
    }
    found = {}
    for name, some in cases.items():
        hits = [fired(*given) for given in some]
        found[name] = {"cases": len(hits), "fired": int(sum(hits))}
        print(name, found[name], flush=True)
    return found


def make_foreign(out: Path, n_files: int) -> None:
    """Make the foreign pairs, file by file; those that are there are kept. Cost: seconds a pair."""
    for part in FOREIGN_PARTS:
        (out / part).mkdir(parents=True, exist_ok=True)
    recipe = read_recipe(RECIPE)
    maker = ChunkMaker(recipe, recipe.mesh(), recipe.seed)
    for number in range(n_files):
        path = out / FOREIGN_PARTS[number % 2] / f"pairs_{number:04d}.npz"
        if path.exists():
            continue
        maker.seed = recipe.seed + 1000 * number
        begun = time.perf_counter()
        try:
            simulations, truths = simulated_pairs(maker, 1, max_iterations=_ITERATIONS)
        except EnsembleError as error:
            print(f"{path.name}: {error}", flush=True)
            continue
        with atomic_file(path) as draft, draft.open("wb") as stream:
            np.savez(stream, simulation_mm=simulations.astype(np.float32), truth_mm=truths.astype(np.float32))
        print(f"{path.name}: {len(truths)} pairs in {time.perf_counter() - begun:.0f} s", flush=True)


def read_foreign(folder: Path, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Return simulations and truths of one of `FOREIGN_PARTS`."""
    loaded = [np.load(path) for path in sorted((folder / part).glob("pairs_*.npz"))]
    return tuple(np.concatenate([one[name] for one in loaded]) for name in ("simulation_mm", "truth_mm"))  # type: ignore[return-value]


def fitted_pca(data: Any) -> tuple[PcaModel, np.ndarray]:
    """Return 26 principal components of the training split, with errors of 200 fields of the validation split."""
    split = data.split
    fields = data.displacement[split["train"][::4]].astype(np.float64)
    held_out = data.displacement[split["valid"][:200]].astype(np.float64)
    model = PcaModel.fit(fields, held_out, centre=fields.mean(axis=0), n_latent=26, card={"kind": "pca"})
    return model, codes_of(model, data.displacement, split["train"])


def measure(
    model_folder: Path,
    data_folder: Path,
    foreign: Path,
    n_test: int,
    n_rivals: int,
    n_alarms: int,
    part: str,
    table2: Path | None = None,
    pressed: Path | None = None,
) -> dict[str, Any]:
    """Measure everything; `part` is ``test``, or ``valid`` while a method is being made."""
    data = tr.open_dataset(data_folder)
    mesh, split = data.mesh, data.split
    model = NetworkModel(model_folder, mesh, threads=1, calibrated=part == "test")
    plain = NetworkModel(model_folder, mesh, threads=1, calibrated=False)
    unseen = data.displacement[split["valid"]]
    development, asked = (read_foreign(foreign, each) for each in FOREIGN_PARTS)
    how = RehearsalSettings()
    if part == "valid":
        # Half of the validation split and of the development pairs calibrates, the other half is asked.
        asked = tuple(one[1::2] for one in development)
        development = tuple(one[::2] for one in development)
        unseen, held = unseen[::2], unseen[1::2]
    else:
        held = data.displacement[split["test"]]
    if part == "valid" or not (model_folder / CALIBRATION_NAME).exists():
        codes = codes_of(model, data.displacement, split["train"])
        pairs = [development] if pressed is None else [development, read_pairs(pressed, mesh.n_nodes)]
        model.calibration = calibrate(model, mesh, codes, unseen, pairs, settings=how)
    pca, codes = fitted_pca(data)
    plain_pca = PcaModel(pca.centre, pca.components, pca.error_fields, pca.card)
    pca.calibration = calibrate(pca, mesh, codes, unseen, settings=how)
    known = [event(mesh, field, None, [41, i]) for i, field in enumerate(held[:n_test])]
    strange = [event(mesh, b, a, [42, i]) for i, (a, b) in enumerate(zip(*asked, strict=True))]
    ours = registered(mesh, model)
    paper_network = {}
    if table2 is not None:
        paper_network["ours, Table II's network"] = registered(mesh, NetworkModel(table2, mesh, threads=1))
    sets = {
        "known": rows(
            mesh,
            {
                "ours": ours,
                **paper_network,
                "not calibrated": registered(mesh, plain),
                "paper": paper(mesh, model),
                "pca26": registered(mesh, pca),
                "pca26, not calibrated": registered(mesh, plain_pca),
            },
            known,
            n_rivals,
            "known physics",
        ),
        "foreign": rows(
            mesh,
            {
                "ours": ours,
                **paper_network,
                "ours, without the simulation": registered(mesh, model, simulated=False),
                "not calibrated": registered(mesh, plain),
                "paper": paper(mesh, model),
                "pca26": registered(mesh, pca, simulated=False),
            },
            strange,
            n_rivals,
            "foreign physics",
        ),
    }
    return {
        "schema": "tissuereg.spread/1",
        "model": {**model.card, "source": model_folder.name},
        "table2": None if table2 is None else {**NetworkModel(table2, mesh, threads=1).card, "source": table2.name},
        "part": part,
        "n_development_pairs": len(development[0]),
        "kinds_of_change": 0 if model.calibration.change is None else len(model.calibration.change.covariances),
        "sets": sets,
        "alarms": alarms(mesh, model, known[:n_alarms], strange[:n_alarms], 5 if part == "test" else 15),
        "widening": {"alone": model.calibration.alone.widening}
        | ({} if model.calibration.anchored is None else {"simulated": model.calibration.anchored.widening}),
        "tail": {"alone": model.calibration.alone.tail}
        | ({} if model.calibration.anchored is None else {"simulated": model.calibration.anchored.tail}),
        "machine": machine(),
        "versions": versions(),
    }


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return round(float(value), 4) if isinstance(value, float | np.floating) else value


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--foreign", type=Path)
    parser.add_argument("--make-foreign", type=Path)
    parser.add_argument("--files", type=int, default=60, help="files of foreign pairs")
    parser.add_argument("--events", type=int, default=500, help="test shapes")
    parser.add_argument("--rivals", type=int, default=200, help="shapes that the other methods register")
    parser.add_argument("--alarms", type=int, default=100, help="shapes spoilt in each way")
    parser.add_argument("--table2", type=Path, help="calibrated model folder of a Table II network, as a further row")
    parser.add_argument(
        "--pressed", type=Path, help="pairs of rigs (`make -C paper pairs`), where the model is calibrated here"
    )
    parser.add_argument("--part", choices=("test", "valid"), default="test", help="valid while a method is being made")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--page", action="store_true", help="measure nothing: write the page of what was measured")
    options = parser.parse_args()
    if options.make_foreign:
        make_foreign(options.make_foreign, options.files)
        return
    if not options.page:
        counts = options.events, options.rivals, options.alarms
        others = options.table2, options.pressed
        found = measure(options.model, options.data, options.foreign, *counts, options.part, *others)
        write_archive(options.out, found, TABLES)
    if options.part == "test":
        from spread.spread_page import write_page

        write_page(read_archive(options.out))


if __name__ == "__main__":
    main()
