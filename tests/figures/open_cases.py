"""Open cases of the blind bench: their seeds are far from those of sealed ones, so they reveal nothing of these."""

import tissuereg as tr
from blind.generator.cases import Plan, make
from blind.generator.jobs import hidden
from blind.generator.open_cases import NULL_SEEDS, SEEDS
from blind.generator.store import write_case
from blind.materialise import materialise


def hiding(cause, folder, *, rig=0, detectability=21.0):
    """Return the experiment of a rig in which a cause is hidden, and the ids that explain it as well."""
    index = [effect.id for effect in hidden("catalogue")].index(cause)
    seed = SEEDS + 37 * index + rig + int(detectability)
    plan = Plan(cause, seed, rig, "single", (("catalogue", index),), detectability)
    return _made(plan, folder)


def without_effect(rig, folder):
    """Return the experiment of a rig without an effect."""
    return _made(Plan(f"null_{rig}", NULL_SEEDS + 100 * rig, rig, "null"), folder)[0]


def _made(plan, folder):
    experiment = make(plan)
    write_case(folder / f"{plan.name}.npz", experiment)
    materialise(plan.name, folder / plan.name, cases=folder)
    return tr.read_experiment(folder / plan.name), experiment.answer.get("group_ok", [])
