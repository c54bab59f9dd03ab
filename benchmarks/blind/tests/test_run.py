"""Running diagnosers over cases: each runs once, answers are whole, an interrupted run can be resumed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from blind import run
from blind.materialise import case_names

CASES = case_names()[:3]
CONSISTENT = {"verdict": "consistent", "causes": []}


def returns_its_arguments(folder, ids, *, threads):
    return CONSISTENT | {"given": [folder.name, *ids, threads], "worker": os.getpid()}


def fails(folder, ids, *, threads):
    message = "no answer"
    raise ArithmeticError(message)


def dawdles(folder, ids, *, threads):
    time.sleep(60.0)


def question(folder, case=CASES[0], diagnoser="any {folder}", ids=()):
    return run.Question(case, diagnoser, folder / f"{case}.json", ids)


def test_an_interrupted_run_resumes_and_runs_no_case_twice(tmp_path, monkeypatch):
    ran = []
    monkeypatch.setattr(run, "_run", lambda question, folder, *_: ran.append(folder.name) or dict(CONSISTENT))
    for _ in range(2):
        answer = run.diagnose(question(tmp_path / "predictions"), tmp_path)
    assert ran == [CASES[0]]
    assert answer["verdict"] == "consistent"
    assert {"seconds", "commit", "date"} <= answer.keys()
    assert json.loads((tmp_path / "predictions" / f"{CASES[0]}.json").read_text(encoding="utf-8")) == answer


def test_a_diagnoser_that_fails_is_an_answer_too(tmp_path):
    command = run.diagnose(question(tmp_path / "a", diagnoser="false {folder}"), tmp_path)
    assert command["verdict"] == "failed"
    assert "exit status 1" in command["error"]
    function = run.diagnose(question(tmp_path / "b", diagnoser="blind.tests.test_run:fails"), tmp_path)
    assert function["verdict"] == "failed"
    assert "ArithmeticError: no answer" in function["error"]


def test_a_function_that_takes_too_long_counts_as_not_answered(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "LIMIT", 0.05)
    answer = run.diagnose(question(tmp_path, diagnoser="blind.tests.test_run:dawdles"), tmp_path)
    assert answer["verdict"] == "failed"
    assert "TimeoutError" in answer["error"]


def test_a_case_killed_half_written_is_written_anew(tmp_path):
    (tmp_path / "cases" / f"{CASES[0]}.part").mkdir(parents=True)
    (tmp_path / "cases" / f"{CASES[0]}.part" / "mesh.vtu").write_text("half", encoding="utf-8")
    run.diagnose(question(tmp_path / "predictions", diagnoser="blind.tests.test_run:returns_its_arguments"), tmp_path)
    assert (tmp_path / "cases" / CASES[0] / "mesh.vtu").read_text(encoding="utf-8").endswith("</VTKFile>\n")


def test_parallel_workers_answer_all_and_keep_the_methods_of_a_case_together(tmp_path):
    questions = [
        run.Question(case, "blind.tests.test_run:returns_its_arguments", tmp_path / method / f"{case}.json", (method,))
        for case in CASES
        for method in ("a", "b")
    ]
    answers = dict(run.answer_all(questions, tmp_path, 2))
    assert set(answers) == set(questions)
    for one, answer in answers.items():
        assert answer["given"] == [one.case, *one.ids, 1]
        assert answer["worker"] != os.getpid()
    for case in CASES:
        assert len({answer["worker"] for one, answer in answers.items() if one.case == case}) == 1


def test_methods_are_selected_by_name_and_given_only_the_ids_of_their_lists(tmp_path):
    (tmp_path / "oracle.txt").write_text(f"{CASES[1]} layer,scale\n", encoding="utf-8")
    found = run.questions_of(CASES, ["oracle", "rivals"], run.OURS, tmp_path / "predictions", tmp_path)
    with_ids = [one for one in found if one.ids]
    assert [(one.case, one.ids) for one in with_ids] == [(CASES[1], ("layer", "scale"))]
    assert with_ids[0].kept == tmp_path / "predictions" / "oracle" / f"{CASES[1]}.json"
    assert len(found) == 1 + len(CASES) * sum(name.startswith("rivals/") for name in run.METHODS)
    with pytest.raises(ValueError, match="nobody"):
        run.questions_of(CASES, ["nobody"], run.OURS, tmp_path, tmp_path)


@pytest.mark.parametrize("name", [run.OURS, *run.METHODS.values()])
def test_every_method_is_there(name):
    assert callable(run.function_of(name))


def test_an_interrupted_run_leaves_nothing_half_written(tmp_path):
    cases, predictions = tmp_path / "cases.txt", tmp_path / "predictions"
    cases.write_text("\n".join(CASES), encoding="utf-8")
    words = [sys.executable, "-m", "blind.run", "--cases", cases, "--work", tmp_path, "--predictions", predictions]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), *sys.path])}
    begun = subprocess.Popen(
        [*words, "--diagnoser", "sh -c 'sleep 60' {folder}", "--jobs", "2"],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 30.0
    while len(list((tmp_path / "out").glob("*"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(begun.pid, signal.SIGINT)
    errors = begun.communicate(timeout=20.0)[1]
    assert begun.returncode == 1
    assert "resumes from there" in errors
    assert not list(predictions.glob("*"))
