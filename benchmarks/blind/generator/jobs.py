"""The list of solves by the other solver, most valuable first, and the files of their results."""

import hashlib
import traceback
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from blind.generator.effects import CATALOGUE
from blind.generator.rigs import N_RIGS, make_rig

FIELDS = Path(__file__).resolve().parent.parent / "data" / "fields"


@dataclass(frozen=True)
class Job:
    """One solve: a rig, what is hidden (index into a list, or None for nothing) and which of its two sizes."""

    rig: int
    group: str = "null"
    index: int = -1
    size: int = -1

    @property
    def name(self):
        """Name of the file, which reveals nothing."""
        text = f"{self.rig}/{self.group}/{self.index}/{self.size}"
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    @property
    def path(self):
        """Where the result lies."""
        return FIELDS / f"{self.name}.npz"

    def rng(self):
        """Draws of the hidden effect, the same for both sizes."""
        return np.random.default_rng([911, self.rig, sum(self.group.encode()), self.index + 1])

    def effect(self):
        """Return the hidden effect."""
        return hidden(self.group)[self.index]

    def built(self):
        """Return settings and parameters of the hidden effect, of a pair merged."""
        effect = self.effect()
        return effect.build(make_rig(self.rig), self.rng(), effect.sizes[self.size])


def hidden(group):
    """Return the list of hidden effects of a group."""
    if group == "catalogue":
        return CATALOGUE
    from blind.generator import outside, pairs

    return {"outside": outside.SOLVED, "pairs": pairs.PAIRS}[group]


def rank_within(index):
    """Return the how manieth variant of its id an effect is."""
    return [e.id for e in CATALOGUE[:index]].count(CATALOGUE[index].id)


def both(rig, group, index):
    """Return the jobs of the two sizes."""
    return [Job(rig, group, index, size) for size in range(len(hidden(group)[index].sizes))]


def all_jobs():
    """Return all jobs in the order in which they are done."""
    jobs = [Job(rig) for rig in (0, 1)]
    order = sorted(range(len(CATALOGUE)), key=lambda i: (rank_within(i) > 0, i))
    for turn, rigs in enumerate(((0, 1), (1, 0))):
        for place, index in enumerate(order):
            jobs += both(rigs[rank_within(index) % 2], "catalogue", index)
            if turn == 0 and place % 3 == 2 and 2 + place // 3 < N_RIGS:
                jobs.append(Job(2 + place // 3))
        jobs += [Job(rig) for rig in range(N_RIGS)]
        for group in ("outside", "pairs"):
            jobs += [j for i in range(len(hidden(group))) for j in both((i + turn) % 2, group, i)]
    for index in order:
        jobs += both(2 + rank_within(index) % 2, "catalogue", index)
    return list(dict.fromkeys(jobs))


def run(job):
    """Solve one job and return the arrays."""
    from blind.generator.solve import solve

    rig = make_rig(job.rig)
    if job.group == "null":
        return solve(rig, {}, extra=True)
    effect = job.effect()
    settings, _ = job.built()
    return solve(rig, settings, effect.timed, effect.only)


def save(job, found):
    """Store the arrays, single precision, compressed."""
    FIELDS.mkdir(parents=True, exist_ok=True)
    slim = {k: v.astype(np.float32) if v.dtype == np.float64 else v for k, v in found.items()}
    partial = job.path.with_suffix(".part.npz")
    np.savez_compressed(partial, **slim)
    partial.rename(job.path)


def make_all():
    """Do every job that is not done; a job that finds no equilibrium leaves a note next to the results."""
    for job in all_jobs():
        note = job.path.with_suffix(".failed")
        if job.path.exists() or note.exists():
            continue
        print(job, flush=True)
        try:
            found = run(job)
        except (FloatingPointError, ValueError, np.linalg.LinAlgError) as error:
            FIELDS.mkdir(parents=True, exist_ok=True)
            note.write_text(f"{job}\n{error}\n{traceback.format_exc()}", encoding="utf-8")
            print("   failed:", error, flush=True)
            continue
        save(job, found)
        print(f"   {float(found['seconds']):.0f} s, {int(found['factorings'])} factors", flush=True)


def compare(name):
    """Make one job anew and return the largest difference from what is stored, in mm or mN, by array."""
    job = next(job for job in all_jobs() if job.name == name)
    found, stored = run(job), np.load(job.path)
    return {key: float(np.abs(found[key] - stored[key]).max()) for key in ("markers", "targets", "forces")}
