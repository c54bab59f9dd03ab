"""Do the tables of benchmarks/README.md hold the figures of the archived JSON?"""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from support.scripts import REPOSITORY, script
from tissuereg.tracking import fitted_prior

BENCHMARKS = REPOSITORY / "benchmarks"


def loaded(name):
    """Return a script of the benchmarks as a module."""
    return script("benchmarks", name)


@pytest.mark.parametrize(("name", "archive"), [("febio", "febio"), ("simulated_here", "simulated-here")])
def test_pages_of_diagnoses_are_those_of_their_archives(name, archive):
    script = loaded(name)
    rows = json.loads((BENCHMARKS / "results" / f"{archive}.json").read_text(encoding="utf-8"))
    kept = (BENCHMARKS.parent / "docs" / f"{archive}.md").read_text(encoding="utf-8")
    assert script.page(rows) == kept
    first = next(iter(rows["rows"].values()))
    first["p_misfit"] = 0.123456
    assert script.page(rows) != kept


def test_the_page_of_tracking_is_that_of_its_archive():
    script = loaded("tracking")
    kept = (BENCHMARKS.parent / "docs" / "tracked.md").read_text(encoding="utf-8")
    for changed in range(2):
        answer, replays = (
            json.loads((BENCHMARKS / "results" / f"{name}.json").read_text(encoding="utf-8"))
            for name in ("tracking", "tracking-rate")
        )
        assert script.page(answer, replays) == kept
        if changed:
            answer["model"][0]["frame by frame"][5][0] += 1.0
        else:
            replays["rows"]["contacts"]["dropped"] += 1
        assert script.page(answer, replays) != kept


def test_the_page_of_the_tracked_beam_is_that_of_its_archive():
    script = loaded("tracked_beam")
    answer = json.loads((BENCHMARKS / "results" / "tracked-beam.json").read_text(encoding="utf-8"))
    kept = (BENCHMARKS.parent / "docs" / "tracked-beam.md").read_text(encoding="utf-8")
    assert script.page(answer) == kept
    answer["trials"][0]["by_seed"][0]["rest_mm"]["tracked"] += 0.1
    assert script.page(answer) != kept


def test_a_replay_counts_what_it_drops_and_times_what_it_registers():
    benchmark, mesh = loaded("tracking"), block(cells=(2, 2, 3))
    places = mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)][::3]
    now_s = [0.0]

    def clock():
        return now_s[0]

    def wait(seconds):
        now_s[0] += seconds

    def slow(share):
        now_s[0] += 2.4 / benchmark.HZ
        return share * (mesh.nodes[:, 2:] > 0.0) * np.ones(3)

    motion = SimpleNamespace(
        measured=np.repeat(places[None], 10, axis=0), shares=np.zeros(10), of=lambda frame, _: [float(frame)]
    )
    model = fitted_prior(mesh, largest_mm=1.0, n_events=20, n_latent=4, threads=1)
    tracker = tr.Tracker(
        tr.Registrar(mesh, places, model, settings=tr.RegisterSettings(threads=1)), simulator=slow, restart="reference"
    )
    row = benchmark.replayed(motion, tracker, clock=clock, wait=wait)
    # A frame takes 2.4 intervals, so that every second or third one is registered: 0, 2, 4, 7, 9.
    assert (row["registered"], row["dropped"]) == (5, 5)
    assert row["lesion_mm"] == pytest.approx(np.mean([0, 2, 4, 7, 9]))
    assert row["latency_median_ms"] == pytest.approx(np.median(row["latency_ms"]))
    assert min(row["latency_ms"]) == pytest.approx(2.4e3 / benchmark.HZ)
    assert row["hz"] == pytest.approx(5 / (9 / benchmark.HZ + 1e-3 * row["latency_ms"][-1]))


def test_an_answer_is_right_with_every_true_cause_and_no_other():
    script = loaded("febio")

    def row(truth, *groups, detectability=50.0):
        causes = [{"id": group[0], "group": list(group)} for group in groups]
        verdict = "named" if groups else "consistent"
        return {"truth": truth, "causes": causes, "verdict": verdict, "detectability": detectability}

    assert script.is_right(row([]))
    assert not script.is_right(row([], ["layer"]))
    assert script.is_right(row(["layer"], ["fibre", "layer"]))
    assert not script.is_right(row(["layer"]))
    assert script.is_right(row(["layer"], detectability=4.0))
    assert not script.is_right(row(["layer"], ["layer"], ["fibre"]))
    assert not script.is_right(row(["layer", "latency"], ["layer"]))


def test_the_solver_tables_are_those_of_the_json():
    tables = loaded("solver_table")
    answer = json.loads((BENCHMARKS / "results" / "solver.json").read_text(encoding="utf-8"))
    kept = loaded("readme").table("solver.json")
    assert kept == tables.tables(answer)
    answer["many"]["ms_a_member"] += 1.0
    assert tables.tables(answer) != kept


def test_the_table_of_the_smoother_is_that_of_its_json():
    script = loaded("esmda")
    answer = json.loads((BENCHMARKS / "results" / "esmda.json").read_text(encoding="utf-8"))
    kept = loaded("readme").table("esmda.json")
    assert kept == script.table(answer)
    answer["cases"][0]["rows"][0]["median_s"] *= 1.1
    assert script.table(answer) != kept


def test_the_figures_of_many_machines_are_those_of_their_json():
    script = loaded("cluster")
    answer = json.loads((BENCHMARKS / "results" / "cluster.json").read_text(encoding="utf-8"))
    kept = loaded("readme").table("cluster.json", BENCHMARKS.parent / "docs" / "cluster.md")
    assert script.figures(answer) == kept
    slower = {**answer, "chunk_s": {name: 2.0 * one for name, one in answer["chunk_s"].items()}}
    assert script.figures(slower) != kept
    assert "does not keep up with chunks of 16" in script.figures({**answer, "empty_tasks_per_s": 100.0})
    assert "It keeps up with chunks of 16" in script.figures({**answer, "empty_tasks_per_s": 1e6})
    quiet = script.figures({**answer, "load_before": 0.05})
    assert "busy" not in quiet
    assert "busy" in script.figures({**answer, "load_before": 3.0})


def test_the_table_of_advised_markers_is_that_of_its_json():
    script = loaded("advise")
    answer = json.loads((BENCHMARKS / "results" / "advise.json").read_text(encoding="utf-8"))
    kept = loaded("readme").table("advise.json", BENCHMARKS.parent / "docs" / "advise-markers.md")
    assert script.table(answer) == kept
    answer["rows"][0]["advised_mm"] *= 2.0
    assert script.table(answer) != kept


def test_the_page_of_parts_of_material_tests_is_that_of_its_archive():
    script = loaded("material_parts")
    archive = json.loads((BENCHMARKS / "results" / "material-parts.json").read_text(encoding="utf-8"))
    kept = (BENCHMARKS.parent / "docs" / "material-parts.md").read_text(encoding="utf-8")
    assert script.page(archive) == kept
    # Parameters of one part lie within two stated deviations of another's; by curvature alone they would not.
    adhesive = archive["measured"]["adhesive"]["pairs"]
    apart = {kind: [z for pair in adhesive if pair["same_form"] for z in pair[kind].values()] for kind in script.KINDS}
    assert max(apart["stated"]) <= 2.0 < max(apart["right"])
    next(iter(archive["known"].values()))["rows alike"]["stated"]["within_two"] = 0.123
    assert script.page(archive) != kept


def test_parts_are_compared_by_their_difference_or_by_the_smaller_one():
    script = loaded("material_parts")
    one, other = {"b": [1.0, 0.3]}, {"b": [1.5, 0.4]}
    assert script.distances(one, other, "apart")["b"] == pytest.approx(1.0)
    assert script.distances(one, other, "within")["b"] == pytest.approx(0.5 / 0.3)
    a, b = object(), object()
    assert script.pairs({"a": [a], "b": [b], "both": [a, b]}) == [
        ("a", "b", "apart"),
        ("a", "both", "within"),
        ("b", "both", "within"),
    ]


def test_the_page_of_large_bodies_is_that_of_its_archive_and_estimates_hold():
    script = loaded("large_bodies")
    archive = json.loads((BENCHMARKS / "results" / "large-bodies.json").read_text(encoding="utf-8"))
    assert script.page(archive) == (BENCHMARKS.parent / "docs" / "large-bodies.md").read_text(encoding="utf-8")
    assert [row["size"]["n_nodes"] // 1000 for row in archive["rows"]] == [4, 20, 101, 201]
    for row in archive["rows"]:
        for command in ("register", "solve"):
            # Never much too low, since bodies are refused by it; never twice too high.
            told, found = row["expected"][command]["peak_bytes"], row["measured"][command]["peak_bytes"]
            assert 0.95 * found < told < 2.0 * found, (row["size"]["n_nodes"], command)
    archive["rows"][0]["measured"]["register"]["peak_bytes"] += 10**8
    assert script.page(archive) != script.page(json.loads((BENCHMARKS / "results" / "large-bodies.json").read_text()))


def test_the_page_of_the_spread_is_that_of_its_archive():
    script = loaded("spread_page")
    archive = json.loads((BENCHMARKS / "results" / "spread.json").read_text(encoding="utf-8"))
    kept = (BENCHMARKS.parent / "docs" / "spread.md").read_text(encoding="utf-8")
    assert script.page(archive) == kept
    assert (BENCHMARKS.parent / "docs" / script.PICTURE).is_file()
    ours = archive["sets"]["known"]["ours"]
    # What the page claims is what was wanted of regions.
    assert 0.86 <= ours["coverage"]["0.90"][0] <= 0.94
    assert archive["sets"]["foreign"]["ours"]["coverage"]["0.90"][0] >= 0.80
    ours["coverage"]["0.90"][0] = 0.123
    assert script.page(archive) != kept


@pytest.mark.parametrize(
    ("name", "page"), [("variants", "decisions/variants-of-a-simulation"), ("fallback", "decisions/fallback")]
)
def test_tables_of_decisions_are_those_of_their_archives(name, page):
    made, readme = loaded(name), loaded("readme")
    content = json.loads((BENCHMARKS / "results" / f"{name}.json").read_text(encoding="utf-8"))
    begin, end = readme.marks(name)
    kept = (BENCHMARKS.parent / "docs" / f"{page}.md").read_text(encoding="utf-8")
    assert kept.split(begin)[1].split(end)[0] == made.table(content)
    if name == "variants":
        content["rows"][0]["rigs"]["scenario1-101"]["inner_mm"] += 1.0
    else:
        next(row for row in content["rows"] if not row["trusted"])["errors_mm"][0] += 1e3
    assert kept.split(begin)[1].split(end)[0] != made.table(content)


def test_the_page_of_the_rivals_is_that_of_its_archive_and_of_their_defaults():
    pages, script = loaded("tune_rivals_page"), loaded("tune_rivals")
    answer = json.loads((BENCHMARKS / "results" / "rivals-tuning.json").read_text(encoding="utf-8"))
    kept = (BENCHMARKS.parent / "docs" / "rivals-tuning.md").read_text(encoding="utf-8")
    assert pages.page(answer) == kept
    known, pending = {}, {tuple(one) for one in answer["pending"]}
    for sweep in answer["sweeps"]:
        key = sweep["method"], sweep["constant"]
        known[key] = sweep["default"]
        errors = dict(zip(sweep["values"], pages.errors_of(sweep), strict=True))
        best = min(errors, key=errors.get)
        chosen = errors[sweep["default"]]
        assert chosen <= (1.0 + pages.TIE) * errors[best] or key in pages.REASONS, key
        at_an_end = sweep["default"] in (sweep["values"][0], sweep["values"][-1])
        flat = max(errors.values()) <= (1.0 + pages.TIE) * chosen
        assert not at_an_end or flat or sweep["default"] == 0.0 or key in pages.REASONS, key
    for method in script.b.RIVALS.values():
        for constant, default in script.constants_of(method).items():
            key = method.name, constant
            assert key in known or key in pages.FIXED or key in pending or constant == "spread", key
            assert known.get(key, default) == default, key
    answer["sweeps"][0]["sensor_mm"][0][0] += 1.0
    assert pages.page(answer) != kept
