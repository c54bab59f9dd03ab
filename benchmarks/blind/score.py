"""Scores predictions against the sealed answers: ``python -m blind.score PREDICTIONS [--out PAGE]``.

Cases without a prediction are not scored. Counts come with 95 % Wilson intervals. `blind.scored` opens the answers and
defines right and wrong; `blind.compare` makes the table of rivals and ablations.
"""

import argparse
import json
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from blind.compare import comparison, made, read_methods
from blind.materialise import case_names
from blind.scored import (
    SEEN,
    Scored,
    clear_singles,
    gains,
    held_out,
    of_kind,
    read_predictions,
    scored,
    seen,
    singles,
    wilson,
)
from tissuereg.diagnosis.causes import CAUSES

#: Names of the cases that were stored after the diagnoser's rules had been set, and were diagnosed once.
LATER = Path(__file__).parent / "later.txt"

_HEAD = ["| figure | count | share | goal | met | |", "|---|---|---|---|---|---|"]


@dataclass
class Row:
    """One figure of the table."""

    figure: str
    hits: int
    n: int
    goal: str
    share: float = 0.0
    at_least: bool = True
    note: str = ""

    @property
    def met(self) -> str:
        """``yes`` where the whole interval meets the goal, ``count`` where the count alone does, ``no``; "" of none."""
        if not self.goal or not self.n:
            return ""
        low, high = wilson(self.hits, self.n)
        least, most = (low, self.hits / self.n) if self.at_least else (1.0 - high, 1.0 - self.hits / self.n)
        share = self.share if self.at_least else 1.0 - self.share
        return "yes" if least >= share else "count" if most >= share else "no"

    def text(self) -> str:
        """Return the row in Markdown."""
        low, high = wilson(self.hits, self.n)
        share = f"{100 * self.hits / self.n:.0f} % ({100 * low:.0f}-{100 * high:.0f})" if self.n else "-"
        return f"| {self.figure} | {self.hits} of {self.n} | {share} | {self.goal} | {self.met} | {self.note} |"


def rows(cases: list[Scored], oracle: dict[str, dict], without: dict[str, list[Scored]]) -> list[Row]:
    """Return all figures of the goal table.

    Parameters
    ----------
    cases : list of Scored
    oracle : dict
        Predictions of the oracle fit, which is given the true causes, by case; a chi of 1 is used where absent.
    without : dict
        Scored cases of a hidden id, diagnosed with that id removed from the catalogue, by id.
    """
    table = [*_null_rows(cases), *_single_rows(cases, oracle), *_outside_rows(cases, without)]
    table += [*_gain_rows(cases, oracle), *_pair_rows(cases), *_probability_rows(cases), *_tied_rows(cases, oracle)]
    return table


def _count(figure, flags, goal, share, at_least=True, note="") -> Row:
    flags = list(flags)
    return Row(figure, sum(flags), len(flags), goal, share, at_least, note)


def _null_rows(cases):
    nulls = of_kind(cases, "null")
    yield _count("false alarms on nulls", (bool(c.ids) for c in nulls), "<= 3 %", 0.03, at_least=False)
    yield _count("nulls answered consistent", (c.prediction["verdict"] == "consistent" for c in nulls), ">= 90 %", 0.9)
    for noise in ("white", "ar1", "common"):
        some = [c for c in nulls if c.truth["noise"] == noise]
        yield _count(f"false alarms, noise {noise}", (bool(c.ids) for c in some), "", 1.0, at_least=False)


def _single_rows(cases, oracle):
    every, clear = singles(cases), clear_singles(cases)
    with_oracle = [c for c in clear if c.case in oracle]
    visible = seen(with_oracle, oracle)
    yield _count("singles, d >= 8, separable: right group", (c.right for c in clear), ">= 90 %", 0.9)
    yield _count("the same, exact", (c.exact for c in clear), ">= 80 %", 0.8)
    yield _count(
        f"right group, where the oracle fit gains {SEEN:g} nats",
        (c.right for c in visible),
        "",
        0.0,
        note=f"{len(with_oracle) - len(visible)} of {len(with_oracle)} oracle fits gain less",
    )
    high = [c for c in clear if c.truth["detectability"] >= 20]
    yield _count("singles, d >= 21, separable: right group", (c.right for c in high), ">= 97 %", 0.97)
    eight = [c for c in every if c.truth["level"] == 8.0]
    yield _count("singles, d = 8, separable or not: right group", (c.right for c in eight), ">= 50 %", 0.5)
    foreign = [c for c in clear if c.foreign]
    yield _count("form that the fit does not have: right group", (c.right for c in foreign), "", 0.0)
    yield _count("wrong group named, all singles", (c.wrong for c in every), "<= 3 %", 0.03, at_least=False)


def _outside_rows(cases, without):
    outside = of_kind(cases, "outside")
    yield _count(
        "outside the catalogue: silently misnamed", (bool(c.ids) for c in outside), "<= 10 %", 0.1, at_least=False
    )
    high = [c for c in outside if c.truth["detectability"] >= 12.8]
    yield _count(
        "outside, d >= 13: unexplained", (c.prediction["verdict"] == "unexplained" for c in high), ">= 80 %", 0.8
    )
    removed = [c for some in without.values() for c in some]
    yield _count(
        "true cause removed from the catalogue: silently misnamed",
        (c.silent for c in removed),
        "<= 10 %",
        0.1,
        at_least=False,
        note=f"{len(without)} causes",
    )
    named_together = {c.case: set().union(*c.groups) for c in cases}
    yield _count(
        "the same, where the full catalogue separates the two",
        (bool(set(c.ids) - named_together.get(c.case, set())) and c.silent for c in removed),
        "",
        1.0,
    )
    high = [c for c in removed if c.truth["detectability"] >= 12.8]
    yield _count(
        "true cause removed, d >= 13: unexplained, or a cause that the answer accepts",
        (c.prediction["verdict"] == "unexplained" or c.right for c in high),
        ">= 80 %",
        0.8,
    )


def _gain_rows(cases, oracle):
    known = of_kind(cases, "single", "fine", "pair", "tied")
    found, small = gains([c for c in known if c.right], oracle)
    note = f"median {np.median(found):.2f}, 10th percentile {np.quantile(found, 0.1):.2f}; " if found else ""
    note += f"{small} with too little to gain; oracle: {'fit given the cause' if oracle else 'chi = 1'}"
    row = _count("held-out gain of at least 0.95", (g >= 0.95 for g in found), "median >= 0.95", 0.5, note=note)
    yield row
    some = [held_out(c) for c in known]
    pairs = [(f["chi_base"], f["chi_named"]) for f in some if "chi_base" in f and "chi_named" in f]
    yield _count("more than 2 % worse than base", (n > 1.02 * b for b, n in pairs), "none", 0.0, at_least=False)
    right = [held_out(c) for c in known if c.right]
    pairs = [(f["chi_named"], f["chi_generic"]) for f in right if "chi_generic" in f and "chi_named" in f]
    yield _count("named cause beats the generic patch", (n < g for n, g in pairs), ">= 90 %", 0.9)


def _pair_rows(cases):
    together = of_kind(cases, "pair")
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
        for k, cause in enumerate(c.prediction.get("causes", []))
        if c.ids and cause.get("probability", 0.0) >= 0.9
    ]
    flags = (bool(c.groups[k] & set(c.truth["group_ok"])) for c, k in sure)
    note = f"calibration error of all findings {calibration_error(cases):.3f} (goal 0.05)"
    yield _count("stated probability >= 0.9: right", flags, ">= 90 %", 0.9, note=note)


def calibration_error(cases: list[Scored], n_bins: int = 5) -> float:
    """Return the mean difference of stated probability and share of right findings, over bins weighted by count."""
    stated = [
        (cause.get("probability", 0.0), bool(c.groups[k] & set(c.truth["group_ok"])))
        for c in cases
        if c.ids
        for k, cause in enumerate(c.prediction["causes"])
    ]
    bins: dict[int, list[tuple[float, bool]]] = defaultdict(list)
    for probability, right in stated:
        bins[min(int(probability * n_bins), n_bins - 1)].append((probability, right))
    gaps = [abs(sum(p for p, _ in some) - sum(r for _, r in some)) for some in bins.values()]
    return sum(gaps) / len(stated) if stated else 0.0


def _tied_rows(cases, oracle):
    tied = of_kind(cases, "tied")
    flags = [
        len(c.groups) == 1 and 2 <= len(c.groups[0]) <= 3 and bool(set(c.truth["cause"]) & c.groups[0]) for c in tied
    ]
    pure = sum(flag and c.groups[0] <= set(c.truth["group_ok"]) for flag, c in zip(flags, tied, strict=True))
    note = f"{pure} of these groups contain tied ids only" if tied else ""
    yield _count("tied causes: a group that contains the hidden one", flags, ">= 90 %", 0.9, note=note)
    if any(c.case in oracle for c in tied):
        visible = {c.case for c in seen(tied, oracle)}
        shown = [flag for flag, c in zip(flags, tied, strict=True) if c.case in visible]
        yield _count(f"the same, where the oracle fit gains {SEEN:g} nats", shown, "", 0.0)


def confusion(cases: list[Scored]) -> dict[str, Counter]:
    """Return the confusion counts: for every hidden id, how often each ids, consistent or unexplained was answered."""
    table: dict[str, Counter] = defaultdict(Counter)
    for case in cases:
        truth = case.truth
        if truth["kind"] == "pair":
            continue
        hidden = truth["cause"][0] if truth["cause"] else "outside" if truth["outside"] else "nothing"
        table[hidden]["+".join(case.ids) or case.prediction["verdict"]] += 1
    return dict(table)


def power(cases: list[Scored]) -> dict[str, dict[float, tuple[int, int]]]:
    """Return (number named rightly, number of cases) by cause and level of detectability."""
    table: dict[str, dict[float, list[int]]] = defaultdict(lambda: defaultdict(lambda: [0, 0]))
    for case in singles(cases):
        if case.truth["level"] is None:
            continue
        cell = table[case.truth["cause"][0]][case.truth["level"]]
        cell[0] += case.right
        cell[1] += 1
    return {cause: {level: (hits, n) for level, (hits, n) in levels.items()} for cause, levels in table.items()}


def _weak(table):
    at_eight = {cause: row[8.0] for cause, row in sorted(table.items()) if 8.0 in row}
    weak = [f"{cause} ({hits} of {n})" for cause, (hits, n) in at_eight.items() if 2 * hits < n]
    absent = sorted(set(CAUSES) - set(table))
    lines = [f"Causes of which fewer than half are named at d = 8: {', '.join(weak) or 'none'}."] if at_eight else []
    lines += [f"Causes without a case at a stated level: {', '.join(absent)}."] if absent else []
    return " ".join(lines)


def report(
    cases: list[Scored],
    oracle: dict[str, dict],
    without: dict[str, list[Scored]],
    methods: dict[str, list[Scored]],
    note: str = "",
    sizes: dict | None = None,
) -> str:
    """Return all tables in Markdown, with a note on how the predictions were made."""
    lines = [
        "# Blind test bench",
        "",
        "Simulated experiments, most with a hidden effect, made by other code than the package and diagnosed without "
        "access to the answers (how: `DATA.md`).",
        "",
        f"{len(cases)} of {len(case_names())} sealed cases scored; intervals are 95 % (Wilson). Cases are diagnosed in "
        f"the order of their names, which are random. Verdicts: {made(cases)}.",
        *(["", note.strip()] if note else []),
        "",
        "*null*: a case without an effect; *single*: with one effect of the catalogue. *d*: detectability, the length "
        "of the effect in the data in standard deviations of the noise, after modulus and frame are fitted. "
        "*Separable*: no other cause changes the data nearly alike. *Right group*: the named cause, or the group it is "
        "in, contains the hidden one. *Oracle fit*: a fit that is given the true causes. *met*: `yes` if the whole "
        "interval meets the goal, `count` if only the count does.",
        "",
        *_HEAD,
        *(row.text() for row in rows(cases, oracle, without)),
    ]
    names = set(LATER.read_text(encoding="utf-8").split())
    later = [case for case in cases if case.case in names]
    if later:
        lines += ["", "## The cases that were stored after every rule was set", "", f"{len(later)} of the above.", ""]
        lines += [*_HEAD, *(row.text() for row in rows(later, oracle, {}) if row.n)]
    table = power(cases)
    levels = sorted({level for row in table.values() for level in row})
    lines += [
        "",
        "## Power: right group by detectability",
        "",
        f"Last column: cases from d = 8 on in which the oracle fit gains {SEEN:g} nats, of those with an oracle fit.",
        "",
        "| cause | " + " | ".join(f"{x:g}" for x in levels) + " | oracle |",
        "|---|" + "---|" * (len(levels) + 1),
    ]
    fitted = [c for c in clear_singles(cases) if c.case in oracle]
    n_fitted, n_seen = (Counter(c.truth["cause"][0] for c in some) for some in (fitted, seen(fitted, oracle)))
    for cause, row in sorted(table.items()):
        cells = [f"{row[x][0]}/{row[x][1]}" if x in row else "" for x in levels]
        cells.append(f"{n_seen[cause]}/{n_fitted[cause]}" if n_fitted[cause] else "")
        lines.append(f"| {cause} | " + " | ".join(cells) + " |")
    every = [tuple(sum(row[x][k] for row in table.values() if x in row) for k in (0, 1)) for x in levels]
    cells = [f"{h}/{n} ({100 * wilson(h, n)[0]:.0f}-{100 * wilson(h, n)[1]:.0f} %)" for h, n in every]
    lines.append("| all | " + " | ".join(cells) + " | |")
    lines += ["", _weak(table)]
    lines += ["", "## Answers by hidden cause", "", "| hidden | answers |", "|---|---|"]
    for hidden, counts in sorted(confusion(cases).items()):
        lines.append(f"| {hidden} | " + ", ".join(f"{what} {n}" for what, n in counts.most_common()) + " |")
    if methods:
        lines += ["", "## Rivals and ablations on the same cases", "", *comparison(cases, methods, oracle)]
    return "\n".join(lines + sizes_table(sizes)) + "\n"


def sizes_table(sizes: dict | None, level: str = "##") -> list[str]:
    """Return the section on the nuisances' priors, from the answer of `blind.sizes`; `level`: of its heading."""
    if sizes is None:
        return []
    lines = [
        "",
        f"{level} Prior standard deviations of the nuisances",
        "",
        "Factor on the prior standard deviations in use under which the data of "
        f"{sizes['nulls']} nulls are likeliest. Below 1 the prior in use is too wide, and weak effects are lost in it.",
        "",
        "| kind | factor | within 2 nats | gain in nats |",
        "|---|---|---|---|",
    ]
    for kind, found in sorted(sizes["sizes"].items()):
        likely = f"{found['low']:.2f}-{found['high']:.2f}"
        lines.append(f"| {kind} | {found['factor']:.2f} | {likely} | {found['gain_nats']:.1f} |")
    if "forces" in sizes:
        along, across, noise = (100 * sizes["forces"][key] for key in ("along", "across", "noise"))
        lines += [
            "",
            f"With the modulus fitted, the error of the pad forces of these nulls is {along:.2f} % of the largest "
            f"force along the force and {across:.2f} % across it; noise accounts for {noise:.2f} % (rms; means of "
            "loaded frames).",
        ]
    return lines


def scores(predictions: Path, note: str = "") -> str:
    """Return the page of a folder of predictions, with a note on how they were made."""
    without = defaultdict(list)
    for case in scored(read_predictions(predictions / "without")):
        without[case.truth["cause"][0]].append(case)
    kept = predictions / "sizes.json"
    sizes = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else None
    cases, oracle = scored(read_predictions(predictions)), read_predictions(predictions / "oracle")
    return report(cases, oracle, dict(without), read_methods(predictions), note, sizes)


def main() -> None:
    """Score a folder of predictions."""
    parser = argparse.ArgumentParser(prog="python -m blind.score", description=__doc__)
    parser.add_argument(
        "predictions",
        type=Path,
        help="CASE.json; the same in oracle/, without/, rivals/NAME/, ablations/NAME/; sizes.json of blind.sizes",
    )
    parser.add_argument("--out", type=Path, help="Markdown file; standard output if absent")
    parser.add_argument("--list-oracle", type=Path, help="write CASE ID,ID for the oracle fits, and stop")
    parser.add_argument("--list-without", type=Path, help="write CASE ID for the fits without their cause, and stop")
    parser.add_argument("--note", default="", help="text for the head of the page, such as how times were measured")
    options = parser.parse_args()
    cases = scored(read_predictions(options.predictions))
    if options.list_oracle or options.list_without:
        if options.list_oracle:
            write_list(options.list_oracle, [c for c in cases if c.truth["cause"]])
        if options.list_without:
            write_list(options.list_without, [c for c in singles(cases) if c.truth["detectability"] >= 7.8])
        return
    text = scores(options.predictions, options.note)
    if options.out:
        options.out.write_text(text, encoding="utf-8")
    else:
        print(text)


def write_list(path: Path, cases: list[Scored]) -> None:
    """Write a list of cases with the ids of their hidden causes, ``CASE ID,ID`` a line."""
    lines = [f"{c.case} {','.join(c.truth['cause'])}\n" for c in cases]
    path.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
