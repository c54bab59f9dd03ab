"""The answer that is left where a registration is not to be trusted: linear elasticity alone."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support import doors
from support.meshes import block
from tissuereg.body.observe import TargetObservation
from tissuereg.cli.register import summary
from tissuereg.registration import fallback as fallbacks
from tissuereg.registration import registrar as registrars
from tissuereg.registration.body import fitting_element
from tissuereg.registration.contacts.elastic import ElasticBody
from tissuereg.registration.linear_prior import most_probable

MATERIAL = tr.Material(young=8.0, poisson=0.4)
TARGET = np.array([15.0, 11.0, 22.0])


@pytest.fixture(scope="module")
def mesh():
    return block(cells=(4, 4, 5))


@pytest.fixture(scope="module")
def places(mesh):
    return mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[::7]]


@pytest.fixture(scope="module")
def moved(mesh):
    """A simulation."""
    height = mesh.nodes[:, 2:] / mesh.extent
    return height * np.array([2.0, 0.0, -0.5])


def torn(places, seed=0):
    """Return markers of which each is somewhere else: no body explains them."""
    return places + np.random.default_rng(seed).normal(scale=4.0, size=places.shape)


def registered(mesh, places, measured, **how):
    given = {"std": 0.1, "material": MATERIAL, "threads": 1, "targets": {"t": TARGET}, **how}
    std = given.pop("std")
    return doors.registered(mesh, tr.Markers(places, measured, std), **given)


def linear_elastic(mesh, places, measured, simulation=None, std=0.1):
    markers = tr.Markers(places, np.full_like(places, np.nan), std)
    body = ElasticBody(mesh, MATERIAL, markers, element=fitting_element(mesh, MATERIAL), threads=1)
    seen = np.flatnonzero(np.isfinite(measured).all(axis=1))
    residual = body.residual((measured - places)[seen], seen, simulation)
    change = most_probable(body.priors(), residual, seen)[1].displacement_mm
    return change if simulation is None else simulation + change


def test_it_is_linear_elasticity_about_the_simulation(mesh, places, moved):
    result = registered(mesh, places, torn(places), simulation=moved)
    assert not result.trust.ok
    used = np.isin([f"M{i + 1}" for i in range(len(places))], result.markers.used)
    seen = np.where(used[:, None], torn(places), np.nan)
    expected = linear_elastic(mesh, places, seen, moved)
    np.testing.assert_allclose(result.fallback.displacement, expected, atol=1e-9)
    node = int(np.argmin(np.linalg.norm(mesh.nodes - TARGET, axis=1)))
    at_node = registered(mesh, places, torn(places), simulation=moved, targets={"n": mesh.nodes[node]})
    np.testing.assert_allclose(at_node.fallback.targets["n"] - mesh.nodes[node], expected[node], atol=1e-9)


def test_without_a_simulation_it_is_about_rest_and_takes_the_noise_of_the_moment(mesh, places):
    registrar = tr.Registrar(
        tr.Body(mesh, material=MATERIAL), tr.Markers(places, std=0.1), settings=tr.RegisterSettings(threads=1)
    )
    found = registrar.register(tr.Markers(places, torn(places), 2.0, registrar.markers.names))
    other = registrar.register(torn(places))
    for result, std in ((found, 2.0), (other, 0.1)):
        result = result if not result.trust.ok else replace(result, trust=replace(result.trust, ok=False))
        used = np.isin(registrar.markers.names, result.markers.used)
        expected = linear_elastic(mesh, places, np.where(used[:, None], torn(places), np.nan), std=std)
        np.testing.assert_allclose(result.fallback.displacement, expected, atol=1e-9)


def test_a_result_that_can_be_trusted_has_none_and_costs_nothing(mesh, places, moved, monkeypatch):
    made = []
    init = ElasticBody.__init__

    def counted(self, *given, **named):
        made.append(1)
        init(self, *given, **named)

    monkeypatch.setattr(fallbacks.ElasticBody, "__init__", counted)
    registrar = tr.Registrar(
        tr.Body(mesh, material=MATERIAL), tr.Markers(places, std=0.1), settings=tr.RegisterSettings(threads=1)
    )
    good = registrar.register(places + 0.05 * np.random.default_rng(3).standard_normal(places.shape))
    assert good.trust.ok
    assert good.fallback is None
    bad, again = registrar.register(torn(places)), registrar.register(torn(places, 1))
    assert not made
    assert bad.fallback is bad.fallback is not None
    assert again.fallback is not None
    assert len(made) == 1
    # Other places of markers are another body to linearise.
    fewer = registrar.made_for(tr.Markers(places[:-1], places[:-1], 0.1))
    off = fewer.register(torn(places)[:-1])
    used = np.isin(fewer.markers.names, off.markers.used)
    expected = linear_elastic(mesh, places[:-1], np.where(used[:, None], torn(places)[:-1], np.nan))
    np.testing.assert_allclose(off.fallback.displacement, expected, atol=1e-9)


def test_markers_that_were_seen_in_part_are_left_out(mesh, places, moved):
    part = torn(places)
    part[2, 1] = np.nan
    result = registered(mesh, places, part, simulation=moved)
    used = np.isin([f"M{i + 1}" for i in range(len(places))], result.markers.used)
    used[2] = False
    expected = linear_elastic(mesh, places, np.where(used[:, None], torn(places), np.nan), moved)
    assert not result.trust.ok
    np.testing.assert_allclose(result.fallback.displacement, expected, atol=1e-9)


def test_a_body_that_can_move_freely_has_none(mesh, places):
    free = tr.Mesh(mesh.nodes, mesh.tets)
    result = registered(free, places, torn(places), held="free")
    assert not result.trust.ok
    assert result.fallback is None


def test_a_large_body_has_none(mesh, places, monkeypatch):
    monkeypatch.setattr(registrars, "LARGEST", mesh.n_nodes - 1)
    assert registered(mesh, places, torn(places)).fallback is None
    monkeypatch.setattr(registrars, "LARGEST", mesh.n_nodes)
    assert registered(mesh, places, torn(places)).fallback is not None


def test_it_is_in_the_json_and_comes_with_many_moments(mesh, places, moved, tmp_path):
    how = {"settings": tr.RegisterSettings(threads=1), "targets": {"t": TARGET}, "simulation": moved}
    alone = registered(mesh, places, torn(places), simulation=moved)
    said = alone.to_json()["fallback"]
    assert said["method"] == "linear elastic"
    np.testing.assert_array_equal(said["targets_mm"]["t"], alone.fallback.targets["t"])
    (many,) = tr.register_many(tr.Body(mesh, MATERIAL), [tr.Markers(places, torn(places), 0.1)], **how)
    np.testing.assert_array_equal(many.fallback.displacement, alone.fallback.displacement)
    (line,) = [line for line in summary(alone.to_json(), "out").splitlines() if "linear elasticity" in line]
    place = ", ".join(f"{x:.2f}" for x in said["targets_mm"]["t"])
    assert line == f"By linear elasticity alone, without a region: t at ({place}) mm."
    assert line in alone.report(tmp_path / "report.html").read_text(encoding="utf-8")
    good = registered(mesh, places, places + 0.05 * np.random.default_rng(3).standard_normal(places.shape))
    assert good.trust.ok
    assert good.to_json()["fallback"] is None


def test_markers_where_they_were_simulated_leave_the_simulation_as_it_is(mesh, places, moved):
    seen = mesh.nodes[:, None, :] == places[None]
    there = places + moved[np.argmax(seen.all(axis=2), axis=0)]
    markers, targets = tr.Markers(places, there, 0.1), TargetObservation(mesh, {"t": TARGET})
    found = fallbacks.ElasticFallback.of(mesh, MATERIAL, markers, targets, 1).about(markers, markers.names, moved)
    np.testing.assert_allclose(found.displacement, moved, atol=1e-9)
