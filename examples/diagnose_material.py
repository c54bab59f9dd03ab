"""What a neo-Hookean solid gets wrong in measured material tests: found, named, and proved on what was not fitted.

    python examples/diagnose_material.py brain|silicone|shear-rates --data DIR [--out DIR] [--json FILE]

DIR holds files of one kind, any number of them:

brain        ``REGION_tension.txt``, ``REGION_compression.txt``, ``REGION_simple_shear.txt``: stretch or amount of
             shear, nominal stress in kPa, no header. One diagnosis a region; modes are left out in turn.
silicone     ``NAME_SPECIMEN.csv``: time s, compression, load, engineering strain, engineering stress kPa, ...; lines
             with ``#`` are skipped. SPECIMEN is a letter and the number of a test of it. One diagnosis a silicone (same
             NAME), whole specimens left out, and one per file.
shear-rates  ``*_RATE_per_s.csv`` with the header time_s, shear, nominal shear stress in kPa. One diagnosis of all
             rates, and one without each rate, which it then predicts.

Every diagnosis works on an experiment folder (``experiment.toml`` and ``test.csv``) that is written first, under --out
where that is given. Believed is a neo-Hookean solid with the modulus that fits best, known to a half.
"""

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import tissuereg as tr
from tissuereg.diagnosis.material import MaterialDiagnosis, diagnose_material, predicted_stresses
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
from tissuereg.experiment.material_tests import MaterialTest, fit_law
from tissuereg.io.material_experiments import read_material_experiment, write_test_table

POISSON = 0.495
MODES = {"tension": "tension", "compression": "compression", "simple_shear": "simple-shear"}


def read_region(folder: Path, region: str) -> list[Curve]:
    """Return the modes of a region of the brain; neither rate nor time is known."""
    curves = []
    for name, mode in MODES.items():
        path = folder / f"{region}_{name}.txt"
        if path.exists():
            amount, stress = np.loadtxt(path, delimiter=",", ndmin=2)[:, :2].T
            curves.append(Curve(region, mode, np.nan, np.full(len(amount), np.nan), amount, stress))
    return curves


def read_silicone(path: Path) -> Curve:
    """Return one compression of a silicone; the letter of its name is that of the specimen, the digit of the test."""
    columns = np.loadtxt(path, delimiter=",", comments="#", ndmin=2)
    time, stretch, stress = columns[:, 0], 1.0 + columns[:, 3], columns[:, 4]
    rate = float(abs(stretch[-1] - stretch[0]) / (time[-1] - time[0]))
    return Curve(path.stem.rsplit("_", 1)[-1][0], "compression", float(f"{rate:.3g}"), time, stretch, stress)


def read_rate(path: Path) -> Curve:
    """Return one staircase of shear; the rate is in its name."""
    found = re.search(r"([0-9.]+)_per_s$", path.stem)
    if found is None:
        message = f"the name must end in a rate, such as staircase_0.1_per_s.csv, got {path.name}"
        raise tr.errors.FormatError(message, where=str(path))
    time, shear, stress = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2).T
    return Curve("adhesive", "simple-shear", float(found[1]), time, shear, stress)


def neo_hookean(curves: Sequence[Curve]) -> tr.Material:
    """Return the neo-Hookean solid that fits curves best, each counting alike."""
    tests = [MaterialTest(curve.mode, curve.amounts, curve.stress) for curve in curves]
    return fit_law(tests, "neo-hookean", poisson=POISSON).material


def diagnosed(name: str, curves: Sequence[Curve], out: Path) -> MaterialDiagnosis:
    """Write the experiment folder of some curves, read it, diagnose it, and leave the answer in it."""
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    write_test_table(folder / "test.csv", curves)
    material = neo_hookean(curves)
    believed = MaterialExperiment(name, folder, material, 0.5 * float(material.young), None, tuple(curves))
    tr.write_experiment(believed, folder / "experiment.toml")
    diagnosis = diagnose_material(read_material_experiment(folder))
    diagnosis.save(folder)
    return diagnosis


def summary_of(name: str, diagnosis: MaterialDiagnosis) -> dict[str, object]:
    """Print what was found and return its figures."""
    answer = diagnosis.to_json()
    held_out = answer["held_out"]
    causes = {cause["id"]: cause["parameters"] for cause in answer["causes"]}
    groups = [cause["group"] for cause in answer["causes"]]
    print(f"{name}: {answer['verdict']} {', '.join(' or '.join(group) for group in groups)}")
    for sentence in answer["sentences"]:
        print(f"  {sentence}")
    for case, errors in held_out["by_case"].items():
        rms = [errors[f"rms_{key}_kpa"] for key in ("base", "named", "generic")]
        print(f"  left out {case}: rms {rms[0]:.3g} kPa neo-Hookean, {rms[1]:.3g} named, {rms[2]:.3g} generic patch")
    return {
        "name": name,
        "verdict": answer["verdict"],
        "groups": groups,
        "parameters": causes,
        "held_out": held_out,
        "explained": answer["explained"],
        "p_misfit": answer["p_misfit"],
    }


def standard_error(curve: Curve, stress: np.ndarray, n_parameters: int) -> float:
    """Return the root of the sum of squares over (rows - parameters), kPa."""
    return float(np.sqrt(np.sum((curve.stress - stress) ** 2) / (len(stress) - n_parameters)))


def study_brain(data: Path, out: Path) -> list[dict[str, object]]:
    """Diagnose every region."""
    regions = sorted({p.name.removesuffix("_tension.txt") for p in data.glob("*_tension.txt")})
    return [summary_of(region, diagnosed(region, read_region(data, region), out)) for region in regions]


def study_silicone(data: Path, out: Path) -> list[dict[str, object]]:
    """Diagnose every silicone, and every file of it alone."""
    silicones: dict[str, list[Path]] = {}
    for path in sorted(data.glob("EF*.csv")):
        silicones.setdefault(path.stem.rsplit("_", 1)[0], []).append(path)
    rows = []
    for name, paths in silicones.items():
        curves = [read_silicone(path) for path in paths]
        row = summary_of(name, diagnosed(name, curves, out))
        row["files"] = [study_file(path.stem, curve, out) for path, curve in zip(paths, curves, strict=True)]
        rows.append(row)
    return rows


def study_file(name: str, curve: Curve, out: Path) -> dict[str, object]:
    """Return the standard errors of one file: neo-Hookean, the extended model, and its law by plain least squares."""
    diagnosis = diagnosed(name, [curve], out)
    test = MaterialTest(curve.mode, curve.amounts, curve.stress)
    row: dict[str, object] = {"file": name, "verdict": diagnosis.verdict}
    row["neo_hookean_kpa"] = fit_law([test], "neo-hookean", weighting="plain").standard_error
    if diagnosis.findings:
        n_parameters = len(diagnosis.outcome.refined.fit.x)
        row["extended_kpa"] = standard_error(curve, predicted_stresses(diagnosis.extended)[0], n_parameters)
        laws = [cause for cause in diagnosis.extended.effects if hasattr(cause, "law")]
        if laws:
            terms = len(laws[0].alpha or (1,))
            row["law"] = laws[0].law
            row["law_plain_kpa"] = fit_law([test], laws[0].law, terms=terms, weighting="plain").standard_error
    errors = ", ".join(f"{key.removesuffix('_kpa')} {value:.2f}" for key, value in row.items() if key.endswith("_kpa"))
    causes = [finding.id for finding in diagnosis.findings]
    print(
        f"  {name}: {diagnosis.verdict} {' '.join(causes)} ({row.get('law', 'no law')}); standard error kPa: {errors}"
    )
    return row


def study_rates(data: Path, out: Path) -> list[dict[str, object]]:
    """Diagnose all rates together, and all but one, which is then predicted."""
    curves = [read_rate(path) for path in sorted(data.glob("*_per_s.csv"))]
    rows = [summary_of("all rates", diagnosed("all-rates", curves, out))]
    for unseen in curves if len(curves) > 1 else []:
        others = [curve for curve in curves if curve is not unseen]
        diagnosis = diagnosed(f"without-{unseen.rate:g}", others, out)
        row = summary_of(f"without {unseen.rate:g}/s", diagnosis)
        base = MaterialExperiment("unseen", out, neo_hookean(others), None, None, (unseen,))
        models = {"neo_hookean": base}
        if diagnosis.findings:
            extended = diagnosis.extended
            models["extended"] = MaterialExperiment(
                "unseen", out, extended.material, None, None, (unseen,), extended.effects
            )
        peak = float(np.abs(unseen.stress).max())
        row["unseen"] = {"rate_per_s": unseen.rate, "peak_kpa": peak}
        for key, model in models.items():
            rms = float(np.sqrt(np.mean((predicted_stresses(model)[0] - unseen.stress) ** 2)))
            row["unseen"][f"rms_{key}_kpa"] = rms
            print(f"  the unseen rate predicted by {key}: rms {rms:.3g} kPa, {rms / peak:.1%} of its peak")
        rows.append(row)
    return rows


STUDIES = {"brain": study_brain, "silicone": study_silicone, "shear-rates": study_rates}


def main() -> int:
    """Diagnose what a folder holds, print it, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=list(STUDIES), help="what the files are")
    parser.add_argument("--data", type=Path, required=True, help="folder with the measured files")
    parser.add_argument("--out", type=Path, help="folder for experiment folders and answers; a temporary one if absent")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        rows = STUDIES[options.kind](options.data, options.out or Path(temporary))
    if not rows:
        print(f"no files of the kind {options.kind} in {options.data}", file=sys.stderr)
        return 2
    if options.json:
        document = {"schema": "tissuereg.diagnose-material/1", "kind": options.kind, "rows": rows}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
