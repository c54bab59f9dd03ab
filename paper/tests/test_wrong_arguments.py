"""Wrong arguments of the methods and the studies: each works, or is refused by an error of ours that names it."""

import tempfile
from functools import cache

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from support.wrong import ends_well, swept
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.pca import PcaModel
from tissuereg_paper.rivals import RIVALS, Rigid, Setting
from tissuereg_paper.rivals.assimilation import AssimilationSettings, StepOptions, assimilate
from tissuereg_paper.studies import ContestInputs
from tissuereg_paper.studies import run as running


@cache
def mesh():
    return block(cells=(2, 2, 3))


@cache
def markers():
    places = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0]])
    return tr.Markers(places, places + np.array([0.5, 0.0, 0.0]))


@cache
def load():
    return tr.Load(forces=np.where(mesh().nodes[:, 2:] == 40.0, [5.0, 0.0, 0.0], 0.0))


@cache
def quick():
    few = ContactSettings(n_chains=2, n_chains_first=2, max_passes=1, n_kept=1, powers=(1.0,), n_draws=2)
    return tr.RegisterSettings(threads=1, contacts=few)


def setting(**given):
    """What the methods of the comparison are given."""
    good = {"mesh": mesh(), "reference_mm": markers().reference, "std_mm": np.full(3, 0.1), "material": tr.Material()}
    return Setting(**{**good, "threads": 1, **given})


def gaussian():
    return Gaussian(np.zeros(1), np.eye(1))


def assimilated(**given):
    good = {"observed": [1.0], "noise": np.eye(1), "prior": gaussian(), "rng": np.random.default_rng(0)}
    few = AssimilationSettings(n_members=9, min_members=5)
    return assimilate(lambda z: z, **{**good, "settings": few, **given})


def rival(name):
    """Return the constructor of a method, given everything that any of them needs."""
    fields = np.random.default_rng(0).standard_normal((20, mesh().n_nodes, 3))
    model = PcaModel.fit(fields, fields[:0], centre=fields.mean(axis=0), n_latent=3, card={})
    whole = setting(fields=fields, model=model, load=load())
    return lambda **given: RIVALS[name](**{"setting": whole, **given})


def reproduced(**given):
    """Check the arguments of the paper's studies, of which none is run."""
    with pytest.MonkeyPatch.context() as changed, tempfile.TemporaryDirectory() as folder:
        changed.setattr(running, "_simulated", lambda *_, **__: {})
        changed.setattr(running, "_delivered", lambda *_, **__: None)
        return running.reproduce(**{"out": folder, **given})


#: Every method and the studies: a call that works.
CALLS = {
    "StepOptions": (StepOptions, {"form": "stochastic", "factorisation": "auto"}),
    "assimilate": (
        lambda **given: assimilated(**given),
        {
            "observed": [1.0],
            "noise": np.eye(1),
            "prior": gaussian(),
            "rng": np.random.default_rng(0),
            "settings": AssimilationSettings(n_members=9, min_members=5),
            "perturbations": lambda step, shape: np.ones(shape),
        },
    ),
    "AssimilationSettings": (
        AssimilationSettings,
        {
            "n_members": 9,
            "n_steps": 2,
            "schedule": "geometric",
            "decrease": 2.0,
            "options": StepOptions(),
            "min_members": 5,
            "threads": 1,
        },
    ),
    "Setting": (
        setting,
        {
            "mesh": mesh(),
            "reference_mm": markers().reference,
            "std_mm": np.full(3, 0.1),
            "material": tr.Material(),
            "load": None,
            "model": None,
            "fields": np.zeros((1, mesh().n_nodes, 3)),
            "frame_s": 0.025,
            "seed": 0,
            "threads": 1,
        },
    ),
    "Rival.register": (
        lambda **given: Rigid(setting()).register(**{"measured_mm": markers().measured, **given}),
        {"measured_mm": markers().measured, "simulation_mm": np.zeros((mesh().n_nodes, 3))},
    ),
    "LinearElastic": (rival("linear elastic"), {"setting": None, "smooth": False}),
    "Libr": (rival("LIBR"), {"n_cells": 4, "energy_weight": 1.0}),
    "LinearResidual": (rival("linear residual"), {"window": 3, "memory_s": 0.1}),
    "ParameterInference": (
        rival("parameter inference"),
        {
            "stiffness_std": 0.5,
            "load_std": 0.5,
            "drift": 0.1,
            "n_members": 8,
            "n_steps": 2,
            "later_steps": 1,
            "spread": False,
        },
    ),
    "PcaEsMda": (rival("PCA-26 + ES-MDA"), {"n_latent": 3, "n_members": 9, "n_steps": 2}),
    "OneStepSmoother": (rival("one-step ES in latents"), {"n_members": 9, "spread": False}),
    "LatentFilter": (rival("EnKF in latents"), {"memory_s": 1.0, "n_members": 9, "spread": False}),
    "EnsembleOfSimulations": (rival("ensemble of simulations"), {"error_mm": 0.1}),
    "PhysicsPrior": (rival("tissuereg, physics prior"), {"spread": False, "settings": quick()}),
    "reproduce": (
        reproduced,
        {
            "studies": ["table2", "fig8"],
            "out": "out",
            "model": None,
            "contest": ContestInputs(),
            "seed": 0,
            "threads": 1,
            "progress": None,
        },
    ),
    "ContestInputs": (
        ContestInputs,
        {"data": "rigs", "fields": None, "variants": None, "methods": ["rigid"], "keep": None},
    ),
}

#: What a message may call an argument instead of its name; several are split by bars.
CALLED = {
    "reference_mm": "marker",
    "measured_mm": "marker",
    "model": "model",
    "observed": "noise",
    "schedule": "coefficients",
}


@pytest.mark.parametrize(("call", "argument", "wrong"), swept(CALLS))
def test_a_wrong_argument_works_or_is_named(call, argument, wrong):
    good = next(given for each, given in CALLS.values() if each is call)
    given = {name: value for name, value in good.items() if value is not None}
    ends_well(call, argument, CALLED, **{**given, argument: wrong})


@pytest.mark.parametrize("call", CALLS, ids=str)
def test_the_call_that_is_swept_works_with_good_arguments(call):
    function, good = CALLS[call]
    function(**{name: value for name, value in good.items() if value is not None})
