"""Prior standard deviations estimated from effect-free data: known ones are recovered."""

import numpy as np
import pytest

from blind.score import report
from blind.sizes import Needs, force_errors, kind_of, sizes_of
from support.rigs import STROKE, rig
from tissuereg.diagnosis.signals import SignalLayout


def drawn(true, generator, size=40):
    """Return a case whose nuisances, two of each kind, are `true` times their prior standard deviations."""
    kinds = np.repeat(list(true), 2)
    columns = generator.standard_normal((len(kinds), size))
    amplitudes = np.array([true[kind] for kind in kinds]) * generator.standard_normal(len(kinds))
    left = amplitudes @ columns + generator.standard_normal(size)
    return Needs(kinds, columns, left)


def test_known_sizes_are_recovered():
    rng = np.random.default_rng(3)
    true = {"frame": 1.0, "size": 2.5, "tilt": 0.4}
    found = sizes_of([drawn(true, rng) for _ in range(40)])
    for kind, size in found.items():
        # Ranges are of two standard deviations; this is one of four.
        assert size["low"] ** 2 / size["factor"] < true[kind] < size["high"] ** 2 / size["factor"], kind
        assert size["high"] / size["low"] < 1.7, kind
    assert found["size"]["gain_nats"] > 20.0


def test_likelihood_is_that_of_the_whole_covariance():
    rng = np.random.default_rng(4)
    columns, left = rng.standard_normal((3, 7)), rng.standard_normal(7)
    needs = Needs(np.array(["a", "a", "b"]), columns, left)

    def dense(factors):
        covariance = np.eye(7) + (factors[:, None] * columns).T @ (factors[:, None] * columns)
        return -0.5 * left @ np.linalg.solve(covariance, left) - 0.5 * np.linalg.slogdet(covariance)[1]

    some, others = np.array([1.0, 2.0, 0.3]), np.ones(3)
    change = needs.log_likelihood(some) - needs.log_likelihood(others)
    assert change == pytest.approx(dense(some) - dense(others), abs=1e-10)


def test_mesh_errors_of_forces_and_markers_are_separate_kinds():
    pads = {"push_x": "ball", "push_y": "nodes"}
    assert kind_of("mesh push_x push_x 2", pads) == "mesh, forces"
    assert kind_of("bent push_x push_x 2", pads) == "bent, forces"
    assert kind_of("mesh push_x 2 0", pads) == "mesh, markers"
    assert kind_of("tilt of push_x 1", pads) == "tilt, ball"
    assert kind_of("size of push_y", pads) == "size, nodes"
    assert kind_of("edge of base", pads) == "edge"
    assert kind_of("surface 3", pads) == "surface"


def test_errors_of_forces_are_split_along_and_across_them():
    layout = SignalLayout(rig())
    base = np.zeros(layout.size)
    for part in layout.parts:
        load = np.zeros(part.n_frames) if part.name == "rest" else STROKE
        part.markers(base)[..., 2] = -load[:, None]
        for pad in range(len(part.pads)):
            part.forces(base)[:, pad, 2] = -200.0 * load
            part.forces(layout.measured)[:, pad] = part.forces(base)[:, pad] + load[:, None] * [0.0, 4.0, -2.0]
    found = force_errors(layout, base, base, 3.0)
    # Frames with at most half of the load are not used.
    loaded = (STROKE > 0.5).sum()
    np.testing.assert_allclose(found, [[0.01, 0.02 / np.sqrt(2.0), 3.0 / np.sqrt(loaded) / 200.0]] * 2)


def test_the_report_shows_what_was_found():
    sizes = {"nulls": 9, "sizes": {"size": {"factor": 1.31, "low": 1.2, "high": 1.46, "gain_nats": 10.4}}}
    shown = report([], {}, {}, {}, sizes=sizes)
    assert "Prior standard deviations" in shown
    assert "| size | 1.31 | 1.20-1.46 | 10.4 |" in shown
    assert "Prior standard deviations" not in report([], {}, {}, {})
    sizes["forces"] = {"along": 0.0123, "across": 0.004, "noise": 0.001}
    assert "1.23 % of the largest force along the force and 0.40 %" in report([], {}, {}, {}, sizes=sizes)
