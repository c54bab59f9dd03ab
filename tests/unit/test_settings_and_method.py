"""What means nothing for a method cannot be given to it; settings are checked where they are made and kept whole."""

import dataclasses
import json

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from support.small_model import SMALL_MODEL
from tissuereg.errors import ArgumentError, MaterialError, ModelError, SupportError
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.contacts.settings import ContactSettings

FEW = ContactSettings(n_chains=2, n_chains_first=2, max_passes=1, n_kept=1, powers=(1.0,), n_draws=2)
PLACES = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0]])


@pytest.fixture(scope="module")
def mesh():
    return phantom_mesh("small")


@pytest.fixture(scope="module")
def places(mesh):
    return mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[::40]]


def made(mesh, places, body=None, load=None, **settings):
    return tr.Registrar(
        tr.Body(mesh, **(body or {})), places, SMALL_MODEL, load=load, settings=tr.RegisterSettings(**settings)
    )


OF_CONTACTS = {"tracker": "drifts", "contacts": FEW, "ensemble": 30}
OF_SUPPORTS = {"held": "perhaps", "stiffness": "graded"}


@pytest.mark.parametrize("name", OF_CONTACTS)
def test_a_setting_of_contacts_means_nothing_with_a_model(mesh, places, name):
    with pytest.raises(
        ModelError, match=f"`{name}` must be left out with a trained model, where it means nothing; got"
    ) as e:
        made(mesh, places, **{name: OF_CONTACTS[name]})
    assert e.value.where == name


@pytest.mark.parametrize("name", OF_SUPPORTS)
def test_what_is_believed_of_supports_and_stiffness_means_nothing_with_a_model(mesh, places, name):
    with pytest.raises(ModelError, match=f"`{name}` must be left out with a trained model.*'{OF_SUPPORTS[name]}'") as e:
        made(mesh, places, {name: OF_SUPPORTS[name]})
    assert e.value.where == name


@pytest.mark.parametrize("name", ["element", "held_nodes"])
def test_elements_and_prescribed_nodes_mean_nothing_with_a_model_that_simulates_no_load(mesh, places, name):
    body = {"element": "tet4-averaged", "held_nodes": mesh.fixed_nodes}
    with pytest.raises(ModelError, match=f"`{name}` must be left out.*without a `load`.*; got"):
        made(mesh, places, {name: body[name]})
    assert not made(mesh, places, {name: body[name]}, tr.Load(body_force=(0.0, 0.0, 0.001))).by_contacts


def test_a_material_is_that_of_the_fallback_with_a_model_as_well(mesh, places):
    assert not made(mesh, places, {"material": tr.Material(5.0)}).by_contacts


def test_a_moment_before_means_nothing_with_a_model(mesh, places):
    registrar = made(mesh, places)
    before = registrar.register(places + 0.1)
    with pytest.raises(ModelError, match="`after` must be left out with a trained model"):
        registrar.register(places + 0.1, after=before)


OF_MODELS = {"smoother": tr.SmootherSettings(n_members=50), "readings": "always"}


@pytest.mark.parametrize("name", OF_MODELS)
def test_a_setting_of_models_means_nothing_without_one(name):
    body = block(cells=(2, 2, 3))
    with pytest.raises(ArgumentError, match=f"`{name}` must be left out without a trained model.*; got") as e:
        tr.register(body, (PLACES, PLACES), settings=tr.RegisterSettings(**{name: OF_MODELS[name]}))
    assert e.value.where == name


def test_variants_mean_nothing_without_a_model():
    body = block(cells=(2, 2, 3))
    with pytest.raises(ArgumentError, match="`variants` are of a registration with a trained model"):
        tr.register(body, (PLACES, PLACES), simulation=tr.SimulationVariants(np.zeros((4, body.n_nodes, 3))))


def test_beliefs_and_settings_are_frozen_and_checked_where_they_are_made():
    body, settings = tr.Body(block(cells=(2, 2, 3))), tr.RegisterSettings()
    for noun, name in ((body, "held"), (settings, "tracker"), (settings.smoother, "update")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(noun, name, "other")
    with pytest.raises(SupportError, match="one of sure, perhaps, free, got 'maybe'"):
        tr.Body(body.mesh, held="maybe")
    with pytest.raises(SupportError, match="must name nodes"):
        tr.Body(body.mesh, held_nodes=[body.mesh.n_nodes])
    with pytest.raises(MaterialError, match="stiffness"):
        tr.Body(body.mesh, stiffness="soft")
    with pytest.raises(ArgumentError, match="element"):
        tr.Body(body.mesh, element="tet5")
    assert dataclasses.replace(body, held="free").held == "free"


def test_settings_and_beliefs_reach_the_result_and_its_json_whole(tmp_path):
    mesh = block(cells=(2, 2, 3))
    settings = tr.RegisterSettings(threads=1, tracker="drifts", contacts=FEW)
    body = tr.Body(mesh, tr.Material(5.0), held="perhaps", element="tet4")
    result = tr.register(body, tr.Markers(PLACES, PLACES + 0.1, 0.2), settings=settings)
    assert isinstance(result, tr.ContactRegistration)
    assert isinstance(result, tr.Registration)
    assert result.settings is settings
    assert result.body is body
    written = json.loads((result.save(tmp_path / "out") / "registration.json").read_text(encoding="utf-8"))
    assert written["tracker"] == "drifts"
    kept = written["provenance"]["settings"]
    names = {one.name for one in dataclasses.fields(tr.RegisterSettings)} - {"threads"}
    assert set(kept) == names | {"body"}
    assert kept["contacts"] == json.loads(json.dumps(dataclasses.asdict(FEW)))
    assert kept["smoother"] == dataclasses.asdict(tr.SmootherSettings())
    assert kept["body"]["held"] == "perhaps"
    assert kept["body"]["element"] == "tet4"
    assert kept["body"]["material"]["young_kpa"] == 5.0


def test_a_result_of_a_model_has_what_models_give_and_no_more(mesh, places):
    result = made(mesh, places).register(places + 0.1)
    assert isinstance(result, tr.LearnedRegistration)
    assert isinstance(result, tr.Registration)
    assert result.dropped_members == []
    assert not hasattr(result, "contacts")
    said = result.to_json()
    assert (said["surface"], said["contacts"], said["work"], said["dropped_members"]) == (None, [], {}, [])
    with pytest.raises(ModelError, match="draws need a registration by contacts"):
        result.draws(3)
    assert repr(result).startswith("LearnedRegistration(")


def test_a_registrar_for_other_markers_is_as_one_that_was_made_for_them(mesh, places):
    load = tr.Load(body_force=(0.0, 0.0, 0.001))
    some = made(mesh, places, load=load)
    fewer = tr.Markers(places[:-1], places[:-1] + 0.1)
    one, other = some.made_for(fewer).register(fewer), made(mesh, fewer, load=load).register(fewer)
    assert np.array_equal(one.displacement, other.displacement)
    assert one.trust == other.trust
    assert some.made_for(some.markers) is some
