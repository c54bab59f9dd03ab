"""Every way of giving something wrong ends in a sentence, an exit code and no file."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import RECIPE, make_workplace

from tissuereg_training.errors import ExperimentError
from tissuereg_training.recipe import read_recipe
from tissuereg_training.settings import SETTINGS, GraphSettings


def spoil(path, **arrays):
    with np.load(path) as kept:
        whole = {**kept}
    np.savez(path, **{k: v for k, v in {**whole, **arrays}.items() if v is not None})


def spoil_hdf5(path, **arrays):
    with h5py.File(path, "a") as file:
        for name, array in arrays.items():
            del file[name]
            if array is not None:
                file.create_dataset(name, data=array)


def nan_field(place):
    path = place.data / "chunk_0001.h5"
    with h5py.File(path) as chunk:
        fields = chunk["displacement_mm"][()]
    fields[4, 7, 1] = np.nan
    spoil_hdf5(path, displacement_mm=fields)


def edit_card(place, **entries):
    path = place.data / "dataset.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))


CASES = {
    "no data set": (lambda p: (p.data / "dataset.json").unlink(), 2, "FormatError", "dataset.json"),
    "card is no json": (lambda p: (p.data / "dataset.json").write_text("{"), 2, "FormatError", "readable"),
    "card of another kind": (lambda p: edit_card(p, schema="x/1"), 2, "FormatError", "tissuereg.dataset/2"),
    "card names a path": (
        lambda p: edit_card(p, chunks=[{"file": "../x.h5", "members": 3}]),
        2,
        "FormatError",
        "plain file names",
    ),
    "chunk missing": (lambda p: (p.data / "chunk_0000.h5").unlink(), 2, "FormatError", "chunk_0000"),
    "chunk cut short": (lambda p: (p.data / "chunk_0000.h5").write_bytes(b"PK12"), 2, "FormatError", "HDF5 file"),
    "array missing": (lambda p: spoil_hdf5(p.data / "chunk_0000.h5", index=None), 2, "FormatError", "lacks index"),
    "nan field": (nan_field, 2, "FormatError", "the first in row 4"),
    "members twice": (
        lambda p: spoil_hdf5(p.data / "chunk_0001.h5", index=np.arange(30)),
        2,
        "FormatError",
        "member 0 comes after 29",
    ),
    "fields of another mesh": (
        lambda p: spoil_hdf5(p.data / "chunk_0000.h5", displacement_mm=np.zeros((30, 149, 3), np.float32)),
        2,
        "MeshError",
        "150 nodes, got 149",
    ),
    "flat fields": (
        lambda p: spoil_hdf5(p.data / "chunk_0000.h5", displacement_mm=np.zeros((30, 450), np.float32)),
        2,
        "FormatError",
        "shape (members, 150, 3)",
    ),
    "no split": (lambda p: edit_card(p, split=None), 2, "FormatError", "train, valid and test"),
    "split beyond the members": (
        lambda p: edit_card(p, split={"train": [60], "valid": [0], "test": [1]}),
        2,
        "FormatError",
        "rows below 60",
    ),
    "card of another mesh": (
        lambda p: edit_card(p, mesh={"file": "mesh.npz", "digest": "0" * 64}),
        2,
        "MeshError",
        "one mesh",
    ),
    "tets out of range": (
        lambda p: spoil(p.data / "mesh.npz", tets=np.array([[0, 1, 2, 150]])),
        2,
        "FormatError",
        "below 150",
    ),
    "nodes not finite": (
        lambda p: spoil(p.data / "mesh.npz", nodes_mm=np.full((150, 3), np.inf)),
        2,
        "FormatError",
        "finite floats",
    ),
    "pairs that do not pair": (
        lambda p: spoil_hdf5(p.data / "pairs.h5", truth_mm=np.zeros((3, 150, 3), np.float32)),
        2,
        "FormatError",
        "got 12 and 3",
    ),
    "recipe of another mesh": (
        lambda p: p.recipe.write_text(RECIPE.replace("block.vtu", "liver.vtu")),
        2,
        "ExperimentError",
        "'block.vtu'; got 'liver.vtu'",
    ),
    "more latents than fields": (
        lambda p: p.recipe.write_text(RECIPE.replace("n_latent = 6", "n_latent = 48")),
        3,
        "EnsembleError",
        "got 60 members",
    ),
    "out is a file": (lambda p: (p.folder / "model").write_text("x"), 2, "OutputError", "is a file"),
    "out holds other things": (
        lambda p: ((p.folder / "model").mkdir(), (p.folder / "model" / "thesis.tex").write_text("x")),
        2,
        "OutputError",
        "holds other files",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_it_is_refused_with_a_sentence(tmp_path, capsys, name):
    spoil_it, code, error, words = CASES[name]
    place = make_workplace(tmp_path)
    spoil_it(place)
    before = sorted(map(str, tmp_path.rglob("*")))
    assert place.train() == code
    summary = place.answer()
    assert summary["schema"] == "tissuereg.error/1"
    assert (summary["error"], words in summary["message"]) == (error, True), summary
    assert summary["where"]
    output = capsys.readouterr().err
    assert output.startswith("error: ")
    assert "Traceback" not in output
    (tmp_path / "answer.json").unlink()
    assert sorted(map(str, tmp_path.rglob("*"))) == before


def test_too_few_members(tmp_path):
    place = make_workplace(tmp_path, n_members=8)
    assert place.train() == 3
    assert "simulate more" in place.answer()["message"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[train]\nepoch = 3", r"and nothing else, got: epoch"),
        ("[trian]\n", r"nothing else, got: trian"),
        ("train = 3", r"must be a table"),
        ("[train]\nepochs = 0", r"epochs must be at least 1, got 0"),
        ("[train]\nepochs = true", r"kind of 300, got True"),
        ("[train]\nepochs = 2.5", r"kind of 300, got 2.5"),
        ("[train]\nkl_weight = 0", r"positive: without it the codes have no prior"),
        ("[train]\nkl_weight = nan", r"kl_weight must be positive"),
        ("[train]\nkl_warmup = 1.0", r"kl_warmup must be in \[0, 1\)"),
        ("[train]\nchannels = []", r"channels must be positive whole numbers"),
        ("[train]\nchannels = [8, 'x']", r"kind of \[32, 64, 128\]"),
        ("[train]\nloss = 'l3'", r"one of distance, squared"),
        ("[train]\ncoarse_edges = 'x'", r"one of wide, reduced"),
        ("[train]\npatience = -1", r"patience must be at least 0"),
        ("[train]\nkind = 'mlp'", r"kind must be one of graph, closure, graph-closure, got 'mlp'"),
        ("[train]\nkind = []", r"kind must be one of graph, closure, graph-closure, got \[\]"),
        ("[train]\nkind = 'closure'\nchannels = [8]", r"and nothing else, got: channels"),
        ("[train]\nkind = 'closure'\nn_components = 25", r"n_components must be at least n_latent, 26, got 25"),
        ("[train]\nkind = 'closure'\nhidden = [0]", r"hidden must be positive whole numbers"),
        ("[train]\nkind = 'graph-closure'\nchannels = [0]", r"channels must be positive whole numbers"),
        ("[train]\nkind = 'graph-closure'\nn_components = 25", r"at least n_latent, 26, got 25"),
        ("[train]\nerror_fields = 0", r"error_fields must be at least 1"),
        ("[train]\nkind = 'closure'\nactivation = 'cos'", r"one of elu, silu"),
        ("[train]\nkind = 'closure'\nloss = 'distance'", r"one of rms, squared"),
        ("seed = -1", r"seed must be a whole number"),
        ("seed = [", r"readable TOML"),
    ],
)
def test_a_recipe_that_says_something_wrong_is_refused(tmp_path, text, words):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(ExperimentError, match=words):
        read_recipe(path)


def test_a_silent_recipe_has_the_defaults_and_a_missing_one_is_refused(tmp_path):
    (tmp_path / "r.toml").write_text("")
    recipe = read_recipe(tmp_path / "r.toml")
    assert (recipe.seed, recipe.settings) == (0, GraphSettings())
    with pytest.raises(ExperimentError, match="readable TOML"):
        read_recipe(tmp_path / "none.toml")
    with pytest.raises(ExperimentError, match="readable TOML"):
        read_recipe(tmp_path)


@pytest.mark.parametrize(
    "words", [["--threads", "-1"], ["--seed", "x"], ["--resume", "--fresh"], ["--wrong"], ["extra"]]
)
def test_words_that_make_no_command_are_refused(workplace, words):
    assert workplace.train(*words) == 2
    assert workplace.answer()["error"] == "UsageError"


def test_every_documented_recipe_key_exists():
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    for settings in SETTINGS.values():
        for key in settings().as_dict():
            assert f"| `{key}` |" in readme
