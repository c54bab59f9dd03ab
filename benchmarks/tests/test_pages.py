"""Is every page of results what its command writes from its archive?"""

import pytest

import advise.advise as advice
import blind.page as blind
import diagnosis.febio as febio
import diagnosis.material_parts as material_parts
import diagnosis.simulated_here as simulated_here
import images.images as images
import implanted.implanted as implanted
import learned.__main__ as learned
import learned.page as learned_page
import misuse.__main__ as misuse
import misuse.lost as lost
import real.__main__ as real
import regions.regions as regions
import rigs.page as rigs
import speed.cluster as cluster
import speed.esmda as esmda
import speed.large_bodies as large_bodies
import speed.solver as solver
import tracking.soak as soak
import tracking.tracked_beam as beam
import tracking.tracking as tracking
from common import read_archive, write_archive
from loadfree import table as loadfree
from readme import table


def _more(row, key, by=1.0):
    row[key] += by


#: Name, archive, page, what is written from the archive, and a figure of it that is changed.
WRITTEN = {
    "advise": (advice.ARCHIVE, advice.PAGE, advice.page, lambda a: _more(a["rows"][0], "advised_mm")),
    "implanted": (
        implanted.ARCHIVE,
        implanted.PAGE,
        implanted.page,
        lambda a: _more(a["rows"][0]["both"], "error_mm"),
    ),
    "febio": (febio.ARCHIVE, febio.PAGE, febio.page, lambda a: _more(a["rows"]["case_06b87d"], "p_misfit")),
    "simulated here": (
        simulated_here.ARCHIVE,
        simulated_here.PAGE,
        simulated_here.page,
        lambda a: _more(a["rows"]["0"], "p_misfit", -2.0),
    ),
    "material parts": (
        material_parts.ARCHIVE,
        material_parts.PAGE,
        material_parts.page,
        lambda a: _more(next(iter(a["known"].values()))["rows alike"]["stated"], "within_two"),
    ),
    "misuse": (
        misuse.ARCHIVE,
        misuse.PAGE,
        misuse.page,
        lambda a: a["good"][0].update(found=not a["good"][0]["found"]),
    ),
    "lost": (lost.ARCHIVE, lost.PAGE, lost.page, lambda a: a["rows"][0].update(trusted=not a["rows"][0]["trusted"])),
    "regions": (regions.ARCHIVE, regions.PAGE, regions.page, lambda a: _more(a["rows"][0], "crps_mm")),
    "images": (images.ARCHIVE, images.PAGE, images.page, lambda a: _more(a["rows"][0], "value")),
    "real": (real.ARCHIVE, real.PAGE, real.page, lambda a: _more(a["hydrogel"][0], "registered")),
    "cluster": (cluster.ARCHIVE, cluster.PAGE, cluster.page, lambda a: _more(a["chunk_s"], "local:1")),
    "large bodies": (
        large_bodies.ARCHIVE,
        large_bodies.PAGE,
        large_bodies.page,
        lambda a: _more(a["rows"][0]["measured"]["register"], "peak_bytes", 10**8),
    ),
    "learned": (
        learned.ARCHIVE,
        learned_page.PAGE,
        learned_page.page,
        lambda a: _more(a["rows"][0], "after_mm"),
    ),
    "beam": (beam.ARCHIVE, beam.PAGE, beam.page, lambda a: _more(a["trials"][0]["by_seed"][0]["rest_mm"], "tracked")),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_page_is_that_of_its_archive(name):
    folder, page, written, change = WRITTEN[name]
    answer, kept = read_archive(folder), page.read_text(encoding="utf-8")
    assert written(answer) == kept
    change(answer)
    assert written(answer) != kept


@pytest.mark.parametrize("tier", blind.PAGES)
def test_a_page_of_the_blind_bench_is_that_of_its_verdicts(tier):
    assert blind.page(tier) == (blind.HERE / blind.PAGES[tier]).read_text(encoding="utf-8")


def test_the_page_of_rigs_is_that_of_its_verdicts():
    archives, kept = rigs.archives(), rigs.PAGE.read_text(encoding="utf-8")
    assert rigs.page(archives) == kept
    next(iter(archives["dev"]["rows"].values()))["verdict"] = "unexplained elsewhere"
    assert rigs.page(archives) != kept


def test_the_table_of_trained_models_in_the_results_is_that_of_the_archive():
    answer, kept = read_archive(learned.ARCHIVE), table("learned", learned_page.RESULTS)
    assert learned_page.results_table(answer["rows"]) == kept
    assert learned_page.readme_table(answer["rows"]) == table("learned", learned_page.README)


def test_the_table_of_images_in_the_results_is_that_of_the_archive():
    assert images.table(read_archive(images.ARCHIVE)) == table("images", images.RESULTS)


def test_the_page_of_unknown_loads_is_that_of_its_archives():
    assert loadfree.page() == loadfree.PAGE.read_text(encoding="utf-8")


def test_the_page_of_tracking_is_that_of_its_archives():
    answer, rate = read_archive(tracking.ARCHIVE), read_archive(tracking.RATE_ARCHIVE)
    kept = tracking.PAGE.read_text(encoding="utf-8")
    assert tracking.page(answer, rate) == kept
    rate["rows"]["contacts"]["dropped"] += 1
    assert tracking.page(answer, rate) != kept
    rate["rows"]["contacts"]["dropped"] -= 1
    answer["model"][0]["frame by frame"][5][0] += 1.0
    assert tracking.page(answer, rate) != kept


def test_the_page_of_live_is_that_of_its_archives():
    kept = soak.PAGE.read_text(encoding="utf-8")
    assert soak.page() == kept
    answer = read_archive(soak.SOAK)
    section = "\n".join(soak.soak_section(answer))
    assert section in kept
    answer["minutes"][-1]["rss_mb"] += 1.0
    assert "\n".join(soak.soak_section(answer)) != section


@pytest.mark.parametrize(
    ("name", "folder", "written", "change"),
    [
        ("solver", solver.ARCHIVE, solver.tables, lambda a: _more(a["many"], "ms_a_member")),
        ("esmda", esmda.ARCHIVE, esmda.table, lambda a: _more(a["cases"][0]["rows"][0], "median_s")),
    ],
)
def test_a_table_of_the_page_of_times_is_that_of_its_archive(name, folder, written, change):
    answer, kept = read_archive(folder), table(name, solver.PAGE)
    assert written(answer) == kept
    change(answer)
    assert written(answer) != kept


def test_an_archive_is_read_as_it_was_written(tmp_path):
    answer = {
        "schema": "a/1",
        "empty": {},
        "rows": {"one": {"a": 1.5, "b": {"c": None, "d": "2", "e": "a word, two"}}, "0.5": {"a": [1, [2]], "f": ""}},
        "trials": [{"x": True}, {"x": " spaced", "y": {}}],
        "methods": {"m": [{"i": 0}, {"i": 1}], "n": [{"i": 2}]},
        "bodies": {"a": {"parts": {"p/q": {"v": 1}}, "pairs": [{"v": "null"}]}, "b": {"parts": {}, "pairs": []}},
        "cases": [{"n": 1, "rows": [{"k": 1}, {"k": 2}]}, {"n": 2, "rows": [{"k": 3}]}],
    }
    tables = ("rows/<row>", "trials/#", "methods/<method>/#", "bodies/<body>/parts/<part>", "cases/#/rows/#")
    write_archive(tmp_path / "kept", answer, tables)
    assert read_archive(tmp_path / "kept") == {
        **answer,
        "bodies": {"a": answer["bodies"]["a"], "b": {"pairs": []}},
    }
    assert (tmp_path / "kept" / "trials.csv").read_text(encoding="utf-8") == 'x,y\ntrue,\n""" spaced""",{}\n'


def test_a_large_table_is_compressed_and_replaces_the_plain_one(tmp_path):
    for number in (10, 40_000, 10):
        answer = {"rows": [{"value": k} for k in range(number)]}
        write_archive(tmp_path, answer, ("rows/#",))
        assert read_archive(tmp_path) == answer
        assert {path.name for path in tmp_path.iterdir()} == {"run.json", "rows.csv" if number == 10 else "rows.csv.xz"}
