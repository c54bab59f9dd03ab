"""Displacement that no load explains: its covariance, what markers leave of it, and what it does to an answer."""

import numpy as np
import pytest

import tissuereg as tr
from support.pushes import MATERIAL, push
from tissuereg.registration.contacts.unexplained import Unexplained


@pytest.fixture(scope="module")
def field():
    mesh = push().mesh
    places = mesh.nodes[push().nodes]
    return Unexplained.of(mesh, mesh.fixed_nodes, places, 2.0)


def kernel(x, y, length):
    q = np.sqrt(3.0) * np.linalg.norm(x[:, None] - y[None], axis=2) / length
    return (1.0 + q) * np.exp(-q)


def test_fields_and_rest_have_the_covariance_that_is_zero_where_the_body_is_held(field):
    mesh, length = push().mesh, 0.3 * push().mesh.extent
    some = np.random.default_rng(0).choice(mesh.n_nodes, 40, replace=False)
    x, held = mesh.nodes[some], mesh.nodes[mesh.fixed_nodes]
    across = kernel(x, held, length)
    wanted = kernel(x, x, length) - across @ np.linalg.solve(
        kernel(held, held, length) + 1e-6 * np.eye(len(held)), across.T
    )
    whole = field.fields[some] @ field.fields[some].T + field.rest[some] @ field.rest[some].T
    assert np.abs(whole - wanted).max() < 0.1
    assert np.abs(whole - wanted).mean() < 0.003
    variance = np.sum(field.fields[some] ** 2, axis=1) + field.left[some]
    assert variance == pytest.approx(np.diag(wanted), abs=1e-4)
    assert np.sum(field.rest[some] ** 2, axis=1) == pytest.approx(field.left[some], abs=0.1)
    assert np.abs(field.fields[mesh.fixed_nodes]).max() < 2e-3
    assert field.left[push().nodes].max() < 1e-4 < 0.1 < field.left.max()


def test_rows_and_fields_agree(field):
    rng = np.random.default_rng(1)
    coefficients = rng.standard_normal((2, field.n_columns))
    nodes, weights = np.array([7, 300, 41]), rng.standard_normal((3, 3))
    by_field = np.einsum("dnx,nx->d", field.displacement(coefficients)[:, nodes], weights)
    assert field.responses([(nodes, weights)]) @ coefficients.T == pytest.approx(by_field[None], rel=1e-12)


def swollen():
    """A body that grows where it is not held: no load on its surface does that."""
    mesh = push().mesh
    height = mesh.nodes[:, 2:] / 24.0
    moved = 0.15 * height**2 * (mesh.nodes - [30.0, 30.0, 0.0])
    return mesh, moved


def registered(mesh, moved, **options):
    rng = np.random.default_rng(2)
    top = mesh.surface_nodes[mesh.nodes[mesh.surface_nodes, 2] > 8.0]
    nodes = rng.choice(top, 30, replace=False)
    inner = np.setdiff1d(np.arange(mesh.n_nodes), np.union1d(mesh.surface_nodes, mesh.fixed_nodes))
    markers = tr.Markers(mesh.nodes[nodes], (mesh.nodes + moved)[nodes] + 0.02 * rng.standard_normal((30, 3)), 0.02)
    targets = {str(node): mesh.nodes[node] for node in inner}
    settings = tr.RegisterSettings(contacts=tr.ContactSettings(**options))
    result = tr.register(tr.Body(mesh, MATERIAL), markers, targets=targets, settings=settings)
    truth = (mesh.nodes + moved)[inner]
    held = [target.region(0.9).contains(place) for target, place in zip(result.targets.values(), truth, strict=True)]
    return result, float(np.mean(held))


def test_a_body_that_grows_is_covered_and_said_to_do_what_no_load_does():
    mesh, moved = swollen()
    result, covered = registered(mesh, moved)
    assert covered > 0.8
    assert any(reason.startswith("unexplained: ") for reason in result.trust.reasons)
    assert result.explained_mm["unexplained"] > 0.1 * np.sqrt(np.mean(np.sum(moved**2, axis=1)))
    assert set(result.explained_mm) == {"loads", "tracker", "stiffness", "unexplained"}
    # Between the markers the rest is most of the spread, of nodes and of draws as of targets.
    nodes = np.array([int(name) for name in result.targets])
    stated = np.array([np.sqrt(np.trace(target.covariance)) for target in result.targets.values()])
    assert np.mean(result.std[nodes] / stated) == pytest.approx(1.0, abs=0.05)
    draws = result.draws(40)[:, nodes]
    drawn = np.sqrt(np.sum(draws.var(axis=0), axis=1))
    assert 0.8 < np.sqrt(np.mean(drawn**2) / np.mean(stated**2)) < 1.1
    _, before = registered(mesh, moved, unexplained=(1e-6, 0.1))
    assert before < covered - 0.2


def test_a_push_is_explained_by_loads():
    result = tr.register(tr.Body(push().mesh, MATERIAL), push().markers())
    parts = result.explained_mm
    assert parts["unexplained"] < 0.05 * parts["loads"]
    assert result.trust.ok, result.trust.reasons
    assert result.to_json()["explained_mm"] == parts


def test_a_stiffness_far_from_the_believed_one_is_said():
    mesh = push().mesh
    height = mesh.nodes[mesh.tets].mean(axis=1)[:, 2] / 24.0
    softer = tr.Material(8.0 * np.exp(1.5 - 3.0 * height), 0.4)
    load = tr.Load(
        traction=(mesh.surface[(mesh.nodes[mesh.surface][:, :, 2] > 24 - 1e-9).all(axis=1)], (0.4, 0.1, -0.2))
    )
    moved = tr.simulate(mesh, load, softer).displacement
    result, covered = registered(mesh, moved, stiffness=(0.5, 0.5))
    assert any(reason.startswith("stiffness: ") for reason in result.trust.reasons)
    assert result.explained_mm["stiffness"] > 0.0
    assert covered > 0.7


def test_another_motion_changes_the_prior_of_the_size_alone(field):
    kept = field.fields
    other = field.with_motion(7.0)
    assert other.motion == 7.0
    assert other.fields is kept
    fresh = Unexplained(field.nodes, field.length, field.held, field.places, 7.0)
    assert np.array_equal(other.fields, fresh.fields)
    assert np.array_equal(other.left, fresh.left)
