"""Brain tissue in three modes: which law holds in all of them, and which predicts a mode it has not seen.

    python examples/brain.py --data DIR [--json FILE]

DIR holds ``REGION_tension.txt``, ``REGION_compression.txt`` and ``REGION_simple_shear.txt`` for any number of regions:
stretch or amount of shear, nominal stress in kPa, comma-separated, no header. Every law is fitted, without volume
change, to all modes of a region at once and to all but one; each mode counts alike (its residuals are divided by its
largest stress and the root of its number of points).
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from tissuereg.experiment.material_tests import LawFit, MaterialTest, fit_law

MODES = {"tension": "tension", "compression": "compression", "simple_shear": "simple-shear"}
LAWS = (
    ("neo-hookean", 1),
    ("mooney-rivlin", 1),
    ("yeoh", 1),
    ("fung", 1),
    ("veronda-westmann", 1),
    ("ogden", 1),
    ("ogden", 2),
)


def read_regions(folder: Path) -> dict[str, dict[str, MaterialTest]]:
    """Return the tests of every region that has a tension file, by mode."""
    regions: dict[str, dict[str, MaterialTest]] = {}
    for first in sorted(folder.glob("*_tension.txt")):
        region = first.name.removesuffix("_tension.txt")
        tests = {}
        for name, mode in MODES.items():
            path = folder / f"{region}_{name}.txt"
            if path.exists():
                columns = np.loadtxt(path, delimiter=",", ndmin=2)
                tests[mode] = MaterialTest(mode, columns[:, 0], columns[:, 1], f"{region} {mode}")
        regions[region] = tests
    return regions


def rms(test: MaterialTest, fit: LawFit) -> float:
    """Return the root mean square misfit of one test in kPa."""
    return float(np.sqrt(np.mean((test.stress - test.predicted(fit.material)) ** 2)))


def study_law(tests: dict[str, MaterialTest], law: str, terms: int) -> dict[str, object]:
    """Return the fit of one law to all modes and what it predicts of each mode left out."""
    everything = list(tests.values())
    fit, plain = (fit_law(everything, law, terms=terms, weighting=weighting) for weighting in ("mode", "plain"))
    held_out = {}
    for mode, test in tests.items():
        others = [other for name, other in tests.items() if name != mode]
        if others:
            held_out[mode] = rms(test, fit_law(others, law, terms=terms))
    return {
        "law": law,
        "terms": terms,
        "young_kpa": float(fit.material.young),
        "shape": dict(fit.material.shape),
        "r2": {mode: test.r_squared(fit.material) for mode, test in tests.items()},
        "r2_plain_least_squares": {mode: test.r_squared(plain.material) for mode, test in tests.items()},
        "rms_kpa": {mode: rms(test, fit) for mode, test in tests.items()},
        "held_out_rms_kpa": held_out,
    }


def main() -> int:
    """Fit every law to every region, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with REGION_tension.txt and its siblings")
    parser.add_argument("--json", type=Path, help="file for the answer")
    options = parser.parse_args()
    regions = read_regions(options.data)
    if not regions:
        print(f"no file *_tension.txt in {options.data}", file=sys.stderr)
        return 2
    answer = []
    for region, tests in regions.items():
        rows = [study_law(tests, law, terms) for law, terms in LAWS]
        base = rows[0]["held_out_rms_kpa"]
        for row in rows:
            held_out = row["held_out_rms_kpa"]
            row["held_out_gain"] = {mode: base[mode] / held_out[mode] for mode in held_out}
        answer.append({"region": region, "modes": list(tests), "laws": rows})
        print(f"{region}: R2 fitted to all modes (plain least squares), rms in kPa of the mode left out")
        print(f"{'law':18s} " + " ".join(f"{mode:>24s}" for mode in tests))
        for row in rows:
            cells = []
            for mode in tests:
                r2, plain = row["r2"][mode], row["r2_plain_least_squares"][mode]
                cells.append(f"{r2:6.2f} ({plain:5.2f}) {row['held_out_rms_kpa'].get(mode, np.nan):7.3f}")
            name = f"{row['law']} {row['terms']}" if row["terms"] > 1 else row["law"]
            print(f"{name:18s} " + " ".join(f"{cell:>24s}" for cell in cells))
    if options.json:
        document = {"schema": "tissuereg.brain/1", "regions": answer}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
