"""Variants of rigs, by this package's solver: ``python -m twin.variants OUT`` (`make -C paper variants`).

What is uncertain of a rig is drawn anew: inclusion, law, Poisson's ratio, base, and the actuators' pose about the known
one. What a user knows stays: the body, the pads, their strokes. Nothing of the rig's truth is used, but the ranges are
those of the truth; with ``--halved`` they are wrong by half. Each rig is one file; a run that was stopped goes on.

=================  =====================================  ===========================================================
array              shape                                  what
=================  =====================================  ===========================================================
``field_mm``       (n_variants, n_levels, n_nodes, 3)     displacement at equal steps of the strokes, half precision
``push_mN``        (n_variants, n_levels)                 how hard the pads push there along their strokes together
``young_kpa``      (2,)                                   least and largest Young's modulus with which they are taken
=================  =====================================  ===========================================================

Levels without an equilibrium are NaN. Young's modulus is the believed one: a body that is pushed by forces moves as a
softer one under smaller forces.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from tissuereg.errors import ConvergenceError
from tissuereg.io.fields import write_npz
from tissuereg.phantom import phantom_mesh
from tissuereg_paper.studies.believed import BELIEVED, Believed
from tissuereg_paper.studies.rigs import read_rig
from tissuereg_paper.studies.variants import YOUNG_KPA
from twin.pairs import true_path
from twin.rig import DEVELOPMENT_SEEDS, SCENARIOS, SEEDS, about_known_pose, draw

#: Recordings, by kind.
RIGS = Path(__file__).resolve().parent

#: Variants of a rig, and the seed of the first one's draw.
N_VARIANTS, FIRST = 24, 20_000

#: Shares of the strokes; softer bodies go farther under the measured force than the actuators did.
SHARES = np.array([0.25, 0.5, 0.75, 1.0, 1.25])


def halved(rig):
    """Return a rig of half the stiffening, contrast and base stiffness, and twice as far from incompressible."""
    return replace(
        rig,
        alpha=0.5 * rig.alpha,
        poisson=0.5 - 2.0 * (0.5 - rig.poisson),
        inclusion_contrast=1.0 + 0.5 * (rig.inclusion_contrast - 1.0),
        base_along=0.5 * rig.base_along,
        base_across=0.5 * rig.base_across,
    )


def variant(scenario, seed, number):
    """Return a rig with the known actuators of another one: what else it is made of is drawn by `number`."""
    known = draw(scenario, seed).actuators
    other = draw(scenario, FIRST + 100 * seed + number)
    rng = np.random.default_rng([29, scenario, seed, number])
    actuators = tuple(about_known_pose(one, rng) for one in known)
    return replace(other, actuators=actuators, young=float(BELIEVED.young))


def main():
    """Make what is missing."""
    parser = argparse.ArgumentParser(prog="python -m twin.variants", description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--development", action="store_true", help="of the rigs on which methods are tuned")
    parser.add_argument("--scenario", type=int, choices=list(SCENARIOS), help="only its rigs, as one of two processes")
    parser.add_argument("--halved", action="store_true", help="drawn from ranges that are wrong by half")
    options = parser.parse_args()
    youngs = np.array(YOUNG_KPA) * (0.5 if options.halved else 1.0)
    options.out.mkdir(parents=True, exist_ok=True)
    mesh = phantom_mesh()
    for scenario in SCENARIOS if options.scenario is None else (options.scenario,):
        for seed in DEVELOPMENT_SEEDS[scenario] if options.development else SEEDS:
            name = f"{draw(scenario, seed).name}.npz"
            path = options.out / name
            if path.exists():
                continue
            recording = read_rig(RIGS / ("development" if options.development else "rigs") / name)
            if not Believed(recording, mesh, 1).simulated:
                print(f"{path.stem}: the believed body has no equilibrium under its pads", flush=True)
                continue
            fields = np.full((N_VARIANTS, len(SHARES), mesh.n_nodes, 3), np.nan, np.float16)
            pushes = np.full((N_VARIANTS, len(SHARES)), np.nan)
            for number in range(N_VARIANTS):
                rig = variant(scenario, seed, number)
                rig = halved(rig) if options.halved else rig
                try:
                    found, forces = true_path(rig, mesh, shares=SHARES)
                except ConvergenceError as error:
                    print(f"{path.stem}, variant {number}: {error}", flush=True)
                    continue
                fields[number, : len(found)] = found
                if len(found):
                    pushes[number, : len(found)] = recording.push(forces)
            write_npz(path, {"field_mm": fields, "push_mN": pushes, "young_kpa": youngs})
            print(f"{path.stem}: {int(np.isfinite(pushes).sum())} of {pushes.size} equilibria", flush=True)


if __name__ == "__main__":
    main()
