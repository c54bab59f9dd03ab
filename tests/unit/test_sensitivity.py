"""Derivatives of equilibria against differences of solves."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.errors import ConvergenceError, MaterialError, ShapeError
from tissuereg.simulation.sensitivity import Linearised, ModulusField, Observation, Parameter
from tissuereg.simulation.solve import Simulator

TIGHT = {"tolerance": 1e-12, "method": "newton"}
ELEMENTS = ["tet4", "tet4-averaged", "tet10"]
PULL = tr.Load(body_force=[0.02, 0.005, 0.04])


@pytest.fixture(params=ELEMENTS)
def simulator(request):
    return Simulator(block(cells=(2, 1, 3)), element=request.param)


def difference(solved, step):
    """Return the fourth-order central difference of displacement and reactions."""
    a, b, c, d = (solved(k * step) for k in (-2, -1, 1, 2))

    def of(name):
        far, near = getattr(d, name) - getattr(a, name), getattr(c, name) - getattr(b, name)
        return (8 * near - far) / (12 * step)

    return of("displacement"), of("reactions")


def linearised(simulator, load, material):
    found = simulator.solve(load, material, **TIGHT)
    return Linearised(simulator, load, material, found.all_displacement)


def assert_close(found, k, wanted):
    for ours, theirs in zip((found.displacement[k], found.reactions[k]), wanted, strict=True):
        assert np.abs(theirs).max() > 0.0
        assert np.abs(ours - theirs).max() < 1e-5 * np.abs(theirs).max()


def test_parameters_agree_with_differences(simulator):
    def material(young=9.0, poisson=0.4, b=1.5):
        return tr.Material(young, poisson, law="fung", shape={"b": b})

    here = linearised(simulator, PULL, material())
    found = here.derivatives([Parameter("young"), Parameter("poisson"), Parameter("b")])
    assert found.displacement.shape == (3, simulator.mesh.n_nodes, 3)
    for k, (name, value, step) in enumerate([("young", 9.0, 1e-2), ("poisson", 0.4, 1e-4), ("b", 1.5, 1e-2)]):
        wanted = difference(lambda by, n=name, v=value: simulator.solve(PULL, material(**{n: v + by}), **TIGHT), step)
        assert_close(found, k, wanted)


def test_a_term_of_an_ogden_law_agrees_with_differences(simulator):
    def material(by=0.0):
        return tr.Material(9.0, 0.4, law="ogden", shape={"alpha": [4.0, -7.0 + by], "weight": [1.2, 0.4]})

    found = linearised(simulator, PULL, material()).derivatives([Parameter("alpha", 1)])
    assert_close(found, 0, difference(lambda by: simulator.solve(PULL, material(by), **TIGHT), 1e-2))


@pytest.mark.parametrize("each", ["tet", "point"])
def test_fields_agree_with_differences(simulator, each):
    n = simulator.mesh.n_tets
    rng = np.random.default_rng(2)
    shape = (n,) if each == "tet" else (n, simulator.n_points)
    rates = rng.uniform(-1.0, 1.0, shape)

    def material(young=0.0, poisson=0.0):
        return tr.Material(np.full(shape, 9.0) + young * rates, np.full(shape, 0.4) + poisson * rates)

    found = linearised(simulator, PULL, material()).derivatives(
        [ModulusField("young", rates), ModulusField("poisson", rates)]
    )
    for k, (name, step) in enumerate([("young", 1e-2), ("poisson", 1e-4)]):
        wanted = difference(lambda by, m=name: simulator.solve(PULL, material(**{m: by}), **TIGHT), step)
        assert_close(found, k, wanted)


def test_loads_agree_with_differences(simulator):
    mesh = simulator.mesh
    rng = np.random.default_rng(3)
    surface = simulator.body.surface_triangles
    top = surface[(mesh.nodes[surface][..., 2] > 39.9).all(axis=1)]
    rates = {
        "forces": rng.normal(size=(mesh.n_nodes, 3)),
        "body_force": np.array([0.01, -0.02, 0.01]),
        "prescribed": rng.normal(size=(len(simulator.held_nodes), 3)),
    }

    def load(by):
        return tr.Load(
            forces=by * rates["forces"],
            body_force=np.asarray(PULL.body_force) + by * rates["body_force"],
            prescribed=by * rates["prescribed"],
            traction=(top, by * np.array([0.1, 0.0, 0.3])),
        )

    silicone = tr.Material(9.0, 0.4)
    rate = tr.Load(**rates, traction=(top, [0.1, 0.0, 0.3]))
    found = linearised(simulator, load(0.0), silicone).derivatives([rate])
    assert_close(found, 0, difference(lambda by: simulator.solve(load(by), silicone, **TIGHT), 1e-3))


def test_adjoints_are_the_transpose_of_derivatives(simulator):
    rng = np.random.default_rng(5)
    here = linearised(simulator, PULL, tr.Material(9.0, 0.4))
    shape = (simulator.mesh.n_tets, simulator.n_points)
    fields = rng.normal(size=(2, *shape))
    push = tr.Load(
        forces=rng.normal(size=(simulator.mesh.n_nodes, 3)),
        body_force=rng.normal(size=3),
        prescribed=rng.normal(size=(len(simulator.held_nodes), 3)),
    )
    forward = here.derivatives([ModulusField("young", fields[0]), ModulusField("poisson", fields[1]), push])
    marker = Observation([3, 9, 9], rng.normal(size=(3, 3)))
    reaction = Observation(held_nodes=simulator.held_nodes[:2], held_weights=rng.normal(size=(2, 3)))
    adjoints = here.adjoints([marker, reaction])
    assert adjoints.young.shape == (2, *shape)
    wanted = np.stack(
        [
            np.einsum("ki,cki->c", marker.weights, forward.displacement[:, [3, 9, 9]]),
            np.einsum("ki,cki->c", reaction.held_weights, forward.reactions[:, :2]),
        ]
    )
    by_push = (
        np.einsum("onk,nk->o", adjoints.forces[:, : simulator.mesh.n_nodes], push.forces)
        + adjoints.body_force @ push.body_force
        + np.einsum("ohk,hk->o", adjoints.prescribed, push.prescribed)
    )
    found = np.stack(
        [np.sum(adjoints.young * fields[0], axis=(1, 2)), np.sum(adjoints.poisson * fields[1], axis=(1, 2)), by_push]
    ).T
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_wrong_input_is_named():
    simulator = Simulator(block(cells=(2, 1, 3)))
    silicone = tr.Material(9.0, 0.4)
    rest = np.zeros((simulator.mesh.n_nodes, 3))
    with pytest.raises(ConvergenceError, match="equilibrium"):
        Linearised(simulator, PULL, silicone, rest)
    with pytest.raises(ShapeError, match="`displacement` must have shape"):
        Linearised(simulator, PULL, silicone, rest[:4])
    here = Linearised(simulator, tr.Load(), silicone, rest)
    with pytest.raises(MaterialError, match="this law"):
        here.derivatives([Parameter("b")])
    with pytest.raises(ShapeError, match="`rates of young` must have shape"):
        here.derivatives([ModulusField("young", [1.0, 2.0])])
    with pytest.raises(ShapeError, match="`weights` must have shape"):
        here.adjoints([Observation([3, 4], [[1.0, 0.0, 0.0]])])
