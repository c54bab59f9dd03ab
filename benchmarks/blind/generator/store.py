"""Experiments on disk: one small compressed file each, a seal for every answer, checksums of everything."""

import gzip
import hashlib
import json
import secrets
from pathlib import Path

import numpy as np

from blind.generator.cases import Experiment, NotReadyError, OutOfReachError, make
from blind.generator.fields import TIMES, rig_of
from blind.generator.plans import all_plans
from blind.generator.rigs import user_mesh

DATA = Path(__file__).resolve().parent.parent / "data"
CASES, MESHES = DATA / "cases", DATA / "meshes"
TIERS = DATA / "tiers.json"
ANSWERS, SEALS, SUMS = DATA / "answers.json.gz", DATA / "seals.csv", DATA / "SHA256SUMS"

#: Steps in which places and forces are stored.
STEP_MM, STEP_MN = 1e-4, 1e-2
MISSING = -(2**31)


def seal(salt, name, answer):
    """Return the salted hash of an answer."""
    text = json.dumps(answer, sort_keys=True)
    return hashlib.sha256(f"{salt}/{name}/{text}".encode()).hexdigest()


def make_cases(report=print):
    """Make every experiment whose solves are done; store cases, meshes, answers, seals and checksums."""
    for folder in (CASES, MESHES):
        folder.mkdir(parents=True, exist_ok=True)
    old = json.loads(gzip.decompress(ANSWERS.read_bytes())) if ANSWERS.exists() else {}
    salt = old.get("salt") or secrets.token_hex(16)
    answers, counts = {}, {"made": 0, "waiting": 0, "out of reach": 0}
    for plan in all_plans():
        path = CASES / f"{plan.name}.npz"
        try:
            experiment = make(plan)
        except NotReadyError:
            counts["waiting"] += 1
            continue
        except OutOfReachError:
            counts["out of reach"] += 1
            path.unlink(missing_ok=True)
            continue
        if plan.kind == "tied" and not 2 <= len(experiment.answer["group_ok"]) <= 3:
            counts["out of reach"] += 1
            path.unlink(missing_ok=True)
            continue
        write_case(path, experiment)
        answers[plan.name] = experiment.answer
        counts["made"] += 1
    body = json.dumps({"salt": salt, "answers": answers}, sort_keys=True, default=float)
    answers = json.loads(body)["answers"]
    ANSWERS.write_bytes(gzip.compress(body.encode(), mtime=0))
    rows = [f"{name},{seal(salt, name, answers[name])}" for name in sorted(answers)]
    SEALS.write_text("case,sha256\n" + "\n".join(rows) + "\n", encoding="utf-8")
    TIERS.write_text(json.dumps(_tiers(answers), indent=1) + "\n", encoding="utf-8")
    checksums()
    report(counts)


def _tiers(answers):
    """Return names of the quick tier (16 effects, 20 nulls) and of the one with 4,000 nodes, sorted."""
    quick, seen = [], set()
    for name in sorted(answers):
        summary = answers[name]
        if (
            summary["kind"] != "single"
            or summary["detectability"] < 12.8
            or not summary["separable"]
            or summary["cause"][0] in seen
        ):
            continue
        seen.add(summary["cause"][0])
        quick.append(name)
    nulls = [name for name in sorted(answers) if answers[name]["kind"] == "null" and not answers[name]["fine"]]
    return {"quick": sorted([*quick[:16], *nulls[:20]]), "fine": sorted(n for n in answers if answers[n]["fine"])}


def write_case(path, experiment: Experiment):
    """Store what is measured and believed, and the user's mesh where it is not stored yet."""
    arrays = experiment.arrays
    variant = experiment.plan.mesh
    mesh = MESHES / f"r{experiment.plan.rig:02d}{'f' if variant == -1 else 'abc'[variant]}.npz"
    if not mesh.exists():
        nodes, tets = user_mesh(rig_of(experiment.plan.rig), variant)
        np.savez_compressed(mesh, nodes=nodes, tets=tets.astype(np.int32))
    rig = rig_of(experiment.plan.rig)
    rows = arrays["rows"]
    np.savez_compressed(
        path,
        toml=np.array(experiment.toml),
        mesh=np.array(mesh.name),
        times=TIMES[rows],
        markers=_whole(arrays["markers"], STEP_MM),
        targets=_whole(arrays["targets"], STEP_MM),
        forces=_whole(arrays["forces"], STEP_MN),
        forces_given=np.array(experiment.plan.forces),
        strokes=np.array([rig.strokes[n] for n in ("push_x", "push_y", "push_z")]),
        target_names=np.array(list(rig.targets)),
    )


def _whole(values, step):
    whole = np.round(np.nan_to_num(values) / step).astype(np.int32)
    return np.where(np.isnan(values), MISSING, whole).astype(np.int32)


def checksums():
    """Write the checksums of everything stored."""
    files = sorted(
        [*CASES.glob("*.npz"), *MESHES.glob("*.npz"), *(DATA / "fields").glob("*.npz"), ANSWERS, SEALS, TIERS]
    )
    files = [f for f in files if ".part" not in f.name]
    lines = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(DATA).as_posix()}" for f in files]
    SUMS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    make_cases()
