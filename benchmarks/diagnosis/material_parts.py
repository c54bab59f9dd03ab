"""Parameters fitted to different parts of the data, compared -> archive, RESULTS-material-parts.md.

    python -m diagnosis.material_parts [--data DIR] [--seeds N] [--page]

Every part of the measured curves is diagnosed separately, as a user would. Where two disjoint or nested parts are
explained by the same form of law, their parameters are compared. Synthetic curves, whose truth is known or which are
fitted with a wrong form, come from `tests/support`. ``--page`` writes the page alone.
"""

import argparse
import itertools
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from common import REPOSITORY, SHARED, read_archive, write_archive

sys.path.insert(0, str(REPOSITORY / "examples"))

import diagnose_material as example

from support import material_curves as made
from support.material_curves import believed, histories, in_modes, with_lasting_errors, with_smooth_misfit
from support.material_fits import both, numbers
from tissuereg.cli.common import envelope
from tissuereg.diagnosis.material import diagnose_material
from tissuereg.diagnosis.material.answer import SelectionOutcome
from tissuereg.diagnosis.material.fit import fitted
from tissuereg.diagnosis.material.refine import rows_alike
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive" / "material-parts", HERE / "RESULTS-material-parts.md"
TABLES = ("measured/<specimen>/parts/<part>", "measured/<specimen>/pairs/#", "known/<data>/<parts>")

Curves = Sequence[Curve]
Numbers = dict[str, list[float]]
#: Standard deviations that are compared: the stated ones, and those of the curvature alone, as if the form were right.
KINDS = ("stated", "right")


def parts_of_rates(curves: Curves) -> dict[str, list[Curve]]:
    """Return every set of rates."""
    sets = [s for n in range(1, len(curves) + 1) for s in itertools.combinations(curves, n)]
    return {" and ".join(f"{curve.rate:g}/s" for curve in s): list(s) for s in sets}


def parts_of_modes(curves: Curves) -> dict[str, list[Curve]]:
    """Return every set of modes."""
    sets = [s for n in range(1, len(curves) + 1) for s in itertools.combinations(curves, n)]
    return {", ".join(curve.mode for curve in s): list(s) for s in sets}


def parts_of_specimens(files: dict[str, Curve]) -> dict[str, list[Curve]]:
    """Return all, specimens, tests of all specimens, and files."""
    parts = {"all": list(files.values())}
    for specimen in sorted({name[0] for name in files}):
        parts[f"specimen {specimen}"] = [curve for name, curve in files.items() if name[0] == specimen]
    for test in sorted({name[1:] for name in files}):
        parts[f"tests {test}"] = [curve for name, curve in files.items() if name[1:] == test]
    parts |= {f"file {name}": [curve] for name, curve in files.items()}
    return parts


def materials(data: Path) -> dict[str, dict[str, list[Curve]]]:
    """Return the parts of every measured material in a folder like ``shared/data``."""
    rates = [example.read_rate(path) for path in sorted((data / "shear-rates").glob("*_per_s.csv"))]
    found = {"adhesive": parts_of_rates(rates)} if rates else {}
    silicones: dict[str, dict[str, Curve]] = {}
    for path in sorted((data / "silicone").glob("EF*.csv")):
        name, test = path.stem.rsplit("_", 1)
        silicones.setdefault(name, {})[test] = example.read_silicone(path)
    found |= {name: parts_of_specimens(files) for name, files in silicones.items()}
    for path in sorted((data / "brain").glob("*_tension.txt")):
        region = path.name.removesuffix("_tension.txt")
        found[region.replace("_", " ")] = parts_of_modes(example.read_region(data / "brain", region))
    return found


def answered(name: str, curves: Curves) -> dict[str, Any]:
    """Diagnose some curves and return the forms found and their numbers."""
    material = example.neo_hookean(curves)
    experiment = MaterialExperiment(name, Path(), material, 0.5 * float(material.young), None, tuple(curves))
    diagnosis = diagnose_material(experiment)
    outcome, row = diagnosis.outcome, {"verdict": diagnosis.verdict}
    if outcome.refined is None:
        return row
    causes = {cause["id"]: cause["parameters"] for cause in diagnosis.to_json()["causes"]}
    young = [float(diagnosis.extended.material.young_array[0]), float(diagnosis.extended.young_std or math.nan)]
    right = of_a_right_form(outcome)
    return {
        **row,
        # An Ogden exponent counts as `stiffening` where pull or push alone was tested: one form, whatever its name.
        "forms": [part.free_parameters.label for part in outcome.refined.fit.parts],
        "provisional": diagnosis.provisional,
        "weighting": outcome.refined.weighting,
        "form_error": outcome.refined.form_error,
        "stated": {"young_kpa": young, **{key: value for found in causes.values() for key, value in found.items()}},
        "right": right,
    }


def of_a_right_form(outcome: SelectionOutcome) -> Numbers:
    """Return the numbers of an answer with the deviations that the curvature of their fit gives."""
    assert outcome.refined is not None
    bench, fit = outcome.bench, outcome.refined.fit
    if outcome.refined.weighting == "rows alike":
        bench = rows_alike(bench)
    again = fitted(bench, fit.parts, [fit.x], fit.share)
    return numbers(again)


def pairs(parts: dict[str, list[Curve]]) -> list[tuple[str, str, str]]:
    """Return the pairs to compare: parts without a common curve, and parts (first) of others."""
    ids = {name: {id(curve) for curve in curves} for name, curves in parts.items()}
    apart = [(a, b, "apart") for a, b in itertools.combinations(parts, 2) if not ids[a] & ids[b]]
    return apart + [(a, b, "within") for a, b in itertools.permutations(parts, 2) if ids[a] < ids[b]]


def distances(one: Numbers, other: Numbers, how: str) -> dict[str, float]:
    """Return how far numbers lie apart, in deviations: of their difference, or of the smaller part."""
    return {
        key: abs(value - other[key][0]) / (math.hypot(std, other[key][1]) if how == "apart" else std)
        for key, (value, std) in one.items()
        if key in other and std > 0  # the weight of a single term is 1
    }


def measured(parts: dict[str, list[Curve]]) -> dict[str, Any]:
    """Diagnose the parts of one material and compare those of one form."""
    answers = {name: answered(name, curves) for name, curves in parts.items()}
    return {"parts": answers, "pairs": [compared(answers, *pair) for pair in pairs(parts)]}


def compared(answers: dict[str, dict[str, Any]], one: str, other: str, how: str) -> dict[str, Any]:
    """Return how far the numbers of two parts lie apart, where they are of one form."""
    a, b = answers[one], answers[other]
    same = "forms" in a and a["forms"] == b.get("forms")
    row: dict[str, Any] = {"one": one, "other": other, "how": how, "same_form": same}
    return row | {kind: distances(a[kind], b[kind], how) for kind in KINDS} if same else row


def relaxing(kernel: Callable[[Any], Any]) -> Callable[..., Any]:
    """Return the answer of a plain solid that relaxes."""
    return lambda mode, times, strain: made.relaxed(("plain",), mode, times, strain, kernel)


Maker = Callable[[np.random.Generator], list[Curve]]
FUNG = ("fung", 1.0)
FUNG_TRUTH = {"young_kpa": 10.0, "b": 1.0}
TERMS = {"young_kpa": 10.0, "g_1": 0.25, "g_2": 0.2, "tau_s_1": 1.5, "tau_s_2": 20.0}


def two_times(rng: np.random.Generator) -> list[Curve]:
    """Return holds at two rates of a solid of two relaxation times, with errors that last along a curve."""
    return with_lasting_errors(histories(rng, relaxing(made.prony((0.25, 1.5), (0.2, 20.0)))), rng)


def misfitting(size: float) -> Maker:
    """Return a maker of curves by Fung's law, with errors that last along a curve and a smooth misfit."""
    return lambda rng: with_smooth_misfit(with_lasting_errors(in_modes(rng, FUNG), rng), rng, size)


#: Cause, form, truth, and how the curves are made.
KNOWN: dict[str, tuple[str, str, dict[str, float], Maker]] = {
    "Fung, white noise alone": ("stiffening", "fung", FUNG_TRUTH, lambda rng: in_modes(rng, FUNG)),
    "Fung, errors that last": (
        "stiffening",
        "fung",
        FUNG_TRUTH,
        lambda rng: with_lasting_errors(in_modes(rng, FUNG), rng),
    ),
    "two relaxation times, errors that last": ("relaxation", "prony-2", TERMS, two_times),
    "Fung, a smooth misfit of 5 %": ("stiffening", "fung", FUNG_TRUTH, misfitting(0.05)),
    "Fung, a smooth misfit of 10 %": ("stiffening", "fung", FUNG_TRUTH, misfitting(0.1)),
}
POWER: Maker = lambda rng: histories(rng, relaxing(lambda t: (1.0 + t / 0.3) ** -0.12), rates=(0.003, 0.03, 0.3))  # noqa: E731
#: Cause, form, how the curves are made, and the key by which their parts differ.
WRONG: dict[str, tuple[str, str, Maker, str]] = {
    "a limit of extension as Fung": ("stiffening", "fung", lambda rng: in_modes(rng, ("gent", 1.0)), "mode"),
    "a power of time as one Prony term": ("relaxation", "prony-1", POWER, "rate"),
    "a power of time as two": ("relaxation", "prony-2", POWER, "rate"),
    "a power of time as three": ("relaxation", "prony-3", POWER, "rate"),
}
WEIGHTINGS = ("lasting errors", "rows alike")


def known(name: str, seeds: int) -> dict[str, Any]:
    """Return errors over standard deviations where the truth is known."""
    cause, label, truth, maker = KNOWN[name]
    rows = {}
    for weighting in WEIGHTINGS:
        fits = [both(believed(maker(np.random.default_rng(s))), cause, label, weighting) for s in range(seeds)]
        rows[weighting] = {"form_error": float(np.median([size for *_, size in fits]))}
        for kind, answers in zip(KINDS, zip(*[row[:2] for row in fits], strict=True), strict=True):
            z = np.array([[(a[key][0] - value) / a[key][1] for key, value in truth.items()] for a in answers])
            values = np.array([[a[key] for key in truth] for a in answers])
            ratio = np.median(values[:, :, 1], axis=0) / values[:, :, 0].std(axis=0, ddof=1)
            rows[weighting][kind] = {
                "within_two": float(np.mean(np.abs(z) <= 2.0)),
                "over_scatter": float(np.median(ratio)),
            }
    return rows


def wrong(name: str, seeds: int) -> dict[str, Any]:
    """Return how far parameters of different parts lie apart where the form is wrong."""
    cause, label, maker, unit = WRONG[name]
    rows = {}
    for weighting in WEIGHTINGS:
        found: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for seed in range(seeds):
            curves = maker(np.random.default_rng(seed))
            sets = sorted({getattr(curve, unit) for curve in curves})
            parts = {str(s): [c for c in curves if getattr(c, unit) == s] for s in sets} | {"all": curves}
            fits = {key: both(believed(part), cause, label, weighting) for key, part in parts.items()}
            for one, other, how in pairs(parts):
                for i, kind in enumerate(KINDS):
                    found[kind] += distances(fits[one][i], fits[other][i], how).values()
        rows[weighting] = {kind: within(z) for kind, z in found.items()}
    return rows


def within(distances: Sequence[float]) -> dict[str, float]:
    """Return counts of distances."""
    z = np.array(distances)
    return {"n": len(z), "within_two": float(np.mean(z <= 2.0)), "largest": float(z.max())}


_INTRO = """# Do parameters from different parts of the data agree?

Written by `make -C benchmarks/diagnosis material-parts`. The parameters of one law, fitted to different parts of the
same data, should agree within their stated standard deviations. These include the full noise (errors that are
correlated along a curve and scale factors of specimens) and a smooth misfit of the size of the fit's residual, for
what the form of the law cannot follow. "By curvature alone" are the standard deviations that hold if the form is right
and the noise is that of the weights; earlier releases stated these. Two disjoint parts are compared by the standard
deviation of their difference, a part and the larger part that contains it by the standard deviation of the smaller; 95
of 100 should lie within two. Parts share the error of their form, so parameters of similar parts agree better than
that.

## Measured

Every part is diagnosed separately. Parts for which no cause is named, or another form of law is chosen, cannot be
compared; they are counted. An answer is provisional if nothing but the last part of its curves could be held out.
"""

_MEASURED = (
    "material",
    "parts named",
    "pairs of the same form",
    "parameters compared",
    "within two standard deviations",
    "largest",
    "by curvature alone",
    "largest",
)
_TERMS = (
    "rates",
    "verdict",
    "misfit of the form",
    "first share",
    "by curvature alone",
    "first time, s",
    "instantaneous modulus, kPa",
)
_KNOWN = (
    "curves",
    "weights",
    "estimated misfit of the form",
    "truth within two standard deviations",
    "standard deviation over scatter",
    "by curvature alone: within two",
    "over scatter",
)
_WRONG = (
    "form",
    "weights",
    "parameters",
    "within two standard deviations",
    "largest",
    "by curvature alone",
    "largest",
)

_LIMIT = """A form that fits its own part of the data within the noise shows no misfit there, however wrong it is
elsewhere. Parameters of one relaxation term fitted to one time window, or of one law fitted to one mode of loading, may
therefore differ from those of another part by more than is stated. Only data over a wider range can reveal this."""


def head(cells: Sequence[str]) -> list[str]:
    """Return the first two lines of a table."""
    return [f"| {' | '.join(cells)} |", "|---" * len(cells) + "|"]


def page(archive: dict[str, Any]) -> str:
    """Return the page of an archive."""
    parts = [_INTRO]
    parts += head(_MEASURED)
    parts += [_summary(name, rows) for name, rows in archive["measured"].items()]
    parts += ["", "Parameters beyond two stated standard deviations:", ""]
    parts += _beyond(archive["measured"]) or ["* none"]
    adhesive = archive["measured"].get("adhesive")
    if adhesive:
        parts += ["", "### The adhesive", "", *_terms(adhesive["parts"])]
    parts += ["", "## Synthetic, truth known", "", *_known_table(archive["known"])]
    parts += ["", "## Synthetic, fitted with a wrong form", "", *_wrong_table(archive["wrong"]), "", _LIMIT, ""]
    return "\n".join(parts)


def _all(rows: dict[str, Any], kind: str) -> list[float]:
    return [z for pair in rows["pairs"] if pair["same_form"] for z in pair[kind].values()]


def _summary(name: str, rows: dict[str, Any]) -> str:
    named = sum("forms" in row for row in rows["parts"].values())
    same = sum(pair["same_form"] for pair in rows["pairs"])
    cells = [name, f"{named} of {len(rows['parts'])}", f"{same} of {len(rows['pairs'])}"]
    found = {kind: _all(rows, kind) for kind in KINDS}
    cells.append(str(len(found["stated"])))
    for z in found.values():
        cells += [f"{np.mean(np.array(z) <= 2.0):.0%}", f"{max(z):.1f}"] if z else ["", ""]
    return "| " + " | ".join(cells) + " |"


def _beyond(measured: dict[str, Any]) -> list[str]:
    return [
        f"* {name}, {key}: {pair['one']} against {pair['other']}, {z:.1f}{_provisional(rows['parts'], pair)}"
        for name, rows in measured.items()
        for pair in rows["pairs"]
        if pair["same_form"]
        for key, z in pair["stated"].items()
        if z > 2.0
    ]


def _provisional(parts: dict[str, Any], pair: dict[str, Any]) -> str:
    return " (provisional answers)" if parts[pair["one"]]["provisional"] or parts[pair["other"]]["provisional"] else ""


def _terms(parts: dict[str, Any]) -> list[str]:
    lines = head(_TERMS)
    for name, row in parts.items():
        cells = [name, row["verdict"]]
        if "g_1" in row.get("stated", {}):
            stated = row["stated"]
            cells += [f"{row['form_error']:.1%}", _with(stated["g_1"]), _with(row["right"]["g_1"])]
            cells += [_with(stated["tau_s_1"]), _with(stated["young_kpa"])]
        lines.append("| " + " | ".join([*cells, *[""] * (len(_TERMS) - len(cells))]) + " |")
    return lines


def _with(pair: Sequence[float]) -> str:
    return f"{pair[0]:.3g} \u00b1 {pair[1]:.2g}"


def _known_table(rows: dict[str, Any]) -> list[str]:
    lines = head(_KNOWN)
    for name, row in rows.items():
        for weighting, found in row.items():
            cells = [name, weighting, f"{found['form_error']:.1%}"]
            for kind in KINDS:
                cells += [f"{found[kind]['within_two']:.0%}", f"{found[kind]['over_scatter']:.2f}"]
            lines.append("| " + " | ".join(cells) + " |")
    return lines


def _wrong_table(rows: dict[str, Any]) -> list[str]:
    lines = head(_WRONG)
    for name, row in rows.items():
        for weighting, found in row.items():
            cells = [name, weighting, str(found["stated"]["n"])]
            for kind in KINDS:
                cells += [f"{found[kind]['within_two']:.0%}", f"{found[kind]['largest']:.1f}"]
            lines.append("| " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    """Diagnose, fit, write the archive and the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=SHARED / "data", help="folder of measured files")
    parser.add_argument("--seeds", type=int, default=40, help="of every synthetic case")
    parser.add_argument("--page", action="store_true", help="write the page from the archive, run nothing")
    options = parser.parse_args()
    if options.page:
        archive = read_archive(ARCHIVE)
    else:
        archive = {"schema": "tissuereg.material-parts/1", **envelope(1), "seeds": options.seeds}
        archive["measured"] = {}
        for name, parts in materials(options.data).items():
            archive["measured"][name] = measured(parts)
            print(_summary(name, archive["measured"][name]), flush=True)
        archive["known"] = {name: known(name, options.seeds) for name in KNOWN}
        archive["wrong"] = {name: wrong(name, max(options.seeds // 4, 2)) for name in WRONG}
        write_archive(ARCHIVE, archive, TABLES)
    PAGE.write_text(page(archive), encoding="utf-8")


if __name__ == "__main__":
    main()
