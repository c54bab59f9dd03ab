"""Small experiments for tests."""

from pathlib import Path

import numpy as np

from support.meshes import block
from tissuereg.body.material import Material
from tissuereg.experiment.experiment import Actuator, Boundary, Case, Experiment

STROKE = np.array([0.0, 0.5, 1.0, 1.0, 0.0])


def rig(*, gravity=None) -> Experiment:
    """A block with two pads, a rest case and two pushes; markers on and off its surface."""
    mesh = block()
    size = mesh.nodes.max(axis=0)
    top = np.flatnonzero(mesh.nodes[:, 2] == size[2])
    side = np.flatnonzero((mesh.nodes[:, 0] == size[0]) & (mesh.nodes[:, 2] > 0.4 * size[2]))
    one, two = top[mesh.nodes[top, 0] < 0.4 * size[0]], side[mesh.nodes[side, 2] < 0.9 * size[2]]
    reference = np.array(
        [
            [3.0, 0.0, 20.0],
            [12.0, 0.0, 33.0],
            [0.0, 7.0, 25.0],
            [28.0, 12.0, 40.0],
            [15.0, 20.0, 30.0],
            [22.0, 22.0, 36.0],
        ]
    )
    rng = np.random.default_rng(0)
    mesh = mesh.with_node_set("top", one).with_node_set("side", two)
    cases = {}
    for begin, (name, pad, motion) in zip(
        (0.0, 10.0, 20.0),
        (("rest", None, None), ("down", "top", (0, 0, -3.0)), ("in", "side", (-2.5, 0.5, 0))),
        strict=True,
    ):
        times = begin + np.arange(8.0 if pad is None else len(STROKE))
        markers = reference + 0.05 * rng.standard_normal((len(times), len(reference), 3))
        given = {} if pad is None else {pad: STROKE[:, None] * np.array(motion)}
        forces = {} if pad is None else {pad: rng.standard_normal((len(times), 3))}
        cases[name] = Case(name, times, markers, given, forces=forces)
    return Experiment(
        "rig", Path(), Path("mesh.vtu"), mesh, Material(young=10.0, poisson=0.4), 3.0, None, gravity,
        (Boundary("base", mesh.fixed_nodes),),
        (Actuator("top", one, "displacement"), Actuator("side", two, "displacement")),
        tuple(f"P{i}" for i in range(len(reference))), reference, 0.05, {}, cases, force_std=2.0, rest_case="rest",
    )  # fmt: skip
