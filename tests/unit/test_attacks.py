"""Input that attacks: refused at once, by an error of ours, before anything is parsed."""

import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from tissuereg.errors import ExperimentError, FormatError, ModelError
from tissuereg.io.bounds import FILES
from tissuereg.io.fields import open_npz
from tissuereg.io.tables import read_surface, read_targets
from tissuereg.io.toml import parsed_toml, read_toml
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.calibration_file import read_calibration
from tissuereg.registration.learned.card import card_text, check_files, list_file, read_card

SHIPPED = Path(tr.__file__).parent / "phantom" / "graph"


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 20_000 + " = 1",
        "[a" + ".a" * 20_000 + "]",
        "[[" + '"a" . ' * 20_000 + "a]]",
        "x = {a" + ".'a'" * 20_000 + " = 1}",
        "x = " + "[" * 20_000,
        "x = " + "{a = " * 20_000,
        "k" * 40_000 + " = 1",
    ],
)
def test_toml_of_deep_or_long_keys_is_refused_at_once(tmp_path, text):
    (tmp_path / "experiment.toml").write_text(text)
    begin = time.perf_counter()
    with pytest.raises(ExperimentError, match="keys must have at most"):
        read_toml(tmp_path / "experiment.toml")
    assert time.perf_counter() - begin < 2.0


def test_dots_and_brackets_in_texts_comments_and_numbers_do_not_count():
    dots = "." * 50 + "[" * 50
    text = f'a = "{dots}" # {dots}\nb = \'{dots}\'\nc = """\n{dots}\n"quoted" """\nd = [' + "1.5, " * 100 + "]\n"
    assert parsed_toml(text)["a"] == dots
    assert len(parsed_toml(text)["d"]) == 100
    assert parsed_toml("a" + ".a" * (FILES.toml_depth - 1) + " = 1")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
@pytest.mark.parametrize(
    ("read", "name"),
    [
        (tr.read_mesh, "body.vtu"),
        (tr.read_mesh, "body.npz"),
        (tr.read_markers, "markers.csv"),
        (read_targets, "targets.fcsv"),
        (read_targets, "targets.mrk.json"),
        (tr.read_experiment, "experiment.toml"),
        (read_surface, "points.csv"),
        (lambda path: open_npz(path).__enter__(), "field.npz"),
        (lambda path: tr.open_dataset(path.parent), "dataset.json"),
        (lambda path: read_card(path.parent), "model.json"),
    ],
)
def test_a_pipe_in_place_of_a_file_is_refused_and_not_waited_for(tmp_path, read, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises((FormatError, ModelError), match=r"regular file|no such file"):
        read(tmp_path / name)


@pytest.fixture
def model(tmp_path):
    return Path(shutil.copytree(SHIPPED, tmp_path / "model"))


def signed_anew(folder, name):
    card = read_card(folder)
    list_file(card, folder / name)
    (folder / "model.json").write_text(card_text(card))


def test_the_shipped_cards_list_size_and_hash_of_every_file():
    for folder in (SHIPPED, SHIPPED.with_name("model")):
        card = json.loads((folder / "model.json").read_text())
        beside = {file.name for file in folder.iterdir()} - {"model.json"}
        assert set(card["files"]) == set(card["sizes"]) == beside
        check_files(folder, read_card(folder))


@pytest.mark.parametrize("name", ["components_mm.npy", "decoder.onnx", "decoder_weights.npz", "layer1.weight.npy"])
def test_a_file_of_another_size_or_content_is_not_used(model, name):
    whole = (model / name).read_bytes()
    (model / name).write_bytes(whole + b"\0")
    with pytest.raises(ModelError, match="bytes"):
        check_files(model, read_card(model))
    (model / name).write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with pytest.raises(ModelError, match="SHA-256"):
        check_files(model, read_card(model))


def test_a_network_takes_no_table_from_a_file_that_the_card_does_not_list(model):
    card = read_card(model)
    del card["files"]["layer1.weight.npy"]
    (model / "model.json").write_text(card_text(card))
    with pytest.raises(ModelError, match=r"files of its card alone, got 'layer1\.weight\.npy'"):
        check_files(model, read_card(model))


@pytest.mark.parametrize(
    ("array", "change"),
    [
        ("kind_weights", lambda x: 0.0 * x),
        ("kind_weights", lambda x: -x),
        ("kind_covariances", lambda x: 0.0 * x),
        ("kind_covariances", lambda x: -x),
        ("error_covariances", lambda x: -x),
        ("error_rest_mm", lambda x: -x - 1.0),
        ("change_factors", lambda x: x - 10.0),
        ("change_covariances", lambda x: -x),
        ("alone_scales", lambda x: 0.0 * x),
        ("alone_scale_weights", lambda x: 0.0 * x),
        ("alone_widening", lambda x: 0.0 * x),
        ("anchored_tail", lambda x: x - 100.0),
        ("alone_signs", lambda x: x + np.nan),
    ],
)
def test_a_calibration_without_sense_is_refused_though_it_is_signed(model, array, change):
    with np.load(model / "calibration.npz") as file:
        arrays = dict(file)
    arrays[array] = change(arrays[array])
    np.savez(model / "calibration.npz", **arrays)
    signed_anew(model, "calibration.npz")
    with pytest.raises(FormatError, match=array):
        read_calibration(model, read_card(model))


@pytest.mark.parametrize(
    "name", ["conv3.coefficients.npy", "components_mm.npy", "fully_connected.weight.npy", "layer2.weight.npy"]
)
def test_a_table_of_zeros_is_refused_though_it_is_signed(model, name):
    np.save(model / name, 0 * np.load(model / name))
    signed_anew(model, name)
    with pytest.raises(ModelError, match=r"must hold numbers other than 0; it holds none"):
        tr.Registrar(phantom_mesh(), phantom_mesh().nodes[phantom_mesh().surface_nodes[::200]], model)


@pytest.mark.parametrize("entry", ["covariance", "mismatch_covariance"])
def test_a_card_without_a_covariance_is_refused(model, entry):
    card = json.loads((model / "model.json").read_text())
    card["prior"][entry] = (-np.asarray(card["prior"][entry]) * (entry != "covariance")).tolist()
    (model / "model.json").write_text(card_text(card))
    with pytest.raises(ModelError, match=entry):
        read_card(model)
