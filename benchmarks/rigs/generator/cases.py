"""Experiments from clean readings: noise, the tracker's frame, the true modulus, and what the user believes."""

import json
from pathlib import Path

import numpy as np

from rigs.generator.rigs import CASE_TIMES, REST_TIMES, SHARES

DATA = Path(__file__).resolve().parent.parent / "data"
STEP_MM, STEP_MN, MISSING = 1e-3, 1e-1, -(2**31)

#: Noise in the middle of its range; it is scaled by half to twice.
STD_MM, STD_MN = 0.1, 5.0
#: A sensor's noise as a share of the largest force, and what it reads wrong as a share of each: no effect is smaller.
FULL_SCALE, GAUGE = 0.004, 0.01
FRAME_MM, FRAME_DEG = 0.02, 0.02


def shares_of(rig):
    """Return the share of the stroke in every frame."""
    return np.concatenate([np.zeros(len(REST_TIMES)), *(SHARES for _ in rig.loads)])


def commanded(rig, pad_index):
    """Return which frames a pad is present in."""
    name = rig.pads[pad_index].name
    return np.concatenate(
        [np.zeros(len(REST_TIMES), bool), *(np.full(len(CASE_TIMES), name in load.strokes) for load in rig.loads)]
    )


def force_noise(null):
    """Return the middle of the range of the force sensors' noise, mN: of a sensor that bears the largest force."""
    return max(STD_MN, FULL_SCALE * float(np.nanmax(np.abs(null["forces"]))))


def length_of(rig, clean, null, factor):
    """Return how long the change of markers and forces is, in units of noise, without the best factor on forces."""
    marks = (clean["places"] - null["places"])[:, : rig.n_markers] / (STD_MM * factor)
    if not rig.forces:
        return float(np.linalg.norm(marks))
    base = np.nan_to_num(null["forces"])
    scale = np.hypot(force_noise(null) * factor, GAUGE * np.linalg.norm(base, axis=-1, keepdims=True))
    change = ((np.nan_to_num(clean["forces"]) - base) / scale).ravel()
    base = (base / scale).ravel()
    change = change - base * (change @ base) / max(base @ base, 1e-12)
    return float(np.hypot(np.linalg.norm(marks), np.linalg.norm(change)))


def measured_norm(rig, clean, null):
    """Return the length of the change of the markers alone, in units of the middle noise."""
    return float(np.linalg.norm((clean["places"] - null["places"])[:, : rig.n_markers] / STD_MM))


def young_factor(rig, rng):
    """Return the true modulus over the believed mean, drawn from the prior."""
    if rig.factor != 1.0:
        return rig.factor
    relative = rig.young[1] / rig.young[0]
    return float(1 + relative * np.clip(rng.normal(), -2, 2))


def measured(rig, clean, share, factor, std_mn, rng):
    """Return arrays of one experiment: modulus times `share`, noise times `factor`."""
    turn = np.deg2rad(FRAME_DEG) * rng.normal(size=3)
    shift = FRAME_MM * rng.normal(size=3)
    places = clean["places"][:, : rig.n_markers]
    seen = places + np.cross(turn, places) + shift + STD_MM * factor * rng.normal(size=places.shape)
    targets = clean["targets"][:, : rig.n_targets]
    found = {
        "times": clean["times"],
        "markers": _whole(seen, STEP_MM),
        "targets": _whole(targets + 0.05 * rng.normal(size=targets.shape), STEP_MM),
    }
    if rig.forces:
        forces = share * clean["forces"]
        found["forces"] = _whole(forces + std_mn * factor * rng.normal(size=forces.shape), STEP_MN)
    return found


def _whole(values, step):
    whole = np.round(np.nan_to_num(values) / step).astype(np.int64)
    return np.where(np.isnan(values), MISSING, whole).astype(np.int32)


def write_case(name, rig, clean, share, factor, std_mn, rng, gravity=None):
    """Store one experiment."""
    about = {
        "toml": toml(name, rig, clean, factor, std_mn, gravity),
        "labels": [str(label) for label in clean["labels"]],
        "pads": [pad.name for pad in rig.pads],
        "targets": [f"T{k + 1}" for k in range(rig.n_targets)],
        "strokes": {load.name: {k: np.asarray(v).tolist() for k, v in load.strokes.items()} for load in rig.loads},
        "shares": shares_of(rig).tolist(),
    }
    arrays = measured(rig, clean, share, factor, std_mn, rng)
    save(DATA / "cases" / f"{name}.npz", about=np.array(json.dumps(about)), **arrays)


def save(path, **arrays):
    """Write a compressed file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    with partial.open("wb") as file:
        np.savez_compressed(file, **arrays)
    partial.replace(path)


def _row(values, digits=3):
    return "[" + ", ".join(f"{float(v):.{digits}f}" for v in values) + "]"


def rule_of_pad(rig, pad):
    """Return how the user tells the nodes of a pad."""
    if pad.reading == "ball":
        radius = pad.half[0] * (1 + rig.read_error.get(pad.name, 0.0))
        return f"{{ centre_mm = {_row(pad.centre)}, radius_mm = {radius:.3f} }}"
    if pad.reading == "box":
        across = np.cross(pad.normal, pad.along)
        reach = np.abs(pad.along) * pad.half[0] + np.abs(across) * pad.half[1] + 0.2
        return f"{{ low_mm = {_row(pad.centre - reach)}, high_mm = {_row(pad.centre + reach)} }}"
    return f'"{pad.name}"'


def toml(name, rig, clean, factor, std_mn, gravity):
    """Return the experiment's file."""
    law, shape = rig.law
    lines = [f'name = "{name}"', "", "[mesh]", 'file = "mesh.vtu"', "", "[material]", f'law = "{law}"']
    lines += [f"{key} = {value}" for key, value in shape.items()]
    lines += [f"young_kpa = [{rig.young[0]}, {rig.young[1]}]", f"poisson = {rig.poisson}", ""]
    if gravity is not None:
        lines += ["[gravity]", f"direction = {_row(gravity['direction'], 6)}"]
        lines += [f"g_mm_per_s2 = {gravity['g_mm_per_s2']:.3f}", "in_reference = true", ""]
    for hold in rig.holds:
        normal = [float(hold.axis == k) for k in range(3)]
        plane = f"{{ plane = [{', '.join(map(str, [*normal, round(hold.place, 4)]))}], tolerance_mm = 0.1 }}"
        rule = plane if hold.until is None else f'"{hold.name}"'
        lines += ["[[boundary]]", f'name = "{hold.name}"', f"nodes = {rule}", ""]
    for pad in rig.pads:
        lines += ["[[actuator]]", f'name = "{pad.name}"', f"nodes = {rule_of_pad(rig, pad)}", 'kind = "displacement"']
        if rig.stated_edges and pad.reading in ("nodes", "triangles", "box"):
            lines += [f"edge_std_mm = {0.18 * pad.half.min():.2f}"]
        lines += [""]
    if rig.forces:
        lines += ["[forces]", f"std_mN = {std_mn * factor:.4g}", ""]
    lines += ["[markers]", f"std_mm = {STD_MM * factor:.4g}", 'rest_case = "rest"', "", "[markers.reference]"]
    lines += [f"P{k + 1} = {_row(place)}" for k, place in enumerate(clean["marks"][: rig.n_markers])]
    for k, place in enumerate(clean["inner"][: rig.n_targets]):
        lines += ["", "[[target]]", f'name = "T{k + 1}"', f"reference = {_row(place)}"]
    return "\n".join(lines) + "\n"
