"""Scores predictions against the sealed answers: ``python -m rigs.score PREDICTIONS [--out PAGE]``.

Cases without a prediction are not scored. Intervals are by rig: cases of one rig are not independent.
"""

import argparse
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

from blind.compare import made
from blind.score import write_list
from blind.scored import SEEN, Scored, of_kind, read_predictions, seen
from regions.intervals import interval
from rigs.materialise import case_names, rig_of
from rigs.run import ORACLE, WITHOUT
from rigs.scored import by_rig, scored

_HEAD = ["| figure | count | share (95 %, by rig) | rigs |", "|---|---|---|---|"]
#: Effects outside the catalogue of which the right family may be stated alone.
FAMILIES = dict.fromkeys(("gradient", "stiff rod", "bands of stiffness", "stiff and soft ball"), "region")
#: Least length of an effect that is clear.
CLEAR = 12.9
#: Errors at inner targets of the believed and of the extended model, and the share by which the latter may be larger.
INNER = ("target_rms_base_mm", "target_rms_named_mm")
WORSE = 0.02
LEVELS = (8.0, 13.0, 21.0, 50.0)
TITLES = {"dev": "Development half", "sealed": "Sealed half", "third": "Third draw"}


def row(figure: str, cases: list[Scored], flag: Callable[[Scored], bool]) -> str:
    """Return a row of the table: in how many cases a flag is set."""
    flags = [flag(case) for case in cases]
    if not cases:
        return f"| {figure} | 0 of 0 | - | 0 |"
    counts = by_rig(cases, flags)
    low, high = interval(tuple(sorted(counts)))
    share = f"{100 * sum(flags) / len(flags):.0f} % ({100 * low:.0f}-{100 * high:.0f})"
    return f"| {figure} | {sum(flags)} of {len(flags)} | {share} | {len(counts)} |"


def named(case: Scored) -> bool:
    """Whether something is named."""
    return bool(case.ids)


def silently_misnamed(case: Scored) -> bool:
    """Whether something is named other than the family alone that the effect outside the catalogue is one of."""
    return any(family is None or family != FAMILIES.get(case.truth["outside"][0]) for family in case.families)


def consistent(case: Scored) -> bool:
    """Whether the answer is that nothing is wrong."""
    return case.prediction["verdict"] == "consistent"


def all_named(case: Scored) -> bool:
    """Whether every hidden cause is in some group."""
    return all(any(cause in group for group in case.groups) for cause in case.truth["cause"])


def figures(cases: list[Scored], without: list[Scored], oracle: dict[str, dict]) -> Iterator[str]:
    """Yield the rows of the table of figures.

    Parameters
    ----------
    cases : list of Scored
        Answers.
    without : list of Scored
        Those without the hidden cause in the catalogue.
    oracle : dict
        Fits of the hidden causes alone, by case.
    """
    nulls, alone = of_kind(cases, "null"), of_kind(cases, "single")
    for kind, words in (("rig", "drawn rigs"), ("box", "boxes")):
        some = [case for case in nulls if rig_of(case.case).startswith(kind)]
        yield row(f"nulls of {words}: consistent", some, consistent)
        yield row(f"nulls of {words}: false alarms", some, named)
    for code in ("ngsolve", "scikit-fem"):
        yield row(f"nulls by {code}: consistent", [c for c in nulls if c.truth["code"] == code], consistent)
    for reading in ("ball", "box", "nodes", "triangles", "imprint"):
        some = [case for case in nulls if reading in case.truth["readings"]]
        yield row(f"nulls with a pad read as {reading}: consistent", some, consistent)
    for level in LEVELS:
        some = [case for case in alone if case.truth["level"] == level]
        yield row(f"one cause, d = {level:g}: right group", some, lambda c: c.right)
        yield row(f"one cause, d = {level:g}: exact", some, lambda c: c.exact)
    yield row("one cause, any d: right group", alone, lambda c: c.right)
    if oracle:
        visible = f"where the oracle fit gains {SEEN:g} nats"
        yield row(f"one cause, {visible}: right group", seen(alone, oracle), _right)
    yield row("one cause, form of its own: right group", [c for c in alone if not all(c.truth["own_form"])], _right)
    yield row("one cause: wrong group named", alone, lambda c: c.wrong)
    outside = of_kind(cases, "outside")
    yield row("outside the catalogue: misnamed", outside, named)
    clear = [case for case in outside if case.truth["detectability"] >= CLEAR]
    yield row(f"outside the catalogue, d >= {CLEAR:g}: silently misnamed", clear, silently_misnamed)
    yield row("outside the catalogue: unexplained", outside, lambda c: c.prediction["verdict"] == "unexplained")
    pairs = of_kind(cases, "pair")
    for kind, words in (("rig", "pairs"), ("box", "pairs on boxes")):
        some = [case for case in pairs if rig_of(case.case).startswith(kind)]
        yield row(f"{words}: both named", some, all_named)
        yield row(f"{words}: one right and none wrong", some, lambda c: c.right and not c.wrong)
        yield row(f"{words}: one wrong", some, lambda c: c.wrong)
        if oracle:
            clear = [case for case in some if _each_seen(case, oracle)]
            yield row(f"{words}, {visible} with each cause: both named", clear, all_named)
    if without:
        yield row("true cause taken out of the catalogue: misnamed", without, lambda c: c.wrong)
        yield row("the same, without stating the right family alone", without, lambda c: c.silent)
    inner = [case for case in cases if _inner(case)]
    worse = f"inner targets: extended model worse by more than {100 * WORSE:g} %"
    yield row(worse, inner, lambda c: _inner(c)[1] > (1.0 + WORSE) * _inner(c)[0])
    sure = [(case, k) for case in cases for k, p in enumerate(_probabilities(case)) if p >= 0.9]
    right = {id(case): case.groups[k] & set(case.truth["group_ok"]) for case, k in sure}
    yield row("stated probability >= 0.9: right", [case for case, _ in sure], lambda c: bool(right[id(c)]))


def _inner(case: Scored) -> tuple[float, ...]:
    """Return the errors at inner targets of an answer that names something; empty where it states none."""
    held_out = case.prediction["causes"][0].get("held_out", {}) if case.ids else {}
    errors = tuple(held_out.get(key) for key in INNER)
    return () if None in errors else errors


def _each_seen(case: Scored, oracle: dict[str, dict]) -> bool:
    """Whether the fit of both hidden causes loses enough evidence without each of them."""
    found = oracle.get(case.case, {}).get("causes", [])
    return len(found) == len(case.truth["cause"]) and all(cause["log_bayes_factor"] >= SEEN for cause in found)


def _right(case: Scored) -> bool:
    return case.right


def _probabilities(case: Scored) -> list[float]:
    return [cause.get("probability", 0.0) for cause in case.prediction["causes"]] if case.ids else []


def hidden(case: Scored) -> str:
    """Return what is hidden in a case, in words."""
    if case.truth["kind"] == "null":
        return "nothing"
    return " + ".join(case.truth["cause"]) or f"outside: {case.truth['outside'][0]}"


def each(cases: list[Scored]) -> list[str]:
    """Return a row for every case."""
    lines = [
        "| case | body, solver | hidden | d | d of markers | verdict | named (P) |",
        "|---|---|---|---|---|---|---|",
    ]
    for case in sorted(cases, key=lambda c: (rig_of(c.case), c.truth["kind"], c.case)):
        truth = case.truth
        stated = ", ".join(f"{i} ({p:.2f})" for i, p in zip(case.ids, _probabilities(case), strict=True))
        size = f"{truth['detectability']:.0f} | {truth['of_markers']:.1f}" if truth["detectability"] else " | "
        lines.append(
            f"| {case.case} | {truth['body']}, {truth['code']} | {hidden(case)} | {size} "
            f"| {case.prediction['verdict']} | {stated} |"
        )
    return lines


def answers_by_cause(cases: list[Scored]) -> list[str]:
    """Return how often each answer was given, by the single hidden cause."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for case in cases:
        if case.truth["kind"] != "pair":
            table[hidden(case)]["+".join(case.ids) or case.prediction["verdict"]] += 1
    lines = ["| hidden | answers |", "|---|---|"]
    for cause, counts in sorted(table.items()):
        lines.append(f"| {cause} | " + ", ".join(f"{what} {n}" for what, n in counts.most_common()) + " |")
    return lines


def report(cases: list[Scored], without: list[Scored], oracle: dict[str, dict], half: str) -> str:
    """Return the section of a half in Markdown; `cases`, `without`, `oracle`: of `figures`."""
    lines = [
        f"## {TITLES[half]}",
        "",
        f"{len(cases)} of {len(case_names(half))} cases, on {len({rig_of(c.case) for c in cases})} rigs. "
        f"Verdicts: {made(cases)}."
        + (f" Oracle fits: {made(scored(oracle))}." if oracle else "")
        + (f" Causes taken out: {made(without)}." if without else ""),
        "",
        *_HEAD,
        *figures(cases, without, oracle),
        "",
        *answers_by_cause(cases),
        "",
        *each(cases),
    ]
    return "\n".join(lines) + "\n"


def predictions_of(folder: Path, half: str) -> dict[str, dict]:
    """Return the predictions of a half that are in a folder, by case."""
    mine = set(case_names(half))
    return {case: answer for case, answer in read_predictions(folder, "*.json").items() if case in mine}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rigs.score", description=__doc__)
    parser.add_argument("predictions", type=Path)
    parser.add_argument("--half", choices=tuple(TITLES), default="dev")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--list", type=Path, help="write CASE ID,ID of cases with hidden causes, and stop")
    parser.add_argument("--kinds", nargs="+", default=["single", "pair"], help="kinds of cases in that list")
    options = parser.parse_args()
    folders = (options.predictions, *(options.predictions / method for method in (WITHOUT, ORACLE)))
    answers, without, oracle = (predictions_of(folder, options.half) for folder in folders)
    if options.list:
        write_list(options.list, of_kind(scored(answers), *options.kinds))
        return
    text = report(scored(answers), scored(without), oracle, options.half)
    if options.out:
        options.out.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
