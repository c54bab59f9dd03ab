"""Wrong arguments of every public name: each works, or is refused by an error of ours that names the argument."""

import inspect
import math
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from support.files import GOOD_MARKERS, write_experiment
from support.meshes import block
from support.rigs import rig
from tissuereg.contacts.settings import ContactSettings
from tissuereg.effects import EFFECTS
from tissuereg.errors import TissueRegError
from tissuereg.io.experiments import read_experiment
from tissuereg.simulate.fine import FineMeshing

#: What no argument of ours is, or only few are.
WRONG = {
    "None": None,
    "a word": "words",
    "an empty text": "",
    "bytes": b"\xff",
    "a null byte": "a\0b",
    "a long text": "a" * 5000,
    "true": True,
    "minus one": -1,
    "zero": 0,
    "a fraction": 1.5,
    "nan": math.nan,
    "infinity": math.inf,
    "a huge number": 1e300,
    "a huge count": 10**30,
    "a complex number": 1j,
    "an object": object(),
    "a class": int,
    "an empty list": [],
    "a ragged list": [[1.0], [2.0, 3.0]],
    "a list of None": [None, None, None],
    "a mapping": {"a": 1},
    "a mapping of numbers": {1: (0.0, 0.0, 0.0)},
    "a cube of zeros": np.zeros((2, 2, 2)),
    "numbers as text": np.array(["a", "b", "c"]),
    "nan thrice": np.full(3, np.nan),
}


@cache
def mesh():
    return block(cells=(2, 2, 3))


@cache
def markers():
    places = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0]])
    return tr.Markers(places, places + [0.5, 0.0, 0.0])


@cache
def quick():
    few = ContactSettings(n_chains=2, n_chains_first=2, max_passes=1, n_kept=1, powers=(1.0,), n_draws=2)
    return tr.RegisterSettings(contacts=few)


@cache
def registered():
    return tr.register(mesh(), markers(), targets={"deep": (15.0, 10.0, 20.0)}, settings=quick(), threads=1)


@cache
def load():
    return tr.Load(forces=np.where(mesh().nodes[:, 2:] == 40.0, [5.0, 0.0, 0.0], 0.0))


@cache
def simulator():
    return tr.Simulator(mesh())


def registration(**changed):
    given = {"mesh": mesh(), "markers": markers(), "settings": quick(), "threads": 1}
    return tr.register(**{**given, **changed})


def experiment_with(**changed):
    from dataclasses import replace

    return replace(rig(), **changed)


#: Every public function and class: a call that works, and what its arguments are called in messages besides.
CALLS = {
    "Mesh": (tr.Mesh, {"nodes": mesh().nodes, "tets": mesh().tets, "node_sets": {"fixed": [0, 1, 2]}}),
    "Mesh.node_set": (mesh().node_set, {"name": "fixed"}),
    "Mesh.with_node_set": (mesh().with_node_set, {"name": "other", "indices": [0, 1]}),
    "Mesh.surface_nodes_within": (mesh().surface_nodes_within, {"centre": (0, 0, 0), "radius": 9.0}),
    "Markers": (
        tr.Markers,
        {"reference": markers().reference, "measured": markers().measured, "std": 0.1, "names": ["a", "b", "c"]},
    ),
    "Markers.only": (markers().only, {"keep": [0, 1]}),
    "Material": (
        tr.Material,
        {
            "young": 10.0,
            "poisson": 0.4,
            "law": "fung",
            "density": 1.0,
            "shape": {"b": 1.0},
            "volumetric": "log",
            "fibre": tr.Fibre(),
        },
    ),
    "Material of fibres": (
        lambda **fibre: tr.Material(fibre=tr.Fibre(**fibre)),
        {"k1_over_mu": 1.0, "k2": 1.0, "direction": (0, 0, 1.0), "tension_only": True},
    ),
    "Material.scaled": (tr.Material().scaled, {"factor": 2.0}),
    "Material.weight": (tr.Material().weight, {"direction": (0, 0, -1.0), "g": 9810.0}),
    "Load": (
        lambda **parts: tr.simulate(mesh(), tr.Load(**parts), tr.Material(), threads=1),
        {
            "forces": load().forces,
            "body_force": (0, 0, 0.001),
            "prescribed": np.zeros((len(mesh().fixed_nodes), 3)),
            "traction": (mesh().surface[:2], (0.0, 0.0, 0.01)),
        },
    ),
    "simulate": (
        tr.simulate,
        {
            "mesh": mesh(),
            "load": load(),
            "material": tr.Material(),
            "element": "tet4",
            "held_nodes": mesh().fixed_nodes,
            "tolerance": 1e-6,
            "threads": 1,
        },
    ),
    "Simulator": (
        tr.Simulator,
        {"mesh": mesh(), "element": "tet4", "held_nodes": mesh().fixed_nodes, "springs": (), "rests": True},
    ),
    "Simulator.solve": (
        lambda **given: simulator().solve(**given),
        {
            "load": load(),
            "material": tr.Material(),
            "tolerance": 1e-6,
            "threads": 1,
            "method": "auto",
            "max_iterations": 50,
            "load_steps": 0,
            "start": np.zeros((mesh().n_nodes, 3)),
        },
    ),
    "Simulator.solve_many": (
        lambda **given: simulator().solve_many(**given),
        {"loads": [load()], "materials": [tr.Material()], "progress": None, "threads": 1},
    ),
    "Simulator.internal_forces": (
        lambda **given: simulator().internal_forces(**given),
        {"displacement": np.zeros((mesh().n_nodes, 3)), "material": tr.Material(), "springs": None},
    ),
    "RegisterSettings": (tr.RegisterSettings, {"n_members": 9, "n_steps": 2, "decrease": 2.0, "contacts": quick().contacts}),
    "ContactSettings": (ContactSettings, {"n_slots": 3, "odds": 0.8, "sizes": (0.1,), "weight": (0.1, 2.0)}),
    "register": (
        registration,
        {
            "mesh": mesh(),
            "markers": markers(),
            "surface": None,
            "model": None,
            "simulation": None,
            "targets": {},
            "load": None,
            "material": tr.Material(),
            "element": "auto",
            "held": "sure",
            "held_nodes": None,
            "frame": "known",
            "stiffness": "believed",
            "seed": 0,
            "threads": 1,
            "settings": quick(),
            "polish": False,
            "ensemble": 0,
            "progress": None,
        },
    ),
    "register of a surface": (
        lambda **given: registration(markers=None, **given),
        {"surface": mesh().nodes[mesh().surface_nodes], "surface_std": 0.1},
    ),
    "Registration.draws": (lambda **given: registered().draws(**given), {"count": 2}),
    "Registration.target": (lambda **given: registered().target(**given), {"name": "deep"}),
    "Target.region": (lambda **given: registered().target("deep").region(**given), {"share": 0.9}),
    "Region.contains": (lambda **given: registered().target("deep").region().contains(**given), {"point": (0, 0, 0)}),
    "diagnose": (
        # Refused before the bank of causes is made, or not at all.
        lambda **given: tr.diagnose(**{"experiment": experiment_with(cases={}), **given}),
        {"experiment": None, "seed": 0, "threads": 1, "keep": False, "element": "tet4", "progress": None},
    ),
    "simulate_experiment": (
        lambda **given: tr.simulate_experiment(**{"experiment": rig(), "model": "plain", **given}),
        {"experiment": None, "model": "plain", "element": "tet4", "threads": 1, "progress": None},
    ),
    "register_frame": (
        lambda **given: tr.register_frame(**{"experiment": rig(), "settings": quick(), "threads": 1, **given}),
        {"experiment": rig(), "case": "down", "time": 12.0, "element": "tet4", "threads": 1},
    ),
    "Experiment.frame": (rig().frame, {"case": "down", "time": 12.0}),
    "Experiment.actuator": (rig().actuator, {"name": "top"}),
    "Experiment": (
        experiment_with,
        {
            "name": "rig",
            "mesh": rig().mesh,
            "material": rig().material,
            "young_std": 3.0,
            "poisson_std": None,
            "gravity": None,
            "boundaries": rig().boundaries,
            "actuators": rig().actuators,
            "marker_names": rig().marker_names,
            "marker_reference": rig().marker_reference,
            "marker_std": 0.05,
            "targets": {},
            "cases": rig().cases,
            "force_std": 2.0,
            "rest_case": "rest",
            "effects": (),
            "trial_share": 0.0,
            "surface_std": 0.0,
            "surface_length": None,
            "simulated": None,
        },
    ),
    "FineModel": (
        lambda **given: tr.FineModel(**{"experiment": rig(), **given}),
        {"experiment": rig(), "meshing": FineMeshing(rim_edge=2.0)},
    ),
    "FineMeshing": (FineMeshing, {"rim_edge": 0.5, "growth": 1.0, "edge_share": 0.5, "cut": True}),
}

#: What a message may call an argument instead of its name.
CALLED = {
    "tets": "tet",
    "node_sets": "node set",
    "reference": "marker",
    "measured": "marker",
    "std": "std",
    "case": "case",
    "shape": "`b`",
    "direction": "direction",
    "held_nodes": "held",
    "nodes": "node",
    "indices": "node set",
    "experiment": "experiment",
    "fibre": "Fibre",
    "targets": "target",
    "factor": "factor",
    "markers": "marker",
    "model": "model",
    "traction": "traction",
    "prescribed": "prescribed",
}

SWEPT = [
    pytest.param(call, argument, wrong, id=f"{name}({argument}={what})")
    for name, (call, good) in CALLS.items()
    for argument in good
    for what, wrong in WRONG.items()
]


def ends_well(call, argument, **given):
    """Run a call; what is wrong must be an error of ours that names the argument."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            call(**given)
        except TissueRegError as error:
            said = f"{error} {error.where}"
            assert argument in said or CALLED.get(argument, argument) in said, said
            assert len(said) < 2000, "a message is for reading"


@pytest.mark.parametrize(("call", "argument", "wrong"), SWEPT)
def test_a_wrong_argument_works_or_is_named(call, argument, wrong):
    good = next(given for each, given in CALLS.values() if each is call)
    given = {name: value for name, value in good.items() if value is not None}
    ends_well(call, argument, **{**given, argument: wrong})
