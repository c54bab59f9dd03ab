"""Do the tables of benchmarks/README.md hold the figures of the JSON beside them?"""

import importlib.util
import json
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def test_the_solver_tables_are_those_of_the_json():
    spec = importlib.util.spec_from_file_location("solver_table", BENCHMARKS / "solver_table.py")
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    answer = json.loads((BENCHMARKS / "results" / "solver.json").read_text(encoding="utf-8"))
    text = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
    assert text.split(tables.BEGIN + "\n")[1].split(tables.END)[0] == tables.tables(answer)
    answer["many"]["ms_a_member"] += 1.0
    assert tables.tables(answer) not in text
