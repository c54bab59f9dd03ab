"""Writes all cases whose readings are there, their answers and seals, the halves and checksums."""

import gzip
import hashlib
import json
import secrets

from rigs.generator.cases import DATA
from rigs.generator.make import write
from rigs.generator.plans import all_plans
from rigs.generator.rigs import halves

ANSWERS, SEALS, SUMS, HALVES = (DATA / n for n in ("answers.json.gz", "seals.csv", "SHA256SUMS", "halves.csv"))


def store(report=print):
    """Make every case whose readings are there."""
    DATA.mkdir(parents=True, exist_ok=True)
    rows = "".join(f"{rig},{half}\n" for rig, half in sorted(halves().items()))
    HALVES.write_text("rig,half\n" + rows, encoding="utf-8")
    old = json.loads(gzip.decompress(ANSWERS.read_bytes())) if ANSWERS.exists() else {}
    salt = old.get("salt") or secrets.token_hex(16)
    answers = {}
    for plan in all_plans():
        answer = write(plan)
        if answer is not None:
            answers[plan.name] = answer
    # Cases of an earlier run, whose readings are not here, stay with their answers.
    answers = {k: v for k, v in old.get("answers", {}).items() if (DATA / f"cases/{k}.npz").exists()} | answers
    for path in DATA.glob("cases/*.npz"):
        if path.stem not in answers:
            path.unlink()
    body = json.dumps({"salt": salt, "answers": answers}, sort_keys=True, default=float)
    answers = json.loads(body)["answers"]
    ANSWERS.write_bytes(gzip.compress(body.encode(), mtime=0))
    seals = [f"{name},{_seal(salt, name, answers[name])}" for name in sorted(answers)]
    SEALS.write_text("case,sha256\n" + "\n".join(seals) + "\n", encoding="utf-8")
    files = sorted([*DATA.glob("cases/*.npz"), *DATA.glob("meshes/*.npz"), ANSWERS, SEALS, HALVES, DATA / "rigs.json"])
    sums = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(DATA).as_posix()}" for f in files]
    SUMS.write_text("\n".join(sums) + "\n", encoding="utf-8")
    report(f"{len(answers)} cases, {sum(f.stat().st_size for f in files) / 1e6:.1f} MB")


def _seal(salt, name, answer):
    return hashlib.sha256(f"{salt}/{name}/{json.dumps(answer, sort_keys=True)}".encode()).hexdigest()
