"""The table of networks is measured from their files, and the README's is what was measured."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import make_workplace

from tissuereg_training.cli import main
from tissuereg_training.compare import BEGIN, END, table

TRAINING = Path(__file__).parents[1]
CLOSURE = """
seed = 3
[train]
kind = "closure"
epochs = 20
batch = 32
n_latent = 6
n_components = 20
hidden = [32]
encoder_hidden = [32]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = make_workplace(tmp_path_factory.mktemp("compare"), n_members=100, recipe=CLOSURE)
    assert place.train() == 0
    shutil.copytree(place.folder / "model", place.folder / "again")
    return place


def run(place, *words):
    models = [str(place.folder / name) for name in ("model", "again")]
    answer = place.folder / "compared.json"
    code = main(["compare", *models, "--data", str(place.data), "--json", str(answer), *words])
    return code, json.loads(answer.read_text())


def test_errors_are_those_that_training_stated(place):
    code, content = run(place)
    assert code == 0
    card = json.loads((place.folder / "model" / "model.json").read_text())
    one, other = content["networks"]
    assert (one["name"], other["name"]) == ("model", "again")
    for part in ("valid", "test"):
        assert one[f"{part}_mm"] == other[f"{part}_mm"]
        assert one[f"{part}_mm"] == pytest.approx(card["errors_mm"][part], rel=1e-4)
    rivals = content["rivals"]
    assert rivals["n_components"] == 6
    assert rivals["pca"]["test_mm"] == pytest.approx(card["errors_mm"]["pca"], rel=1e-4)
    assert rivals["mean_shape"]["test_mm"] == pytest.approx(card["errors_mm"]["mean_shape"], rel=1e-6)
    assert one["share_of_pca"] == pytest.approx(one["test_mm"] / rivals["pca"]["test_mm"])
    # Measured from the files: the same spread as torch's, and other draws of the same prior.
    assert one["spread"] == pytest.approx(card["code_spread"]["aggregate_std_mean"], rel=1e-4)
    assert one["samples"]["fields"] == 1000
    assert (one["trained_on"], one["epochs"], one["hours"]) == (80, 20, card["training"]["hours"])
    assert content["split"] == {"train": 80, "valid": 10, "test": 10}


def test_the_table_goes_between_the_marks_of_a_page_and_nowhere_else(place):
    page = place.folder / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    code, content = run(place, "--page", str(page))
    assert code == 0
    assert page.read_text() == f"before\n{BEGIN}\n{table(content)}{END}\nafter\n"
    rows = [line for line in table(content).splitlines() if line.startswith("| ")]
    assert len({row.count("|") for row in rows}) == 1
    assert [row.split(" |")[0] for row in rows[-2:]] == ["| 6 principal components", "| constant mean shape"]
    page.write_text("no marks\n")
    assert run(place, "--page", str(page))[0] == 2
    assert page.read_text() == "no marks\n"


def test_another_mesh_a_spoilt_network_and_a_missing_folder_are_refused(place, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(place.folder / "model", other)
    words = ["--data", str(place.data), "--json", str(tmp_path / "answer.json")]

    def refused(folder):
        code = main(["compare", str(folder), *words])
        return code, json.loads((tmp_path / "answer.json").read_text())["error"]

    (other / "encoder.onnx").write_bytes(b"spoilt")
    assert refused(other) == (2, "FormatError")
    card = json.loads((other / "model.json").read_text())
    (other / "model.json").write_text(json.dumps({**card, "mesh_digest": "0" * 64}))
    assert refused(other) == (2, "MeshError")
    (other / "model.json").write_text(json.dumps({"kind": "closure"}))
    assert refused(other) == (2, "FormatError")
    assert refused(tmp_path / "nothing") == (2, "FormatError")


def test_the_table_of_the_readme_is_the_kept_measurement():
    content = json.loads((TRAINING / "benchmarks" / "networks.json").read_text())
    page = (TRAINING / "README.md").read_text()
    assert page.split(BEGIN)[1].split(END)[0] == f"\n{table(content)}"
    for each in content["networks"]:
        assert np.isfinite([each["valid_mm"], each["test_mm"]]).all()
