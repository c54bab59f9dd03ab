"""The paper's studies on a small body: Algorithm 1, shapes that nobody trained on, verdicts that are computed?"""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, run_json
from tissuereg.errors import ArgumentError, EnsembleError, ModelError
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.pca import PcaModel
from tissuereg.simulation.dataset import make_dataset
from tissuereg.simulation.recipe import recipe_of
from tissuereg_paper.cli import _STUDIES, main
from tissuereg_paper.rivals.assimilation import AssimilationSettings, assimilate
from tissuereg_paper.studies import SIMULATED, STUDIES, reproduce, shapes
from tissuereg_paper.studies import run as running
from tissuereg_paper.studies import sweep as sweeping
from tissuereg_paper.studies.algorithm import DECREASE, assimilate_many
from tissuereg_paper.studies.cases import draw_cases
from tissuereg_paper.studies.claims import Agreement, Claim
from tissuereg_paper.studies.figures import CDS, FIGURES, fig6_settings, fig7_settings, fig8_settings
from tissuereg_paper.studies.layers import PAPER, graph_layers
from tissuereg_paper.studies.measures import Clusters, Errors, inside90
from tissuereg_paper.studies.settings import METHODS, STD_AS_VARIANCE, Setting
from tissuereg_paper.studies.shapes import HeldOut
from tissuereg_paper.studies.subject import Subject
from tissuereg_paper.studies.sweep import Sweep
from tissuereg_paper.studies.table2 import layer_rows, run_table2

RECIPE = {
    "seed": 3,
    "mesh": {"source": "phantom", "n_nodes": 150},
    "data": {"members": 130, "chunk": 20, "largest_mm": [8.0, 22.0], "gravity_share": 0.3, "plate_share": 0.2},
    "pairs": {"members": 0},
}
N_LATENT, CODE_STD = 6, 0.05


class Coded(PcaModel):
    """Principal components with an encoder that states a spread, as networks have one."""

    def encode(self, field):
        return super().encode(field), np.full(self.n_latent, CODE_STD**2)


@pytest.fixture(scope="module")
def subject():
    recipe = recipe_of(RECIPE, "recipe.toml")
    held_out = HeldOut(recipe, recipe.mesh())
    training = np.setdiff1d(np.arange(60), held_out.numbers)
    fields = held_out.fields(training, threads=1).astype(np.float64)
    centre = np.zeros(fields.shape[1:])
    model = Coded.fit(fields[:40], fields[:0], centre=centre, n_latent=N_LATENT, card={})
    codes = np.stack([model.encode(field)[0] for field in fields[40:]], axis=1)
    model.error_fields = fields[40:] - model.decode(codes)
    errors = {"train": 0.2, "valid": 0.3, "test": 0.3, "pca": 0.4}
    facts = {"kind": "pca", "source": "here", "n_nodes": len(centre), "n_latent": N_LATENT, "errors_mm": errors}
    return Subject(held_out, model, {**facts, "members": 40}, (), fields.mean(axis=0))


@pytest.fixture(scope="module")
def cases(subject):
    return draw_cases(subject.held_out, 0, 1, n_starts=3, n_targets=4)


# --- shapes and pairs ---


def test_a_held_out_shape_is_the_test_member_of_the_data_set_bit_for_bit(tmp_path):
    recipe = recipe_of(RECIPE, "recipe.toml")
    make_dataset(recipe, tmp_path / "data", threads=1)
    data = tr.open_dataset(tmp_path / "data")
    held_out = HeldOut(recipe, recipe.mesh(), tuple(number for number, _ in data.failed))
    assert held_out.mesh.digest() == data.mesh.digest()
    assert np.array_equal(held_out.numbers, data.index[data.split["test"]])
    assert np.array_equal(held_out.fields(held_out.numbers, threads=2), data.displacement[data.split["test"]])


def test_shapes_come_in_the_order_asked_for(subject):
    some = subject.held_out.numbers[[4, 1, 4]]
    found = subject.held_out.fields(some, threads=1)
    assert np.array_equal(found[0], found[2])
    assert np.array_equal(found[1:2], subject.held_out.fields(some[1:2], threads=1))


def test_a_split_without_the_failed_members_is_another_one(subject):
    recipe, mesh = subject.held_out.recipe, subject.held_out.mesh
    failed = HeldOut(recipe, mesh, (5, 17))
    assert not {5, 17} & set(failed.numbers)
    assert not np.array_equal(failed.numbers, subject.held_out.numbers)


def test_every_start_has_targets_of_its_own_that_are_other_shapes(subject, cases):
    assert cases.n_pairs == 12
    for start in np.unique(cases.starts):
        targets = cases.targets[cases.starts == start]
        assert len(set(targets) | {start}) == 5
    again = draw_cases(subject.held_out, 0, 2, n_starts=3, n_targets=4)
    assert np.array_equal(again.fields, cases.fields)
    other = draw_cases(subject.held_out, 1, 1, n_starts=3, n_targets=4)
    assert not np.array_equal(other.markers, cases.markers)


def test_markers_lie_on_the_free_surface_and_inner_points_inside(subject, cases):
    mesh = subject.held_out.mesh
    skin = set(mesh.surface.ravel())
    assert len(set(cases.markers)) == 15
    assert set(cases.markers) <= skin - set(mesh.fixed_nodes)
    assert len(cases.inner)
    assert not set(cases.inner) & (skin | set(mesh.fixed_nodes))


def test_far_pairs_lie_as_far_apart_as_asked_and_no_shapes_pair_twice(cases):
    middle = float(np.median(cases.start_errors))
    far = cases.far(middle, 1.0, 9, np.random.default_rng(0))
    assert np.abs(far.start_errors - middle).max() <= 1.0
    assert len({frozenset(pair) for pair in zip(far.starts, far.targets, strict=True)}) == far.n_pairs
    with pytest.raises(EnsembleError, match=r"99.0 mm apart"):
        cases.far(99.0, 0.1, 9, np.random.default_rng(0))


def test_too_few_shapes_are_refused(subject):
    with pytest.raises(EnsembleError, match="at least 21 held-out shapes"):
        draw_cases(subject.held_out, 0, 1, n_starts=2, n_targets=20)


# --- Algorithm 1 ---


def linear_case(n_pairs=3):
    rng = np.random.default_rng(0)
    slope = rng.standard_normal((7, 4))
    observed = rng.standard_normal((n_pairs, 7))
    priors = [Gaussian(rng.standard_normal(4), np.diag(rng.uniform(0.5, 2.0, 4))) for _ in range(n_pairs)]
    return lambda z: np.tanh(z.T @ slope.T), observed, 0.3 * np.eye(7) + 0.1, priors


def by_the_paper(predict, observed, noise, prior, rng, n_members, n_steps):
    """Equations 4 and 5 as they stand in the paper."""
    z = prior.mean[:, None] + np.linalg.cholesky(prior.covariance) @ rng.standard_normal((len(prior.mean), n_members))
    alphas = np.array([DECREASE ** (n_steps - 1 - n) for n in range(n_steps)])
    alphas *= (1.0 / alphas).sum()
    for alpha in alphas:
        y = predict(z).T
        draws = rng.standard_normal(y.shape)
        dz, dy = z - z.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
        c_zy, c_yy = dz @ dy.T / (n_members - 1), dy @ dy.T / (n_members - 1)
        disturbed = observed[:, None] + np.sqrt(alpha) * np.linalg.cholesky(noise) @ draws
        z = z + c_zy @ np.linalg.solve(c_yy + alpha * noise, disturbed - y)
    return z


@pytest.mark.parametrize(("n_members", "n_steps"), [(3, 1), (10, 5), (50, 4)])
def test_many_pairs_at_once_are_the_papers_equations_one_by_one(n_members, n_steps):
    predict, observed, noise, priors = linear_case()
    found = assimilate_many(
        predict,
        observed,
        noise,
        priors,
        rngs=[np.random.default_rng(pair) for pair in range(3)],
        n_members=n_members,
        n_steps=n_steps,
    )
    for pair in range(3):
        rng = np.random.default_rng(pair)
        wanted = by_the_paper(predict, observed[pair], noise, priors[pair], rng, n_members, n_steps)
        # Singular values of whitened anomalies against a solve: rounding of a few steps.
        np.testing.assert_allclose(found.latents[pair], wanted, atol=1e-9)
    np.testing.assert_array_equal(found.means[-1], found.latents.mean(axis=2))
    assert found.means.shape == (n_steps, 3, 4)
    assert not found.exact


def test_with_balanced_draws_they_are_those_of_registrations():
    predict, observed, noise, priors = linear_case()
    found = assimilate_many(
        predict,
        observed,
        noise,
        priors,
        rngs=[np.random.default_rng(pair) for pair in range(3)],
        n_members=40,
        n_steps=5,
        balanced=True,
    )
    for pair in range(3):
        one = assimilate(
            lambda z: predict(z).T,
            observed[pair],
            noise,
            priors[pair],
            rng=np.random.default_rng(pair),
            settings=AssimilationSettings(n_members=40, n_steps=5),
        )
        np.testing.assert_allclose(found.latents[pair], one.latents, atol=1e-12)
        assert found.spread_factor == one.spread_factor == 1.0


# --- settings reach the smoother ---


def test_the_two_readings_of_the_unit_differ_by_a_hundred():
    for cd in CDS:
        read = {reading: Setting(METHODS[0], cd, reading, 10, 5).cd_mm2 for reading in ("cm2", "mm2")}
        assert read["cm2"] == pytest.approx(100.0 * read["mm2"], rel=1e-14)
    assert Setting(METHODS[0], 0.001, "cm2", 10, 5).key == Setting(METHODS[0], 0.1, "mm2", 10, 5).key


@pytest.mark.parametrize("method", [*METHODS, STD_AS_VARIANCE], ids=lambda method: method.name)
def test_members_assimilations_and_noise_of_a_setting_reach_the_smoother(subject, cases, method, monkeypatch):
    decoded, noises, priors = [], [], []

    class Counted(Coded):
        def decode(self, latents, nodes=None):
            decoded.append((latents.shape[1], None if nodes is None else len(nodes)))
            return super().decode(latents, nodes)

    def watched(predict, observed, noise, of_pairs, **given):
        noises.append(noise)
        priors.extend(of_pairs)
        return assimilate_many(predict, observed, noise, of_pairs, **given)

    monkeypatch.setattr(sweeping, "assimilate_many", watched)
    model = subject.model
    counted = Counted(model.centre, model.components, model.error_fields, {})
    sweep = Sweep(Subject(subject.held_out, counted, {}), cases, 0)
    sweep.run([Setting(method, 0.01, "cm2", 20, 3)], threads=1)
    at_markers = [members for members, nodes in decoded if nodes == len(cases.markers)]
    assert at_markers == 3 * [10 * 20] + 3 * [2 * 20]
    own = sweep._at_markers if method.own_errors else 0.0
    np.testing.assert_allclose(noises[0], 1.0 * np.eye(45) + own, rtol=1e-12)
    variances = {float(prior.covariance[0, 0]) for prior in priors}
    assert variances == {{"encoder": CODE_STD**2, "encoder-std": CODE_STD, "family": 1.0}[method.prior]}
    assert sweep.encoder_spread == pytest.approx(CODE_STD)


def test_a_setting_is_run_once_and_threads_change_no_bit(subject, cases):
    settings = fig8_settings()
    one, two = (Sweep(subject, cases, 0) for _ in range(2))
    one.run(settings, threads=1)
    two.run(settings, threads=3)
    calls = []
    one.run(settings, threads=1, progress=lambda done, in_all: calls.append(done))
    assert not calls
    for setting in settings:
        assert one.row("fig8", setting) == two.row("fig8", setting)


def test_the_sweeps_are_those_of_the_paper():
    fig6, fig7 = fig6_settings(), fig7_settings()
    assert {(s.cd, s.n_e) for s in fig6} == {(cd, n) for cd in (0.1, 0.01, 0.001) for n in (10, 50, 100)}
    assert {s.n_a for s in fig6} == {5}
    assert {s.cd for s in fig7} == {0.001}
    assert {s.n_a for s in fig7} >= {1, 5, 10}
    assert {(s.n_e, s.n_a, s.cd) for s in fig8_settings()} == {(100, 5, 0.001)}
    for settings in (fig6, fig7, fig8_settings()):
        assert {s.reading for s in settings} == {"cm2", "mm2"}
        assert {s.method.name for s in settings} >= {"paper", "family", "ours"}


def test_the_row_of_a_setting_holds_the_errors_of_its_meshes(subject, cases):
    sweep = Sweep(subject, cases, 0, thorough=True)
    setting = Setting(METHODS[1], 0.001, "mm2", 100, 5)
    sweep.run([setting], threads=1)
    row, outcome = sweep.row("fig8", setting), sweep.outcome(setting)
    assert len(outcome.steps) == 5
    assert row["end_mean_mm"] == outcome.end.mean.mean()
    assert row["end_mean_mm"] <= row["end_rms_mm"] <= row["end_max_mm"]
    assert 0.0 < row["min_det_f"] < 1.0
    assert row["inverted_tets"] == 0
    low, high = row["end_mean_interval95_mm"]
    assert low <= row["end_mean_mm"] <= high
    # Nearly exact markers determine six components: what is left is what they cannot represent.
    fields = cases.fields.astype(np.float64)
    codes = np.stack([subject.model.encode(field)[0] for field in fields], axis=1)
    best = Errors.of(subject.model.decode(codes), fields).mean[cases.targets]
    assert best.mean() < row["end_mean_mm"] < min(3.0 * best.mean(), 0.5 * row["start_mean_mm"])


# --- measures ---


def test_nine_in_ten_regions_of_a_right_ensemble_hold_the_truth():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((3, 3))
    draws = rng.standard_normal((40, 101, 100, 3)) @ root.T
    share = inside90(draws[:, 1:], draws[:, 0], (1 + 1 / 100) * 99 / 97)
    # 4,000 points: a standard error of half a percent.
    assert share.mean() == pytest.approx(0.9, abs=0.02)
    wider = inside90(draws[:, 1:], draws[:, 0], 1.0, np.broadcast_to(root @ root.T, (100, 3, 3)))
    assert wider.mean() > 0.97


def test_errors_are_means_roots_and_largest_of_distances():
    field = np.zeros((1, 4, 3))
    field[0, 0] = (3.0, 0.0, 4.0)
    errors = Errors.of(field, np.zeros((1, 4, 3)))
    assert (errors.mean[0], errors.rms[0], errors.largest[0]) == (1.25, 2.5, 5.0)


def test_an_interval_counts_start_meshes_not_pairs():
    starts, targets = np.repeat(np.arange(10), 10), np.arange(100)
    rng = np.random.default_rng(0)
    by_start = rng.standard_normal(10)[starts]
    low, high = Clusters(starts, targets).interval(by_start)
    # Ten values, each ten times: the interval is that of ten, not the root of ten narrower; targets widen it a little.
    of_ten = 2 * 1.96 * by_start.std() / np.sqrt(10)
    assert 0.8 * of_ten < high - low < 1.5 * of_ten
    assert Clusters(starts, targets).interval(np.full(100, 2.0)) == pytest.approx((2.0, 2.0))


# --- verdicts ---


def stub(end):
    """A sweep whose errors are a function of the setting; ten starts, ten targets each, with some scatter."""
    scatter = np.random.default_rng(0).uniform(0.9, 1.1, 100)

    def outcome(setting):
        mean = end(setting) * scatter
        return SimpleNamespace(end=Errors(mean, mean, mean))

    clusters = Clusters(np.repeat(np.arange(10), 10), np.arange(100))
    return SimpleNamespace(outcome=outcome, clusters=clusters, start=np.full(100, 7.3))


def as_in_the_paper(setting):
    few = 1.0 if setting.n_e == 10 else 0.0
    return 0.5 + few + (0.3 if setting.cd == 0.1 else 0.0) + 0.1 * max(5 - setting.n_a, 0)


@pytest.mark.parametrize("study", FIGURES)
def test_a_study_agrees_if_and_only_if_the_errors_do(study):
    agreement = FIGURES[study].agreement
    assert agreement(stub(as_in_the_paper), METHODS[0]).agrees
    turned = agreement(stub(lambda setting: 2.0 - as_in_the_paper(setting)), METHODS[0])
    assert not turned.agrees
    assert turned.to_json()["agree"] == "no"
    assert "not: " in turned.why


@pytest.mark.parametrize(
    ("study", "statement", "end"),
    [
        ("fig6", "C_d = 0.1 is worse", lambda s: as_in_the_paper(s) if s.cd < 0.1 else as_in_the_paper(s) - 0.3),
        ("fig6", "C_d = 0.01 and 0.001 are alike", lambda s: as_in_the_paper(s) + (0.1 if s.cd == 0.01 else 0.0)),
        ("fig6", "N_e = 50 and 100 are alike", lambda s: as_in_the_paper(s) + (0.1 if s.n_e == 50 else 0.0)),
        ("fig7", "N_a = 3 is worse than 5", lambda s: as_in_the_paper(s) - (0.2 if s.n_a == 3 else 0.0)),
        ("fig7", "N_a = 8 gains nothing", lambda s: as_in_the_paper(s) - (0.1 if s.n_a == 8 else 0.0)),
    ],
)
def test_each_statement_can_fail_alone(study, statement, end):
    for claims in FIGURES[study].agreement(stub(end), METHODS[0]).readings.values():
        wrong = [claim.text for claim in claims if not claim.holds]
        assert len(wrong) == 1
        assert wrong[0].startswith(statement)


@pytest.mark.parametrize("study", ["fig6", "fig7"])
def test_errors_that_hardly_differ_agree_with_no_statement_of_worse(study):
    """A prior too narrow to move leaves differences of micrometres, all of one sign."""
    hardly = FIGURES[study].agreement(stub(lambda setting: 4.3 + 1e-4 * as_in_the_paper(setting)), METHODS[0])
    assert not hardly.agrees
    for claims in hardly.readings.values():
        assert not any(claim.holds for claim in claims if "worse" in claim.text)


def test_one_reading_in_which_all_holds_is_enough():
    good, bad = Claim("a", True, "1"), Claim("b", False, "2")
    assert Agreement({"one": (good, bad), "other": (good,)}).agrees
    assert not Agreement({"one": (good, bad), "other": (bad,)}).agrees


def test_table_ii_is_told_from_other_networks(subject, cases):
    ours = graph_layers((4258, 830, 80, 7), (32, 64, 128), 26)
    assert [layer.output for layer in PAPER][-1] == (4223, 3)
    assert all(row["paper"] and row["here"] for row in layer_rows(ours))
    assert not any(row["paper"] and row["here"] for row in layer_rows(ours[:3]))

    def holds(layers, **changed):
        facts = {**subject.facts, "errors_mm": {**subject.facts["errors_mm"], **changed}}
        found = run_table2(Subject(subject.held_out, subject.model, facts, layers), cases, 0, n_samples=2)
        (claims,) = found.agreement.readings.values()
        return [claim.holds for claim in claims]

    assert holds(ours, test=0.24) == [True, False, True]
    assert holds(graph_layers((1213, 221, 28, 4), (32, 64, 128), 26), test=0.241) == [False, False, False]
    assert holds(graph_layers((4258, 830, 80, 7), (32, 64, 64), 26)) == [False, False, False]


# --- written ---


@pytest.fixture
def few(subject, monkeypatch):
    """Studies are of a small body, and of twelve pairs of its shapes."""
    monkeypatch.setattr(running, "subject_of", lambda model: subject)
    monkeypatch.setattr(running, "draw_cases", lambda *given: draw_cases(*given, n_starts=4, n_targets=3))


@pytest.mark.usefixtures("few")
def test_all_studies_are_written_with_what_the_interface_states(tmp_path):
    said = []
    content = reproduce(SIMULATED, tmp_path / "out", threads=1, progress=lambda *given: said.append(given))
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        f"{study}.{ending}" for study in SIMULATED for ending in ("md", "csv", "png", "json")
    }
    wanted = {"study", "cd_mm2", "n_e", "n_a", "n_pairs", "start_mean_mm", "end_mean_mm", "end_rms_mm", "end_max_mm"}
    for row in content["rows"]:
        assert wanted | {"coverage90", "paper_mm"} <= set(row)
    for study in SIMULATED:
        kept = json.loads((tmp_path / "out" / f"{study}.json").read_text())
        assert kept["schema"] == "tissuereg.reproduce/1"
        assert kept["rows"] == [row for row in content["rows"] if row["study"] == study]
        assert kept["agree"] == {study: content["agree"][study]}
        assert content["agree"][study]["agree"] in ("yes", "no")
        assert content["agree"][study]["why"]
        lines = (tmp_path / "out" / f"{study}.csv").read_text().splitlines()
        assert len(lines) == 1 + len(kept["rows"])
        assert (tmp_path / "out" / f"{study}.png").stat().st_size > 10_000
    assert {study for study, _, _ in said} == set(FIGURES)
    assert said[-1][1] == said[-1][2]
    assert content["seconds"]["total"] == pytest.approx(sum(v for k, v in content["seconds"].items() if k != "total"))


@pytest.mark.usefixtures("few")
def test_a_study_that_fails_leaves_nothing(tmp_path, monkeypatch):
    def fails(content):
        raise EnsembleError(content["rows"][0]["study"])

    monkeypatch.setattr(running, "picture", fails)
    with pytest.raises(EnsembleError):
        reproduce(["fig8"], tmp_path / "out", threads=1)
    assert not list(tmp_path.iterdir())


# --- the command ---


def test_the_command_knows_the_studies_of_the_package():
    assert _STUDIES == STUDIES


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fig9"], "STUDY must be one or more of table2, fig6, fig7, fig8, fig10, fig11, phantom, got fig9"),
        (["fig8", "--model", "none"], "a model folder must hold model.json"),
        (["fig8", "--seed", "-1"], "--seed"),
        ([], "STUDY"),
    ],
    ids=["study", "model", "seed", "nothing"],
)
def test_wrong_words_end_with_one_paragraph_and_no_output(words, said, tmp_path, capsys):
    code, answer, err = run_json(capsys, *words, "--out", tmp_path / "out", program=main)
    assert code == 2
    assert said in answer["message"]
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_a_model_of_another_body_is_refused_by_name(tmp_path):
    with pytest.raises(ModelError, match="recipe travels with the package"):
        shapes.held_out_of("0" * 64)
    with pytest.raises(ArgumentError, match="`studies` must name at least one"):
        reproduce([], tmp_path / "out")


@pytest.mark.usefixtures("few")
def test_the_command_says_what_holds_of_the_paper(tmp_path, capsys):
    code, out, _ = run(capsys, "fig8", "--out", tmp_path / "out", "--threads", "1", "--quiet", program=main)
    assert code == 0
    assert "fig8: 8 rows; agrees with the paper: " in out
    code, answer, _ = run_json(capsys, "table2", "--out", tmp_path / "out", "--threads", "1", "--quiet", program=main)
    assert code == 0
    assert set(answer) >= {"schema", "rows", "agree", "seed", "seconds", "threads", "machine", "versions", "layers"}
    assert (tmp_path / "out" / "fig8.md").exists()
