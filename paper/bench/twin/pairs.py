"""Pairs of simulation and truth of rigs, by our own solver: ``python -m twin.pairs OUT`` (`make -C paper pairs`).

A model that is calibrated with them (``tissuereg calibrate --pairs OUT``) knows how bodies that pads press differ from
their simulations. Rigs are drawn as those of the twin, of other seeds; the truth has four-node elements on the mesh of
the model, and no element, node or solver of the twin's. Each rig is one file; a run that was stopped goes on.
"""

import argparse
from pathlib import Path

import numpy as np

import tissuereg as tr
from tissuereg.errors import ConvergenceError
from tissuereg.io.fields import write_npz
from tissuereg.phantom import phantom_mesh
from tissuereg_paper.studies.believed import Believed, moved_by_pads
from tissuereg_paper.studies.rigs import Pad
from tissuereg_paper.studies.rigs import Rig as Recording
from twin.rig import FRAME_S, PAIR_SEEDS, SCENARIOS, draw

#: Shares of the strokes at which the truth is solved, and those of them that become pairs.
SHARES, PAIRED = np.arange(1, 9) / 8.0, (1, 3, 5, 7)

#: Four-node tetrahedra lock at larger Poisson's ratios.
_MOST_POISSON = 0.47


def true_path(rig, mesh, threads=1, shares=SHARES):
    """Return displacements (n, n_nodes, 3) in mm and forces of the pads (n, n_pads, 3) in mN, as far as there are."""
    base = mesh.surface[np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)]
    pads = [mesh.surface_nodes_within(one.centre, one.radius) for one in rig.actuators]
    whole = np.array([one.stroke * one.direction for one in rig.actuators])
    held, strokes, of_pad = moved_by_pads(pads, whole, np.zeros(0, np.int64))
    springs = [(base, np.array([rig.base_across, rig.base_along]))]
    simulator = tr.Simulator(mesh, held_nodes=held, springs=springs)
    young = rig.young * rig.contrast(mesh.nodes[mesh.tets].mean(axis=1))
    shape = {"alpha": [rig.alpha], "weight": [1.0]}
    material = tr.Material(young, min(rig.poisson, _MOST_POISSON), law="ogden", shape=shape)
    fields, forces = [], []
    for share in shares:
        load = tr.Load(prescribed=share * strokes)
        try:
            found = simulator.solve(load, material, start=fields[-1] if fields else None, threads=threads)
        except ConvergenceError:
            break
        fields.append(found.displacement)
        forces.append([found.reactions[of_pad == number].sum(axis=0) for number in range(len(pads))])
    return np.array(fields), np.array(forces)


def pairs_of(rig, mesh, threads=1):
    """Return simulations and truths (n, n_nodes, 3) in mm of a rig: equal pushes, as in the phantom experiment."""
    truths, forces = true_path(rig, mesh, threads)
    none = np.zeros((len(truths), 0, 3))
    recording = Recording(
        name=rig.name,
        scenario=rig.scenario,
        seed=rig.seed,
        pads=tuple(Pad(one.known_centre, one.stroke * one.known_direction, one.radius) for one in rig.actuators),
        frame_s=FRAME_S,
        motion=SHARES[: len(truths)],
        reference_mm=np.zeros((0, 3)),
        sensor_mm=np.array([0.0, 0.0, 20.0]),
        inner_mm=np.zeros((0, 3)),
        shares=SHARES[: len(truths)],
        marker_levels_mm=none,
        sensor_levels_mm=np.zeros((len(truths), 3)),
        inner_levels_mm=none,
        pad_forces=forces,
        truth={},
    )
    path = Believed(recording, mesh, threads).path
    taken = [level for level in PAIRED if level < len(truths)]
    simulations = path.fields_at(path.shares_of(recording.push(forces)))
    return simulations[taken], truths[taken]


def main():
    """Make what is missing."""
    parser = argparse.ArgumentParser(prog="python -m twin.pairs", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenario", type=int, choices=list(SCENARIOS), help="only its rigs, as one of two processes")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    mesh = phantom_mesh()
    for seed in PAIR_SEEDS:
        for scenario in SCENARIOS if options.scenario is None else (options.scenario,):
            rig = draw(scenario, seed)
            path = options.out / f"pairs_{scenario}-{seed}.npz"
            if path.exists():
                continue
            try:
                simulations, truths = pairs_of(rig, mesh)
            except ConvergenceError as error:
                print(f"{rig.name}: {error}", flush=True)
                simulations = truths = np.zeros((0, mesh.n_nodes, 3))
            arrays = {"simulation_mm": simulations.astype(np.float32), "truth_mm": truths.astype(np.float32)}
            write_npz(path, arrays)
            print(f"{rig.name}: {len(truths)} pairs", flush=True)


if __name__ == "__main__":
    main()
