import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import RECIPE, make_workplace, smooth_fields, write_dataset

import tissuereg_training
from tissuereg_training import pipeline
from tissuereg_training.cli import main
from tissuereg_training.data import mesh_digest
from tissuereg_training.errors import CheckpointError
from tissuereg_training.host import best_device, device_name
from tissuereg_training.inversion import volume_ratios
from tissuereg_training.kinds import KINDS
from tissuereg_training.parity import onnx_session

FILES = ["MODEL.md", "decoder.onnx", "decoder_weights.npz", "encoder.onnx", "model.json", "training.png"]


def model_card(place):
    return json.loads((place.folder / "model" / "model.json").read_text())


def finite(value):
    if isinstance(value, dict):
        return all(map(finite, value.values()))
    if isinstance(value, list):
        return all(map(finite, value))
    return value is None or isinstance(value, str | bool) or bool(np.isfinite(value))


def test_the_model_folder_holds_files_that_its_card_knows(trained):
    folder = trained.folder / "model"
    assert sorted(p.name for p in folder.iterdir()) == FILES
    assert not (trained.folder / "model.training").exists()
    for name, digest in model_card(trained)["files"].items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest


def test_the_card_says_what_a_registration_needs(trained):
    card = model_card(trained)
    assert (card["schema"], card["kind"]) == ("tissuereg.model/1", "gnn-vae")
    assert card["mesh_digest"] == mesh_digest(trained.block.nodes, trained.block.tets, trained.block.held)
    assert (card["n_nodes"], card["n_latent"], card["n_bases"], card["members"]) == (150, 6, 9, 200)
    assert card["levels"][0] == 150
    assert len(card["levels"]) == len(card["channels"]) + 1 == 4
    assert card["split"] == {"train": 160, "valid": 20, "test": 20}
    assert finite(card)
    prior = card["prior"]
    assert prior["mismatch_pairs"] == 12
    for name in ("covariance", "mismatch_covariance"):
        matrix = np.array(prior[name])
        assert matrix.shape == (6, 6)
        np.testing.assert_allclose(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > -1e-9
    assert card["code_spread"]["active"] == 6
    assert 0.6 < card["code_spread"]["aggregate_std_mean"] < 1.4
    assert card["kl_weight"] == 5e-3


@pytest.mark.parametrize("kind", ["trained", "closure"])
def test_the_card_tells_data_training_and_shapes_and_a_page_says_the_same(request, kind):
    place = request.getfixturevalue(kind)
    card, folder = model_card(place), place.folder / "model"
    assert card["data"][0] == {"seed": 0, "members": 200, "recipe_sha256": ""}
    training = card["training"]
    assert 0 < training["hours"] < 1
    assert (training["threads"], training["device"], training["stopped_early"]) == (
        1,
        device_name(best_device()),
        False,
    )
    # Decoded again from the files: the model's shapes and how many of them are impossible.
    z = np.random.default_rng([3, 14]).standard_normal((1000, 6), dtype=np.float32)
    found = session(folder / "decoder.onnx").run(None, {"z": z})[0]
    ratios = volume_ratios(place.block.nodes, place.block.tets, found)
    assert card["samples"]["fields"] == 1000
    assert card["samples"]["min_det_f"] == pytest.approx(ratios.min(), abs=1e-3)
    assert card["samples"]["inverted_tets"] == pytest.approx((ratios <= 0).mean(), abs=1e-4)
    assert card["samples"]["fields_with_inverted_tets"] == pytest.approx((ratios <= 0).any(axis=1).mean(), abs=2e-3)
    assert card["reconstructions"]["fields"] == 20
    page = (folder / "MODEL.md").read_text()
    errors = card["errors_mm"]
    for name in ("train", "valid", "test", "pca", "mean_shape"):
        assert f"| {errors[name]:.4f} |" in page
    assert f"error: {errors['test'] / errors['pca']:.3f}" in page
    assert f"KL weight {card['kl_weight']:g}" in page
    assert (folder / "training.png").read_bytes().startswith(b"\x89PNG")


def test_training_learns_and_its_errors_can_be_measured_again_from_the_files(trained):
    card, folder = model_card(trained), trained.folder / "model"
    fields = smooth_fields(trained.block, 200, 1)
    still = np.linalg.norm(fields - fields.mean(axis=0), axis=2).mean()
    assert card["errors_mm"]["test"] < 0.35 * still
    mean = session(folder / "encoder.onnx").run(["mean"], {"displacement": fields})[0]
    found = session(folder / "decoder.onnx").run(None, {"z": mean})[0]
    errors = np.linalg.norm(fields - found, axis=2).mean(axis=1)
    summary = card["errors_mm"]
    assert errors.mean() == pytest.approx(
        0.8 * summary["train"] + 0.1 * summary["valid"] + 0.1 * summary["test"], rel=1e-4
    )


def test_error_fields_are_what_the_model_misses_of_the_pairs_truths(trained):
    folder = trained.folder / "model"
    truths = 1.1 * smooth_fields(trained.block, 12, 2)
    mean = session(folder / "encoder.onnx").run(["mean"], {"displacement": truths})[0]
    missed = truths - session(folder / "decoder.onnx").run(None, {"z": mean})[0]
    with np.load(folder / "decoder_weights.npz", allow_pickle=False) as weights:
        kept = weights["error_fields_mm"]
    assert kept.dtype == np.float16
    # Half precision, for a small table: 11 bits.
    np.testing.assert_allclose(kept, missed, rtol=1e-3, atol=1e-3 * np.abs(missed).max())


def test_change_errors_are_what_the_model_misses_from_simulation_to_truth(trained):
    with np.load(trained.folder / "model" / "decoder_weights.npz", allow_pickle=False) as weights:
        plain, change = weights["error_fields_mm"], weights["change_error_fields_mm"]
        sizes = weights["change_sizes_mm"]
    with h5py.File(trained.folder / "data" / "pairs.h5") as data:
        simulated, true = data["simulation_mm"][()], data["truth_mm"][()]
    encoder, decoder = (session(trained.folder / "model" / f"{name}.onnx") for name in ("encoder", "decoder"))
    code = encoder.run(["mean"], {"displacement": simulated})[0]
    missed_of_simulated = simulated - decoder.run(None, {"z": code})[0]
    # Half precision: 11 bits of each of the two.
    np.testing.assert_allclose(change, plain - missed_of_simulated, atol=2e-3 * np.abs(plain).max())
    np.testing.assert_allclose(sizes, np.sqrt(((true - simulated) ** 2).sum(axis=2).mean(axis=1)), rtol=1e-5)


def session(path):
    import onnx

    return onnx_session(onnx.load(path))


def test_the_json_says_what_was_done(trained):
    summary = trained.answer()
    assert summary["schema"] == "tissuereg.train/1"
    assert set(summary["errors_mm"]) == {"train", "valid", "test", "pca", "mean_shape"}
    assert (summary["epochs"], summary["seed"], summary["threads"]) == (60, 3, 1)
    assert set(summary["parity"]) == {"encoder", "decoder"}
    assert max(summary["parity"].values()) < 1e-4
    assert set(summary["seconds"]) == {"read", "start", "train", "evaluate", "export", "total"}
    assert {"torch", "onnxruntime", "numpy"} <= set(summary["versions"])
    assert set(summary["machine"]) == {"system", "processor", "cores"}
    assert finite(summary)


def test_the_function_returns_the_json_and_replaces_an_older_model(workplace):
    lines = []
    for _ in range(2):
        summary = tissuereg_training.train(
            workplace.recipe, workplace.data, workplace.folder / "model", threads=1, seed=5, report=lines.append
        )
    assert (summary["seed"], summary["epochs"]) == (5, 2)
    assert sorted(p.name for p in (workplace.folder / "model").iterdir()) == FILES
    assert sorted(p.name for p in workplace.folder.iterdir()) == ["data", "model", "recipe.toml"]
    assert any("nodes 150 >" in line for line in lines)


def test_an_export_that_disagrees_is_refused_and_leaves_nothing(workplace, monkeypatch, capsys):
    graph = KINDS["graph"]

    def spoilt(model, facts):
        with_error = graph.decoder_onnx(model, facts)
        table = next(t for t in with_error.graph.initializer if t.name == "decoder/scale_mm")
        table.raw_data = (np.frombuffer(table.raw_data, np.float32) * 1.001).tobytes()
        return with_error

    monkeypatch.setitem(KINDS, "graph", dataclasses.replace(graph, decoder_onnx=spoilt))
    assert workplace.train() == 3
    assert not (workplace.folder / "model").exists()
    assert workplace.answer()["error"] == "ParityError"
    assert workplace.answer()["where"] == "decoder.onnx"
    assert "must agree to 0.0001" in capsys.readouterr().err
    # The trained weights are not lost: the next run goes on from the last epoch.
    monkeypatch.undo()
    assert workplace.train("--resume") == 0
    assert sorted(p.name for p in (workplace.folder / "model").iterdir()) == FILES


def test_resume_wants_a_checkpoint_and_fresh_discards_one(workplace, monkeypatch):
    assert workplace.train("--resume") == 2
    assert workplace.answer()["error"] == "CheckpointError"
    folder = workplace.folder / "model.training"
    folder.mkdir()
    (folder / "last.pt").write_bytes(b"spoilt")
    assert workplace.train() == 2
    assert "--fresh" in workplace.answer()["message"]
    assert workplace.train("--fresh") == 0
    assert not folder.exists()


def test_a_checkpoint_of_other_data_or_settings_is_refused(workplace, monkeypatch):
    monkeypatch.setattr(pipeline, "write_model", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    assert workplace.train() == 130
    assert workplace.answer()["error"] == "KeyboardInterrupt"
    monkeypatch.undo()
    assert workplace.train("--seed", "9") == 2
    assert workplace.answer()["error"] == "CheckpointError"
    assert workplace.train(recipe=workplace.recipe.read_text().replace("batch = 8", "batch = 4")) == 2
    assert workplace.train(recipe=workplace.recipe.read_text().replace("batch = 4", "batch = 8")) == 0


def test_a_killed_command_goes_on_and_gives_the_same_model(workplace, on_the_processor):
    recipe = RECIPE.replace("epochs = 60", "epochs = 40")
    workplace.recipe.write_text(recipe)
    words = [str(workplace.recipe), "--data", str(workplace.data), "--threads", "1"]
    assert main([*words, "--out", str(workplace.folder / "whole"), "--quiet"]) == 0
    # A run in the background of a shell starts with the interrupt ignored.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from tissuereg_training.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, *words, "--out", str(workplace.folder / "model")]
    running = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    checkpoint = workplace.folder / "model.training" / "last.pt"
    give_up = time.monotonic() + 60
    while not checkpoint.exists() and running.poll() is None and time.monotonic() < give_up:
        time.sleep(0.01)
    running.send_signal(signal.SIGINT)
    _, output = running.communicate(timeout=60)
    assert running.returncode == 130, output
    assert b"Traceback" not in output
    assert checkpoint.exists()
    assert not (workplace.folder / "model").exists()
    assert workplace.train("--resume") == 0
    for name in ("decoder.onnx", "decoder_weights.npz", "encoder.onnx"):
        one, other = (workplace.folder / folder / name for folder in ("whole", "model"))
        assert one.read_bytes() == other.read_bytes(), name


CLOSURE = """
seed = 3
[train]
kind = "closure"
epochs = 150
batch = 32
n_latent = 6
n_components = 20
hidden = [32, 32]
encoder_hidden = [32]
"""


@pytest.fixture(scope="module")
def closure(tmp_path_factory):
    place = make_workplace(tmp_path_factory.mktemp("closure"), n_members=200, recipe=CLOSURE)
    more = write_dataset(place.folder / "more", place.block, 100, seed=8)
    assert place.train("--data", str(more)) == 0
    return place


def test_a_closure_is_a_model_folder_of_the_same_form(closure):
    card = model_card(closure)
    assert sorted(p.name for p in (closure.folder / "model").iterdir()) == FILES
    assert (card["kind"], card["n_components"], card["hidden"]) == ("closure", 20, [32, 32])
    assert (card["members"], card["trained_on"]) == (200, 260)
    assert finite(card)
    assert np.array(card["prior"]["mismatch_covariance"]).shape == (6, 6)
    # The fields hang nonlinearly on six numbers: six linear components must leave more.
    assert card["errors_mm"]["test"] < 0.8 * card["errors_mm"]["pca"] < card["errors_mm"]["mean_shape"]


def test_errors_of_a_closure_can_be_measured_again_from_the_files(closure):
    folder = closure.folder / "model"
    fields = smooth_fields(closure.block, 200, 1)
    mean = session(folder / "encoder.onnx").run(["mean"], {"displacement": fields})[0]
    found = session(folder / "decoder.onnx").run(None, {"z": mean})[0]
    errors = model_card(closure)["errors_mm"]
    wanted = 0.8 * errors["train"] + 0.1 * errors["valid"] + 0.1 * errors["test"]
    assert np.linalg.norm(fields - found, axis=2).mean() == pytest.approx(wanted, rel=1e-4)


def test_without_pairs_the_test_split_tells_the_errors(tmp_path):
    place = make_workplace(tmp_path, recipe=RECIPE.replace("epochs = 60", "epochs = 2"), n_pairs=0)
    assert place.train() == 0
    with np.load(place.folder / "model" / "decoder_weights.npz") as weights:
        assert weights["error_fields_mm"].shape == (6, 150, 3)
    prior = model_card(place)["prior"]
    assert prior["mismatch_covariance"] == prior["covariance"]


def test_the_package_is_one_version_with_the_workspace():
    manifest = Path(__file__).parents[2] / "Cargo.toml"
    ours = (Path(__file__).parents[1] / "pyproject.toml").read_text()
    version = next(line for line in manifest.read_text().splitlines() if line.startswith("version = "))
    assert version in ours.splitlines()


def test_help_and_errors_need_no_torch(tmp_path):
    code = (
        "import sys; from tissuereg_training.cli import main; import tissuereg_training; "
        "codes = [main(['--help']), main(['nothing.toml'])]; sys.exit(codes != [0, 2] or 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, cwd=tmp_path, env={**os.environ})
    assert done.returncode == 0, done.stderr
    assert b"usage: tissuereg train" in done.stdout


def test_checkpoint_error_is_an_error_of_the_package():
    assert issubclass(CheckpointError, tissuereg_training.TissueRegError)
