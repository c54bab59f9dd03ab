"""Many diagnoses: each is that of `diagnose`, none is made twice, and one that fails is alone in it."""

import json
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.answers import told, undated
from support.files import write_experiment
from tissuereg.diagnosis import many
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.errors import ArgumentError, FormatError
from tissuereg.parallel import Failed, InProcess, Processes

TEST = 'kind = "material-test"\n[material]\nlaw = "neo-hookean"\nyoung_kpa = [10.0, 3.0]\npoisson = 0.45\n'


def material_test(folder, young):
    """A specimen pulled and sheared, measured with noise, in a folder of its own."""
    folder.mkdir()
    rng = np.random.default_rng(round(young))
    rows = ["specimen,mode,rate_per_s,time_s,stretch_or_shear,stress_kPa"]
    for amount in np.linspace(0.0, 0.3, 16):
        stretch, mu = 1.0 + amount, young / 3.0
        pull, shear = mu * (stretch - stretch**-2), mu * amount
        rows.append(f"a,tension,,,{stretch},{pull + 0.02 * rng.standard_normal()}")
        rows.append(f"a,simple-shear,,,{amount},{shear + 0.02 * rng.standard_normal()}")
    (folder / "experiment.toml").write_text(TEST, encoding="utf-8")
    (folder / "test.csv").write_text("\n".join(sorted(rows[1:])).join([rows[0] + "\n", "\n"]), encoding="utf-8")
    return folder


@pytest.fixture
def tests(tmp_path):
    return [material_test(tmp_path / name, young) for name, young in (("soft", 8.0), ("stiff", 12.0))]


@pytest.fixture
def quick(monkeypatch):
    """Diagnoses that take no time; what was asked of them."""
    asked = []

    class Quick:
        def __init__(self, experiment):
            self.name = experiment.name

        def save(self, folder, extra):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "diagnosis.json").write_text(json.dumps({"verdict": "consistent", **extra}), encoding="utf-8")

    def diagnose(experiment, **settings):
        asked.append((experiment.name, settings))
        return Quick(experiment)

    monkeypatch.setattr(many, "diagnose", diagnose)
    return asked


def test_results_of_processes_are_those_of_diagnose(tests, tmp_path):
    with Processes(2) as executor:
        found = list(tr.diagnose_many(tests, tmp_path / "out", executor=executor, seed=2))
    assert [(one.name, one.made) for one in found] == [("soft", True), ("stiff", True)]
    for one, folder in zip(found, tests, strict=True):
        alone = tr.diagnose(tr.read_material_experiment(folder), seed=2)
        answer = json.loads(json.dumps(told(alone, "versions")))  # packages that a process has loaded
        said = undated(one.answer)
        assert {key: said[key] for key in answer} == answer
        assert one.verdict == alone.verdict
        names = {file.name for file in one.folder.iterdir()}
        assert names == {"diagnosis.json", "experiment.extended.toml", "report.html"}


def test_what_is_there_is_kept_and_what_has_changed_is_made_again(tests, tmp_path, quick):
    def made(**settings):
        counted = []
        found = tr.diagnose_many(tests, tmp_path / "out", progress=lambda *n: counted.append(n), **settings)
        names = [one.name for one in found if one.made]
        assert counted == [(1, 2), (2, 2)]
        return names

    assert made() == ["soft", "stiff"]
    assert made() == []
    assert made(executor=InProcess()) == []  # threads change no result
    with (tests[1] / "test.csv").open("a", encoding="utf-8") as table:
        table.write("a,simple-shear,,,0.31,1.2\n")
    assert made() == ["stiff"]
    assert made(seed=1) == ["soft", "stiff"]
    (tmp_path / "out" / "soft" / "diagnosis.json").write_text("{half", encoding="utf-8")
    assert made(seed=1) == ["soft"]
    assert len(quick) == 6
    changed = replace(DEFAULT, search=replace(DEFAULT.search, stated=0.9))
    assert made(seed=1, settings=changed) == ["soft", "stiff"]
    assert [settings["settings"] for _, settings in quick] == [DEFAULT] * 6 + [changed] * 2
    assert made(seed=1, settings=changed) == []


def test_a_rig_without_files_fails_alone_and_bodies_and_tests_go_together(tests, tmp_path, quick):
    body = write_experiment(tmp_path / "body")
    given = [tests[0] / "experiment.toml", tmp_path / "absent", body]
    found = list(tr.diagnose_many(given, tmp_path / "out", element="tet10", threads=1))
    assert isinstance(found[1], Failed)
    assert isinstance(found[1].error, FormatError)
    assert [found[0].name, found[2].name] == ["soft", "body"]
    assert [settings["element"] for _, settings in quick] == [None, "tet10"]  # a material test has no elements
    assert not (tmp_path / "out" / "absent").exists()


def test_two_experiments_of_one_name_are_refused_before_anything_is_made(tests, tmp_path, quick):
    (tmp_path / "more").mkdir()
    other = material_test(tmp_path / "more" / "soft", 9.0)
    with pytest.raises(ArgumentError, match="twice: soft"):
        tr.diagnose_many([*tests, other], tmp_path / "out")
    assert quick == []
