"""One process of `loadfree.timing`: prints what it measured as one JSON object.

    python -m loadfree.timing_work dome|large|points SEED [--problem FILE] [--threads N]

The package is imported and a small mesh registered before anything is timed, so that only the mesh of the case is new.
"""

import argparse
import json
import time
from pathlib import Path

N_MARKERS, N_POINTS, N_TARGETS, NOISE_MM = 15, 500, 5, 0.1

#: Nodes of the mesh that is registered before.
N_SMALL = 200


def seconds_of(work) -> tuple[dict, object]:
    """Return wall and processor seconds of a call, and what it returns."""
    wall, cpu = time.perf_counter(), time.process_time()
    answer = work()
    return {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}, answer


def imported():
    """Import the package; nothing else of size is imported before."""
    import tissuereg

    return tissuereg


def small(threads: int) -> None:
    """Register a small mesh: what is imported at need is there afterwards."""
    import numpy as np

    import tissuereg as tr
    from speed.half_ellipsoid import half_ellipsoid

    nodes, tets = half_ellipsoid(N_SMALL)
    mesh = tr.Mesh(nodes, tets, {"fixed": np.flatnonzero(nodes[:, 2] < 1e-9)})
    places = nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[:6]]
    seen = places + np.array([0.5, 0.0, 0.0])
    tr.register(
        mesh, tr.Markers(places, seen, std=NOISE_MM), surface=seen, settings=tr.RegisterSettings(threads=threads)
    )


def registered(mesh, truth, threads: int, labels: dict, **given) -> dict:
    """Return times, work and error of one call, with the given labels."""
    import numpy as np

    import tissuereg as tr

    spent, result = seconds_of(
        lambda: tr.register(mesh, seed=0, settings=tr.RegisterSettings(threads=threads), **given)
    )
    off = np.linalg.norm(result.displacement - truth, axis=1).mean()
    return {
        **labels,
        **spent,
        "body_mm": float(off),
        "moved_mm": float(np.linalg.norm(truth, axis=1).mean()),
        "trusted": bool(result.trust.ok),
        "work": dict(result.work),
        "stages_s": dict(result.seconds),
    }


def dome(options: argparse.Namespace) -> list[dict]:
    """Return the first call on the dome, and the next with the values of another event at the same markers."""
    import numpy as np

    import tissuereg as tr
    from loadfree.events import read_body
    from loadfree.layouts import chosen

    body = read_body("dome")
    events = plain_events(body)
    rng = np.random.default_rng([options.seed, 1])
    places = chosen(body, events[options.seed % len(events)], "spread", N_MARKERS)
    rows = []
    for call, event in zip(("first", "next"), np.roll(events, -options.seed)[:2], strict=True):
        noise = NOISE_MM * rng.normal(size=(N_MARKERS, 3))
        markers = tr.Markers(body.pool[places], body.pool[places] + event.pool[places] + noise, std=NOISE_MM)
        labels = {"call": call, "event": event.number, "n_nodes": body.mesh.n_nodes}
        given = {"markers": markers, "targets": named(body.targets)}
        rows.append(registered(body.mesh, event.nodes, options.threads, labels, **given))
    return rows


def large(options: argparse.Namespace) -> list[dict]:
    """Return the first call on a mesh of 20,000 nodes."""
    import numpy as np

    import tissuereg as tr
    from loadfree.layouts import farthest

    with np.load(options.problem) as problem:
        nodes, truth = problem["nodes_mm"], problem["displacement_mm"]
        mesh = tr.Mesh(nodes, problem["tets"], {"fixed": problem["fixed_nodes"]})
    rng = np.random.default_rng([options.seed, 2])
    free = mesh.surface_nodes[nodes[mesh.surface_nodes, 2] > 0.05 * mesh.extent]
    places = free[farthest(nodes[free], N_MARKERS, rng)]
    seen = nodes[places] + truth[places] + NOISE_MM * rng.normal(size=(N_MARKERS, 3))
    inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.surface_nodes)
    given = {
        "markers": tr.Markers(nodes[places], seen, std=NOISE_MM),
        "targets": named(nodes[rng.choice(inner, N_TARGETS)]),
    }
    return [registered(mesh, truth, options.threads, {"call": "first", "n_nodes": mesh.n_nodes}, **given)]


def points(options: argparse.Namespace) -> list[dict]:
    """Return the first call on the dome with points of its surface, without labels and without markers."""
    import numpy as np

    import tissuereg as tr
    from loadfree.events import free_surface, read_body

    body = read_body("dome")
    events = plain_events(body)
    event = events[options.seed % len(events)]
    rng = np.random.default_rng([options.seed, 3])
    triangles, normals = free_surface(body.mesh)
    area = np.linalg.norm(normals, axis=1)
    some = triangles[rng.choice(len(triangles), N_POINTS, p=area / area.sum())]
    moved = (body.mesh.nodes + event.nodes)[some]
    seen = np.einsum("na,nax->nx", rng.dirichlet(np.ones(3), N_POINTS), moved)
    seen += NOISE_MM * rng.normal(size=seen.shape)
    labels = {"call": "first", "event": event.number, "n_nodes": body.mesh.n_nodes}
    given = {"surface": tr.SurfacePoints(seen, NOISE_MM), "targets": named(body.targets)}
    return [registered(body.mesh, event.nodes, options.threads, labels, **given)]


def plain_events(body) -> list:
    """Return the first development event of every kind whose body is as believed."""
    from loadfree.events import KINDS, events_of

    events = [event for event in events_of(body, "dev") if event.description["difference"] is None]
    return [next(event for event in events if event.kind == kind) for kind in KINDS]


def named(places) -> dict:
    """Return the first places as targets."""
    return {f"t{i}": place for i, place in enumerate(places[:N_TARGETS])}


def main() -> None:
    cases = {work.__name__: work for work in (dome, large, points)}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", choices=cases)
    parser.add_argument("seed", type=int)
    parser.add_argument("--problem", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    importing, _ = seconds_of(imported)
    starting, _ = seconds_of(lambda: small(options.threads))
    calls = cases[options.case](options)
    from tissuereg._base.machine import versions

    print(json.dumps({"import": importing, "small": starting, "calls": calls, "versions": versions()}))


if __name__ == "__main__":
    main()
