"""Stress along a curve: against textbook formulas of another hand, and against a solved block."""

import numpy as np
import pytest

import support.material_curves as made
import tissuereg as tr
from support.meshes import block
from tissuereg import _core
from tissuereg.diagnosis.material.model import Model, stress_of
from tissuereg.errors import ExperimentError, MaterialError
from tissuereg.experiment.effects import EFFECTS
from tissuereg.experiment.effects.history import Rate, Relaxation, Set, Softening, Swelling

#: So near to incompressible that the volume change is far below the tolerances.
GEL = tr.Material(3.0 * made.MU, 0.49999)
LAWS = [
    ("neo-hookean", {}),
    ("bimodular", {"excess": 0.6}),
    ("yeoh", {"c2_over_c1": 0.3, "c3_over_c1": 0.1}),
    ("ogden", {"alpha": [-5.0, 3.0], "weight": [1.0, 2.0]}),
    ("fung", {"b": 0.4}),
    ("hooke", {}),
]


def curve(mode, times, strain):
    return made.measured("a", mode, 0.01, np.asarray(times), np.asarray(strain), np.asarray(strain))


@pytest.mark.parametrize("mode", ["tension", "compression", "simple-shear"])
@pytest.mark.parametrize(
    ("law", "material"),
    [
        (("plain",), GEL),
        (("mooney", 0.4), tr.Material(3.0 * made.MU, 0.49999, "mooney-rivlin", shape={"share": 0.4})),
        (("fung", 1.3), tr.Material(3.0 * made.MU, 0.49999, "fung", shape={"b": 1.3})),
        (("ogden", -7.0), tr.Material(3.0 * made.MU, 0.49999, "ogden", shape={"alpha": [-7.0], "weight": [1.0]})),
    ],
)
def test_laws_agree_with_their_textbook_formulas(mode, law, material):
    times, strain = made.ramp(made.LARGEST[mode], 0.01)
    found = stress_of(Model(material), curve(mode, times, strain))
    # E = 3 mu at no volume change; 0.49999 is off by some 1e-5.
    assert found == pytest.approx(made.elastic(law, mode, strain), rel=2e-4, abs=1e-4)


@pytest.mark.parametrize("mode", ["tension", "compression", "simple-shear"])
def test_relaxation_is_the_hereditary_integral(mode):
    times, strain = made.ramp_and_hold(made.LARGEST[mode], 0.02, 60.0)
    model = Model(GEL).with_effects([Relaxation(g=(0.3, 0.2), tau_s=(2.0, 25.0))])
    summary = made.relaxed(("plain",), mode, times, strain, made.prony((0.3, 2.0), (0.2, 25.0)), n=6000)
    # Steps of the curve against a fine grid.
    assert stress_of(model, curve(mode, times, strain)) == pytest.approx(summary, abs=2e-3 * np.abs(summary).max())


@pytest.mark.parametrize("mode", ["tension", "simple-shear"])
def test_viscosity_softening_and_set_follow_their_formulas(mode):
    times, strain = made.cycles(made.LARGEST[mode], 0.02, n=200)
    path = curve(mode, times, strain)
    flow = made.viscous(mode, times, strain, 3.0)
    middle = (strain[1:-1] - strain[:-2]) * (strain[2:] - strain[1:-1]) > 0
    # First order in the time step, corners of the path left out.
    found = stress_of(Model(GEL).with_effects([Rate(viscosity_kpa_s=3.0)]), path)
    assert found[1:-1][middle] == pytest.approx(flow[1:-1][middle], abs=5e-3 * np.abs(flow).max())
    soft = stress_of(Model(GEL).with_effects([Softening(r=2.0, m_kpa=0.1)]), path)
    assert soft == pytest.approx(made.softened(mode, strain, 2.0, 0.1), abs=1e-3 * np.abs(soft).max())
    if mode == "tension":
        stays = stress_of(Model(GEL).with_effects([Set(fraction=0.1)]), path)
        assert stays == pytest.approx(made.left_strained(mode, strain, 0.1), abs=1e-3 * np.abs(stays).max())


@pytest.mark.parametrize(("law", "shape"), LAWS)
@pytest.mark.parametrize(
    ("numbers", "memory"),
    [
        ({"relaxation": ([0.3, 0.2], [1.0, 8.0], "whole")}, Relaxation(g=(0.3, 0.2), tau_s=(1.0, 8.0))),
        ({"relaxation": ([0.3], [1.0], "isochoric")}, Relaxation(g=(0.3,), tau_s=(1.0,), part="isochoric")),
        ({"viscosity_kpa_s": 2.0}, Rate(viscosity_kpa_s=2.0)),
        ({"softening": ("ogden-roxburgh", 2.0, 0.1, 0.2)}, Softening(r=2.0, m_kpa=0.1, beta=0.2)),
        ({"softening": ("damage", 2.0, 0.1, 0.0)}, Softening(r=2.0, m_kpa=0.1, form="damage")),
        ({"set": 0.1}, Set(fraction=0.1)),
    ],
)
def test_a_sheared_block_in_the_solver_answers_alike(law, shape, numbers, memory):
    material = tr.Material(5.0, 0.45, law, shape=shape)
    times = np.array([1.0, 2.0, 3.0, 6.0, 8.0, 9.0])
    shear = np.array([0.2, 0.4, 0.5, 0.5, 0.1, 0.3])
    # At this rate the first row is one second from rest, as in the solver.
    path = made.Curve("a", "simple-shear", 0.2, times, shear, shear)
    found = stress_of(Model(material).with_effects([memory]), path)
    assert found == pytest.approx(solved(material, numbers, times, shear), rel=1e-8, abs=1e-8)


def test_rows_are_taken_from_the_whole_history_and_without_times_nothing_fades():
    times, strain = made.cycles(0.3, 0.02, n=10)
    fading = [Relaxation(g=(0.5,), tau_s=(3.0,)), Rate(viscosity_kpa_s=2.0)]
    soft = Softening(r=2.0, m_kpa=0.1)
    path = curve("tension", times, strain)
    model = Model(GEL).with_effects([*fading, soft])
    whole, rows = stress_of(model, path), [3, 40, 12]
    assert stress_of(model, path, rows).tolist() == whole[rows].tolist()
    untimed = made.Curve("a", "tension", np.nan, np.full(len(strain), np.nan), 1.0 + strain, strain)
    remaining = stress_of(Model(GEL).with_effects([soft]), untimed)
    assert stress_of(model, untimed) == pytest.approx(remaining, rel=1e-9, abs=1e-9)
    assert np.abs(whole - remaining).max() > 0.1 * np.abs(remaining).max()


def test_a_specimen_has_one_material_and_shows_what_a_material_does():
    path = curve("tension", *made.cycles(0.3, 0.02, n=10))
    fading = Relaxation(g=(0.5,), tau_s=(3.0,))
    with pytest.raises(MaterialError, match="one Young's modulus"):
        stress_of(Model(tr.Material([3.0, 30.0], 0.49)).with_effects([fading]), path)
    with pytest.raises(ExperimentError, match="on the material, got 'swelling'"):
        Model(GEL).with_effects([fading, Swelling(linear_strain=0.1, from_time_s=0.0, to_time_s=1.0)])
    shown = {name for name, effect in EFFECTS.items() if effect.of_specimen}
    laws = {"stiffness", "poisson", "stiffening", "mooney", "asymmetry", "fibre"}
    assert shown == {*laws, "relaxation", "rate", "softening", "set"}


def solved(material, numbers, times, shear):
    """Return the nominal shear stress of a block whose surface moves as simple shear has it."""
    mesh = block((10.0, 10.0, 10.0), (2, 2, 2))
    held = np.flatnonzero(((mesh.nodes == 0.0) | (mesh.nodes == 10.0)).any(axis=1)).astype(np.int64)
    fields = np.full(len(mesh.tets), material.young), np.full(len(mesh.tets), material.poisson)
    body = _core.Body(mesh.nodes, mesh.tets, held)
    rig = _core.Rig(body, *fields, law=material.core_law(), behaviour=_core.Behaviour(**numbers))
    stress = []
    for time, amount in zip([0.0, *times], [0.0, *shear], strict=True):
        moved = np.zeros((len(held), 3))
        moved[:, 0] = amount * mesh.nodes[held, 1]
        frame = rig.advance(time, np.zeros((0, 3)), prescribed=moved)
        # The mean stress of a body is the sum of surface force times place over its volume.
        stress.append(float(frame.reactions[:, 0] @ mesh.nodes[held, 1]) / 1000.0)
    return np.array(stress[1:])
