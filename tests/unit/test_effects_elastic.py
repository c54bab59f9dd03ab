"""What effects do to the simulation of a leaning block where the model is elastic; every one with a number."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import EXPERIMENT, write_experiment
from support.meshes import block
from tissuereg.errors import ExperimentError
from tissuereg.experiment import experiment
from tissuereg.experiment.effects import (
    ActuatorDirection,
    ActuatorGain,
    ActuatorOffset,
    Detachment,
    Frame,
    Gravity,
    Inclusion,
    Latency,
    Layer,
    MarkerSlip,
    MarkerSwap,
    Poisson,
    Reference,
    Scale,
    Stiffness,
    extended,
    seen_markers,
    true_markers,
)
from tissuereg.experiment.effects.regions import Ellipsoid, OuterLayer, share_inside
from tissuereg.experiment.effects.supports import node_areas
from tissuereg.registration.frame import frame_input
from tissuereg.simulation.experiment import simulate_plain


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return tr.read_experiment(write_experiment(tmp_path_factory.mktemp("effects") / "rig"))


@pytest.fixture(scope="module")
def believed(rig):
    return simulate_plain(rig)


def simulated(rig, *effects):
    return simulate_plain(replace(rig, effects=effects))


def same(one, other, *parts):
    """Return whether two simulations agree to the last bit, in some parts or all."""
    for case, answer in one.items():
        for part in parts or ("displacement", "markers", "forces", "targets"):
            mine, theirs = getattr(answer, part), getattr(other[case], part)
            pairs = [(mine[key], theirs[key]) for key in mine] if isinstance(mine, dict) else [(mine, theirs)]
            if not all(np.array_equal(a, b) for a, b in pairs):
                return False
    return True


def test_an_experiment_without_effects_is_solved_as_it_stands(rig, believed):
    assert extended(rig) is rig
    assert same(simulated(rig, Scale(scale=1.01)), believed, "displacement", "forces", "targets")


def test_stiffness_and_ratio_are_those_of_another_belief(rig, believed):
    stiff = simulated(rig, Stiffness(young_kpa=20.0))
    assert same(stiff, simulate_plain(replace(rig, material=tr.Material(20.0, 0.45))))
    # Moved by displacements alone, the body does not feel its modulus; the pusher does, in proportion.
    assert np.abs(stiff["lean"].markers - believed["lean"].markers).max() < 1e-6
    assert np.allclose(stiff["lean"].forces["push"], 2.0 * believed["lean"].forces["push"], rtol=1e-6, atol=1e-6)
    drained = simulated(rig, Poisson(poisson=0.2))
    assert same(drained, simulate_plain(replace(rig, material=tr.Material(10.0, 0.2))))
    assert np.abs(drained["lean"].markers - believed["lean"].markers).max() > 0.01


def test_an_inclusion_of_contrast_one_changes_nothing_and_a_stiff_one_makes_the_push_harder(rig, believed):
    ball = Inclusion(centre_mm=(15.0, 10.0, 20.0), semi_axes_mm=(8.0, 8.0, 8.0), contrast=1.0)
    assert same(simulated(rig, ball), believed)
    push = [
        simulated(rig, replace(ball, contrast=contrast))["lean"].forces["push"][-1, 0] for contrast in (0.3, 1.0, 3.0)
    ]
    assert push[0] < 0.98 * push[1] < push[1] < 0.98 * push[2]


def test_an_inclusion_larger_than_the_body_and_a_layer_thicker_than_it_are_the_stiffness_everywhere(rig):
    stiff = simulated(rig, Stiffness(young_kpa=25.0))
    assert same(stiff, simulated(rig, Inclusion(centre_mm=(15, 10, 20), semi_axes_mm=(99, 99, 99), contrast=2.5)))
    assert same(stiff, simulated(rig, Layer(thickness_mm=99.0, contrast=2.5)))
    assert same(stiff, simulated(rig, Layer(thickness_mm=99.0, contrast=0.5), Stiffness(young_kpa=50.0)))


def test_the_share_of_an_inclusion_is_its_volume(block_mesh):
    for centre, axes in (((15.0, 10.0, 20.0), (8.0, 8.0, 8.0)), ((14.0, 9.0, 22.0), (9.0, 6.0, 12.0))):
        inside = share_inside(Ellipsoid(centre, axes), block_mesh) @ block_mesh.volumes
        # 56 points stand for a tet of about the inclusion's size.
        assert inside == pytest.approx(4.0 / 3.0 * np.pi * np.prod(axes), rel=0.01)
        whole, parts = (share_inside(Ellipsoid(centre, axes), block_mesh, n) for n in (1, 4))
        assert np.allclose(parts.mean(axis=1), whole, rtol=0, atol=1e-12)
        assert parts.std(axis=1).max() > 0.2


def test_a_quarter_of_a_tet_is_what_lies_nearest_to_its_corner():
    tet = tr.Mesh([[0, 0, 0], [8, 0, 0], [0, 8, 0], [0, 0, 8]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    for corner in range(4):
        share = share_inside(Ellipsoid(tuple(tet.nodes[corner]), (3.0, 3.0, 3.0)), tet, 4)[0]
        assert np.argmax(share) == corner
        assert np.delete(share, corner).max() < 0.2 * share[corner]


def test_the_share_of_a_layer_is_its_volume_and_the_held_face_has_none():
    fine = block(cells=(12, 8, 16))
    for thickness in (2.0, 5.0, 8.0):
        inside = share_inside(OuterLayer(fine, thickness), fine) @ fine.volumes
        core = (30.0 - 2 * thickness) * (20.0 - 2 * thickness) * (40.0 - thickness)
        # Depth is linear between corners and centre of a tet, which rounds the core's edges.
        assert inside == pytest.approx(30.0 * 20.0 * 40.0 - core, rel=0.02)
    points = np.array([[15.0, 10.0, 1.0], [15.0, 10.0, 38.5], [1.0, 10.0, 20.0]])
    assert OuterLayer(fine, 3.0).depth(points) == pytest.approx([-7.0, 1.5, 2.0], abs=0.02)


def test_the_share_moves_on_smoothly_with_the_inclusion(block_mesh):
    left = block_mesh.nodes[block_mesh.tets].mean(axis=1)[:, 0] < 15.0

    def volume_left(x):
        share = share_inside(Ellipsoid((x, 10.0, 20.0), (6.0, 6.0, 6.0)), block_mesh)
        return float(share[left] @ block_mesh.volumes[left])

    steps = np.diff([volume_left(x) for x in np.linspace(12.0, 18.0, 121)])
    # A disc of the ball passes a step; no sample point jumps from outside to inside.
    assert steps.max() < 0.0
    assert steps.min() > -2.0 * np.pi * 36.0 * 0.05


def test_weight_acts_where_an_effect_says_so(rig):
    down = simulated(rig, Gravity(direction=(0, 0, -1)))
    hung = replace(rig, gravity=experiment.BodyWeight(np.array([0.0, 0.0, -1.0]), in_reference=False))
    assert same(down, simulate_plain(hung))
    sunk = down["rest"].displacement[0]
    assert sunk[:, 2].min() < -0.1
    # Weight is linear to a few percent here: half as strong, half as deep; turned over, the other way.
    half = simulated(hung, Gravity(g_mm_per_s2=4905.0))["rest"].displacement[0]
    assert half[:, 2].min() == pytest.approx(0.5 * sunk[:, 2].min(), rel=0.1)
    assert simulated(hung, Gravity(direction=(0, 0, 1)))["rest"].displacement[0][:, 2].max() > 0.1


def test_a_detached_ball_is_free_and_the_rest_is_held(rig):
    corner = Detachment(boundary="base", centre_mm=(30.0, 0.0, 0.0), radius_mm=9.0)
    loose = extended(replace(rig, effects=(corner,)))
    freed = np.setdiff1d(rig.mesh.fixed_nodes, loose.mesh.fixed_nodes)
    places = rig.mesh.nodes[rig.mesh.fixed_nodes]
    assert np.array_equal(freed, rig.mesh.fixed_nodes[np.linalg.norm(places - [30.0, 0.0, 0.0], axis=1) <= 9.0])
    assert np.array_equal(loose.boundaries[0].nodes, loose.mesh.node_set("base"))
    moved = simulated(rig, corner)["lean"].displacement[-1]
    assert np.abs(moved[freed]).max() > 0.05
    assert not moved[loose.mesh.fixed_nodes].any()


def test_a_detached_rim_has_the_share_of_the_area_and_lies_towards_the_azimuth(rig):
    base = rig.mesh.fixed_nodes
    area = node_areas(rig.mesh, base)
    assert area.sum() == pytest.approx(30.0 * 20.0)
    for share in (0.1, 0.3, 0.5):
        freed = Detachment(boundary="base", azimuth_deg=90.0, share=share).freed(rig.mesh, base)
        # Right to the area of the node at the edge of the rim.
        assert area[np.isin(base, freed)].sum() == pytest.approx(share * 600.0, abs=area.max())
        assert rig.mesh.nodes[freed, 1].min() >= rig.mesh.nodes[np.setdiff1d(base, freed), 1].max()


def test_a_gain_is_a_larger_motion(rig):
    lean = rig.case("lean")
    larger = replace(lean, displacements={"push": 1.1 * lean.displacements["push"]})
    wanted = simulate_plain(replace(rig, cases={**rig.cases, "lean": larger}))
    assert same(simulated(rig, ActuatorGain(actuator="push", gain=1.1)), wanted)


def test_a_direction_turns_the_motion_and_an_offset_adds_to_it(rig):
    lean = rig.case("lean")
    turned = extended(replace(rig, effects=(ActuatorDirection(actuator="push", rotation_deg=(0, 0, 90.0)),)))
    motion = lean.displacements["push"]
    assert np.allclose(turned.case("lean").displacements["push"], motion[:, [1, 0, 2]] * [-1, 1, 1], atol=1e-12)
    off = extended(replace(rig, effects=(ActuatorOffset(actuator="push", offset_mm=(0.0, 0.5, 0.0)),)))
    assert np.array_equal(off.case("lean").displacements["push"], motion + np.array([0.0, 0.5, 0.0]))
    assert off.case("rest").displacements == {}
    moved = simulated(rig, ActuatorOffset(actuator="push", offset_mm=(0.0, 0.5, 0.0)))["lean"].displacement
    assert (moved[0][rig.actuator("push").nodes] == [0.0, 0.5, 0.0]).all()


def test_a_force_actuator_has_gain_and_direction_too(tmp_path):
    toml = EXPERIMENT.replace('kind = "displacement"', 'kind = "force"')
    applied = "case,time_s,actuator,x_mN,y_mN,z_mN\nlean,10,push,0,0,0\nlean,11,push,50,0,0\n"
    rig = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml, actuators=None, forces_applied=applied))
    effects = (ActuatorGain(actuator="push", gain=2.0), ActuatorDirection(actuator="push", rotation_deg=(0, 0, 90.0)))
    pulled = extended(replace(rig, effects=effects)).case("lean").applied_forces["push"]
    assert pulled == pytest.approx(np.array([[0, 0, 0], [0, 50, 0], [0, 100, 0]]), abs=1e-9)


def test_a_shifted_patch_is_the_one_that_a_shifted_rule_would_catch(rig, tmp_path):
    shift = ActuatorOffset(actuator="push", shift_mm=(0.0, 0.0, -16.0))
    lower = extended(replace(rig, effects=(shift,)))
    toml = EXPERIMENT.replace("centre_mm = [30.0, 10.0, 40.0]", "centre_mm = [30.0, 10.0, 24.0]")
    wanted = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml))
    assert np.array_equal(lower.actuator("push").nodes, wanted.actuator("push").nodes)
    assert np.array_equal(lower.mesh.node_set("push"), wanted.mesh.node_set("push"))
    # A patch without a sphere moves by its outline; 16 mm are two rows of nodes on the side face.
    side = np.flatnonzero((rig.mesh.nodes[:, 0] == 30.0) & (rig.mesh.nodes[:, 2] == 24.0))
    outline = replace(rig, actuators=(replace(rig.actuator("push"), nodes=side, rule="side"),), effects=(shift,))
    assert set(rig.mesh.nodes[extended(outline).actuator("push").nodes, 2]) == {8.0}


def test_frame_and_scale_are_exact_and_touch_markers_alone(rig, believed):
    turned = simulated(rig, Frame(rotation_deg=(0, 0, 90.0), shift_mm=(1.0, 2.0, 3.0)))
    places = believed["lean"].markers
    assert np.allclose(turned["lean"].markers, places[..., [1, 0, 2]] * [-1, 1, 1] + [1, 2, 3], rtol=0, atol=1e-12)
    assert same(turned, believed, "displacement", "forces", "targets")
    stretched = simulated(rig, Scale(scale=1.02, origin_mm=(5.0, 0.0, 0.0)))["lean"].markers
    assert np.allclose(stretched - [5, 0, 0], 1.02 * (places - [5, 0, 0]), rtol=0, atol=1e-12)


def test_late_markers_show_an_earlier_moment(rig, believed):
    times, places = believed["lean"].times, believed["lean"].markers
    late = simulated(rig, Latency(latency_s=0.5))["lean"].markers
    assert times.tolist() == [10.0, 10.5, 11.0]
    assert np.array_equal(late, places[[0, 0, 1]])
    little = simulated(rig, Latency(latency_s=0.1))["lean"].markers
    assert np.allclose(little[1], 0.8 * places[1] + 0.2 * places[0], rtol=0, atol=1e-12)
    assert np.array_equal(little[0], places[0])
    assert np.array_equal(simulated(rig, Latency(latency_s=0.0))["lean"].markers, places)


def test_a_lost_frame_spoils_no_frame_that_is_hit():
    values = np.array([[[1.0] * 3], [[np.nan] * 3], [[3.0] * 3]])
    late = Latency(latency_s=1.0).seen(values, np.array([0.0, 1.0, 2.0]), ["P1"])[:, 0, 0]
    assert late[:2].tolist() == [1.0, 1.0]
    assert np.isnan(late[2])


def test_a_slip_and_a_swap_begin_at_their_time_and_last(rig, believed):
    places = believed["lean"].markers
    slipped = simulated(rig, MarkerSlip(marker="P2", offset_mm=(0.0, 1.0, 0.0), from_time_s=10.5))
    off = slipped["lean"].markers[:, 1] - places[:, 1]
    assert np.allclose(off, [[0, 0, 0], [0, 1, 0], [0, 1, 0]], rtol=0, atol=1e-12)
    assert np.array_equal(slipped["lean"].markers[:, 0], places[:, 0])
    assert np.array_equal(slipped["rest"].markers, believed["rest"].markers)
    swapped = simulated(rig, MarkerSwap(markers=("P1", "P2"), from_time_s=10.7))["lean"].markers
    assert np.array_equal(swapped[:2], places[:2])
    assert np.array_equal(swapped[2], places[2, ::-1])


def test_the_measuring_chain_can_be_undone(rig, believed):
    chain = (
        MarkerSwap(markers=("P1", "P2"), from_time_s=10.5),
        Scale(scale=1.02, origin_mm=(5.0, 0.0, 0.0)),
        MarkerSlip(marker="P2", offset_mm=(0.0, 1.0, 0.0), from_time_s=10.5),
        Frame(rotation_deg=(0.3, 0.0, 2.0), shift_mm=(1.0, 2.0, 3.0)),
    )
    odd = replace(rig, effects=chain)
    places, times = believed["lean"].markers, believed["lean"].times
    seen = seen_markers(odd, places, times)
    assert np.abs(seen - places).max() > 1.0
    assert np.allclose(true_markers(odd, seen, times), places, rtol=0, atol=1e-12)
    # The swap is the last thing that happens, wherever its table stands.
    assert np.array_equal(seen, seen_markers(replace(rig, effects=chain[::-1]), places, times))
    late = replace(rig, effects=(Latency(latency_s=0.5),))
    assert np.array_equal(true_markers(late, seen_markers(late, places, times), times)[:2], places[:2])


def test_registration_gets_the_extended_simulation_and_the_markers_as_they_were(rig):
    swap = MarkerSwap(markers=("P1", "P2"), from_time_s=10.7)
    odd = replace(rig, effects=(Stiffness(young_kpa=7.0), ActuatorGain(actuator="push", gain=2.0), swap))
    given, plain = frame_input(odd, "lean", 11.0), frame_input(rig, "lean", 11.0)
    assert given["mesh"].material.young == 7.0
    assert np.array_equal(given["load"].prescribed, 2.0 * plain["load"].prescribed)
    assert np.array_equal(given["markers"].measured, plain["markers"].measured[::-1])
    assert given["markers"].names == plain["markers"].names


def test_an_effect_that_does_not_fit_is_named_before_anything_is_solved(rig):
    effects = (Scale(scale=1.1), MarkerSlip(marker="P9", offset_mm=(0, 0, 1), from_time_s=0.0))
    with pytest.raises(ExperimentError, match=r"got 'P9' in \[\[effect\]\] number 2 \('marker_slip'\)"):
        simulated(rig, *effects)


def test_a_reference_effect_says_that_the_mesh_hangs_already(rig):
    hung = replace(rig, gravity=experiment.BodyWeight(np.array([0.0, 0.0, -1.0]), in_reference=False))
    assert extended(replace(hung, effects=(Reference(in_reference=True),))).gravity.in_reference
