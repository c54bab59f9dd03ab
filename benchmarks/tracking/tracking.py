"""What restarts a tracked simulation, what the frames before are worth, and how fast it is -> archive/, RESULTS.md.

    python -m tracking.tracking [--seeds N] [--contacts-seeds N] [--truth FILE] [--threads N]
    python -m tracking.tracking --rate [--truth FILE] [--threads N]
    python -m tracking.tracking --page

The phantom is pushed in equal steps and then held. Its truth is that of `solve_truth`: ten-node elements, another
modulus, a stiff lesion, pushes larger and rotated. ``--truth`` names a file in which the true fields are kept between
runs. ``--rate`` replays a push, a rest and a release in real time, which needs a machine that does nothing else;
``--page`` writes the page again from the archives.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import tissuereg as tr
from common import read_archive, write_archive
from tissuereg._base.choices import RESTARTS
from tissuereg._base.machine import machine, n_cores, versions
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.phantom import event as phantom_event
from tissuereg.tracking import FemPhysics, TablePhysics, fitted_prior

HERE = Path(__file__).resolve().parent
ARCHIVE, TABLES = HERE / "archive" / "tracking", ("model/#", "contacts/#")
RATE_ARCHIVE, RATE_TABLES = HERE / "archive" / "rate", ("rows/<tracker>",)
PAGE = HERE / "RESULTS.md"

#: Frames in motion and at rest, frames a second, values of the push at which truth and tables are solved.
N_MOVING, N_STILL, HZ, N_KNOTS = 10, 10, 40, 9

#: Moving frames that are registered without a model.
N_CONTACTS_MOVING = 5
STD_MM = 0.1

#: Frames of the replay: pushed, held, released.
N_REPLAYED = (40, 40, 40)

#: Largest node displacement of a usual change of the fitted prior, mm: about what the simulation is off by at last.
LARGEST_CHANGE_MM = 3.0

#: Largest node displacement of a usual deformation of the rival's basis, mm.
LARGEST_MOTION_MM = 15.0

#: Sets of markers with which choices were made; figures of the page are of the later ones.
N_DEVELOPMENT = 3
LESION = np.asarray(phantom_event.LESION_MM)

HEAD = """# Tracking: what the frames before are worth

Written by `make -C benchmarks/tracking` from `archive/tracking` and `archive/rate`; edit none.
How it works: [tracking](../../docs/tracking.md).

The phantom is pushed in {n_moving} equal steps at {hz} Hz and then held for {n_still} frames. The believed simulation
has four-node elements, a wrong modulus, no lesion, and pushes that are too small and rotated; the truth has ten-node
elements and a stiff lesion. 15 markers with noise of {std} mm. Errors are distances in mm, means over frames and
random sets of markers: at the lesion, and at the nodes of the body. The filter and the default restart were chosen with
sets 0 to {last_development}; tables are of the sets after them, where they do not say otherwise. *Alone*: the answers
of the frames before the temporal prior. *90 %*: share of frames whose 90 % region holds the lesion.
"""


class Motion:
    """The phantom in motion: truth, measurements, and the believed simulation, all by the share of the push."""

    def __init__(self, truth: tuple[Any, Any], seed: int, threads: int, shares: Any = None) -> None:
        from scipy.interpolate import CubicSpline

        fine, self.mesh = phantom_event.truth_mesh(), phantom_event.phantom_mesh()
        steps = np.r_[np.linspace(1.0 / N_MOVING, 1.0, N_MOVING), np.ones(N_STILL)]
        self.shares = steps if shares is None else shares
        knots = np.linspace(0.0, 1.0, N_KNOTS)
        fields, bodies = (CubicSpline(knots, one)(self.shares) for one in truth)
        self.bodies = bodies
        self.places = phantom_event._marker_places(fine, np.random.default_rng([seed, 5]))
        names = tuple(f"P{i + 1}" for i in range(len(self.places)))
        seen = MarkerObservation(fine, self.places, names)
        inner = TargetObservation(fine, {"lesion": LESION})
        rng = np.random.default_rng([seed, 77])
        moved = seen.predict(fields[:, seen.nodes])
        self.measured = self.places + moved + STD_MM * rng.standard_normal(moved.shape)
        self.lesion = LESION + inner.predict(fields[:, inner.nodes])[:, 0]
        pushes = phantom_event._pushes(self.mesh, 1.0, 0.0).traction
        self.material = tr.Material(10.0, phantom_event.PHANTOM.poisson)
        self.fem = FemPhysics(
            self.mesh,
            self.material,
            lambda share: tr.Load(traction=(pushes[0], share * pushes[1])),
            threads=threads,
        )

    def errors(self, frame: int, displacement: Any, lesion: Any, covariance: Any = None) -> list[float]:
        """Return the error of lesion and body, mm, and whether the 90 % region holds the lesion (-1: no region)."""
        off = lesion - self.lesion[frame]
        body = float(np.linalg.norm(displacement - self.bodies[frame], axis=1).mean())
        # 6.2514 is the 90 % point of chi-square with three degrees of freedom.
        inside = -1.0 if covariance is None else float(off @ np.linalg.solve(covariance, off) <= 6.2514)
        return [float(np.linalg.norm(off)), body, inside]

    def of(self, frame: int, result: tr.Registration) -> list[float]:
        """Return the errors of a registration."""
        target = result.target("lesion")
        return self.errors(frame, result.displacement, target.mean, target.covariance)


def true_fields(kept: Path | None, threads: int) -> tuple[Any, Any]:
    """Return the true fields (n_knots, n_nodes, 3) on the truth's mesh and on the body's, solved or read."""
    if kept is not None and kept.exists():
        with np.load(kept) as file:
            return file["fine"], file["body"]
    fine, body = phantom_event.truth_mesh(), phantom_event.phantom_mesh()
    contrast = np.where(phantom_event._in_lesion(fine), phantom_event.PHANTOM.lesion_contrast, 1.0)
    material = tr.Material(contrast * phantom_event.PHANTOM.true_young, phantom_event.PHANTOM.true_poisson)
    simulator = tr.Simulator(fine, element="tet10")
    triangles, traction = phantom_event._pushes(
        fine, phantom_event.PHANTOM.true_push_factor, phantom_event.PHANTOM.true_tilt_deg
    ).traction
    inside = TargetObservation(fine, {str(i): node for i, node in enumerate(body.nodes)})
    fields, start = [np.zeros_like(fine.nodes)], None
    for share in np.linspace(0.0, 1.0, N_KNOTS)[1:]:
        load = tr.Load(traction=(triangles, share * traction))
        found = simulator.solve(load, material, start=start, tolerance=1e-6, threads=threads)
        start = found.all_displacement
        fields.append(found.displacement)
    on_body = [inside.predict(field[inside.nodes]) for field in fields]
    if kept is not None:
        np.savez(kept, fine=fields, body=on_body)
    return np.array(fields), np.array(on_body)


def table_of(motion: Motion) -> TablePhysics:
    """Return the believed simulation as a table of precomputed fields."""
    shares, fields = np.linspace(0.0, 1.0, N_KNOTS), []
    for share in shares:
        fields.append(motion.fem.field(float(share), start=fields[-1] if fields else None))
    return TablePhysics(shares, fields)


def tracked(motion: Motion, tracker: tr.Tracker, frames: range) -> dict[str, Any]:
    """Return the errors of a tracker before and after the temporal prior, its gains, and processor seconds."""
    rows: dict[str, Any] = {"alone": [], "tracked": [], "simulation": [], "gain": [], "passes": [], "cpu_s": []}
    for k, frame in enumerate(frames):
        before = time.process_time()
        actuator = None if tracker.simulator is None else float(motion.shares[frame])
        result = tracker.step(motion.measured[frame], k / HZ, actuator=actuator)
        rows["cpu_s"].append(time.process_time() - before)
        rows["alone"].append(motion.of(frame, tracker.last.alone))
        rows["tracked"].append(motion.of(frame, result))
        rows["gain"].append(tracker.last.gain)
        rows["passes"].append(result.work.get("passes", 0) if isinstance(result, tr.ContactRegistration) else 0)
    rows["fallbacks"] = tracker.fallbacks
    return rows


def study(truth: tuple[Any, Any], seed: int, threads: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Return the rows of one set of markers, by method."""
    motion = Motion(truth, seed, threads)
    everything = range(len(motion.shares))
    how = tr.RegisterSettings(threads=threads)
    places = tr.Markers(motion.places, std=STD_MM)
    registrar = tr.Registrar(motion.mesh, places, "phantom", {"lesion": LESION}, settings=how)
    table = table_of(motion)
    inner = registrar.attached.targets
    fields = [table.field(share) for share in motion.shares]
    rows: dict[str, Any] = {
        "simulation": [
            motion.errors(k, field, LESION + inner.predict(field[inner.nodes])[0]) for k, field in enumerate(fields)
        ],
        "frame by frame": [motion.of(k, registrar.register(motion.measured[k], fields[k])) for k in everything],
    }
    for restart in RESTARTS:
        simulator = motion.fem if restart in ("forces", "guess") else table
        tell(f"seed {seed}: restart {restart}")
        rows[f"restart: {restart}"] = tracked(
            motion, tr.Tracker(registrar, simulator=simulator, restart=restart), everything
        )
    return rows


def contacts(truth: tuple[Any, Any], seed: int, threads: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Return the rows of the physics prior, which knows neither load nor simulation, from the last moving frames on."""
    motion = Motion(truth, seed, threads)
    frames = range(N_MOVING - N_CONTACTS_MOVING, N_MOVING + N_STILL)
    alone = by_contacts(motion, threads)
    single: dict[str, Any] = {"errors": [], "cpu_s": [], "passes": []}
    for frame in frames:
        before = time.process_time()
        result = alone.register(motion.measured[frame])
        single["cpu_s"].append(time.process_time() - before)
        single["errors"].append(motion.of(frame, result))
        single["passes"].append(result.work["passes"])
    tell(f"seed {seed}: contacts")
    tracker = tr.Tracker(by_contacts(motion, threads))
    tell(f"seed {seed}: reduced basis")
    rival = tracked(motion, by_basis(motion, threads), frames)
    return {"frame by frame": single, "tracked": tracked(motion, tracker, frames), "reduced basis": rival}


def by_contacts(motion: Motion, threads: int) -> tr.Registrar:
    """Return the registrar of the physics prior."""
    body, places = tr.Body(motion.mesh, motion.material), tr.Markers(motion.places, std=STD_MM)
    return tr.Registrar(body, places, None, {"lesion": LESION}, settings=tr.RegisterSettings(threads=threads))


def by_basis(motion: Motion, threads: int) -> tr.Tracker:
    """Return the rival without a simulation: a reduced basis of responses to random loads, about the body at rest."""
    prior = fitted_prior(motion.mesh, motion.material, largest_mm=LARGEST_MOTION_MM, threads=threads)
    targets, how = {"lesion": LESION}, tr.RegisterSettings(threads=threads)
    registrar = tr.Registrar(motion.mesh, tr.Markers(motion.places, std=STD_MM), prior, targets, settings=how)
    rest = np.zeros_like(motion.mesh.nodes)
    return tr.Tracker(registrar, simulator=lambda _: rest, restart="reference")


def replayed_trackers(motion: Motion, threads: int) -> dict[str, Callable[[], tr.Tracker]]:
    """Return makers of the trackers that are timed, by name."""
    targets = {"lesion": LESION}
    how = tr.RegisterSettings(threads=threads)
    places = tr.Markers(motion.places, std=STD_MM)

    def of(model: Any, simulator: Any) -> tr.Tracker:
        registrar = tr.Registrar(motion.mesh, places, model, targets, settings=how)
        return tr.Tracker(registrar, simulator=simulator)

    def fitted() -> Any:
        return fitted_prior(motion.mesh, motion.material, largest_mm=LARGEST_CHANGE_MM, threads=threads)

    return {
        "network, FEM": lambda: of("phantom", motion.fem),
        "network, table": lambda: of("phantom", table_of(motion)),
        "fitted prior, FEM": lambda: of(fitted(), motion.fem),
        "fitted prior, table": lambda: of(fitted(), table_of(motion)),
        "contacts": lambda: tr.Tracker(by_contacts(motion, threads)),
        "reduced basis": lambda: by_basis(motion, threads),
    }


def replayed(motion: Motion, tracker: tr.Tracker, every: int = 1, **clock: Any) -> dict[str, Any]:
    """Return latencies, drops and errors of a tracker on a replay at the recorded rate, of every n-th frame.

    What the first frames make for all is made before. ``clock`` are the clock and the wait of `Tracker.run`.
    """
    known = tracker.simulator is not None
    frames = [
        (k / HZ, seen, float(share) if known else None)
        for k, (seen, share) in enumerate(zip(motion.measured, motion.shares, strict=True))
    ][::every]
    for time_s, seen, share in frames[:3]:
        tracker.step(seen, time_s, actuator=share)
    tracker.reset()
    found = list(tracker.run(frames, **clock))
    latency = np.array([frame.latency_s for frame in found])
    lesion = [motion.of(round(frame.time_s * HZ), frame.registration)[0] for frame in found]
    return {
        "registered": len(found),
        "dropped": tracker.dropped,
        "hz": len(found) / (found[-1].time_s + found[-1].latency_s),
        "latency_median_ms": 1e3 * float(np.median(latency)),
        "latency_p99_ms": 1e3 * float(np.percentile(latency, 99)),
        "lesion_mm": float(np.mean(lesion)),
        "latency_ms": (1e3 * latency).tolist(),
    }


def rate(truth: tuple[Any, Any], threads: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Return the archive of all replays."""
    pushed, held, released = N_REPLAYED
    shares = np.r_[np.linspace(0.0, 1.0, pushed), np.ones(held), np.linspace(1.0, 0.0, released)]
    motion = Motion(truth, 0, threads, shares)
    load, rows = os.getloadavg()[0], {}
    for name, make in replayed_trackers(motion, threads).items():
        tell(f"replay: {name}")
        rows[name] = replayed(motion, make())
    tell("replay: contacts, every second frame")
    rows[f"contacts, {HZ // 2} Hz"] = replayed(motion, tr.Tracker(by_contacts(motion, threads)), every=2)
    return {
        "schema": "tissuereg.tracking-rate/1",
        "hz": HZ,
        "frames": len(shares),
        "std_mm": STD_MM,
        "threads": threads or n_cores(),
        "load_before": load,
        "machine": machine(),
        "versions": versions(),
        "rows": rows,
    }


RATE_HEAD = """## In real time

A push, a rest and a release, {frames} frames at {hz} Hz, replayed at that rate by `make -C benchmarks/tracking
rate` with `Tracker.run`. *Latency*: from a frame's time to its answer. *A second*: frames registered a second.
*Lesion*: mean error at the frames' own times. *FEM*: simulated frame by frame from the registered state; *table*:
precomputed fields.
"""


def rate_section(answer: dict[str, Any]) -> str:
    """Return the part of the page on replays."""
    lines = [
        RATE_HEAD.format(**answer),
        "| | latency, median | latency, 99 % | registered | dropped | a second | lesion |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {name} | {row['latency_median_ms']:.1f} ms | {row['latency_p99_ms']:.1f} ms | {row['registered']} "
            f"| {row['dropped']} | {row['hz']:.1f} | {row['lesion_mm']:.3f} mm |"
            for name, row in answer["rows"].items()
        ),
        f"\n{_machine(answer)}\n",
    ]
    return "\n".join(lines)


def page(answer: dict[str, Any], replays: dict[str, Any]) -> str:
    """Return the page of the two archives."""
    head = HEAD.format(
        n_moving=answer["n_moving"],
        n_still=answer["n_still"],
        hz=answer["hz"],
        std=answer["std_mm"],
        last_development=N_DEVELOPMENT - 1,
    )
    reported, development = _split(answer["model"])
    lines = [head, f"## With the shipped network\n\n{_sets(reported)}.\n", *_errors(reported, answer["n_moving"])]
    lines += ["", *_work(reported, answer["n_moving"])]
    if reported is not development:
        lines += [f"\n{_sets(development)}, with which choices were made:\n", *_errors(development, answer["n_moving"])]
    if answer["contacts"]:
        reported, development = _split(answer["contacts"])
        n_moving = answer["n_contacts_moving"]
        lines.append("\n## Without a model: contacts\n")
        lines.append(
            "*Reduced basis*: the rival that is fitted to responses to 200 random loads on the spot. "
            f"Load and simulation unknown; the last {n_moving} moving frames and those at rest. {_sets(reported)}.\n"
        )
        lines += _contacts(reported, n_moving)
        if reported is not development:
            lines += [f"\n{_sets(development)}, with which choices were made:\n", *_contacts(development, n_moving)]
    lines += [f"\n{_machine(answer)}\n", rate_section(replays)]
    return "\n".join(lines)


def _split(studies: list[Any]) -> tuple[list[Any], list[Any]]:
    """Return the sets that are reported and those of the development; all are both if there are no later ones."""
    later = studies[N_DEVELOPMENT:]
    return (later, studies[:N_DEVELOPMENT]) if later else (studies, studies)


def _sets(studies: list[Any]) -> str:
    return f"{len(studies)} set{'' if len(studies) == 1 else 's'} of markers"


def _restarts(studies: list[Any]) -> list[str]:
    return [name for name in studies[0] if name.startswith("restart")]


def _errors(studies: list[Any], n_moving: int) -> list[str]:
    moving, still = slice(1, n_moving), slice(n_moving, None)
    lines = [_header("moving", "still")]
    for name in ("simulation", "frame by frame"):
        rows = np.array([one[name] for one in studies])
        lines.append(_row(name, [rows[:, moving], rows[:, still]]))
    for name in _restarts(studies):
        for part in ("alone", "tracked"):
            rows = np.array([one[name][part] for one in studies])
            lines.append(_row(f"{name}, {part}", [rows[:, moving], rows[:, still]]))
    return lines


def _work(studies: list[Any], n_moving: int) -> list[str]:
    lines = ["| restart | gain moving | gain still | lost equilibria | processor s a frame |\n|---|---|---|---|---|"]
    for name in _restarts(studies):
        gains = np.array([one[name]["gain"] for one in studies])
        seconds = np.median([one[name]["cpu_s"] for one in studies])
        lost = sum(one[name]["fallbacks"] for one in studies)
        lines.append(
            f"| {name.removeprefix('restart: ')} | {gains[:, 1:n_moving].mean():.2f} "
            f"| {gains[:, n_moving:].mean():.2f} | {lost} | {seconds:.3f} |"
        )
    return lines


def _contacts(studies: list[Any], n_moving: int) -> list[str]:
    lines = [
        "| | lesion moving | body moving | 90 % moving | lesion still | body still | 90 % still | passes a frame "
        "| processor s a frame |\n|---|---|---|---|---|---|---|---|---|"
    ]
    parts = (("frame by frame", "errors"), ("tracked", "alone"), ("tracked", "tracked"), ("reduced basis", "tracked"))
    for name, part in parts:
        rows = np.array([one[name][part] for one in studies])
        cells = []
        for frames in (slice(1, n_moving), slice(n_moving, None)):
            lesion, body, inside = rows[:, frames].mean(axis=(0, 1))
            cells += [f"{lesion:.3f}", f"{body:.3f}", f"{inside:.0%}"]
        title = name if part != "alone" else "tracked, alone"
        made = np.mean([one[name]["passes"] for one in studies])
        passes = f"{made:.1f}" if made else "-"
        seconds = np.median([one[name]["cpu_s"] for one in studies])
        lines.append(f"| {title} | {' | '.join(cells)} | {passes} | {seconds:.2f} |")
    return lines


def _header(*parts: str) -> str:
    names = [f"lesion {part} | body {part} | 90 % {part}" for part in parts]
    return f"| | {' | '.join(names)} |\n|---{'|---' * 3 * len(parts)}|"


def _row(title: str, parts: list[Any]) -> str:
    cells = []
    for part in parts:
        inside = part[..., 2]
        cells += [f"{part[..., 0].mean():.3f}", f"{part[..., 1].mean():.3f}"]
        cells.append("-" if (inside < 0).any() else f"{inside.mean():.0%}")
    return f"| {title} | {' | '.join(cells)} |"


def _machine(answer: dict[str, Any]) -> str:
    busy = answer["load_before"] > 0.5
    words = " The machine was busy with other work: times are too long." if busy else ""
    return f"{answer['threads']} thread(s).{words}"


def main() -> None:
    """Run the studies, or write the page again."""
    parser = argparse.ArgumentParser(description="What restarts the simulation of a tracked body.")
    parser.add_argument("--seeds", type=int, default=8, help="sets of markers with the network; 0: those of before")
    parser.add_argument("--contacts-seeds", type=int, default=8)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--page", action="store_true", help="write the page again from the archive")
    parser.add_argument("--rate", action="store_true", help="replay in real time")
    given = parser.parse_args()

    def tell(words: str) -> None:
        print(words, file=sys.stderr, flush=True)

    if not given.page:
        load, truth = os.getloadavg()[0], true_fields(given.truth, given.threads)
    if given.rate and not given.page:
        write_archive(RATE_ARCHIVE, rate(truth, given.threads, tell), RATE_TABLES)
    elif not given.page:
        answer = {
            "schema": "tissuereg.tracking/1",
            "n_moving": N_MOVING,
            "n_still": N_STILL,
            "n_contacts_moving": N_CONTACTS_MOVING,
            "hz": HZ,
            "std_mm": STD_MM,
            "threads": given.threads,
            "load_before": load,
            "model": [] if given.seeds else read_archive(ARCHIVE)["model"],
            "contacts": [],
        }
        # Archive and page are of what is done; a run that is stopped leaves them so.
        for seed in range(max(given.seeds, given.contacts_seeds)):
            if seed < given.seeds:
                answer["model"].append(study(truth, seed, given.threads, tell))
            if seed < given.contacts_seeds:
                answer["contacts"].append(contacts(truth, seed, given.threads, tell))
            write_archive(ARCHIVE, answer, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE), read_archive(RATE_ARCHIVE)), "utf-8")


if __name__ == "__main__":
    main()
