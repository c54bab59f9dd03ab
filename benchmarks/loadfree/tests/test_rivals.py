"""The rivals behave as named; interrupted runs resume; the page is generated from the results."""

import numpy as np
import pytest

from loadfree import archive, run
from loadfree.events import BODIES, read_body, true_load
from loadfree.gaussian import LENGTHS, gaussian_answer, responses
from loadfree.layouts import NOISE_MM, chosen
from loadfree.reference import FOLDER, read_reference
from loadfree.rivals import METHODS, Case
from loadfree.wrong import wrong_description, wrong_load
from tissuereg import Load
from tissuereg.errors import ConvergenceError

BODY = read_body("phantom")


def test_the_gaussian_field_finds_tractions_of_its_own_kind():
    rng = np.random.default_rng(1)
    found = responses("phantom")
    nodes, covered = BODY.mesh.nodes[found.free], []
    forces = np.zeros((BODY.mesh.n_nodes, 3))
    places = chosen(BODY, BODY.events[0], "spread", 40)
    for _ in range(3):
        push = rng.normal(size=(6, 3)) * 25.0
        centres = nodes[rng.choice(len(nodes), 6)]
        width = LENGTHS[3] * BODY.mesh.extent
        forces[found.free] = np.exp(-0.5 * (np.linalg.norm(nodes[:, None] - centres, axis=2) / width) ** 2) @ push
        truth = found.at_rest.derivatives([Load(forces=forces)]).displacement[0]
        seen = _at_pool(truth)[places] + NOISE_MM * rng.normal(size=(len(places), 3))
        answer, targets, spread = gaussian_answer(BODY, places, seen, NOISE_MM)
        assert np.linalg.norm(answer - truth, axis=1).mean() < 0.1 * np.linalg.norm(truth, axis=1).mean()
        off = targets - _at_targets(truth)
        covered.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off) < 6.251)
    assert np.mean(covered) > 0.8


def _at_pool(field):
    from loadfree.gaussian import on_surface

    nodes, weights = on_surface(BODY)
    return np.einsum("na,nax->nx", weights, field[nodes])


def _at_targets(field):
    from loadfree.gaussian import in_tets

    nodes, weights = in_tets(BODY)
    return np.einsum("na,nax->nx", weights, field[nodes])


@pytest.mark.parametrize("name", ["none", "rigid", "spline", "gaussian"])
def test_quick_rivals_answer_at_every_node_and_target(name):
    event = BODY.events[0]
    answer = METHODS[name](Case(BODY, event, "spread"))
    assert answer.nodes.shape == event.nodes.shape
    assert answer.targets.shape == event.targets.shape
    assert (answer.covariances is not None) == (name == "gaussian")
    if name != "none":
        off = np.linalg.norm(answer.nodes - event.nodes, axis=1).mean()
        assert off < np.linalg.norm(event.nodes, axis=1).mean()


@pytest.mark.parametrize("name", BODIES)
def test_a_wrong_load_is_half_as_large_turned_by_30_degrees_and_12_mm_away_on_the_free_surface(name):
    body = read_body(name)
    skin = np.setdiff1d(body.mesh.surface_nodes, body.mesh.fixed_nodes)
    for event in body.events:
        changed = wrong_description(body, event)
        pairs = list(zip(event.description["contacts"], changed["contacts"], strict=True))
        for true, wrong in pairs:
            assert np.abs(body.mesh.nodes[skin] - wrong["centre"]).max(axis=1).min() == 0.0
            off = np.linalg.norm(np.subtract(wrong["centre"], true["centre"]))
            assert off == pytest.approx(12.0, abs=2.0)  # there must be a node
        turned = [(true["force_mN"], wrong["force_mN"]) for true, wrong in pairs]
        if event.kind == "gravity":
            turned.append((event.description["weight_mN_per_mm3"], changed["weight_mN_per_mm3"]))
        for true, wrong in turned:
            size = np.linalg.norm(true)
            assert np.linalg.norm(wrong) == pytest.approx(0.5 * size)
            assert np.dot(true, wrong) == pytest.approx(0.5 * size**2 * np.cos(np.pi / 6))
        load = wrong_load(body, event)
        whole = np.sum([contact["force_mN"] for contact in changed["contacts"]], axis=0)
        np.testing.assert_allclose(load.forces.sum(axis=0), whole, atol=1e-9 * np.abs(load.forces).sum())
        assert np.array_equal(load.forces, wrong_load(body, event).forces)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.setattr(archive, "RESULTS", tmp_path)
    monkeypatch.setattr(archive, "SCRATCH", tmp_path)
    monkeypatch.setattr(run, "SCRATCH", tmp_path)
    return tmp_path


def test_a_run_goes_on_where_it_stopped_and_keeps_other_methods(elsewhere, monkeypatch):
    words = ["--bodies", "beam", "--limit", "2", "--methods"]
    run.main([*words, "rigid"])
    scratch = elsewhere / "dev-rigid.jsonl"
    lines = scratch.read_text().splitlines()
    assert len(lines) == 8
    scratch.write_text("\n".join(lines[:5]) + "\n" + lines[5][:20])
    asked = []
    monkeypatch.setattr(run, "answer_event", lambda task, bench: asked.append(task) or [])
    run.main([*words, "rigid"])
    assert [(task[2], task[3]) for task in asked] == [(2, ["random", "near", "far"])]
    monkeypatch.undo()


def test_an_error_of_the_package_is_a_row_without_an_answer(monkeypatch):
    def failing(case):
        message = "no equilibrium"
        raise ConvergenceError(message)

    monkeypatch.setitem(METHODS, "rigid", failing)
    (row,) = run.answer_event(("rigid", "beam", 0, ["far"]))
    assert row["error"] == "ConvergenceError: no equilibrium"
    assert "body_mm" not in row


def test_results_are_read_as_written_and_methods_stand_beside_each_other(elsewhere):
    for method in ("none", "rigid"):
        run.main(["--bodies", "beam", "--limit", "1", "--methods", method])
    answer = archive.read_results(elsewhere / "dev")
    assert set(answer["rows"]) == {"none", "rigid"}
    assert answer["methods"]["rigid"]["n"] == 4
    assert [(event["body"], event["event"]) for event in answer["events"]] == [("beam", 0)]
    assert len(answer["events"][0]["moved_um"]) == len(answer["rows"]["none"][0]["off_um"]) == 60
    # Not moving is off by the motion itself.
    assert answer["rows"]["none"][0]["off_um"] == answer["events"][0]["moved_um"]


@pytest.mark.skipif(not FOLDER.is_dir(), reason="the reference problems are not part of the repository")
def test_a_reference_problem_is_told_its_own_load_and_a_wrong_one_of_half_its_size():
    body = read_reference("dome_4k_pull")
    with np.load(FOLDER / "dome_4k_pull.npz") as stored:
        forces = stored["forces_mN"]
    (contact,) = body.events[0].description["contacts"]
    np.testing.assert_allclose(true_load(body, body.events[0]).forces.sum(axis=0), forces.sum(axis=0))
    assert np.dot(contact["normal"], contact["force_mN"]) > 0.5 * np.linalg.norm(contact["force_mN"])
    loaded = body.mesh.nodes[forces.any(axis=1)]
    assert np.linalg.norm(loaded - contact["centre"], axis=1).max() == pytest.approx(contact["radii"][0])
    believed = wrong_load(body, body.events[0])
    assert np.linalg.norm(believed.forces.sum(axis=0)) == pytest.approx(0.5 * np.linalg.norm(forces.sum(axis=0)))
