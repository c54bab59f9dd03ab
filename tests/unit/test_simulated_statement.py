"""``[simulated]`` holds for the mesh and the tables that it is about, and for no others."""

import shutil

import pytest

import tissuereg as tr
from support.rig_folders import write_rig
from tissuereg.cli import main
from tissuereg.diagnosis import run


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a plain simulation of a small rig."""
    folder = tmp_path_factory.mktemp("made")
    rig = write_rig(folder / "rig", "balls")
    assert main(["simulate", str(rig), "--plain", "--quiet", "--threads", "1", "--out", str(folder / "out")]) == 0
    return folder / "out"


@pytest.fixture
def copied(made, tmp_path):
    shutil.copytree(made.parent, tmp_path / "all")
    return tmp_path / "all" / "out"


def test_a_statement_about_these_tables_is_read_whatever_their_line_ends(copied):
    stated = tr.read_experiment(copied).simulated
    assert (stated.model, stated.element) == ("plain", "tet4")
    table = copied / "markers.csv"
    table.write_bytes(table.read_bytes().replace(b"\n", b"\r\n"))
    assert tr.read_experiment(copied).simulated == stated


@pytest.mark.parametrize("file", ["markers.csv", "forces.csv", "actuators.csv"])
def test_a_statement_about_other_tables_is_ignored_with_a_warning(copied, file):
    lines = (copied / file).read_text().splitlines()
    head, _, last = lines[-1].rpartition(",")
    (copied / file).write_text("\n".join([*lines[:-1], f"{head},{float(last or 0.0) + 0.125}"]) + "\n")
    with pytest.warns(UserWarning, match=r"\[simulated\] of .* is ignored"):
        assert tr.read_experiment(copied).simulated is None


def test_an_old_statement_without_a_hash_is_read_and_said_to_be_unchecked(copied, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    file = copied / "experiment.toml"
    lines = [line for line in file.read_text().splitlines() if not line.startswith("tables_sha256")]
    file.write_text("\n".join(lines) + "\n")
    experiment = tr.read_experiment(copied)
    assert experiment.simulated.tables_sha256 is None
    monkeypatch.setattr(run, "SignalLayout", stop)
    with pytest.warns(UserWarning, match="has no `tables_sha256`"), pytest.raises(KeyboardInterrupt):
        tr.diagnose(experiment, threads=1, keep=False)
