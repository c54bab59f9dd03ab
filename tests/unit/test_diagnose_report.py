"""The page of a diagnosis, from made-up answers: it holds the findings, and no external resources."""

import argparse
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from support.browser import needs_browser, opened
from support.files import EXPERIMENT, TABLES, write_experiment
from support.pages import assert_sound_page, scenes_of, unpacked
from tissuereg.cli import diagnose as diagnose_command
from tissuereg.cli.common import Stopwatch
from tissuereg.diagnosis.answer import BodyDiagnosis, DiagnosisDetails, Finding
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.candidates import Candidate
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import Fit, FitTarget, FittedCause
from tissuereg.diagnosis.noise import UnderstatedNoise, estimate_noise
from tissuereg.diagnosis.nuisances import Nuisances
from tissuereg.diagnosis.proof import HeldOut
from tissuereg.diagnosis.report.charts import blocks_words, curves, ranking
from tissuereg.diagnosis.report.page import summary
from tissuereg.diagnosis.report.scene import drawn_surface, scene
from tissuereg.diagnosis.screen import Screened
from tissuereg.diagnosis.search import Search, Step
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Inclusion, MarkerSlip
from tissuereg.report.viewer import script_text

NASTY = "<b>&'\"P</b></script>"
BALL = Inclusion(centre_mm=(15.0, 10.0, 20.0), semi_axes_mm=(4.0, 4.0, 4.0), contrast=6.0)


def finding(**changes):
    made = Finding(
        id="inclusion",
        group=("inclusion", "layer"),
        probability=0.87,
        log_bayes_factor=123.4,
        threshold=6.5,
        parameters={"centre_mm": [15.0, 10.0, 20.0], "contrast": 6.0, "law": "yeoh"},
        deviations={"centre_mm": [0.31, 0.32, 0.33], "contrast": 1.25},
        held_out={
            "rms_base_mm": 0.523,
            "rms_named_mm": 0.061,
            "rms_generic_mm": 0.187,
            "noise_mm": 0.052,
            "chi_base": 9.87,
            "chi_named": 1.13,
            "chi_generic": 3.21,
            "log_density_gain": 77.7,
            "cases": ["lean", "rest"],
        },
        sentence="A stiff inclusion lies < 5 mm deep & hides.",
        group_probability=0.93,
    )
    return replace(made, **changes)


def fitted(layout, noise, parts, left):
    """Return a fit with residuals of `left` mm and mN."""
    prediction = np.where(layout.seen, layout.measured - left, 0.0)
    residual = noise.whitened(np.where(layout.seen, left, 0.0), layout)
    one = np.ones(1)
    return Fit(
        parts,
        x=0.1 * one,
        covariance=0.01 * np.eye(1),
        mean=0.0 * one,
        deviation=0.3 * one,
        prediction=prediction,
        jacobian=np.zeros((1, layout.size)),
        residual=residual,
        objective=0.0,
        log_evidence=0.0,
    )


def made_up(believed, findings=(), effects=(), **changes):
    """Return a diagnosis of an experiment; nothing is solved."""
    layout = SignalLayout(believed)
    noise = estimate_noise(believed, layout)
    bench = Bench(believed, layout)
    correction = Correction(layout)
    target = FitTarget(bench, noise, correction, Null(np.zeros((0, layout.size))))
    generator = np.random.default_rng(3)
    errors = generator.normal(size=(2, layout.size)) * np.array([[0.5], [0.05]])
    base = fitted(layout, noise, (), errors[0])
    final, steps = base, []
    screened = {"inclusion": Screened(123.4, None, np.ones(1)), "unknown": Screened(12.5, None, np.empty(0))}
    for number, one in enumerate(findings):
        part = FittedCause(one.id, None)
        final = fitted(layout, noise, (*final.parts, part), errors[1] / (number + 1))
        found = Candidate(one.id, final, one.log_bayes_factor, None)
        screened = {"unknown": screened["unknown"], one.id: Screened(9.0, None, np.ones(1))}
        proof = HeldOut(("lean",), np.zeros((4, 1)), np.array([[2.5], [1.0], [2.0], [3.0]]) * np.ones((4, layout.size)))
        steps.append(Step(screened, [found], found, proof, proof, given=tuple(step.found.id for step in steps)))
    steps.append(Step(screened, [], None, None, given=tuple(step.found.id for step in steps)))
    answer = BodyDiagnosis(
        verdict="named" if findings else "consistent",
        findings=tuple(findings),
        candidates=(
            {"id": "inclusion", "probability": 0.87, "log_bayes_factor": 123.4, "detectability": 17.9},
            {"id": "unknown", "probability": 0.1, "log_bayes_factor": 12.5, "detectability": 0.0},
            {"id": "layer", "probability": 0.0, "log_bayes_factor": -2.25, "detectability": 0.4},
        ),
        p_misfit=0.43,
        discrepancy={
            "rms_mm": 0.512,
            "in_sigma": 9.9,
            "where": list(believed.marker_names[:1]),
            "when": "most at 11 s",
            "under": layout.parts[-1].name,
            "after": {"rms_mm": 0.049, "in_sigma": 1.02},
        },
        extended=replace(believed, effects=(*believed.effects, *effects)),
        next_experiment=None,
        seed=4711,
        versions={"tissuereg": "9.8.7"},
        details=DiagnosisDetails(
            Search(base, final, steps, final.residual),
            target,
            Nuisances(("stiffness",), np.zeros((1, layout.size))),
            {"inclusion": 6.5, "layer": 6.5},
        ),
    )
    return replace(answer, **changes)


def read_page(answer, path):
    text = answer.report(path).read_text(encoding="utf-8")
    assert_sound_page(text, reaches=["experiment.extended.toml"])
    return text


@pytest.fixture
def rig(tmp_path):
    return tr.read_experiment(write_experiment(tmp_path / "rig"))


def layers_of(drawn):
    return {layer["title"]: layer for layer in drawn["layers"]}


def test_a_page_holds_every_finding_with_its_figures(rig, tmp_path):
    slip = finding(id="marker_slip", group=("marker_slip",), sentence="P1 slipped.", log_bayes_factor=44.4)
    answer = made_up(
        rig, [finding(), slip], [BALL, MarkerSlip(marker="P1", offset_mm=(1.0, 0.0, 0.0), from_time_s=10.5)]
    )
    text = read_page(answer, tmp_path / "report.html")
    for said in (
        "A stiff inclusion lies &lt; 5 mm deep &amp; hides.",
        "P1 slipped.",
        "Probability 0.87, of the group 0.93; log Bayes factor 123.4 (threshold 6.5).",
        "Probability 0.87; log Bayes factor 44.4 (threshold 6.5).",
        "log Bayes factor 44.4",
        "15 \u00b1 0.31<br>10 \u00b1 0.32<br>20 \u00b1 0.33",
        "6 \u00b1 1.2",
        "yeoh",
        "from 0.523 to 0.061 mm (rms), where noise alone is 0.052 mm",
        "leaves 0.187 mm",
        "1.13 against 3.21 noise deviations",
        "e<sup>77.7</sup>",
        "threshold 6.5",
        "cannot distinguish it from: layer",
        "Seed of all random draws: 4711.",
        "tissuereg 9.8.7",
        "contrast = 6.0",
    ):
        assert said in text, said
    layers = layers_of(scenes_of(text)[0])
    inclusion = layers["inclusion found"]
    assert inclusion["names"] == ["inclusion found: contrast 6"]
    assert unpacked(inclusion["places"][0][0]).ravel() == pytest.approx([15.0, 10.0, 20.0], abs=0.001)
    assert unpacked(inclusion["by"][0][0]).ravel() == pytest.approx(4.0 * np.eye(3).ravel(), abs=0.001)
    assert layers["named by a finding"]["names"] == ["P1"]


def test_a_believed_inclusion_is_not_drawn_as_found(rig):
    answer = made_up(replace(rig, effects=(BALL,)))
    layers = layers_of(scene(answer, answer.details).to_json())
    assert "inclusion found" not in layers
    assert len(layers["inclusion believed"]["names"]) == 1


def test_the_scene_holds_measured_minus_predicted(rig):
    answer = made_up(rig, [finding()], [BALL])
    drawn, layout, search = (
        scene(answer, answer.details).to_json(),
        answer.details.target.bench.layout,
        answer.details.search,
    )
    layers, lean = layers_of(drawn), [case["name"] for case in drawn["cases"]].index("lean")
    for state, fit in enumerate((search.base, search.final)):
        left = layout["lean"].markers(layout.measured - fit.prediction)
        got = unpacked(layers["residual of a marker"]["by"][state][lean])
        np.testing.assert_allclose(got, left.reshape(got.shape), atol=0.00051)
        forces = layout["lean"].forces(layout.measured - fit.prediction)
        got = unpacked(layers["residual of a force"]["by"][state][lean])
        np.testing.assert_allclose(got, forces.reshape(got.shape), atol=0.00051)
    case, row = drawn["start"]["case"], drawn["start"]["frame"]
    sizes = [
        np.nansum(layout[one["name"]].markers(layout.measured - search.base.prediction) ** 2, axis=(1, 2))
        for one in drawn["cases"]
    ]
    assert sizes[case][row] == max(size.max() for size in sizes)


def test_curves_are_root_mean_squares_of_what_was_seen(rig):
    answer = made_up(rig, [finding()], [BALL])
    layout, search = answer.details.target.bench.layout, answer.details.search
    markers, force = curves(answer.details)["lean"]
    white = layout["lean"].markers(search.base.residual)
    assert markers.before[1] == pytest.approx(np.sqrt((white[1, 0] ** 2).mean()))  # P2 was not seen
    assert markers.before[2] == pytest.approx(np.sqrt((white[2] ** 2).mean()))
    assert force.title == "force at push"
    assert np.isnan(force.before).tolist() == [True, True, False]
    assert (markers.low < 1).all()
    assert (markers.high > 1).all()
    assert markers.high[1] > markers.high[2]
    few = markers.worst(2)
    assert few.times.tolist() == [markers.times[int(np.argmax(markers.before[:2]))], markers.times[2]]
    assert few.after[1] == markers.after[2]


def test_names_are_text_and_nothing_else(tmp_path):
    toml = EXPERIMENT.replace('"push"', "'''<i>&push</i></script>'''").replace('"leaning block"', "'''a<b>&c'''")
    toml = toml.replace("\nP1 =", '\n"<b>&\'\\"P</b></script>" =')
    held = {
        name.removesuffix(".csv"): text.replace("P1", '"' + NASTY.replace('"', '""') + '"')
        for name, text in TABLES.items()
    }
    held = {
        name: text.replace("push", "<i>&push</i></script>").replace("lean", "<u>lean&") for name, text in held.items()
    }
    believed = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml, **held))
    assert NASTY in believed.marker_names
    advice = {"action": "move <i>&push</i>", "separates": [["inclusion", "layer"]], "separability": 5.5}
    text = read_page(
        made_up(believed, [finding()], [BALL], next_experiment=advice, verdict="group"), tmp_path / "r.html"
    )
    for tag in ("<b>&", "<i>", "<u>", "a<b>"):
        assert tag not in text
    assert "move &lt;i&gt;&amp;push&lt;/i&gt;" in text
    assert "distinguish: either inclusion or layer." in text
    assert "5.5 noise deviations, given the uncertainty" in text
    assert "<li><b>layer</b>: A layer of constant thickness below the free surface, with another modulus.</li>" in text
    assert layers_of(scenes_of(text)[0])["residual of a marker"]["names"][0] == NASTY


@pytest.mark.parametrize("verdict", ["consistent", "unexplained"])
def test_no_findings(rig, tmp_path, verdict):
    text = read_page(made_up(rig, verdict=verdict), tmp_path / "report.html")
    assert "No cause was accepted." in text
    assert "both are the same" in text
    assert ("consistent with the simulation" in text) == (verdict == "consistent")


def test_an_unexplained_answer_says_what_to_check(rig, tmp_path):
    advice = {"action": "check <marker> P7", "separates": [], "separability": None}
    text = read_page(made_up(rig, verdict="unexplained", next_experiment=advice), tmp_path / "report.html")
    assert "<b>Next:</b> check &lt;marker&gt; P7." in text


def test_no_forces_and_one_case(tmp_path):
    toml = EXPERIMENT.replace('rest_case = "rest"\n', "").replace("[forces]\nstd_mN = 5.0\n", "")
    markers = "\n".join(row for row in TABLES["markers.csv"].splitlines() if not row.startswith("rest")) + "\n"
    believed = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml, markers=markers, forces=None))
    text = read_page(made_up(believed, [finding()], [BALL]), tmp_path / "report.html")
    assert "force at" not in text
    assert "Noise of a force component" not in text
    assert len(scenes_of(text)[0]["cases"]) == 1


def test_a_finding_without_proof_and_an_answer_without_details(rig, tmp_path):
    stiff = finding(id="stiffness", group=("stiffness",), held_out={}, sentence="Stiffer.")
    answer = made_up(rig, [stiff, finding()], [BALL])
    search = answer.details.search
    answer = replace(answer, details=replace(answer.details, search=replace(search, steps=search.steps[1:])))
    text = read_page(answer, tmp_path / "report.html")
    assert "Stiffer." in text
    assert text.count("e<sup>") == 1
    bare = read_page(made_up(rig, [finding()], [BALL], details=None), tmp_path / "bare.html")
    assert "log Bayes factor 123.4" in bare
    assert "class='viewer'" not in bare


def test_a_cause_that_was_removed_later_leaves_its_round_unmarked(rig, tmp_path):
    answer = made_up(rig, [finding(), finding(id="layer", group=("layer",))], [BALL])
    search = answer.details.search
    dropped = replace(search.steps[0], found=None)
    details = replace(answer.details, search=replace(search, steps=[dropped, *search.steps[1:]]))
    answer = replace(answer, findings=answer.findings[1:], details=details)
    text = read_page(answer, tmp_path / "report.html")
    charts = re.findall(r"<svg[^>]*aria-label='((?:First r|R)ound[^']*)'(.*?)</svg>", text)
    assert charts[1][0] == "Round 2: further causes, given inclusion"
    bold = {title: re.findall(r"font-weight='700'>([a-z ]+)<", chart) for title, chart in charts}
    assert list(bold.values())[:2] == [[], ["layer"]]


def test_every_round_marks_what_it_found(rig, tmp_path):
    layer = finding(id="layer", group=("layer",))
    text = read_page(made_up(rig, [finding(group=("inclusion",)), layer], [BALL]), tmp_path / "report.html")
    rounds = re.findall(r"<svg[^>]*aria-label='((?:First r|R)ound[^']*)'.*?</svg>", text)
    assert rounds == [
        "First round",
        "Round 2: further causes, given inclusion",
        "Round 3: further causes, given inclusion, layer",
    ]
    bold = [re.findall(r"font-weight='700'>([a-z ]+)<", chart) for chart in re.findall(r"<svg.*?</svg>", text)]
    assert [one for one in bold if one] == [["inclusion"], ["layer"]]


def test_bars_stand_on_the_right_side_of_the_threshold():
    rows = [{"id": "inclusion", "log_bayes_factor": 7.0}, {"id": "layer", "log_bayes_factor": 6.0}]
    text = ranking(rows, {"inclusion": 6.5, "layer": 6.5}, {"inclusion"}, "made up")
    bars = [float(x) + float(w) for x, w in re.findall(r"<rect x='([\d.]+)' y='[\d.]+' width='([\d.]+)'", text)]
    line = float(re.search(r"<line x1='([\d.]+)'[^>]*#a3180d", text)[1])
    assert bars[0] > line > bars[1]


def test_large_bodies_are_drawn_with_fewer_triangles(tmp_path):
    wide = EXPERIMENT.replace("radius_mm = 8.0", "radius_mm = 14.0")
    rig = tr.read_experiment(write_experiment(tmp_path / "rig", toml=wide))
    whole = drawn_surface(rig)
    assert len(whole.triangles) == len(rig.mesh.surface)
    assert set(whole.patch.tolist()) == {0, 1, 2}
    few = drawn_surface(rig, most=60)
    assert 8 < len(few.triangles) <= 60
    assert np.ptp(few.nodes, axis=0) == pytest.approx(np.ptp(rig.mesh.nodes, axis=0), rel=0.5)


def test_blocks_of_frames_are_named_together():
    blocks = [f"a, b, every 4th frame from {number}" for number in range(4)]
    assert blocks_words(["c", *blocks]) == "c, a, b, every 4th frame in turn"


def test_long_histories_are_thinned(rig):
    answer = made_up(rig)
    assert [len(one.times) for one in scene(answer, answer.details).cases] == [2, 3]
    assert [len(one.times) for one in scene(answer, answer.details, most=10).cases] == [1, 2]


def test_text_cannot_end_its_script():
    assert "<" not in script_text({"name": NASTY})
    assert json.loads(script_text({"name": NASTY}))["name"] == NASTY


@needs_browser
def test_the_viewer_draws_arrows_inclusion_and_figures(rig, tmp_path):
    answer = made_up(rig, [finding()], [BALL])
    read_page(answer, tmp_path / "report.html")
    found, wide = opened(
        tmp_path / "report.html",
        """const said = () => [drawn(), viewers[0].querySelector(".figures").textContent];
        const seen = [said()], moment = viewers[0].querySelector("output").textContent;
        button("after"); await settled(); seen.push(said());
        const canvas = viewers[0].querySelector("canvas"), box = canvas.getBoundingClientRect(), tips = new Set();
        for (let x = 0; x < box.width; x += 5) for (let y = 0; y < box.height; y += 5) {
          canvas.dispatchEvent(new PointerEvent("pointermove", { clientX: box.left + x, clientY: box.top + y }));
          tips.add(viewers[0].querySelector(".tip").textContent);
        }
        const cases = [...viewers[0].querySelectorAll("option")].map((one) => one.textContent);
        return { seen, moment, tips: [...tips], cases };""",
    )
    layout, search = answer.details.target.bench.layout, answer.details.search
    start = scene(answer, answer.details).start
    part, row = layout.parts[start[1]], start[2]
    left = [part.markers(layout.measured - fit.prediction)[row] for fit in (search.base, search.final)]
    arrows = int(np.isfinite(left[0]).all(axis=1).sum())
    assert wide <= 0
    assert [drawn["signs"]["residual of a marker"] for drawn, _ in found["seen"]] == [arrows, arrows]
    assert found["seen"][0][0]["signs"]["inclusion found"] == 1
    assert found["seen"][0][0]["labels"] >= 2  # the pads
    for _, figures in found["seen"]:
        rms = [float(x) for x in re.search(r"before ([\d.]+) mm, after ([\d.]+) mm", figures).groups()]
        assert rms == pytest.approx([np.sqrt(np.nanmean(one**2)) for one in left], abs=0.0015)
    assert found["moment"] == f"{part.times[row]:.2f} s"
    assert found["cases"] == ["rest", "lean"]
    said = {tip.split("\n")[0]: tip.split("\n")[1] for tip in found["tips"] if "before: " in tip}
    assert said.keys() & {"P1", "P2"}
    for name, length in zip(layout.marker_names, np.linalg.norm(left[0], axis=1), strict=True):
        if name in said:
            assert float(said[name].split()[1]) == pytest.approx(length, abs=0.0015)


@pytest.mark.parametrize("place", ["out", "new/deep/out", "rig"])
def test_the_extended_model_is_read_back_from_its_final_folder(rig, tmp_path, monkeypatch, place):
    monkeypatch.chdir(tmp_path)
    made_up(rig, [finding()], [BALL]).save(Path(place))
    assert {"diagnosis.json", "experiment.extended.toml", "report.html"} <= {p.name for p in Path(place).iterdir()}
    back = tr.read_experiment(Path(place) / "experiment.extended.toml")
    assert back.effects == (BALL,)
    assert back.mesh.digest() == rig.mesh.digest()
    assert list(back.cases) == list(rig.cases)
    said = (Path(place) / "experiment.extended.toml").read_text(encoding="utf-8")
    page = (Path(place) / "report.html").read_text(encoding="utf-8")
    assert said.replace('"', "&quot;") in page


def test_page_and_command_agree_on_what_is_stated(rig, tmp_path):
    possible = {"id": "layer", "probability": 0.31, "log_bayes_factor": 9.25, "threshold": 6.5}
    tied = finding(probability=0.4, group_probability=0.7)
    noise = UnderstatedNoise("forces", 2.0, 5.0, 2.5, 33.0)
    answer = made_up(rig, [tied], [BALL], possible=(possible,), understated=(noise,), verdict="group")
    page = read_page(answer, tmp_path / "report.html")
    said = told_by_command(answer)
    for text in (page, said):
        assert "The noise of the forces is understated: 2 mN are stated, 5 mN are found, 2.5 times as much" in text
    assert "Possible, but not stated: layer (probability 0.31; log Bayes factor 9.2, threshold 6.5)." in page
    assert "possible, but not stated: layer, P = 0.31, log Bayes factor 9.2 of 6.5" in said
    assert "Probability 0.40, of the group 0.70;" in page
    assert "inclusion (or layer), P = 0.40, 0.70 together:" in said
    assert answer.to_json()["possible"] == [possible]


@pytest.mark.parametrize("verdict", ["consistent", "understated-noise", "unexplained", "named", "group"])
def test_the_exit_code_is_that_of_the_verdict(rig, verdict):
    answer = made_up(rig, verdict=verdict)
    code = outcome_of(answer, exit_code=True).code
    assert (code == 0) == (verdict == "consistent")
    assert outcome_of(answer).code == 0
    assert told_by_command(answer).startswith(f"{verdict}, provisional")


def test_a_provisional_answer_names_the_number_of_cases_that_it_lacks(rig):
    many = replace(DEFAULT, report=replace(DEFAULT.report, least_cases=7))
    assert "fewer than 7 load cases" in summary(made_up(rig, numbers=many))
    few = replace(DEFAULT, report=replace(DEFAULT.report, least_cases=1))
    assert "Provisional" not in summary(made_up(rig, numbers=few))


def outcome_of(answer, **changed):
    given = argparse.Namespace(out=None, verbose=False, threads=1, exit_code=False)
    vars(given).update(changed)
    return diagnose_command._outcome(answer.to_json(), Stopwatch(), given)


def told_by_command(answer):
    return outcome_of(answer).summary
