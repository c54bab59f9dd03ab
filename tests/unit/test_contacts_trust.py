"""What takes trust from an answer by contacts: dropped markers outside their regions, rims of contacts, the misfit."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2, norm

import tissuereg as tr
from support import doors
from support.pushes import ELEMENT, MATERIAL, columns_of, push
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.contacts.answer import Answer, _chance
from tissuereg.registration.contacts.evidence import MarkerEvidence
from tissuereg.registration.contacts.settings import ReportSettings

#: A region whose axes are not those of the tracker.
COVARIANCE = np.array([[1.0, 0.6, -0.3], [0.6, 2.0, 0.5], [-0.3, 0.5, 0.7]])


def registered(markers: tr.Markers, **options: Any) -> tr.Registration:
    options = {"material": MATERIAL, "element": ELEMENT, "threads": 1, **options}
    return doors.registered(push().mesh, markers, **options)


@pytest.fixture(scope="module")
def result() -> tr.Registration:
    return registered(push().markers())


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_component_is_as_unlikely_as_its_own_distribution_says(axis: int) -> None:
    left = np.full(3, np.nan)
    left[axis] = 1.7
    wanted = 2.0 * norm.sf(1.7 / np.sqrt(COVARIANCE[axis, axis]))
    assert _chance(left, COVARIANCE) == pytest.approx(wanted)


def test_two_components_are_as_unlikely_as_where_the_third_could_be_anything() -> None:
    left = np.array([1.0, -1.5, 0.0])
    wide = COVARIANCE.copy()
    wide[2, 2] = 1e12
    score = float(left @ np.linalg.solve(wide, left))
    assert _chance(np.array([1.0, -1.5, np.nan]), COVARIANCE) == pytest.approx(chi2.sf(score, 2), rel=1e-6)
    assert _chance(np.full(3, np.nan), COVARIANCE) == 1.0


@pytest.mark.parametrize(("share", "reported"), [(0.5, True), (2.0, False)])
def test_a_dropped_marker_is_reported_below_one_percent_divided_among_all(share: float, reported: bool) -> None:
    places = np.random.default_rng(0).normal(size=(20, 3))
    size = np.sqrt(chi2.isf(share * 0.01 / 20, 3))
    lost = SimpleNamespace(mean=places[7] - size * np.linalg.cholesky(COVARIANCE)[:, 0], covariance=COVARIANCE)
    one: Any = SimpleNamespace(
        given=SimpleNamespace(markers=tr.Markers(places, places)),
        known=SimpleNamespace(lost=np.array([7])),
        fit=SimpleNamespace(wrong=np.where(np.arange(20) == 7, 0.9, 0.0)),
    )
    unseen: Any = [lost]
    found = Answer._wrong(one, unseen)
    assert [reason[: len("wrong marker: M8 ")] for reason in found] == (["wrong marker: M8 "] if reported else [])


def test_the_misfit_is_that_of_the_innovation_where_the_prior_has_a_part_in_it(result: tr.Registration) -> None:
    draw: Any = result.draw
    trust, misfit = result.trust, draw.fit.misfit
    assert trust.residual_chi_square < misfit
    assert trust.chi_square == pytest.approx(misfit)


def test_noise_that_is_stated_ten_times_too_small_is_named() -> None:
    markers = push().markers()
    places = markers.reference, markers.measured
    assert not any(reason.startswith("noise: ") for reason in registered(tr.Markers(*places, 0.03)).trust.reasons)
    rng = np.random.default_rng(3)
    rough = markers.measured + 0.3 * rng.standard_normal(markers.measured.shape)
    found = registered(tr.Markers(markers.reference, rough, 0.03))
    assert any("noise" in reason for reason in found.trust.reasons)
    assert registered(tr.Markers(markers.reference, rough, 0.3)).trust.ok


def pushed_on_a_base_held(released: float) -> tr.Markers:
    """Return twenty markers of the slab, pulled at its side, whose base is held where x is `released` mm or more."""
    columns = columns_of()
    mesh, patches = columns.body.mesh, columns.body.patches
    coefficients = np.zeros(columns.n_columns)
    side = int(np.argmin(np.linalg.norm(patches.centres - [0.0, 30.0, 18.0], axis=1)))
    coefficients[3 * side : 3 * side + 3] = [-2.0, 1.0, 3.0]
    forces = np.array(columns.load(coefficients).forces)
    held = mesh.fixed_nodes[mesh.nodes[mesh.fixed_nodes, 0] >= released]
    moved = tr.Simulator(mesh, element=ELEMENT, held_nodes=held).solve(tr.Load(forces=forces), MATERIAL).displacement
    rng = np.random.default_rng(8)
    nodes = rng.choice(mesh.surface_nodes[mesh.nodes[mesh.surface_nodes, 2] > 3.0], 20, replace=False)
    noise = 0.03 * rng.standard_normal((20, 3))
    return tr.Markers(mesh.nodes[nodes], mesh.nodes[nodes] + moved[nodes] + noise, 0.03)


@pytest.mark.parametrize(
    ("released", "held", "named"), [(31.0, "sure", True), (0.0, "sure", False), (31.0, "perhaps", False)]
)
def test_a_support_that_gave_is_named_where_it_was_believed(released: float, held: str, named: bool) -> None:
    body = tr.Body(push().mesh, MATERIAL, ELEMENT, held)
    found = tr.register(body, pushed_on_a_base_held(released), settings=tr.RegisterSettings(threads=1))
    assert any(reason.startswith("support: ") for reason in found.trust.reasons) == named
    if not named:
        assert found.trust.ok


@pytest.mark.parametrize(("markers", "named"), [(8, True), (7, False)])
def test_many_markers_need_only_find_larger_noise_more_probable(
    monkeypatch: pytest.MonkeyPatch, markers: int, named: bool
) -> None:
    monkeypatch.setattr(MarkerEvidence, "log_noise_odds", lambda *_: 0.1)
    seen = push().markers()
    found = registered(tr.Markers(seen.reference[:markers], seen.measured[:markers], 0.03))
    assert any(reason.startswith("noise: ") for reason in found.trust.reasons) == named


def test_a_push_that_the_prior_of_contacts_cannot_make_takes_trust_though_markers_are_met() -> None:
    believed = tr.RegisterSettings().contacts
    narrow = replace(believed, sizes=believed.sizes[:1], background=(1e-6, 0.1), weight=(1e-6, 0.1), wrong_odds=1e-30)
    found = registered(push().markers(), settings=tr.RegisterSettings(contacts=narrow))
    assert not found.trust.ok
    assert found.trust.chi_square > 2.0 * found.trust.residual_chi_square


def test_room_for_a_residual_at_a_rim_is_less_than_how_far_the_motion_differs_there(
    result: tr.Registration,
) -> None:
    # All markers are kept and held against the room that their residual has.
    settings = tr.ContactSettings(report=ReportSettings(wrong=2.0))
    markers, mesh = push().markers(), push().mesh
    observed = MarkerObservation.of(mesh, markers)
    differs = observed.variation(push().displacement[observed.nodes])
    at_rim = int(np.argmax(differs))
    assert differs[at_rim] > 10 * 0.03
    measured = markers.measured.copy()
    measured[at_rim] += 2.5 * differs[at_rim] * np.array([0.6, 0.8, 0.0])
    found = registered(tr.Markers(markers.reference, measured, 0.03), settings=tr.RegisterSettings(contacts=settings))
    name = markers.names[at_rim]
    left = np.linalg.norm(found.markers.residual_mm[name])
    assert left > 1.2 * differs[at_rim]
    assert any(reason.startswith(f"wrong marker: {name} ") for reason in found.trust.reasons)
    assert result.trust.ok


def test_a_verdict_is_kept_from_moment_to_moment_and_weighed_anew_now_and_then() -> None:
    registrar = tr.Registrar(
        tr.Body(push().mesh, MATERIAL, ELEMENT), pushed_on_a_base_held(31.0), settings=tr.RegisterSettings(threads=1)
    )
    gave, sound = (pushed_on_a_base_held(released).measured for released in (31.0, 0.0))
    result, said = None, []
    every = tr.ContactSettings().evidence.every
    for moment in range(every + 1):
        result = registrar.register(gave if moment == 0 else sound, after=result)
        said.append(any(reason.startswith("support: ") for reason in result.trust.reasons))
        if result.draw.moments != moment + 1:  # all places were searched anew
            pytest.skip("the second moment did not go on from the first")
    assert said == [True] * every + [False]
