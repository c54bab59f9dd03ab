"""Do the tables of benchmarks/README.md hold the figures of the JSON beside them?"""

import importlib.util
import json
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def loaded(name):
    """Return a script of the benchmarks as a module."""
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("name", "archive"), [("febio", "febio"), ("simulated_here", "simulated-here")])
def test_pages_of_diagnoses_are_those_of_their_archives(name, archive):
    script = loaded(name)
    rows = json.loads((BENCHMARKS / "results" / f"{archive}.json").read_text(encoding="utf-8"))
    kept = (BENCHMARKS.parent / "docs" / f"{archive}.md").read_text(encoding="utf-8")
    assert script.page(rows) == kept
    first = next(iter(rows["rows"].values()))
    first["p_misfit"] = 0.123456
    assert script.page(rows) != kept


def test_an_answer_is_right_with_every_true_cause_and_none_beside():
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
    spec = importlib.util.spec_from_file_location("solver_table", BENCHMARKS / "solver_table.py")
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    answer = json.loads((BENCHMARKS / "results" / "solver.json").read_text(encoding="utf-8"))
    text = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
    assert text.split(tables.BEGIN + "\n")[1].split(tables.END)[0] == tables.tables(answer)
    answer["many"]["ms_a_member"] += 1.0
    assert tables.tables(answer) not in text
