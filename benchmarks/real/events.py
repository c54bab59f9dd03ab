"""Specimens that were measured before and after an event: is the event named? The belief is the state before it."""

from pathlib import Path
from typing import Any

from tissuereg.diagnosis.material import diagnose_material
from tissuereg.io.material_experiments import read_material_experiment

DATA = Path(__file__).resolve().parent / "data"

#: What the data themselves show of each experiment, and the answers that are right.
EVENTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "heart/before": ("relaxed muscle; a neo-Hookean solid is believed", ("stiffening", "relaxation")),
    "heart/after": ("bath of calcium: more stress that relaxes fast, the plateau nearly as before", ("relaxation",)),
    "heart/after-nomava": ("calcium, and the muscle contracts: outside the catalogue", ("unexplained",)),
    "heart/null": ("other preparations, relaxed", ("consistent",)),
    "resin/bioflex-null": ("other specimens", ("consistent",)),
    "resin/bioflex-steam": ("steam: modulus 11 % lower", ("stiffness",)),
    "resin/bioflex-steam-both": ("the same, twice the specimens", ("stiffness",)),
    "resin/bioflex-ethanol": ("ethanol: modulus 9 % higher", ("stiffness",)),
    "resin/bioflex-ethanol-both": ("the same, twice the specimens", ("stiffness",)),
    "resin/gum-null": ("other specimens", ("consistent",)),
    "resin/gum-steam": ("steam: modulus as before", ("consistent",)),
    "resin/gum-steam-both": ("the same, twice the specimens", ("consistent",)),
    "resin/gum-ethanol": ("ethanol: modulus 9 % higher", ("stiffness",)),
    "resin/gum-ethanol-both": ("the same, twice the specimens", ("stiffness",)),
    "resin/silicone-null": ("other specimens", ("consistent",)),
    "resin/silicone-steam": ("steam: modulus within 3 % of before", ("consistent",)),
    "resin/silicone-steam-both": ("the same, twice the specimens", ("consistent",)),
    "resin/silicone-ethanol": ("ethanol: modulus within 3 % of before", ("consistent",)),
    "resin/silicone-ethanol-both": ("the same, twice the specimens", ("consistent",)),
}

HEAD = """
## Specimens before and after an event

Material tests by others, put through `diagnose` with the state before the event as the belief (`data/README.md` says
whose they are and how they were read). *Right*: the verdict, or the whole of the named groups, is what the data show by
means over all specimens; *p left*: p-value of what the answer leaves. The resins were chosen after a look at the data;
nothing of `diagnose` was.

| experiment | what happened | verdict | named, probability | p left | held-out rms: believed; extended, kPa | right |
| --- | --- | --- | --- | --- | --- | --- |
"""


def run(name: str) -> dict[str, Any]:
    """Return the answer on one experiment, as a row of the table."""
    answer = diagnose_material(read_material_experiment(DATA / name)).to_json()
    causes = answer["causes"]
    held_out = causes[0]["held_out"] if causes else {}
    return {
        "experiment": name,
        "verdict": answer["verdict"],
        "named": [" / ".join(cause["group"]) for cause in causes],
        "probability": [cause["probability"] for cause in causes],
        "p_misfit": answer["p_misfit"],
        "rms_kPa": [held_out.get(f"rms_{which}_kpa") for which in ("base", "named")],
    }


def is_right(row: dict[str, Any]) -> bool:
    """Return whether a row states what the data show."""
    wanted = EVENTS[row["experiment"]][1]
    groups = [name.split(" / ") for name in row["named"]]
    if not groups:
        return wanted == (row["verdict"],)
    return len(groups) == len(wanted) and all(any(one in group for group in groups) for one in wanted)


def section(rows: list[dict[str, Any]]) -> str:
    """Return the section of the page."""
    text, right = HEAD, [is_right(row) for row in rows]
    for row, good in zip(rows, right, strict=True):
        pairs = zip(row["named"], row["probability"], strict=True)
        named = ", ".join(f"{name} {chance:.2f}" for name, chance in pairs)
        errors = "; ".join(f"{value:.3g}" for value in row["rms_kPa"] if value is not None)
        cells = (row["experiment"], EVENTS[row["experiment"]][0], row["verdict"], named, f"{row['p_misfit']:.2g}")
        text += f"| {' | '.join(cells)} | {errors} | {'yes' if good else 'no'} |\n"
    return text + f"\n{sum(right)} of {len(rows)} right.\n"
