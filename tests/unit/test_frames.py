"""A body through time frames, from Python: closed-form solutions, failures, and unchanged input."""

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.simulation.behaviour import (
    Behaviour,
    DrainageLaw,
    RateLaw,
    RelaxationLaw,
    SetLaw,
    SofteningLaw,
    Springs,
    SwellingLaw,
)
from tissuereg.simulation.frames import Acting, FrameSettings, Pad, Similar, solve_frames

SOFT = tr.Material(young=8.0, poisson=0.4)
WEIGHT = np.array([0.0, 0.0, -9.81e-3])


def block(n=3, size=30.0):
    """Return a cube of n^3 cells on its base, the set ``top`` above."""
    axis = np.linspace(0.0, size, n + 1)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    paths = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (1, 0, 2), (2, 1, 0)]
    tets = []
    for cell in np.ndindex(n, n, n):
        for k, path in enumerate(paths):
            corner = list(cell)
            tet = [index[tuple(corner)]]
            for step in path:
                corner[step] += 1
                tet.append(index[tuple(corner)])
            tets.append(tet if k < 3 else [tet[0], tet[2], tet[1], tet[3]])
    low, high = nodes[:, 2] < 1e-9, nodes[:, 2] > size - 1e-9
    sets = {"fixed": np.flatnonzero(low), "top": np.flatnonzero(high)}
    return tr.Mesh(nodes, np.array(tets), sets)


def facets(mesh, on):
    return mesh.surface[on[mesh.surface].all(axis=1)]


def push(mesh, *z):
    return Pad("top", mesh.node_sets["top"], [[0.0, 0.0, v] for v in z])


def test_an_elastic_body_has_the_answer_of_a_single_solve_in_every_frame():
    mesh = block()
    found = solve_frames(mesh, SOFT, [0, 1, 2], Acting(pads=[push(mesh, 0.0, -2.0, -5.0)]))
    held = np.concatenate([mesh.fixed_nodes, mesh.node_sets["top"]])
    prescribed = np.zeros((len(held), 3))
    prescribed[len(mesh.fixed_nodes) :, 2] = -5.0
    alone = tr.simulate(mesh, tr.Load(prescribed=prescribed), SOFT, held_nodes=held)
    np.testing.assert_allclose(found.displacement[2], alone.displacement, atol=1e-6)
    np.testing.assert_allclose(
        found.pad_forces["top"][2], alone.reactions[len(mesh.fixed_nodes) :].sum(axis=0), atol=1e-4
    )
    assert found.failed == []
    assert [report["load_steps"] for report in found.reports] == [1, 1, 1]


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_a_held_pad_relaxes_as_its_series_says(element):
    mesh = block(2)
    times = np.array([0.0, 0.5, 4.0, 60.0])
    behaviour = Behaviour(relaxation=RelaxationLaw([0.3, 0.2], [1.0, 5.0]))
    pad = push(mesh, *[-3.0] * 4)
    found = solve_frames(
        mesh, SOFT, times, Acting(pads=[pad]), behaviour=behaviour, settings=FrameSettings(element=element)
    )
    left = 0.5 + 0.3 * np.exp(-times / 1.0) + 0.2 * np.exp(-times / 5.0)
    force = found.pad_forces["top"][:, 2]
    np.testing.assert_allclose(force / force[0], left, rtol=1e-6)


def test_a_pad_that_leaves_frees_its_nodes():
    mesh = block()
    pad = Pad("top", mesh.node_sets["top"], [[np.nan] * 3, [1.0, 0, -4.0], [np.nan] * 3])
    found = solve_frames(mesh, SOFT, [0, 1, 2], Acting(pads=[pad], weight=WEIGHT))
    assert np.isnan(found.pad_forces["top"][[0, 2]]).all()
    np.testing.assert_allclose(found.displacement[2], found.displacement[0], atol=1e-6)
    moved = found.displacement[1] - found.displacement[0]
    np.testing.assert_allclose(moved[mesh.node_sets["top"]], [[1.0, 0, -4.0]] * 16, atol=1e-7)


def test_every_behaviour_reaches_the_solver():
    mesh = block(2)
    pad = push(mesh, 0.0, -4.0, -1.0)
    elastic = solve_frames(mesh, SOFT, [0, 1, 2], Acting(pads=[pad])).pad_forces["top"][:, 2]
    for behaviour in (
        Behaviour(relaxation=RelaxationLaw([0.4], [1.0], part="isochoric")),
        Behaviour(rate=RateLaw(2.0)),
        Behaviour(softening=SofteningLaw(2.0, 0.05, 0.1)),
        Behaviour(set=SetLaw(0.3)),
        Behaviour(drainage=DrainageLaw(0.5, 1.0)),
        Behaviour(swelling=SwellingLaw(0.1, 0.0, 2.0)),
    ):
        force = solve_frames(mesh, SOFT, [0, 1, 2], Acting(pads=[pad]), behaviour=behaviour).pad_forces["top"][:, 2]
        assert abs(force[2] - elastic[2]) > 0.01 * abs(elastic[2]), behaviour


def test_a_body_on_springs_sinks_by_weight_over_stiffness():
    mesh = block(2)
    bed = Springs(facets(mesh, mesh.nodes[:, 2] < 1e-9), 0.3, 0.1)
    found = solve_frames(
        mesh, tr.Material(young=1e3, poisson=0.3), [0.0], Acting(springs=[bed], held_nodes=[], weight=WEIGHT)
    )
    np.testing.assert_allclose(found.spring_forces[0, 0], -WEIGHT * 27000.0, atol=1e-5)
    sunk = found.displacement[0][mesh.node_sets["fixed"], 2]
    np.testing.assert_allclose(sunk, WEIGHT[2] * 30.0 / 0.3, rtol=2e-2)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
def test_a_mesh_given_under_its_weight_stays_where_it_is(element):
    mesh = block()
    weight = -2 * WEIGHT
    found = solve_frames(
        mesh,
        SOFT,
        [0, 1],
        Acting(pads=[push(mesh, 0.0, 2.0)], weight=weight, in_reference=True),
        settings=FrameSettings(element=element),
    )
    assert np.abs(found.displacement[0]).max() < 1.01e-6
    assert np.abs(found.rest_nodes - mesh.nodes).max() > 0.5
    np.testing.assert_allclose(found.displacement[1][mesh.node_sets["top"], 2], 2.0, atol=1e-5)
    hung = tr.Mesh(found.rest_nodes, mesh.tets, mesh.node_sets)
    again = solve_frames(hung, SOFT, [0], Acting(weight=weight), settings=FrameSettings(element=element))
    np.testing.assert_allclose(found.rest_nodes + again.displacement[0], mesh.nodes, atol=2e-6)


def test_a_frame_without_equilibrium_is_a_row_of_nan_and_the_history_goes_on():
    mesh = block(2)
    found = solve_frames(mesh, SOFT, [0, 1, 2], Acting(pads=[push(mesh, -1.0, -40.0, -2.0)]))
    assert [frame for frame, _ in found.failed] == [1]
    assert "no equilibrium" in found.failed[0][1]
    assert np.isnan(found.displacement[1]).all()
    assert np.isfinite(found.displacement[[0, 2]]).all()
    assert found.reports[1] == {}


def test_progress_counts_frames():
    output = []
    solve_frames(block(2), SOFT, [0, 1, 2], progress=output.append)
    assert output == [1, 2, 3]


def test_what_does_not_fit_is_named():
    mesh = block(2)
    pad = push(mesh, -1.0, -2.0)
    with pytest.raises(tr.errors.ShapeError, match="motion of pad 'top'"):
        solve_frames(mesh, SOFT, [0, 1, 2], Acting(pads=[pad]))
    with pytest.raises(tr.errors.LoadError, match="different names"):
        solve_frames(mesh, SOFT, [0, 1], Acting(pads=[pad, pad]))
    with pytest.raises(tr.errors.LoadError, match="all axes or none, not so in frame 1"):
        solve_frames(mesh, SOFT, [0, 1], Acting(pads=[Pad("p", [26], [[0, 0, 0], [np.nan, 0, 0]])]))
    with pytest.raises(tr.errors.LoadError, match="one load per frame, got 1 for 2"):
        solve_frames(mesh, SOFT, [0, 1], Acting(loads=[tr.Load()]))
    with pytest.raises(tr.errors.LoadError, match="only where `weight` is given"):
        solve_frames(mesh, SOFT, [0], Acting(in_reference=True))
    with pytest.raises(tr.errors.LoadError, match="must not run backwards"):
        solve_frames(mesh, SOFT, [1, 0])
    with pytest.raises(tr.errors.MaterialError, match=r"`relaxation\.g` must be"):
        solve_frames(mesh, SOFT, [0], behaviour=Behaviour(relaxation=RelaxationLaw([1.5], [1.0])))
    with pytest.raises(tr.errors.TissueRegError, match="`part` must be"):
        solve_frames(mesh, SOFT, [0], behaviour=Behaviour(relaxation=RelaxationLaw([0.5], [1.0], part="half")))
    with pytest.raises(tr.errors.SupportError, match="translation x"):
        solve_frames(mesh, SOFT, [0], Acting(held_nodes=[]))
    with pytest.raises(tr.errors.ConvergenceError, match="no unloaded shape"):
        solve_frames(mesh, SOFT, [0], Acting(weight=[0, 0, -5.0], in_reference=True))
    with pytest.raises(tr.errors.ConvergenceError, match="some frame must find equilibrium"):
        solve_frames(mesh, SOFT, [0], Acting(pads=[push(mesh, -40.0)]))


def test_a_similar_body_and_a_kept_rig_change_nothing_but_the_work():
    mesh, times = block(), np.arange(6.0)
    pads = [push(mesh, 0.0, -2.0, -4.0, -4.0, -4.0, -2.0)]
    rigs = {}

    def solved(share, **left):
        behaviour = Behaviour(relaxation=RelaxationLaw(g=[share], tau_s=[2.0]))
        return solve_frames(mesh, SOFT, times, Acting(pads=pads), behaviour=behaviour, similar=Similar(**left))

    def work(frames):
        return sum(report["iterations"] for report in frames.reports)

    near = solved(0.3, rigs=rigs)
    plain = solved(0.32)
    again = solved(0.32, rigs=rigs)
    np.testing.assert_array_equal(again.all_displacement, plain.all_displacement)
    led = solved(0.32, rigs=rigs, near=near.all_displacement)
    assert len(rigs) == 1
    np.testing.assert_allclose(led.displacement, plain.displacement, atol=1e-7)
    np.testing.assert_allclose(led.pad_forces["top"], plain.pad_forces["top"], rtol=1e-6, atol=1e-6)
    assert work(led) < 0.8 * work(plain)
    # Frames that are unknown are sought without.
    unknown = near.all_displacement.copy()
    unknown[2:4] = np.nan
    np.testing.assert_allclose(solved(0.32, near=unknown).displacement, plain.displacement, atol=1e-7)
    # The modulus is not remembered.
    stiff = solve_frames(
        mesh, tr.Material(young=16.0, poisson=0.4), times, Acting(pads=pads), similar=Similar(rigs=rigs)
    )
    soft = solve_frames(mesh, SOFT, times, Acting(pads=pads), similar=Similar(rigs=rigs))
    np.testing.assert_allclose(stiff.pad_forces["top"], 2.0 * soft.pad_forces["top"], rtol=1e-9, atol=1e-9)


def test_a_rig_is_kept_for_its_own_mesh_alone():
    rigs = {}
    for size in (30.0, 33.0):
        mesh = block(size=size)
        found = solve_frames(mesh, SOFT, [0, 1], Acting(pads=[push(mesh, 0.0, -2.0)]), similar=Similar(rigs=rigs))
        new = solve_frames(mesh, SOFT, [0, 1], Acting(pads=[push(mesh, 0.0, -2.0)]))
        np.testing.assert_array_equal(found.displacement, new.displacement)


def test_a_similar_body_has_as_many_frames_and_nodes():
    mesh = block()
    with pytest.raises(tr.errors.ShapeError, match="near"):
        solve_frames(
            mesh,
            SOFT,
            [0, 1],
            Acting(pads=[push(mesh, 0.0, -2.0)]),
            similar=Similar(near=np.zeros((1, mesh.n_nodes, 3))),
        )
