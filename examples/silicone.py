"""Silicones in compression to two thirds: the error of each law, file by file.

    python examples/silicone.py --data DIR [--json FILE]

DIR holds recordings ``NAME_SPECIMEN.csv`` of uniaxial compression: lines that begin with ``#`` are skipped, column 4 is
engineering strain, column 5 engineering stress in kPa, compression negative. Every law is fitted to each file alone,
without volume change and by plain least squares, and to all files of one silicone (same NAME) but one specimen letter,
which it then predicts.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from tissuereg.experiment.material_tests import MaterialTest, fit_law

LAWS = (
    ("neo-hookean", 1),
    ("mooney-rivlin", 1),
    ("yeoh", 1),
    ("fung", 1),
    ("veronda-westmann", 1),
    ("ogden", 1),
    ("ogden", 2),
)


def read_test(path: Path) -> MaterialTest:
    """Return one recording; rows that repeat a strain to the machine's rounding stay."""
    columns = np.loadtxt(path, delimiter=",", comments="#", ndmin=2)
    return MaterialTest("compression", 1.0 + columns[:, 3], columns[:, 4], path.stem)


def label(law: str, terms: int) -> str:
    """Return a law's name with its number of terms."""
    return f"{law} {terms}" if terms > 1 else law


def predicted(tests: dict[str, MaterialTest], law: str, terms: int) -> dict[str, float]:
    """Return the rms in kPa on each specimen (first letter of the last part of a name) fitted to the others."""
    specimens: dict[str, list[MaterialTest]] = {}
    for name, test in tests.items():
        specimens.setdefault(name.rsplit("_", 1)[-1][:1], []).append(test)
    errors = {}
    for specimen, own in specimens.items():
        others = [test for other, group in specimens.items() if other != specimen for test in group]
        if others:
            material = fit_law(others, law, terms=terms, weighting="plain").material
            errors[specimen] = float(
                np.sqrt(np.mean(np.concatenate([t.stress - t.predicted(material) for t in own]) ** 2))
            )
    return errors


def main() -> int:
    """Fit every law to every file, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with recordings EF*.csv")
    parser.add_argument("--json", type=Path, help="file for the answer")
    options = parser.parse_args()
    paths = sorted(options.data.glob("EF*.csv"))
    if not paths:
        print(f"no file EF*.csv in {options.data}", file=sys.stderr)
        return 2
    silicones: dict[str, dict[str, MaterialTest]] = {}
    for path in paths:
        silicones.setdefault(path.stem.rsplit("_", 1)[0], {})[path.stem] = read_test(path)
    print("standard error in kPa of each law, fitted to the file alone")
    print(f"{'file':14s} " + " ".join(f"{label(*law):>16s}" for law in LAWS))
    answer = []
    for silicone, tests in silicones.items():
        files = []
        for name, test in tests.items():
            fits = {label(law, terms): fit_law([test], law, terms=terms, weighting="plain") for law, terms in LAWS}
            print(f"{name:14s} " + " ".join(f"{fit.standard_error:16.2f}" for fit in fits.values()))
            laws = {
                law: {
                    "young_kpa": float(fit.material.young),
                    "shape": dict(fit.material.shape),
                    "standard_error_kpa": fit.standard_error,
                    "r2": test.r_squared(fit.material),
                }
                for law, fit in fits.items()
            }
            files.append({"file": name, "laws": laws})
        held_out = {label(law, terms): predicted(tests, law, terms) for law, terms in LAWS}
        answer.append({"silicone": silicone, "files": files, "specimen_left_out_rms_kpa": held_out})
    print("rms in kPa on the specimen left out")
    for entry in answer:
        for specimen in next(iter(entry["specimen_left_out_rms_kpa"].values())):
            cells = " ".join(f"{errors[specimen]:16.2f}" for errors in entry["specimen_left_out_rms_kpa"].values())
            print(f"{entry['silicone'] + ' ' + specimen:14s} {cells}")
    if options.json:
        document = {"schema": "tissuereg.silicone/1", "silicones": answer}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
