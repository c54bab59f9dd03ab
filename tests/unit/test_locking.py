"""A warning that linear tets lock is given once per call, at the caller's line; nowhere else."""

import warnings

import numpy as np
import pytest

import tissuereg as tr
from tissuereg import _core
from tissuereg.errors import LockingWarning
from tissuereg.simulation.frames import Acting, FrameSettings, Pad, solve_frames

PULL = np.array([0.0, 0.0, 20.0])


def soft(poisson):
    return tr.Material(young=10.0, poisson=poisson)


def pull(mesh):
    forces = np.zeros((mesh.n_nodes, 3))
    forces[int(np.argmax(mesh.nodes[:, 2]))] = PULL
    return tr.Load(forces=forces)


def one(mesh, element, poisson):
    tr.Simulator(mesh, element=element).solve(pull(mesh), soft(poisson))


def one_by_function(mesh, element, poisson):
    tr.simulate(mesh, pull(mesh), soft(poisson), element=element)


def many(mesh, element, poisson):
    tr.Simulator(mesh, element=element).solve_many([pull(mesh)] * 3, [soft(0.4), soft(poisson), soft(poisson)])


def frames(mesh, element, poisson):
    top = np.flatnonzero(mesh.nodes[:, 2] > mesh.nodes[:, 2].max() - 1e-6)
    push = Pad("top", top, [[0.0, 0.0, -0.1], [0.0, 0.0, -0.2]])
    solve_frames(mesh, soft(poisson), [0.0, 1.0], Acting(pads=[push]), settings=FrameSettings(element=element))


def core(mesh, element, poisson):
    body = _core.Body(mesh.nodes, mesh.tets, mesh.fixed_nodes, element=element)
    body.solve(np.array([10.0]), np.array([poisson]), body_force=np.array([0.0, 0.0, -1e-3]))


WAYS = [one, one_by_function, many, frames, core]


@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_solve_warns_once_that_linear_tets_lock_at_the_callers_line(block_mesh, way):
    with pytest.warns(LockingWarning, match=r"ratio 0\.49 .*tet4-averaged") as warned:
        way(block_mesh, "tet4", 0.49)
    assert [warning.filename for warning in warned] == [__file__]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("element", "poisson"), [("tet4", 0.45), ("tet4", 0.475), ("tet4-averaged", 0.499), ("tet10", 0.499)]
)
def test_there_is_no_warning_where_nothing_locks(block_mesh, way, element, poisson):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        way(block_mesh, element, poisson)


def test_one_tet_that_locks_is_enough(block_mesh):
    poisson = np.full(block_mesh.n_tets, 0.4)
    poisson[3] = 0.48
    with pytest.warns(LockingWarning, match=r"0\.48"):
        tr.Simulator(block_mesh).solve(pull(block_mesh), tr.Material(young=10.0, poisson=poisson))


def test_a_warning_made_an_error_ends_the_solve(block_mesh):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(LockingWarning):
            one(block_mesh, "tet4", 0.49)


def test_averaged_elements_take_a_modulus_for_each_of_their_four_points(block_mesh):
    simulator = tr.Simulator(block_mesh, element="tet4-averaged")
    uniform = simulator.solve(pull(block_mesh), soft(0.49)).displacement
    points = tr.Material(young=np.full((block_mesh.n_tets, 4), 10.0), poisson=0.49)
    assert np.abs(simulator.solve(pull(block_mesh), points).displacement - uniform).max() < 1e-9
