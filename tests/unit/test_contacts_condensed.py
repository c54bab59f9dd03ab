"""A body on springs of any stiffness from one factorisation, and the stiffness that is chosen with it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from support.pushes import MATERIAL, body, columns_of, push
from tissuereg._base.clock import Clock
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.contacts.condensed import Condensed
from tissuereg.registration.contacts.evidence import _best_over_sizes, _parts, support_stiffness
from tissuereg.registration.contacts.fit import Passes, start_of
from tissuereg.registration.contacts.measured import MarkerData, ObservedData
from tissuereg.registration.contacts.places import gathered
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.contacts.state import RigidMotion

SETTINGS = ContactSettings()

#: Stiffness of the rim and of what lies within.
OTHER = [0.2, 60.0]


def passes_of(believed=None):
    """Return passes over a slab whose base is perhaps held, pushed at its top."""
    columns, markers = columns_of("perhaps", believed), push().markers()
    observed = MarkerObservation.of(columns.body.mesh, markers)
    observed = ObservedData.of(MarkerData(observed, markers, SETTINGS.model_error))
    return Passes(columns, observed, MATERIAL, SETTINGS, np.random.default_rng(0), 1, Clock())


@cache
def condensed():
    """Return the slab under a believed weight, on springs of middling stiffness, with passes there and their start."""
    passes = passes_of({"body_force": np.array([2e-3, 0.0, -4e-3])})
    found = Condensed.of(passes, RigidMotion.still(), 3.0)
    there = replace(passes, columns=found.columns)
    return found, there, start_of(found.columns, MATERIAL, None, RigidMotion.still(), 1)


def test_groups_of_places_are_compact_and_none_is_empty():
    rng = np.random.default_rng(0)
    places = rng.random((900, 2)) @ np.array([[60.0, 0.0, 0.0], [0.0, 60.0, 0.0]])
    group = gathered(places, np.ones(900), 36)
    count = np.bincount(group)
    assert len(count) == 36
    assert count.min() > 0
    # Squares of 10 mm have a root mean square distance of 4.1 mm from their middle.
    middles = np.stack([np.bincount(group, along) / count for along in places.T], axis=1)
    assert np.sqrt(np.mean(np.sum((places - middles[group]) ** 2, axis=1))) < 4.8


def test_cells_have_the_area_of_the_base_and_lie_in_their_set():
    cells, slab = condensed()[0].cells, body("perhaps")
    assert cells.areas.sum() == pytest.approx(3600.0)
    assert np.bincount(cells.of_set).tolist() == [30, 30]
    assert cells.weights.sum(axis=1) == pytest.approx(1.0)
    for index, (triangles, _) in enumerate(slab.springs):
        used = np.flatnonzero(cells.weights[cells.of_set == index].sum(axis=0))
        assert np.array_equal(used, np.unique(triangles))


def test_motions_on_other_springs_balance_the_pull_of_these():
    found, passes, start = condensed()
    there, cells = found.on(OTHER), found.cells
    n_obs, n_nodes = len(found.innovation), cells.weights.shape[1]
    coefficients = 0.2 * np.random.default_rng(1).standard_normal(found.columns.n_columns)
    moved = found.responses @ coefficients
    cell_motion = np.linalg.solve(np.eye(len(there.pull)) + found.among * there.pull, moved[n_obs:])
    forces = found.columns.forces(coefficients[None])
    forces[0, :n_nodes] -= np.einsum("qn,qx->nx", cells.weights, (there.pull * cell_motion).reshape(-1, 3))
    field = passes.linear.tangent(start).linearised.responses(forces)[0, :n_nodes]
    assert (cells.weights @ field).ravel() == pytest.approx(cell_motion, abs=1e-5 * np.abs(cell_motion).max())
    observed = moved[:n_obs] + there.by_motion @ moved[n_obs:]
    wanted = np.array([np.sum(field[nodes] * weights) for nodes, weights in passes.observed.read(start).rows])
    assert observed == pytest.approx(wanted, abs=1e-5 * np.abs(wanted).max())
    assert np.abs(observed - moved[:n_obs]).max() > 0.02 * np.abs(observed).max()
    # One cause alone: its covariance is the outer product of what it does.
    assert there.observed(np.outer(moved, moved)) == pytest.approx(
        np.outer(observed, observed), abs=1e-9 * np.max(observed**2)
    )


def test_innovations_follow_the_stiffness_as_solves_do():
    found, passes, start = condensed()
    before = passes.observed.read(start).residual
    assert found.on([3.0, 3.0]).innovation == pytest.approx(before)
    for other in ([6.0, 6.0], [6.0, 2.0]):
        solved = passes.observed.read(
            start_of(found.columns.on_springs(other), MATERIAL, None, RigidMotion.still(), 1)
        ).residual
        change = found.on(other).innovation - before
        assert np.linalg.norm(change - (solved - before)) < 0.15 * np.linalg.norm(solved - before)


def log_evidence(passes, frame):
    """Return the log evidence of a body that is factored with its springs, as no search does."""
    problem = passes.observations(start_of(passes.columns, passes.material, None, frame, passes.threads))
    parts = _parts(passes.columns, problem.responses, SETTINGS.evidence)
    return _best_over_sizes(problem.innovation, np.diag(problem.variances), parts, SETTINGS.evidence)


def test_the_chosen_stiffness_is_nearly_the_best_of_all_that_are_solved_and_costs_one_factorisation():
    passes = passes_of()
    found = support_stiffness(passes, RigidMotion.still())
    assert passes.counters["factorisations"] <= 1
    tried = SETTINGS.stiffness_tried
    value = lambda stiffness: log_evidence(  # noqa: E731
        replace(passes, columns=passes.columns.on_springs(stiffness)), RigidMotion.still()
    )
    solved = {(rim, inner): value([rim, inner]) for rim in tried for inner in tried}
    assert solved[found.best] > max(solved.values()) - 1.0
    assert solved[found.best] > min(solved.values()) + 3.0
    best = solved[found.best]
    for index, std in enumerate(found.log_std):
        levels = [tuple(one if i == index else b for i, b in enumerate(found.best)) for one in tried]
        chances = np.exp([solved[one] - best for one in levels])
        logs, chances = np.log(tried), chances / chances.sum()
        assert std == pytest.approx(np.sqrt(chances @ (logs - chances @ logs) ** 2), abs=0.4)
