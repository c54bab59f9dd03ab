"""Is every page, and every table of a page elsewhere, what its command writes from its archive?"""

import pytest
from common import read_archive
from readme import table
from scripts import fallback, paper, phantom, tune_rivals, tune_rivals_page, variants

from tissuereg_paper.rivals import RIVALS
from tissuereg_paper.studies import SIMULATED
from tissuereg_paper.studies.phantom import PHANTOM_STUDIES


def test_the_page_of_the_simulation_studies_is_that_of_its_archives():
    archives, kept = paper.read_archives(), paper.PAGE.read_text(encoding="utf-8")
    assert paper.page(archives) == kept
    archives["shipped"]["studies"]["fig8"]["rows"][0]["end_mean_mm"] += 0.1
    assert paper.page(archives) != kept


def test_every_study_was_run_with_every_model():
    archives = paper.read_archives()
    assert set(archives) == set(paper.ARCHIVES)
    for archive in archives.values():
        assert tuple(archive["studies"]) == SIMULATED
        for study, content in archive["studies"].items():
            assert content["agree"][study]["agree"] in ("yes", "no")
            assert {row["study"] for row in content["rows"]} == {study}


def test_every_picture_of_the_page_is_there():
    archives = paper.read_archives()
    text = paper.page(archives)
    pictures = [paper._picture(name, study) for name in archives for study in SIMULATED]
    assert all(picture.exists() and f"({picture.name})" in text for picture in pictures)


@pytest.mark.parametrize("study", PHANTOM_STUDIES)
def test_a_table_of_the_phantom_experiment_is_that_of_its_archive(study):
    content = phantom.read()["studies"][study]
    assert phantom.block(study, content) == table(study, phantom.PAGE)
    content["rows"][0]["sensor_mean_mm"] += 0.1
    assert phantom.block(study, content) != table(study, phantom.PAGE)
    assert (phantom.PAGE.parent / f"phantom-experiment-{study}.png").exists()


def test_the_curves_of_figures_are_kept_in_the_archive():
    content = phantom.read()
    curves = content["studies"]["fig10"]["curves"]
    assert len(curves["motion"]) == len(curves["motion_times_s"]) == 240
    methods = {row["method"] for row in content["studies"]["fig10"]["rows"]}
    assert set(curves["sensor_mm"]) == methods
    assert {len(errors) for errors in curves["sensor_mm"].values()} == {len(curves["times_s"])}
    packed = phantom.packed(content)
    assert "curves" not in packed["studies"]["fig10"]
    assert len(packed["curves"]) == 2 * (1 + len(methods))


@pytest.mark.parametrize("made", [variants, fallback])
def test_tables_of_decisions_are_those_of_their_archives(made):
    name = made.ARCHIVE.name
    content, kept = read_archive(made.ARCHIVE), table(name, made.PAGE)
    assert made.table(content) == kept
    if made is variants:
        content["rows"][0]["rigs"]["scenario1-101"]["inner_mm"] += 1.0
    else:
        next(row for row in content["rows"] if not row["trusted"])["errors_mm"][0] += 1e3
    assert made.table(content) != kept


def test_the_page_of_the_rivals_is_that_of_its_archive_and_of_their_defaults():
    answer, kept = read_archive(tune_rivals.ARCHIVE), tune_rivals.PAGE.read_text(encoding="utf-8")
    assert tune_rivals_page.page(answer) == kept
    known, pending = {}, {tuple(one) for one in answer["pending"]}
    for sweep in answer["sweeps"]:
        key = sweep["method"], sweep["constant"]
        known[key] = sweep["default"]
        errors = dict(zip(sweep["values"], tune_rivals_page.errors_of(sweep), strict=True))
        best = min(errors, key=errors.get)
        chosen, tie = errors[sweep["default"]], 1.0 + tune_rivals_page.TIE
        explained = key in tune_rivals_page.REASONS
        assert chosen <= tie * errors[best] or explained, key
        at_an_end = sweep["default"] in (sweep["values"][0], sweep["values"][-1])
        flat = max(errors.values()) <= tie * chosen
        assert not at_an_end or flat or sweep["default"] == 0.0 or explained, key
    for method in RIVALS.values():
        for constant, default in tune_rivals.constants_of(method).items():
            key = method.name, constant
            assert key in known or key in tune_rivals_page.FIXED or key in pending or constant == "spread", key
            assert known.get(key, default) == default, key
    answer["sweeps"][0]["sensor_mm"][0][0] += 1.0
    assert tune_rivals_page.page(answer) != kept
