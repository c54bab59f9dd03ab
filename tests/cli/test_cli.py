"""The command line: exit codes, JSON, files, and what stands on which stream."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import tissuereg as tr
from support.files import EXPERIMENT, GOOD_MARKERS, MARKERS_HEADER, run, run_json, write_experiment, write_problem
from support.meshes import block
from support.small_model import SMALL_MODEL
from tissuereg.cli import build_parser, solve
from tissuereg.cli.progress import progress_bar
from tissuereg.io.cases import read_histories
from tissuereg.io.experiment_keys import FORCES_CSV
from tissuereg.io.meshes import write_vtu
from tissuereg.io.problems import read_problem, read_simulation
from tissuereg.io.tables import write_markers
from tissuereg.phantom.event import make_event

COMMANDS = ("mesh", "solve", "simulate", "train", "calibrate", "register", "warp", "track", "demo", "bench")
ENVELOPE = {"schema", "seconds", "threads", "machine", "versions"}


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """Keep priors out of the user's cache; they are shared within the run."""
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def problem(tmp_path):
    return write_problem(tmp_path / "problem.npz")


@pytest.fixture
def inputs(tmp_path):
    """A mesh, three markers of which one was not seen, and one target, as files."""
    write_vtu(tmp_path / "mesh.vtu", block())
    (tmp_path / "markers.csv").write_text(GOOD_MARKERS)
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\ndeep,15,10,20\n")
    return tmp_path


def process(*words, **settings):
    command = [sys.executable, "-m", "tissuereg", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **settings)


# --- words ---


@pytest.mark.parametrize("command", COMMANDS)
def test_help_says_purpose_units_defaults_and_an_example(command, capsys):
    code, out, err = run(capsys, command, "--help")
    assert code == 0
    assert err == ""
    assert f"usage: tissuereg {command}" in out
    assert "example:\n  tissuereg " in out
    assert "--json FILE" in out
    assert "default" in out
    assert max(map(len, out.splitlines())) <= 100


def test_every_example_in_the_help_is_a_command_line():
    parser = build_parser()
    for command in COMMANDS:
        text = next(a for a in parser._actions if a.dest == "command").choices[command].epilog
        for line in text.splitlines()[1:]:
            assert parser.parse_args(line.split()[1:]).command == command


def test_help_is_quick_to_import():
    heavy = (
        "torch",
        "onnxruntime",
        "scipy",
        "trimesh",
        "matplotlib",
        "tqdm",
        "pytetwild",
        "pyvista",
        "h5py",
        "fsspec",
    )
    ask = f"print([m for m in {heavy!r} if m in sys.modules])"
    code = f"import sys\nfrom tissuereg.cli import main\nmain(['--help'])\n{ask}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_module_runs_as_a_command():
    done = process("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"tissuereg {tr.__version__}\n", "")


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["sove"],
        ["solve"],
        ["solve", "a.npz"],
        ["solve", "a.npz", "--out", "b.npz", "--tol", "0"],
        ["solve", "a.npz", "--out", "b.npz", "--tol", "nan"],
        ["solve", "a.npz", "--out", "b.npz", "--element", "hex8"],
        ["solve", "a.npz", "--out", "b.npz", "--threads", "-1"],
        ["solve", "a.npz", "--out", "b.npz", "--thread", "1"],
        ["register", "a.vtu", "--out", "b"],
        ["register", "a.vtu", "b.csv", "c.csv", "--out", "b"],
        ["register", "a.vtu", "b.csv", "--out", "b", "--time", "3"],
        ["register", "a.vtu", "b.csv", "--out", "b", "--seed", "1.5"],
        ["track", "a.vtu", "b.csv", "--out", "c"],
        ["track", "a.vtu", "b.csv", "--reference", "c.csv", "--out", "d", "--live", "twice"],
        ["bench", "everything"],
        ["mesh", "a.stl", "--out", "b.vtu"],
        ["mesh", "a.stl", "--size", "-1", "--out", "b.vtu"],
        ["mesh", "a.stl", "--size", "5", "--out", "b.stl"],
        ["mesh", "a.stl", "--size", "5", "--out", "b.vtu", "--unit", "inch"],
        ["mesh", "a.stl", "--size", "5", "--out", "b.vtu", "--set", "lid"],
    ],
    ids=" ".join,
)
def test_bad_usage_exits_with_two_and_writes_the_error(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *words, *(["--json", "e.json"] if words else []))
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert "Traceback" not in err
    if words:
        said = json.loads((tmp_path / "e.json").read_text())
        assert (said["schema"], said["error"]) == ("tissuereg.error/1", "UsageError")
        assert [file.name for file in tmp_path.iterdir()] == ["e.json"]


def test_markers_may_stand_behind_the_options(inputs, capsys):
    code, said, _ = run_json(capsys, "register", inputs / "gone.vtu", "--out", inputs / "out", inputs / "markers.csv")
    assert (code, said["where"]) == (2, str(inputs / "gone.vtu"))


# --- how a command ends ---


def test_an_interrupt_exits_with_130(problem, tmp_path, capsys, monkeypatch):
    def interrupted(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(solve, "run", interrupted)
    code, said, err = run_json(capsys, "solve", problem, "--out", tmp_path / "u.npz")
    assert (code, said["error"], err) == (130, "KeyboardInterrupt", "interrupted\n")


def test_a_bug_exits_with_one_and_shows_its_traceback(problem, tmp_path, capsys, monkeypatch):
    def buggy(args):
        return 1 / 0

    monkeypatch.setattr(solve, "run", buggy)
    code, said, err = run_json(capsys, "solve", problem, "--out", tmp_path / "u.npz")
    assert (code, said["error"]) == (1, "ZeroDivisionError")
    assert "Traceback" in err
    assert "this is a bug in tissuereg" in err


def test_too_little_memory_exits_with_three(problem, tmp_path, capsys, monkeypatch):
    def too_large(args):
        raise MemoryError

    monkeypatch.setattr(solve, "run", too_large)
    code, said, _ = run_json(capsys, "solve", problem, "--out", tmp_path / "u.npz")
    assert (code, said["error"]) == (3, "MemoryError")


def test_debug_shows_the_traceback_of_bad_input(tmp_path, capsys):
    code, _, err = run(capsys, "solve", tmp_path / "gone.npz", "--out", tmp_path / "u.npz", "--debug")
    assert code == 2
    assert "Traceback" in err
    assert err.rstrip().splitlines()[-1].startswith("error: ") or "error: no such file" in err


def test_json_that_cannot_be_written_is_told_before_the_work(problem, tmp_path, capsys):
    code, _, err = run(capsys, "solve", problem, "--out", tmp_path / "u.npz", "--json", tmp_path)
    assert code == 2
    assert "must not be a folder" in err
    assert not (tmp_path / "u.npz").exists()


def test_an_output_never_replaces_an_input(problem, inputs, capsys):
    before = problem.read_bytes()
    code, said, _ = run_json(capsys, "solve", problem, "--out", problem)
    assert (code, said["error"]) == (2, "UsageError")
    assert problem.read_bytes() == before
    rig = write_experiment(inputs / "rig")
    for words in (
        ["simulate", rig, "--out", rig],
        ["register", rig, "--case", "lean", "--time", "11", "--out", rig],
        ["register", inputs / "mesh.vtu", inputs / "markers.csv", "--targets", inputs / "targets.csv", "--out", inputs],
    ):
        code, said, _ = run_json(capsys, *words)
        assert (code, said["error"]) == (2, "UsageError")
        assert "must not replace an input" in said["message"]


def test_ctrl_c_stops_a_long_run_within_seconds_and_leaves_nothing(tmp_path):
    # A run in the background of a shell starts with the interrupt ignored.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        # A package that is just being imported may swallow an interrupt, or Python ends by it.
        "import tissuereg.cli.benchmark.stages; from tissuereg.cli import main\n"
        "print('begun', flush=True); sys.exit(main(sys.argv[1:]))"
    )
    words = ["bench", "ensemble", "--members", "4000", "--element", "tet10", "--json", str(tmp_path / "b.json")]
    with subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        try:
            assert running.stdout.readline() == "begun\n"
            time.sleep(4.0)
            assert running.poll() is None
            running.send_signal(signal.SIGINT)
            _, err = running.communicate(timeout=60)
        finally:
            running.kill()
    assert running.returncode == 130
    assert "Traceback" not in err
    assert "interrupted" in err
    assert json.loads((tmp_path / "b.json").read_text())["schema"] == "tissuereg.error/1"


# --- solve ---


def test_solve_writes_a_field_and_tells_its_work(problem, tmp_path, capsys):
    code, said, err = run_json(capsys, "solve", problem, "--out", tmp_path / "u.npz")
    assert (code, err) == (0, "")
    assert said["schema"] == "tissuereg.solve/1"
    assert set(said) >= ENVELOPE
    assert said["converged"] is True
    assert said["load_fraction"] == 1.0
    assert said["residual"] <= 1e-9
    assert 0 < said["min_det_f"] <= 1.0
    for counter in ("iterations", "solves", "factorisations", "load_steps"):
        assert said[counter] >= 1
    assert said["peak_mib"] > 10
    seconds = said["seconds"]
    assert set(seconds) == {"read", "analyse", "factor", "iterate", "write", "total"}
    assert sum(seconds.values()) - seconds["total"] == pytest.approx(seconds["total"], rel=0.05)
    expected = read_problem(problem)
    found = tr.simulate(expected.mesh, expected.load, expected.material)
    assert np.array_equal(read_simulation(tmp_path / "u.npz"), found.displacement)
    assert said["largest_mm"] == np.linalg.norm(found.displacement, axis=1).max()


def test_solve_gives_the_same_bits_at_any_thread_count(problem, tmp_path, capsys):
    for element in ("tet4", "tet10"):
        fields = []
        for threads in (1, 2, 3):
            words = ["solve", problem, "--out", tmp_path / "u.npz", "--threads", threads, "--element", element]
            code, said, _ = run_json(capsys, *words)
            assert (code, said["threads"]) == (0, threads)
            fields.append((tmp_path / "u.npz").read_bytes())
        assert fields[0] == fields[1] == fields[2]


def test_without_json_solve_prints_a_summary(problem, tmp_path, capsys):
    code, out, err = run(capsys, "solve", problem, "--out", tmp_path / "u.npz")
    assert (code, err) == (0, "")
    assert "largest displacement" in out
    assert f"written: {tmp_path / 'u.npz'}" in out


def test_json_to_a_file_leaves_the_summary_on_standard_output(problem, tmp_path, capsys):
    code, out, _ = run(capsys, "solve", problem, "--out", tmp_path / "u.npz", "--json", tmp_path / "solve.json")
    assert code == 0
    assert "largest displacement" in out
    assert json.loads((tmp_path / "solve.json").read_text())["converged"] is True


def test_solve_agrees_with_a_reference(shared_data, tmp_path, capsys):
    code, said, _ = run_json(
        capsys, "solve", shared_data / "reference" / "dome_4k_push.npz", "--out", tmp_path / "u.npz"
    )
    assert code == 0
    assert said["largest_difference_mm"] < 1e-6 * said["largest_mm"]


# --- simulate ---


def test_simulate_writes_an_experiment_in_its_own_format(tmp_path, capsys):
    rig = write_experiment(tmp_path / "rig")
    code, said, err = run_json(capsys, "simulate", rig, "--out", tmp_path / "sim", "--quiet")
    assert (code, err) == (0, "")
    assert said["schema"] == "tissuereg.simulate/1"
    assert set(said) >= ENVELOPE | {"seed"}
    assert (said["members"], said["failed"]) == (5, [])
    assert said["members_per_s"] > 0
    assert said["cases"] == {"rest": 2, "lean": 3}
    assert (said["model"], said["element"]) == ("fine", "tet10")
    files = ["actuators.csv", "case_lean.npz", "case_rest.npz", "experiment.toml", "forces.csv", "markers.csv"]
    assert sorted(file.name for file in (tmp_path / "sim").iterdir()) == [*files, "targets.csv"]
    pushed = read_histories(tmp_path / "sim" / "forces.csv", FORCES_CSV, ["push"])["lean"]["push"]
    assert pushed.values[0] == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert pushed.values[2][0] > 1.5 * pushed.values[1][0] > 0
    with np.load(tmp_path / "sim" / "case_lean.npz") as kept:
        assert kept["displacement_mm"].shape == (3, 120, 3)
        patch = tr.read_experiment(rig).mesh.node_set("push")
        assert np.allclose(kept["displacement_mm"][2, patch], [2.0, 0.0, 0.0])


def test_what_was_simulated_is_an_experiment_that_says_with_which_model(tmp_path, capsys):
    rig = write_experiment(tmp_path / "rig")
    given = tr.read_experiment(rig)
    for words, expected in (([], ("fine", "tet10")), (["--plain", "--element", "tet10"], ("plain", "tet10"))):
        code, _, _ = run_json(capsys, "simulate", rig, *words, "--out", tmp_path / "sim", "--quiet")
        made = tr.read_experiment(tmp_path / "sim")
        assert code == 0
        assert (made.simulated.model, made.simulated.element) == expected
        assert made.mesh.digest() == given.mesh.digest()
        for name, case in given.cases.items():
            np.testing.assert_allclose(made.cases[name].times, case.times)
            for pad, motion in case.displacements.items():
                np.testing.assert_allclose(made.cases[name].displacements[pad], motion)
        answers = tr.simulate_experiment(given, model=expected[0], element="tet10")
        np.testing.assert_allclose(made.cases["lean"].markers, answers["lean"].markers, atol=1e-5)
    code, said, _ = run_json(capsys, "simulate", rig, "--element", "tet10", "--out", tmp_path / "sim", "--quiet")
    assert code != 0
    assert "--plain" in said["message"]


def test_simulated_noise_is_the_stated_one_by_seed(tmp_path, capsys):
    rig = write_experiment(tmp_path / "rig")
    given = tr.read_experiment(rig)
    seen = []
    for number, words in enumerate((["--noise"], ["--noise"], ["--noise", "--seed", "3"], [])):
        out = tmp_path / f"sim{number}"
        run_json(capsys, "simulate", rig, "--plain", *words, "--out", out, "--quiet")
        seen.append(np.concatenate([case.markers.ravel() for case in tr.read_experiment(out).cases.values()]))
    noisy, again, other, clean = seen
    np.testing.assert_array_equal(noisy, again)
    assert np.std(noisy - clean) == pytest.approx(given.marker_std, rel=0.5)
    assert np.std(noisy - other) == pytest.approx(np.sqrt(2.0) * given.marker_std, rel=0.5)


def test_an_unknown_model_of_a_simulation_is_refused(tmp_path, capsys):
    rig = write_experiment(tmp_path / "rig")
    file = rig / "experiment.toml"
    file.write_text(file.read_text() + '\n[simulated]\nmodel = "finest"\nelement = "tet4"\n')
    with pytest.raises(tr.errors.ExperimentError, match="finest"):
        tr.read_experiment(rig)
    with pytest.raises(tr.errors.ExperimentError, match="'fine' or 'plain'"):
        tr.simulate_experiment(tr.read_experiment(write_experiment(tmp_path / "other")), model="finest")


def test_simulate_makes_a_data_set_and_finishes_one_that_was_begun(tmp_path, capsys):
    write_vtu(tmp_path / "mesh.vtu", block())
    (tmp_path / "recipe.toml").write_text('[mesh]\nfile = "mesh.vtu"\n[data]\nmembers = 12\nchunk = 6\n')
    words = ["simulate", tmp_path / "recipe.toml", "--out", tmp_path / "data", "--quiet"]
    code, said, _ = run_json(capsys, *words)
    assert code == 0
    assert said["members"] + len(said["failed"]) == 12
    assert said["members_per_s"] > 0
    assert said["motion"]["largest_mm"]["largest"] > said["motion"]["mean_node_mm"]["mean"] > 0
    assert len(tr.open_dataset(tmp_path / "data")) == said["members"]
    first = (tmp_path / "data" / "chunk_0001.h5").read_bytes()
    (tmp_path / "data" / "chunk_0001.h5").unlink()
    code, again, _ = run_json(capsys, *words)
    assert (code, again["members"]) == (0, said["members"])
    assert (tmp_path / "data" / "chunk_0001.h5").read_bytes() == first


def test_a_data_set_may_be_written_to_a_url(tmp_path, capsys):
    write_vtu(tmp_path / "mesh.vtu", block())
    (tmp_path / "recipe.toml").write_text(
        '[mesh]\nfile = "mesh.vtu"\n[data]\nmembers = 4\nchunk = 2\n[pairs]\nmembers = 0\n'
    )
    words = ["simulate", tmp_path / "recipe.toml", "--quiet", "--out"]
    assert run_json(capsys, *words, "memory://cli/data")[0] == 0
    assert len(tr.open_dataset("memory://cli/data")) == 4
    code, said, _ = run_json(capsys, *words, "nosuch://cli/data")
    assert (code, said["error"]) == (2, "ArgumentError")
    (tmp_path / "file").write_text("a")
    code, said, _ = run_json(capsys, *words, tmp_path / "file")
    assert (code, said["error"]) == (2, "OutputError")


def test_a_data_set_says_its_size_before_it_is_made_and_its_motion_after(tmp_path):
    write_vtu(tmp_path / "mesh.vtu", block())
    (tmp_path / "recipe.toml").write_text(
        '[mesh]\nfile = "mesh.vtu"\n[data]\nmembers = 12\nchunk = 6\n[pairs]\nmembers = 0\n'
    )
    words = ["simulate", str(tmp_path / "recipe.toml"), "--out", str(tmp_path / "data")]
    first, again = process(*words), process(*words)
    assert "12 simulations on 120 nodes, about 0.0 MB in 2 files\n" in first.stderr
    assert "in 2 files, 2 of which are there" in again.stderr
    assert "a mean node moves" in first.stdout


def test_progress_in_a_log_is_lines_with_the_time_left(monkeypatch, capsys):
    now = [100.0]
    monkeypatch.setattr("tissuereg.cli.progress.time.monotonic", lambda: now[0])
    with progress_bar("simulations", quiet=False) as report:
        report(40, 100)  # there before
        for done in range(41, 101):
            now[0] += 1.0
            report(done, 100)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "simulations: 45 of 100, about 55 s left"
    assert 5 <= len(lines) <= 12
    assert all(line.endswith(" s left") for line in lines)
    with progress_bar("frames", quiet=False) as report:
        now[0] += 60.0  # a mesh is made first: that is not what a frame takes
        report(1, 12)
        now[0] += 10.0
        report(2, 12)
        now[0] += 10.0
        report(3, 12)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["frames: 1 of 12", "frames: 2 of 12, about 2 min left", "frames: 3 of 12, about 90 s left"]


# --- register ---


def test_register_takes_members_and_steps_and_no_longer_an_update(tmp_path, capsys):
    body = tr.phantom.phantom_mesh("small")
    write_vtu(tmp_path / "mesh.vtu", body)
    places = body.nodes[body.surface_nodes[::60]]
    rows = [f"P{i},{x},{y},{z},{x + 0.02 * z},{y},{z}\n" for i, (x, y, z) in enumerate(places.tolist())]
    (tmp_path / "markers.csv").write_text(MARKERS_HEADER + "".join(rows))
    words = ["register", tmp_path / "mesh.vtu", tmp_path / "markers.csv", "--model", SMALL_MODEL]
    fits = []
    for number, options in enumerate((["--members", 40], ["--members", 30], ["--members", 40, "--steps", 1])):
        code, said, _ = run_json(capsys, *words, *options, "--out", tmp_path / str(number))
        assert code in (0, 4)
        fits.append(said["markers"]["after_rms_mm"])
    assert len(set(fits)) == 3
    for gone in (["--update", "esmda"], ["--polish"]):
        assert run(capsys, *words, *gone, "--out", tmp_path / "gone")[0] == 2


def test_register_takes_variants_of_the_simulation(tmp_path, capsys):
    event = make_event(seed=0)
    write_vtu(tmp_path / "mesh.vtu", event.mesh)
    write_markers(tmp_path / "markers.csv", event.markers)
    height = event.mesh.nodes[:, 2:] / event.mesh.extent
    about = np.array([[1.0, 0.2, -2.0], [2.0, 0.1, -1.0], [1.5, -0.4, -1.5], [0.5, 0.3, -1.2], [1.2, 0.0, -0.8]])
    fields = height * about[:, None] + height**2 * about[::-1, None]
    np.savez(tmp_path / "variants.npz", displacement_mm=fields)
    words = ["register", tmp_path / "mesh.vtu", tmp_path / "markers.csv", "--model", "phantom"]
    code, said, _ = run_json(capsys, *words, "--variants", tmp_path / "variants.npz", "--out", tmp_path / "out")
    assert code in (0, 4)
    expected = tr.register(event.mesh, event.markers, model="phantom", simulation=tr.SimulationVariants(fields))
    assert said["markers"]["after_rms_mm"] == pytest.approx(expected.markers.after_rms_mm, rel=1e-4)
    assert (said["fallback"] is None) is said["trust"]["ok"]
    code, said, _ = run_json(capsys, *words[:3], "--variants", tmp_path / "variants.npz", "--out", tmp_path / "other")
    assert code == 2
    assert "a registration with a trained model" in json.dumps(said)


def test_register_writes_its_files_and_tells_all(inputs, capsys):
    out = inputs / "deep" / "out"
    words = ["register", inputs / "mesh.vtu", inputs / "markers.csv", "--targets", inputs / "targets.csv", "--out", out]
    code, said, err = run_json(capsys, *words)
    assert code == 0
    assert "Traceback" not in err
    assert set(said) >= ENVELOPE | {"seed", "markers", "targets", "body", "trust", "model"}
    assert said["schema"] == "tissuereg.registration/1"
    assert said["markers"]["used"] == ["P1", "P2"]
    assert said["markers"]["dropped"] == [{"marker": "P3", "reason": "not seen"}]
    assert said["markers"]["after_rms_mm"] < said["markers"]["before_rms_mm"] == pytest.approx(1.0)
    assert set(said["targets"]["deep"]) >= {"reference_mm", "mean_mm", "covariance_mm2", "region90_radii_mm"}
    assert said["seconds"]["total"] >= max(spent for name, spent in said["seconds"].items() if name != "total")
    names = {"registered.vtu", "field.npz", "targets.csv", "targets.mrk.json", "registration.json", "registered.png"}
    names |= {"report.html"}
    assert {file.name for file in out.iterdir()} == names
    saved = json.loads((out / "registration.json").read_text())
    for key in ("markers", "targets", "body", "trust", "model", "machine", "threads", "seed"):
        assert saved[key] == said[key]
    assert saved["versions"].items() <= said["versions"].items()  # matplotlib comes last
    assert (out / "registered.png").read_bytes()[:4] == b"\x89PNG"


def test_the_picture_is_drawn_once_and_not_at_all_without_one(inputs, capsys, monkeypatch):
    drawn, plot = [], tr.Registration.plot
    monkeypatch.setattr(tr.Registration, "plot", lambda self: drawn.append(self) or plot(self))
    words = ["register", inputs / "mesh.vtu", inputs / "markers.csv", "--quiet", "--out"]
    assert run(capsys, *words, inputs / "plain", "--no-picture")[0] == 0
    assert drawn == []
    assert not (inputs / "plain" / "registered.png").exists()
    assert "<img" not in (inputs / "plain" / "report.html").read_text(encoding="utf-8")
    code, said, _ = run(capsys, *words, inputs / "drawn")
    assert (code, len(drawn)) == (0, 1)
    assert "det F" not in said
    assert "attach" not in said
    assert "det F" in run(capsys, *words, inputs / "plain", "--no-picture", "--verbose")[1]


def test_an_image_lies_under_the_sections(inputs, capsys):
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.Image([16, 16, 16], sitk.sitkInt16)
    image.SetOrigin([-10.0, -10.0, -10.0])
    image.SetSpacing([5.0, 5.0, 5.0])
    sitk.WriteImage(image + 40, str(inputs / "ct.nrrd"))
    words = ["register", inputs / "mesh.vtu", inputs / "markers.csv", "--targets", inputs / "targets.csv", "--quiet"]
    assert run(capsys, *words, "--image", inputs / "ct.nrrd", "--out", inputs / "shown")[0] == 0
    page = (inputs / "shown" / "report.html").read_text(encoding="utf-8")
    assert page.count("<image href='data:image/png;base64,") == 6
    made = json.loads((inputs / "shown" / "registration.json").read_text(encoding="utf-8"))["provenance"]
    assert "--image" not in made["command"]
    code, _, err = run(capsys, *words, "--image", inputs / "none.nrrd", "--out", inputs / "lost")
    assert (code, "none.nrrd" in err) == (2, True)
    assert not (inputs / "lost").exists()


def test_register_takes_a_frame_of_an_experiment(tmp_path, capsys):
    rig = write_experiment(tmp_path / "rig")
    words = ["register", rig, "--case", "lean", "--time", 11.1, "--out", tmp_path / "out"]
    code, said, _ = run_json(capsys, *words, "--quiet")
    assert code == 0
    assert said["markers"]["used"] == ["P1", "P2"]
    assert list(said["targets"]) == ["deep"]
    assert said["targets"]["deep"]["simulation_mm"] is not None


def test_a_warning_is_one_line_on_standard_error_and_stands_in_the_json(tmp_path, capsys):
    toml = EXPERIMENT.replace("reference = [15.0, 10.0, 20.0]", "reference = [15.0, 10.0, -2.0]")
    rig = write_experiment(tmp_path / "rig", toml=toml)
    code, said, err = run_json(capsys, "simulate", rig, "--out", tmp_path / "sim", "--quiet")
    assert code == 0
    assert err.startswith("warning: target 'deep' lies 2.1 mm outside the mesh")
    assert ".py" not in err
    assert "UserWarning" not in err
    assert any("outside the mesh" in note for note in said["warnings"])


def test_a_mesh_that_hangs_already_is_simulated_from_its_unloaded_shape(tmp_path, capsys):
    toml = EXPERIMENT + "[gravity]\ndirection = [0, 0, -1]\nin_reference = true\n"
    rig = write_experiment(tmp_path / "rig", toml=toml)
    code, said, err = run_json(capsys, "simulate", rig, "--out", tmp_path / "sim", "--quiet")
    assert (code, said["warnings"], err) == (0, [], "")


# --- train ---


def test_train_hands_the_whole_line_to_the_training_package(tmp_path, capsys, monkeypatch):
    package = tmp_path / "tissuereg_training"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "cli.py").write_text("import json\n\n\ndef main(words):\n    print(json.dumps(words))\n    return 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("tissuereg_training", "tissuereg_training.cli"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    (tmp_path / "r.toml").write_text("")
    words = [
        "train",
        tmp_path / "r.toml",
        "--out",
        tmp_path / "m",
        "--data",
        "d",
        "--data",
        "more",
        "--fresh",
        "--seed",
        3,
        "--json",
        "-",
        "--quiet",
    ]
    code, out, _ = run(capsys, *words)
    assert code == 3
    told = [
        str(tmp_path / "r.toml"),
        "--data=d",
        "--data=more",
        f"--out={tmp_path / 'm'}",
        "--threads=0",
        "--seed=3",
        "--json=-",
        "--fresh",
        "--quiet",
    ]
    assert json.loads(out) == told
    for name in ("tissuereg_training", "tissuereg_training.cli"):
        sys.modules.pop(name)


# --- bench ---


def test_bench_tells_stages_and_counters(problem, capsys):
    code, said, _ = run_json(capsys, "bench", "solve", "esmda", "--problem", problem, "--repeats", 2)
    assert code == 0
    assert said["schema"] == "tissuereg.bench/1"
    names = [row["name"] for row in said["rows"]]
    assert names[:2] == ["solve/problem/tet4", "solve/problem/tet10"]
    assert "esmda/26x45x100/diagonal" in names
    assert "esmda/26x300x1000/dense" in names
    wanted = {
        "name",
        "n_nodes",
        "threads",
        "repeats",
        "median_s",
        "p99_s",
        "stages_s",
        "counters",
        "residual",
        "peak_mib",
    }
    for row in said["rows"]:
        assert set(row) >= wanted
        assert 0 < row["median_s"] <= row["p99_s"]
        assert set(row["counters"]) == {"iterations", "solves", "factorisations", "analyses"}
        assert sum(row["stages_s"].values()) == pytest.approx(row["median_s"], rel=0.5)
    assert said["rows"][0]["counters"]["analyses"] == 1


@pytest.mark.slow
def test_bench_times_ensembles_and_registrations(capsys):
    quick = ("--repeats", 1, "--members", 8, "--element", "tet4", "--sets", 1)
    code, said, _ = run_json(capsys, "bench", "ensemble", "register", *quick)
    assert code == 0
    assert [row["name"] for row in said["rows"]][-2:] == ["step/shipped", "step/table2"]
    assert [row["name"] for row in said["rows"]][:3] == [
        "ensemble/phantom/tet4/8",
        "register/phantom/contacts-first",
        "register/phantom/contacts",
    ]


# --- register --surface ---


def surface_file(folder, mesh, displacement=0.0):
    """Write points of a block's free surface."""
    free = mesh.surface[~np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)]
    places = (mesh.nodes + displacement)[free].mean(axis=1)
    lines = [",".join(f"{x:.4f}" for x in place) for place in places]
    (folder / "points.csv").write_text("x_mm,y_mm,z_mm\n" + "\n".join(lines) + "\n")
    return folder / "points.csv"


def test_register_takes_points_of_a_surface_without_markers(inputs, capsys):
    mesh = block()
    points = surface_file(inputs, mesh, np.stack([0.002 * mesh.nodes[:, 2] ** 2, *np.zeros((2, mesh.n_nodes))], 1))
    out = inputs / "out"
    words = ["register", inputs / "mesh.vtu", "--surface", points, "--surface-std", 0.2, "--out", out]
    code, said, err = run_json(capsys, *words)
    assert (code, "Traceback" in err) == (0, False)
    assert said["markers"]["used"] == []
    assert said["surface"]["points"] == 164
    assert said["surface"]["after_rms_mm"] < 0.5 * said["surface"]["before_rms_mm"]
    saved = json.loads((out / "registration.json").read_text())
    assert saved["surface"] == said["surface"]
    code, text, _ = run(capsys, *words)
    assert code == 0
    assert "164 surface points used, 0 outliers" in text


def test_register_takes_points_beside_markers(inputs, capsys):
    points = surface_file(inputs, block())
    words = ["register", inputs / "mesh.vtu", inputs / "markers.csv", "--surface", points, "--out", inputs / "out"]
    code, said, _ = run_json(capsys, *words)
    assert code == 4  # the points say that nothing moved, the markers that something did
    assert said["surface"]["points"] == 164


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--surface-std", 0.2, "markers.csv"], "--surface-std must come with --surface"),
        (["--surface", "targets.csv"], "must begin with the header x_mm,y_mm,z_mm"),
        ([], "one MARKERS must be given"),
    ],
)
def test_bad_words_about_a_surface_exit_with_two(inputs, capsys, words, message):
    words = [inputs / word if str(word).endswith(".csv") else word for word in words]
    code, said, _ = run_json(capsys, "register", inputs / "mesh.vtu", *words, "--out", inputs / "out")
    assert code == 2
    assert message in said["message"]


@pytest.mark.parametrize("forces", [True, False], ids=["forces stated", "no forces"])
def test_simulate_needs_nothing_measured(tmp_path, capsys, forces):
    toml = EXPERIMENT if forces else EXPERIMENT.replace("[forces]\nstd_mN = 5.0\n", "")
    rig = write_experiment(tmp_path / "rig", toml=toml, markers=None, forces=None, targets=None)
    out = tmp_path / "out"
    code, report, err = run_json(capsys, "simulate", rig, "--plain", "--out", out)
    assert code == 0, err
    assert report["cases"] == {"lean": 2}
    made = tr.read_experiment(out)
    assert np.isfinite(made.case("lean").markers).all()
    assert made.force_std == (5.0 if forces else None)
