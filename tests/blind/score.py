"""Scores predictions against the sealed answers: ``python -m blind.score PREDICTIONS [--out docs/blind.md]``.

Answers are opened for cases whose prediction is written, and each is checked against its seal. Cases without a
prediction are not scored. Counts come with 95 % Wilson intervals.

Right group: the id or group of every finding meets the ids that the answer accepts. Wrong group: a finding that meets
none of them.
"""

import argparse
import csv
import gzip
import hashlib
import json
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from blind.materialise import DATA

#: Markers' components and forces of a case that was held out: how many numbers a chi stands for.
N_HELD_OUT = 12 * (25 * 3 + 3)

NAMED = ("named", "group")


@dataclass
class Scored:
    """A case with what is true and what was said."""

    case: str
    truth: dict
    said: dict
    ids: list = field(default_factory=list)
    groups: list = field(default_factory=list)

    def __post_init__(self) -> None:
        causes = self.said.get("causes", []) if self.said["verdict"] in NAMED else []
        self.ids = [c["id"] for c in causes]
        self.groups = [set(c.get("group", [])) | {c["id"]} for c in causes]

    @property
    def wrong(self) -> bool:
        """Whether a finding's group misses all that the answer accepts."""
        return any(not group & set(self.truth["group_ok"]) for group in self.groups)

    @property
    def right(self) -> bool:
        """Whether something is named, and nothing that the answer does not accept."""
        return bool(self.groups) and not self.wrong

    @property
    def exact(self) -> bool:
        """Whether the hidden ids, and nothing else, are named first."""
        return sorted(self.ids) == sorted(self.truth["cause"])


def wilson(hits: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Return the Wilson interval of a share.

    Source: E. B. Wilson, Journal of the American Statistical Association 22, 1927.
    """
    if n == 0:
        return 0.0, 1.0
    p = hits / n
    middle, spread = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = (middle - spread) / (1 + z * z / n), (middle + spread) / (1 + z * z / n)
    return max(0.0, float(low)), min(1.0, float(high))


def open_answers(names: set[str]) -> dict[str, dict]:
    """Return the answers of cases, each checked against its seal.

    Raises ValueError where an answer is not the sealed one.
    """
    with (DATA / "seals.csv").open(encoding="utf-8") as file:
        seals = {row["case"]: row["sha256"] for row in csv.DictReader(file)}
    told = json.loads(gzip.decompress((DATA / "answers.json.gz").read_bytes()))
    found = {}
    for name in names & set(told["answers"]):
        text = json.dumps(told["answers"][name], sort_keys=True)
        if hashlib.sha256(f"{told['salt']}/{name}/{text}".encode()).hexdigest() != seals[name]:
            message = f"the answer of {name} must be the sealed one; its hash is another"
            raise ValueError(message)
        found[name] = told["answers"][name]
    return found


def read_predictions(folder: Path) -> dict[str, dict]:
    """Return what was said, by case."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("b*.json"))}


def scored(predictions: dict[str, dict]) -> list[Scored]:
    """Return the cases that have a prediction, with their answers."""
    answers = open_answers(set(predictions))
    return [Scored(name, answers[name], predictions[name]) for name in sorted(answers)]


@dataclass
class Row:
    """One figure of the table."""

    figure: str
    hits: int
    n: int
    goal: str
    met: bool | None = None
    note: str = ""

    def text(self) -> str:
        """Return the row in Markdown."""
        low, high = wilson(self.hits, self.n)
        share = f"{100 * self.hits / self.n:.0f} % ({100 * low:.0f}-{100 * high:.0f})" if self.n else "-"
        met = "" if self.met is None or not self.n else "yes" if self.met else "no"
        return f"| {self.figure} | {self.hits} of {self.n} | {share} | {self.goal} | {met} | {self.note} |"


def rows(cases: list[Scored], oracle: dict[str, dict], without: dict[str, list[Scored]]) -> list[Row]:
    """Return all figures of the goal table.

    Parameters
    ----------
    cases : list of Scored
    oracle : dict
        Predictions of a fit that was told the cause, by case; where absent, a chi of 1 stands for it.
    without : dict
        Scored cases of a hidden id, diagnosed with that id out of the catalogue, by id.
    """
    table = [*_null_rows(cases), *_single_rows(cases), *_outside_rows(cases, without)]
    table += [*_gain_rows(cases, oracle), *_pair_rows(cases), *_probability_rows(cases), *_tied_rows(cases)]
    return table


def _count(figure, flags, goal, share, at_least=True, note="") -> Row:
    flags = list(flags)
    hits, n = sum(flags), len(flags)
    met = (hits >= share * n if at_least else hits <= share * n) if n else None
    return Row(figure, hits, n, goal, met if goal else None, note)


def _of(cases, *kinds):
    return [c for c in cases if c.truth["kind"] in kinds]


def _nulls(cases):
    return [c for c in cases if c.truth["kind"] == "null"]


def _singles(cases):
    return _of(cases, "single", "fine")


def _null_rows(cases):
    nulls = _nulls(cases)
    yield _count("false alarms on nulls", (bool(c.ids) for c in nulls), "<= 3 %", 0.03, at_least=False)
    yield _count("nulls answered consistent", (c.said["verdict"] == "consistent" for c in nulls), ">= 90 %", 0.9)
    for noise in ("white", "ar1", "common"):
        some = [c for c in nulls if c.truth["noise"] == noise]
        yield _count(f"false alarms, noise {noise}", (bool(c.ids) for c in some), "", 1.0, at_least=False)


def _single_rows(cases):
    singles = _singles(cases)
    clear = [c for c in singles if c.truth["detectability"] >= 7.8 and c.truth["separable"]]
    yield _count("singles, d >= 8, separable: right group", (c.right for c in clear), ">= 90 %", 0.9)
    yield _count("the same, exact", (c.exact for c in clear), ">= 80 %", 0.8)
    high = [c for c in clear if c.truth["detectability"] >= 20]
    yield _count("singles, d >= 21, separable: right group", (c.right for c in high), ">= 97 %", 0.97)
    eight = [c for c in singles if c.truth["level"] == 8.0]
    yield _count("singles, d = 8, separable or not: right group", (c.right for c in eight), ">= 50 %", 0.5)
    foreign = [c for c in clear if not c.truth["own_form"]]
    yield _count("form that the fit does not own: right group", (c.right for c in foreign), "", 0.0)
    yield _count("wrong group named, all singles", (c.wrong for c in singles), "<= 3 %", 0.03, at_least=False)


def _outside_rows(cases, without):
    outside = _of(cases, "outside")
    yield _count(
        "outside the catalogue: silently misnamed", (bool(c.ids) for c in outside), "<= 10 %", 0.1, at_least=False
    )
    high = [c for c in outside if c.truth["detectability"] >= 12.8]
    yield _count("outside, d >= 13: unexplained", (c.said["verdict"] == "unexplained" for c in high), ">= 80 %", 0.8)
    removed = [c for some in without.values() for c in some]
    yield _count(
        "a cause taken out: silently misnamed",
        (c.wrong for c in removed),
        "<= 10 %",
        0.1,
        at_least=False,
        note=f"{len(without)} causes",
    )
    high = [c for c in removed if c.truth["detectability"] >= 12.8]
    yield _count(
        "a cause taken out, d >= 13: unexplained or its mate",
        (c.said["verdict"] == "unexplained" or c.right for c in high),
        ">= 80 %",
        0.8,
    )


def _held_out(case):
    """Return the held-out figures of the last finding, which carries what all findings together reach."""
    causes = case.said.get("causes", [])
    return causes[-1].get("held_out", {}) if causes and case.ids else {}


def gains(cases: list[Scored], oracle: dict[str, dict]) -> tuple[list[float], int]:
    """Return (base - named) / (base - oracle) in chi, and how many cases had too little to gain."""
    found, small = [], 0
    for case in cases:
        figures = _held_out(case)
        if "chi_base" not in figures or "chi_named" not in figures:
            continue
        told = oracle.get(case.case, {}).get("causes", [])
        best = told[-1].get("held_out", {}).get("chi_named", 1.0) if told else 1.0
        base = figures["chi_base"]
        if N_HELD_OUT * (base**2 - best**2) < 9.0:
            small += 1
            continue
        found.append((base - figures["chi_named"]) / (base - best))
    return found, small


def _gain_rows(cases, oracle):
    known = _of(cases, "single", "fine", "pair", "tied")
    found, small = gains([c for c in known if c.right], oracle)
    note = f"median {np.median(found):.2f}, 10th percentile {np.quantile(found, 0.1):.2f}; " if found else ""
    note += f"{small} with too little to gain; oracle: {'its own fit' if oracle else 'chi = 1'}"
    row = _count("held-out gain of at least 0.95", (g >= 0.95 for g in found), "median >= 0.95", 0.5, note=note)
    yield row
    some = [_held_out(c) for c in known]
    pairs = [(f["chi_base"], f["chi_named"]) for f in some if "chi_base" in f and "chi_named" in f]
    yield _count("more than 2 % worse than base", (n > 1.02 * b for b, n in pairs), "none", 0.0, at_least=False)
    right = [_held_out(c) for c in known if c.right]
    pairs = [(f["chi_named"], f["chi_generic"]) for f in right if "chi_generic" in f and "chi_named" in f]
    yield _count("named cause beats the generic patch", (n < g for n, g in pairs), ">= 90 %", 0.9)


def _pair_rows(cases):
    together = _of(cases, "pair")
    for name, size, share in (("pairs", 2, 0.7), ("triples", 3, 0.4)):
        some = [c for c in together if len(c.truth["cause"]) == size]
        yield _count(f"{name}: all named", (_all_named(c) for c in some), f">= {100 * share:.0f} %", share)
        yield _count(f"{name}: one right and none wrong", (c.right and not c.wrong for c in some), ">= 93 %", 0.93)


def _all_named(case):
    return all(any(cause in group for group in case.groups) for cause in case.truth["cause"])


def _probability_rows(cases):
    sure = [
        (c, k)
        for c in cases
        for k, cause in enumerate(c.said.get("causes", []))
        if c.ids and cause.get("probability", 0.0) >= 0.9
    ]
    flags = (bool(c.groups[k] & set(c.truth["group_ok"])) for c, k in sure)
    note = f"calibration error of all findings {calibration_error(cases):.3f} (goal 0.05)"
    yield _count("stated probability >= 0.9: right", flags, ">= 90 %", 0.9, note=note)


def calibration_error(cases: list[Scored], n_bins: int = 5) -> float:
    """Return the mean distance of stated probability and share that is right, over bins weighted by their findings."""
    stated = [
        (cause.get("probability", 0.0), bool(c.groups[k] & set(c.truth["group_ok"])))
        for c in cases
        if c.ids
        for k, cause in enumerate(c.said["causes"])
    ]
    bins: dict[int, list[tuple[float, bool]]] = defaultdict(list)
    for probability, right in stated:
        bins[min(int(probability * n_bins), n_bins - 1)].append((probability, right))
    gaps = [abs(sum(p for p, _ in some) - sum(r for _, r in some)) for some in bins.values()]
    return sum(gaps) / len(stated) if stated else 0.0


def _tied_rows(cases):
    tied = _of(cases, "tied")
    flags = (
        len(c.groups) == 1 and 2 <= len(c.groups[0]) <= 3 and bool(set(c.truth["cause"]) & c.groups[0]) for c in tied
    )
    yield _count("tied causes: the group named", flags, ">= 90 %", 0.9)


def confusion(cases: list[Scored]) -> dict[str, Counter]:
    """Return how often each hidden id was answered by what: ids, consistent, unexplained."""
    table: dict[str, Counter] = defaultdict(Counter)
    for case in cases:
        truth = case.truth
        if truth["kind"] == "pair":
            continue
        hidden = truth["cause"][0] if truth["cause"] else "outside" if truth["outside"] else "nothing"
        table[hidden]["+".join(case.ids) or case.said["verdict"]] += 1
    return dict(table)


def power(cases: list[Scored]) -> dict[str, dict[float, tuple[int, int]]]:
    """Return (rightly named, all) by cause and level of detectability."""
    table: dict[str, dict[float, list[int]]] = defaultdict(lambda: defaultdict(lambda: [0, 0]))
    for case in _singles(cases):
        if case.truth["level"] is None:
            continue
        cell = table[case.truth["cause"][0]][case.truth["level"]]
        cell[0] += case.right
        cell[1] += 1
    return {cause: {level: (hits, n) for level, (hits, n) in levels.items()} for cause, levels in table.items()}


def report(cases: list[Scored], oracle: dict[str, dict], without: dict[str, list[Scored]]) -> str:
    """Return all tables in Markdown."""
    lines = [
        "# Blind test bench",
        "",
        f"{len(cases)} sealed cases scored; intervals are 95 % (Wilson).",
        "",
        "| figure | count | share | goal | met | |",
        "|---|---|---|---|---|---|",
    ]
    lines += [row.text() for row in rows(cases, oracle, without)]
    table = power(cases)
    levels = sorted({level for row in table.values() for level in row})
    lines += [
        "",
        "## Power: right group by detectability",
        "",
        "| cause | " + " | ".join(f"{x:g}" for x in levels) + " |",
        "|---|" + "---|" * len(levels),
    ]
    for cause, row in sorted(table.items()):
        cells = [f"{row[x][0]}/{row[x][1]}" if x in row else "" for x in levels]
        lines.append(f"| {cause} | " + " | ".join(cells) + " |")
    every = [tuple(sum(row[x][k] for row in table.values() if x in row) for k in (0, 1)) for x in levels]
    cells = [f"{h}/{n} ({100 * wilson(h, n)[0]:.0f}-{100 * wilson(h, n)[1]:.0f} %)" for h, n in every]
    lines.append("| all | " + " | ".join(cells) + " |")
    lines += ["", "## What was answered", "", "| hidden | answered |", "|---|---|"]
    for hidden, counts in sorted(confusion(cases).items()):
        lines.append(f"| {hidden} | " + ", ".join(f"{what} {n}" for what, n in counts.most_common()) + " |")
    seconds = [c.said["seconds"] for c in cases if "seconds" in c.said]
    failed = sum(c.said["verdict"] == "failed" for c in cases)
    if seconds:
        lines += [
            "",
            f"Seconds a verdict: median {np.median(seconds):.1f}, largest {max(seconds):.1f}; {failed} failed.",
        ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Score a folder of predictions."""
    parser = argparse.ArgumentParser(prog="python -m blind.score", description=__doc__)
    parser.add_argument("predictions", type=Path, help="CASE.json; oracle/CASE.json; without/ID/CASE.json")
    parser.add_argument("--out", type=Path, help="Markdown file; standard output if absent")
    parser.add_argument("--list-oracle", type=Path, help="write CASE ID,ID of what a told fit would be given, and stop")
    parser.add_argument(
        "--list-without", type=Path, help="write ID CASE of what a fit without ID would be given, and stop"
    )
    options = parser.parse_args()
    cases = scored(read_predictions(options.predictions))
    if options.list_oracle or options.list_without:
        known = [c for c in cases if c.truth["cause"]]
        if options.list_oracle:
            lines = [f"{c.case} {','.join(c.truth['cause'])}" for c in known]
            options.list_oracle.write_text("\n".join(lines) + "\n", encoding="utf-8")
        if options.list_without:
            lines = [f"{c.truth['cause'][0]} {c.case}" for c in _singles(known) if c.truth["detectability"] >= 7.8]
            options.list_without.write_text("\n".join(sorted(lines)) + "\n", encoding="utf-8")
        return
    oracle = read_predictions(options.predictions / "oracle")
    folders = sorted(p for p in (options.predictions / "without").glob("*") if p.is_dir())
    without = {p.name: scored(read_predictions(p)) for p in folders}
    text = report(cases, oracle, without)
    if options.out:
        options.out.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
