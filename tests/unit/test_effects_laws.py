"""Effects on law and fibres, in the simulation of a block that is pushed, pulled and leant."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import write_experiment
from tissuereg.experiment.effects import (
    ActuatorDirection,
    ActuatorGain,
    Asymmetry,
    Fibre,
    Inclusion,
    Mooney,
    Stiffening,
    Stiffness,
    extended,
)
from tissuereg.simulation.experiment import simulate_plain


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return tr.read_experiment(write_experiment(tmp_path_factory.mktemp("laws") / "rig"))


def push(rig, *effects, gain=1.0, turn=(0.0, 0.0, 0.0), element="tet4"):
    """Return the force in the last frame of a motion of 2 mm along x, made larger and turned."""
    actuator = (ActuatorGain(actuator="push", gain=gain), ActuatorDirection(actuator="push", rotation_deg=turn))
    lean = replace(rig, cases={"lean": rig.case("lean")}, effects=(*effects, *actuator))
    return simulate_plain(lean, element=element)["lean"].forces["push"][-1]


def test_laws_of_one_modulus_agree_at_small_strain_and_part_at_large(rig):
    plain = Mooney(law="mooney-rivlin", share=0.0)
    for law in (
        Stiffening(law="yeoh", c2_over_c1=1.0, c3_over_c1=0.0),
        Stiffening(law="fung", b=2.0),
        Stiffening(law="veronda-westmann", b=2.0),
    ):
        small = [push(rig, effect, gain=0.01)[0] for effect in (law, plain)]
        large = [push(rig, effect, gain=5.0)[0] for effect in (law, plain)]
        # 0.02 mm on 40 mm: quadratic terms in the strain are of some 1e-3.
        assert small[0] == pytest.approx(small[1], rel=2e-3)
        assert large[0] > 1.05 * large[1]


def test_a_law_with_its_shape_at_zero_is_the_plain_one(rig):
    plain = push(rig, Mooney(law="mooney-rivlin", share=0.0), gain=5.0)
    # Two ways to write mu/2 (I1bar - 3), solved to 1e-9 of the load.
    same = push(rig, Stiffening(law="yeoh", c2_over_c1=0.0, c3_over_c1=0.0), gain=5.0)
    assert same == pytest.approx(plain, rel=1e-6, abs=1e-5)
    second = push(rig, Mooney(law="mooney-rivlin", share=1.0), gain=5.0)
    assert np.linalg.norm(second - plain) > 0.005 * np.linalg.norm(plain)


def test_asymmetry_tells_pull_from_push(rig):
    up, down = (0.0, -90.0, 0.0), (0.0, 90.0, 0.0)
    ratios = []
    for law in (
        Asymmetry(law="ogden", alpha=(2.0,), weight=(1.0,)),
        Asymmetry(law="ogden", alpha=(-12.0,), weight=(1.0,)),
        Asymmetry(law="bimodular", excess=1.0),
    ):
        pulled, pushed = (push(rig, law, gain=2.0, turn=turn)[2] for turn in (up, down))
        assert pulled > 0 > pushed
        ratios.append(-pulled / pushed)
    assert ratios[1] < 0.9 * ratios[0]
    assert ratios[2] > 1.1 * ratios[0]


def test_a_coupled_law_without_shape_is_the_believed_one_and_a_split_one_is_not(rig):
    believed = push(rig, gain=5.0)
    coupled, split = (
        push(rig, Mooney(law="mooney-rivlin", share=0.0, volumetric=form), gain=5.0) for form in ("coupled", "log")
    )
    assert coupled == pytest.approx(believed, rel=1e-6, abs=1e-5)
    assert np.linalg.norm(split - believed) > 1e-4 * np.linalg.norm(believed)


def test_fibres_resist_along_their_direction_and_none_changes_nothing(rig):
    up = (0.0, -90.0, 0.0)
    plain = push(rig, turn=up)[2]
    assert push(rig, Fibre(k1_over_mu=0.0, k2=1.0, direction=(0, 0, 1)), turn=up)[2] == pytest.approx(plain, rel=1e-6)
    along = push(rig, Fibre(k1_over_mu=3.0, k2=1.0, direction=(0, 0, 1)), turn=up)[2]
    across = push(rig, Fibre(k1_over_mu=3.0, k2=1.0, direction=(0, 1, 0)), turn=up)[2]
    assert along > 1.2 * plain
    assert along > 1.1 * across
    turned = push(rig, Fibre(k1_over_mu=3.0, k2=1.0, direction=(0, 0, -2.0)), turn=up)[2]
    assert turned == pytest.approx(along, rel=1e-6)


def test_ten_node_elements_take_an_inclusion_at_their_points(rig):
    small = Inclusion(centre_mm=(28.0, 10.0, 36.0), semi_axes_mm=(3.0, 3.0, 3.0), contrast=5.0)
    field = extended(replace(rig, effects=(small, Stiffness(young_kpa=20.0))), "tet10").material.young_array
    assert field.shape == (360, 4)
    assert (field.min(), 20.0 < field.max() <= 100.0) == (20.0, True)
    assert push(rig, small, element="tet10")[0] > 1.01 * push(rig, element="tet10")[0]
    whole = replace(small, semi_axes_mm=(99.0, 99.0, 99.0))
    stiff = push(rig, Stiffness(young_kpa=50.0), element="tet10")
    assert push(rig, whole, element="tet10") == pytest.approx(stiff, rel=1e-9)
