"""Do the tables of pages hold the figures of their archives?"""

import json

import pytest

from support.scripts import REPOSITORY, script

BENCHMARKS = REPOSITORY / "benchmarks"


def loaded(name):
    """Return a script of the benchmarks as a module."""
    return script("benchmarks", name)


@pytest.mark.parametrize(
    ("name", "page"),
    [("variants", "decisions/learned-model"), ("fallback", "decisions/trust")],
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
