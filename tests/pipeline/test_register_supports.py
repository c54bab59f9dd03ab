"""Bodies whose supports or frame are not known: free, perhaps held, on a tracker that drifts, softer on one side."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.body.observe import TargetObservation
from tissuereg.errors import ArgumentError, MaterialError
from tissuereg.registration.contacts.state import RigidMotion

SILICONE = tr.Material(8.0, 0.45)

HELD = ("perhaps", "sure")


@pytest.fixture(scope="module")
def body():
    return block((30.0, 30.0, 24.0), (6, 6, 5))


def pulled(mesh, held, material=SILICONE):
    """Return the displacement of a body held at some nodes under a local pull on its top."""
    top = np.isclose(mesh.nodes[:, 2], mesh.nodes[:, 2].max())
    away = np.linalg.norm(mesh.nodes - [20.0, 18.0, 24.0], axis=1)
    forces = (top * np.clip(1.0 - (away / 9.0) ** 2, 0.0, None))[:, None] * np.array([60.0, 20.0, 90.0])
    rig = tr.Mesh(mesh.nodes, mesh.tets, {"fixed": held})
    return tr.simulate(rig, tr.Load(forces=forces), material).displacement


def seen(mesh, places, std=0.05, seed=4):
    """Return 15 markers spread over the surface above the base."""
    nodes = mesh.surface_nodes[mesh.nodes[mesh.surface_nodes, 2] > 1.0]
    chosen = [int(nodes[0])]
    gap = np.full(len(nodes), np.inf)
    while len(chosen) < 15:
        gap = np.minimum(gap, np.linalg.norm(mesh.nodes[nodes] - mesh.nodes[chosen[-1]], axis=1))
        chosen.append(int(nodes[np.argmax(gap)]))
    noise = std * np.random.default_rng(seed).standard_normal((15, 3))
    return tr.Markers(mesh.nodes[chosen], places[chosen] + noise, std)


def error(result, places):
    return float(np.linalg.norm(result.mesh.nodes + result.displacement - places, axis=1).mean())


def turned(degrees, shift):
    """Return a rigid motion about an oblique axis."""
    half = np.deg2rad(degrees) * np.array([1.0, 2.0, 2.0]) / 3.0
    angle = np.linalg.norm(half)
    x, y, z = half / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return RigidMotion(rotation, np.asarray(shift, float))


def test_a_body_that_nothing_holds_is_found_after_a_rigid_motion_and_a_pull(body):
    base = np.flatnonzero(body.nodes[:, 2] == 0.0)
    corners = [
        np.argsort(np.linalg.norm(body.nodes[base] - c, axis=1))[:4] for c in ([0, 0, 0], [30, 0, 0], [15, 30, 0])
    ]
    moved = pulled(body, base[np.unique(corners)])
    places = turned(15.0, (12.0, -12.0, 10.0)).apply(body.nodes + moved)
    free = tr.Body(tr.Mesh(body.nodes, body.tets), held="free")
    result = tr.register(free, seen(body, places), targets={"middle": body.nodes.mean(axis=0)})
    rigid = RigidMotion.between(body.nodes, places).apply(body.nodes)
    bent = np.linalg.norm(places - rigid, axis=1).mean()
    assert bent > 0.5
    assert error(result, places) < 0.5 * bent
    assert result.markers.after_rms_mm < 0.3


def held_where(body, inside):
    """Return where a body held at a part of its base goes, and registrations with supports perhaps held and sure."""
    x, y, z = body.nodes.T
    places = body.nodes + pulled(body, np.flatnonzero((z == 0.0) & inside(x, y)))
    inner = np.setdiff1d(np.arange(body.n_nodes), body.surface_nodes)
    targets = {str(node): body.nodes[node] for node in inner}
    markers = seen(body, places)
    # The elements of the truth: what is in question here are the supports.
    return places, [tr.register(tr.Body(body, held=held, element="tet4"), markers, targets=targets) for held in HELD]


def coverage(result, places):
    """Return the share of targets, named by their node, whose 90 % region holds the truth."""
    return np.mean([target.region(0.90).contains(places[int(name)]) for name, target in result.targets.items()])


@pytest.mark.parametrize("reach", [12.0, 22.0])
def test_the_edge_of_a_sure_support_is_uncertain_by_an_element(body, reach):
    """The support truly ends an element (5 mm) before or behind the edge that is stated, at x = 17 mm."""
    x, _, z = body.nodes.T
    places = body.nodes + pulled(body, np.flatnonzero((z == 0.0) & (x < reach)))
    stated = np.flatnonzero((z == 0.0) & (x < 17.0))
    near = {str(i): (at, 15.0 + i % 3, 1.5) for i, at in enumerate(np.linspace(12.0, 21.0, 10))}
    inner = TargetObservation(body, near)
    moved = inner.reference + inner.predict((places - body.nodes)[inner.nodes])
    result = tr.register(
        tr.Body(body.with_node_set("fixed", stated), SILICONE, element="tet4"), seen(body, places), targets=near
    )
    held = [result.target(name).region(0.90).contains(place) for name, place in zip(inner.names, moved, strict=True)]
    assert np.mean(held) >= 0.7


def test_supports_that_hold_at_the_rim_alone_are_found(body):
    rim = lambda x, y: (np.minimum(x, 30.0 - x) < 1.0) | (np.minimum(y, 30.0 - y) < 1.0)  # noqa: E731
    places, (perhaps, sure) = held_where(body, rim)
    assert error(perhaps, places) < 0.25
    assert error(perhaps, places) < 0.6 * error(sure, places)
    assert coverage(perhaps, places) >= 0.80
    assert coverage(sure, places) < 0.50


def test_supports_that_hold_in_the_middle_alone_are_found(body):
    places, (perhaps, sure) = held_where(body, lambda x, y: np.hypot(x - 15.0, y - 15.0) < 9.0)
    assert error(perhaps, places) < 0.6 * error(sure, places)
    assert coverage(perhaps, places) >= 0.80


def test_supports_that_hold_at_two_corners_are_found_in_part(body):
    corners = lambda x, y: (np.hypot(x - 8.0, y - 8.0) < 8.0) | (np.hypot(x - 24.0, y - 20.0) < 7.0)  # noqa: E731
    places, (perhaps, sure) = held_where(body, corners)
    assert error(perhaps, places) < 0.36
    assert error(sure, places) < 0.6


def test_a_tracker_that_drifts_is_distinguished_from_a_pull(body):
    places = body.nodes + pulled(body, np.flatnonzero(body.nodes[:, 2] == 0.0))
    drifted = turned(0.5, (0.6, -0.45, 0.2)).apply(places)
    known, drifts = (
        tr.register(body, seen(body, drifted), settings=tr.RegisterSettings(tracker=tracker))
        for tracker in ("fixed", "drifts")
    )
    assert error(drifts, drifted) < 0.15
    assert error(drifts, drifted) < 0.6 * error(known, drifted)


def test_a_body_softer_at_its_top_is_found_so(body):
    height = body.nodes[body.tets].mean(axis=1)[:, 2] / 24.0
    graded = tr.Material(8.0 * np.exp(1.0 - 2.0 * height), 0.45)
    places = body.nodes + pulled(body, np.flatnonzero(body.nodes[:, 2] == 0.0), graded.scaled(0.5))
    uniform, found = (tr.register(tr.Body(body, stiffness=kind), seen(body, places)) for kind in ("believed", "graded"))
    priors = []
    for result in (uniform, found):
        fit = result.draw.fit
        slopes = fit.columns.slopes(fit.state.coefficients)
        axis = int(np.argmax(np.abs(slopes)))
        upwards = np.corrcoef(fit.columns.body.profiles[axis], height)[0, 1]
        assert abs(upwards) > 0.99
        # Markers tell it, whatever is believed: half of the change from the middle to the top at least.
        assert -slopes[axis] * upwards > 0.5
        family = next(family for family in fit.columns.families if family.name == "stiffness")
        priors.append(np.sqrt(np.median(family.factors)))
    assert priors == pytest.approx([0.1, 0.5])
    assert error(found, places) < 1.2 * error(uniform, places)


def test_words_for_tracker_and_stiffness_are_checked(body):
    markers = seen(body, body.nodes)
    with pytest.raises(ArgumentError, match="one of fixed, drifts, got 'moves'"):
        tr.RegisterSettings(tracker="moves")
    with pytest.raises(MaterialError, match="one of believed, graded, got 'soft'"):
        tr.Body(body, stiffness="soft")
    with pytest.raises(MaterialError, match="a load or none"):
        tr.register(tr.Body(body, stiffness="graded"), markers, simulation=np.zeros_like(body.nodes))
