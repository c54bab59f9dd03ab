"""A registrar: what does not change is made once, and every registration is that of `register`."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.answers import told
from tissuereg.errors import ArgumentError, MarkerError, ModelError, ShapeError
from tissuereg.phantom import shipped_model_folder
from tissuereg.phantom.event import LESION_MM, make_event
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.points import PointModel

TARGETS = {"lesion": LESION_MM}


@pytest.fixture(scope="module")
def event():
    return make_event(seed=0)


@pytest.fixture(scope="module")
def simulation(event):
    return tr.simulate(event.mesh, event.load, event.material).displacement


def settings(**changed):
    return tr.RegisterSettings(smoother=tr.SmootherSettings(**{"n_members": 100, **changed}))


def said(result):
    """What a registration says, without its times and the work that those before it have spared it."""
    return told(result, "work")


@pytest.fixture
def counted(monkeypatch):
    """Counts of ensembles decoded at points, by their members; and of whole fields."""
    counts = {"points": [], "fields": 0}
    at_points, fields, changes = PointModel.decode, NetworkModel.decode, NetworkModel.change

    def decode_points(self, latents):
        counts["points"].append(latents.shape[1])
        return at_points(self, latents)

    def decode_fields(self, latents, nodes=None):
        counts["fields"] += latents.shape[1]
        return fields(self, latents, nodes)

    def decode_changes(self, latents, code):
        counts["fields"] += latents.shape[1]
        return changes(self, latents, code)

    monkeypatch.setattr(PointModel, "decode", decode_points)
    monkeypatch.setattr(NetworkModel, "change", decode_changes)
    monkeypatch.setattr(NetworkModel, "decode", decode_fields)
    return counts


def test_every_registration_is_that_of_register_bit_for_bit(event, simulation):
    how = {"targets": TARGETS, "settings": settings(), "seed": 4}
    registrar = tr.Registrar(event.mesh, event.markers, "phantom", **how)
    gone = event.markers.measured.copy()
    gone[2] = np.nan
    for measured, known in ((event.markers.measured, simulation), (gone, None), (event.markers.measured, simulation)):
        markers = tr.Markers(event.markers.reference, measured, event.markers.axis_std, event.markers.names)
        alone = tr.register(event.mesh, markers, model="phantom", simulation=known, **how)
        again = registrar.register(measured, known)
        assert said(again) == said(alone)
        assert np.array_equal(again.displacement, alone.displacement)
        assert np.array_equal(again.std, alone.std)


def test_threads_change_no_bit(event, simulation):
    found = [
        tr.Registrar(
            event.mesh, event.markers, "phantom", TARGETS, settings=replace(settings(), threads=threads)
        ).register(event.markers.measured, simulation)
        for threads in (1, 3)
    ]
    assert said(found[0]) == said(found[1])


#: Latents by which the decoder is linear about a point: for 26 of them.
DRAWS = 62


def ensembles(counts, n_members):
    """Return the number of pairs whose ensembles were decoded in every batch of some counts of latents."""
    assert len(set(counts)) == 1
    pairs, rest = divmod(counts[0], n_members)
    assert rest == 0
    return pairs


def test_about_a_simulation_two_screenings_are_decoded_and_then_all_pairs_in_one_batch_a_step(
    event, simulation, counted
):
    registrar = tr.Registrar(event.mesh, event.markers, "phantom", TARGETS, settings=settings(n_steps=4))
    counted["points"].clear()
    counted["fields"] = 0
    result = registrar.register(event.markers.measured, simulation)
    assert not any(reason.startswith("simulation") for reason in result.trust.reasons)
    assert result.markers.dropped == ()
    # The simulation's code; screenings; four steps, and the answer.
    assert counted["points"][:3] == [1, DRAWS, DRAWS]
    assert len(counted["points"]) == 3 + 5
    assert 1 <= ensembles(counted["points"][3:], 100) <= 4
    # The answer, as a change from the simulation.
    assert counted["fields"] == 1
    # The spread of nodes decodes 64 draws when it is first read.
    assert result.std.shape == (event.mesh.n_nodes,)
    assert counted["fields"] == 1 + 64


@pytest.mark.parametrize("calibrated", [False, True])
def test_without_a_simulation_three_markers_are_screened_again_twice_each(event, counted, calibrated):
    model = NetworkModel(shipped_model_folder(), event.mesh, calibrated=calibrated)
    registrar = tr.Registrar(event.mesh, event.markers, model, TARGETS, settings=settings(n_members=40))
    counted["points"].clear()
    result = registrar.register(event.markers.measured)
    assert result.markers.dropped == ()
    assert counted["points"][:3] == [DRAWS] * 3
    assert 1 <= ensembles(counted["points"][3:8], 40) <= 4
    assert counted["points"][8:] == [DRAWS] * 6


def test_a_marker_that_is_left_out_costs_another_registration(event, simulation, counted):
    registrar = tr.Registrar(event.mesh, event.markers, "phantom", settings=settings(n_members=20, n_steps=1))
    wrong = event.markers.measured.copy()
    wrong[3] += (0.0, 2.0, 2.0)
    counted["points"].clear()
    result = registrar.register(wrong, simulation)
    assert (event.markers.names[3], "wrong") in result.markers.dropped
    assert counted["points"].count(DRAWS) == 2 * (1 + len(result.markers.dropped))
    assert len(counted["points"]) == 1 + 4 * (1 + len(result.markers.dropped))


def test_members_and_steps_change_the_answer_by_less_than_its_spread(event, simulation):
    found = [
        tr.Registrar(event.mesh, event.markers, "phantom", TARGETS, settings=settings(**how))
        .register(event.markers.measured, simulation)
        .target("lesion")
        for how in ({}, {"n_members": 60}, {"n_steps": 8})
    ]
    for one in found[1:]:
        off = one.mean - found[0].mean
        assert 0.0 < off @ np.linalg.solve(found[0].covariance, off) < 0.3**2
        assert np.trace(one.covariance) == pytest.approx(np.trace(found[0].covariance), rel=0.2)


def test_the_model_is_read_and_cut_once_for_the_same_places(event, monkeypatch):
    read, cut = [], []
    plain_read, plain_cut = NetworkModel.__init__, PointModel.__init__
    monkeypatch.setattr(NetworkModel, "__init__", lambda self, *a, **k: read.append(1) or plain_read(self, *a, **k))
    monkeypatch.setattr(PointModel, "__init__", lambda self, *a, **k: cut.append(1) or plain_cut(self, *a, **k))
    # A number of threads that no other test uses: a model that is kept is not read again.
    registrar = tr.Registrar(event.mesh, event.markers, "phantom", settings=replace(settings(), threads=5))
    for _ in range(3):
        registrar.register(event.markers.measured)
    assert (read, cut) == ([1], [1])
    tr.register(event.mesh, event.markers, model="phantom", settings=replace(settings(), threads=5))
    assert read == [1]


def test_markers_are_examined_at_first_and_where_the_answer_is_in_doubt(event, simulation, monkeypatch):
    from tissuereg.registration import inputs

    examined = []
    plain = inputs.suspect
    monkeypatch.setattr(inputs, "suspect", lambda *given: examined.append(1) or plain(*given))
    swapped = event.markers.measured.copy()
    swapped[[2, 9]] = swapped[[9, 2]]
    moments = [swapped, event.markers.measured, event.markers.measured, swapped]
    registrar = tr.Registrar(event.mesh, event.markers, "phantom", settings=settings())
    found, counts = [], []
    for measured in moments:
        found.append(registrar.register(measured, simulation).trust)
        counts.append(len(examined))
    assert [trust.ok for trust in found] == [False, True, True, False]
    # The first is not plausible, so the second is examined as well; the third is not; the last is in doubt.
    assert counts == [1, 2, 2, 3]
    assert found[3].reasons == found[0].reasons
    always = tr.Registrar(event.mesh, event.markers, "phantom", settings=replace(settings(), readings="always"))
    for measured in moments[1:3]:
        always.register(measured, simulation)
    assert len(examined) == 5


def test_a_model_without_weights_to_cut_gives_the_same_answer(event, simulation):
    class Plain:
        """The shipped model behind the bare protocol."""

        def __init__(self):
            self._network = NetworkModel(shipped_model_folder(), event.mesh)
            self.n_latent, self.n_nodes, self.card = self._network.n_latent, self._network.n_nodes, self._network.card
            self.errors, self.decode, self.prior = self._network.errors, self._network.decode, self._network.prior

    network = NetworkModel(shipped_model_folder(), event.mesh, calibrated=False)
    found = [
        tr.Registrar(event.mesh, event.markers, model, TARGETS, settings=settings()).register(event.markers.measured)
        for model in (network, Plain())
    ]
    # Single precision in another order of sums.
    np.testing.assert_allclose(found[0].displacement, found[1].displacement, atol=2e-3)
    np.testing.assert_allclose(found[0].target("lesion").covariance, found[1].target("lesion").covariance, rtol=1e-2)


def test_without_a_model_a_registrar_gives_the_registrations_by_contacts(block_mesh):
    from tissuereg.registration.contacts.settings import ContactSettings

    few = ContactSettings(n_chains=2, n_chains_first=2, max_passes=1, n_kept=1, powers=(1.0,), n_draws=2)
    places = block_mesh.nodes[block_mesh.surface_nodes][::7]
    places = places[places[:, 2] > 20.0][:4]
    measured = places + np.array([0.4, 0.1, 0.0])
    how = {"settings": tr.RegisterSettings(contacts=few), "seed": 2}
    registrar = tr.Registrar(block_mesh, tr.Markers(places, std=0.2), **how)
    alone = tr.register(block_mesh, tr.Markers(places, measured, 0.2), **how)
    for _ in range(2):
        assert said(registrar.register(measured)) == said(alone)


def test_what_does_not_fit_is_refused_by_name(event):
    with pytest.raises(ShapeError, match="reference_mm"):
        tr.Registrar(event.mesh, [1.0, 2.0, 3.0])
    with pytest.raises(MarkerError, match="near the undeformed surface"):
        tr.Registrar(event.mesh, event.markers.reference + 900.0)
    with pytest.raises(MarkerError, match="target 'far'"):
        tr.Registrar(event.mesh, event.markers.reference, targets={"far": (900.0, 0.0, 0.0)})
    with pytest.raises(ModelError, match="no-model"):
        tr.Registrar(event.mesh, event.markers.reference, "no-model")
    with pytest.raises(ArgumentError, match="element"):
        tr.Registrar(tr.Body(event.mesh, element="tet5"), event.markers.reference)
    registrar = tr.Registrar(event.mesh, event.markers.reference, "phantom")
    with pytest.raises(ShapeError, match="measured_mm"):
        registrar.register(event.markers.measured[:3])
    with pytest.raises(ShapeError, match="simulation"):
        registrar.register(event.markers.measured, np.zeros((3, 3)))
    with pytest.raises(MarkerError, match="at least one marker must have been seen"):
        registrar.register(np.full((len(event.markers), 3), np.nan))
    other = tr.Markers(event.markers.reference + 0.1, event.markers.measured)
    with pytest.raises(MarkerError, match="other names or places"):
        registrar.register(other)


def test_a_simulation_that_is_reversed_or_of_another_event_is_a_reason_and_the_right_one_is_none(event, simulation):
    registrar = tr.Registrar(event.mesh, event.markers, "phantom", TARGETS, settings=settings())
    # The body hangs upwards, half as far as it is pushed in the event.
    upwards = tr.simulate(event.mesh, tr.Load(body_force=(0.0, 0.0, 0.01)), event.material).displacement
    other = 0.5 * upwards * np.sqrt((simulation**2).sum() / (upwards**2).sum())
    said = {
        name: [
            reason for reason in registrar.register(event.markers.measured, field).trust.reasons if "simul" in reason
        ]
        for name, field in (("right", simulation), ("reversed", -simulation), ("other", other))
    }
    assert said["right"] == []
    assert any(reason.startswith("simulation: the markers moved against it") for reason in said["reversed"])
    assert "simulation: another event than the simulated one explains the markers better" in said["other"]
