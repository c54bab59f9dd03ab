"""Effects that need time: what a leaning block does under each of them, with numbers."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import write_experiment
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import (
    Detachment,
    Drainage,
    Gravity,
    Rate,
    Reference,
    Relaxation,
    Set,
    Sliding,
    Softening,
    Stiffness,
    Swelling,
)
from tissuereg.experiment.experiment import Case
from tissuereg.registration.frame import frame_input
from tissuereg.simulation import memory
from tissuereg.simulation.experiment import simulate_plain


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return tr.read_experiment(write_experiment(tmp_path_factory.mktemp("memory") / "rig"))


def case(name, times, motion):
    """Return a case in which the pusher moves along x; None: it is absent."""
    times = np.asarray(times, np.float64)
    unseen = np.full((len(times), 2, 3), np.nan)
    given = {} if motion is None else {"push": np.asarray(motion, np.float64)[:, None] * [1.0, 0.0, 0.0]}
    return Case(name, times, unseen, given)


def simulated(rig, cases, *effects, **options):
    return simulate_plain(replace(rig, cases={c.name: c for c in cases}, effects=effects), **options)


#: At once to 2 mm, held for a long time, and let go.
HOLD = case("hold", [10.0, 10.0001, 11.0, 12.0, 60.0, 60.0001], [0.0, 2.0, 2.0, 2.0, 2.0, 0.0])


def push(answer, name="hold"):
    return answer[name].forces["push"][:, 0]


def test_a_held_stress_relaxes_as_the_series_says(rig):
    elastic = push(simulated(rig, [HOLD]))
    g, tau = 0.38, 1.4
    relaxed = push(simulated(rig, [HOLD], Relaxation(g=(g,), tau_s=(tau,))))
    assert relaxed[1] == pytest.approx(elastic[1], rel=1e-4)
    # The motion is the same, so the whole stress is a factor times the elastic one.
    for frame, held in ((2, 1.0), (3, 2.0), (4, 50.0)):
        assert relaxed[frame] == pytest.approx(elastic[frame] * (1 - g * (1 - np.exp(-held / tau))), rel=1e-3)
    # Let go, the pusher pulls back what has relaxed; that is remembered in the body's own axes, which have turned.
    assert relaxed[5] == pytest.approx(-g * elastic[4], rel=0.1)


def test_each_case_begins_at_rest_where_memory_fades(rig):
    soon = case("soon", [60.1, 60.1001], [0.0, 2.0])
    slow = Relaxation(g=(0.38,), tau_s=(100.0,))
    both = simulated(rig, [HOLD, soon], slow)
    assert push(both, "soon") == pytest.approx(push(simulated(rig, [soon], slow), "soon"), rel=1e-12)
    assert list(both) == ["hold", "soon"]


def test_a_body_that_hangs_has_hung_long_enough(rig):
    still = case("still", [10.0, 20.0], None)
    sag = simulated(rig, [still], Gravity(direction=(0, 0, -1)), Relaxation(g=(0.5,), tau_s=(5.0,)))["still"]
    soft = simulated(rig, [still], Gravity(direction=(0, 0, -1)), Stiffness(young_kpa=5.0))["still"]
    # The relaxed body is the elastic one of half the modulus, to the geometric nonlinearity of a small sag.
    assert sag.displacement[0] == pytest.approx(soft.displacement[0], abs=0.02 * np.abs(soft.displacement[0]).max())
    assert sag.displacement[1] == pytest.approx(sag.displacement[0], abs=1e-5 * np.abs(sag.displacement[0]).max())


def test_viscosity_resists_motion_and_not_holding(rig):
    ramp = case("ramp", [10.0, 11.0, 12.0, 13.0], [0.0, 1.0, 2.0, 2.0])
    elastic, viscous = (
        push(simulated(rig, [ramp], *effects), "ramp") for effects in ((), (Rate(viscosity_kpa_s=2.0),))
    )
    assert viscous[1] > 1.1 * elastic[1]
    assert viscous[3] == pytest.approx(elastic[3], rel=1e-2)
    fast = replace(ramp, times=np.array([10.0, 10.5, 11.0, 11.5]))
    quicker = push(simulated(rig, [fast], Rate(viscosity_kpa_s=2.0)), "ramp")
    # Twice as fast, twice the excess, to the finite strain.
    assert quicker[1] - elastic[1] == pytest.approx(2.0 * (viscous[1] - elastic[1]), rel=0.05)


CYCLES = [
    case(name, start + np.arange(3.0), motion)
    for name, start, motion in (
        ("first", 10.0, [0.0, 2.0, 4.0]),
        ("again", 20.0, [0.0, 2.0, 4.0]),
        ("more", 30.0, [0.0, 2.0, 6.0]),
    )
]


def test_softening_is_carried_from_case_to_case(rig):
    soft = Softening(r=2.0, m_kpa=0.05, beta=0.0)
    elastic, answer = simulated(rig, CYCLES), simulated(rig, CYCLES, soft)
    # Virgin loading is the elastic law's; below the largest load so far the body is softer, at it as stiff again.
    assert push(answer, "first") == pytest.approx(push(elastic, "first"), rel=1e-6, abs=1e-6)
    assert push(answer, "again")[1] < 0.95 * push(elastic, "again")[1]
    assert push(answer, "again")[2] == pytest.approx(push(elastic, "again")[2], rel=1e-3)
    assert push(answer, "more")[2] == pytest.approx(push(elastic, "more")[2], rel=1e-3)
    # In whatever order they stand in the file: the clock says which was first.
    turned = simulated(rig, CYCLES[::-1], soft)
    assert list(turned) == ["more", "again", "first"]
    assert push(turned, "again") == pytest.approx(push(answer, "again"), rel=1e-12)


def test_damage_softens_a_first_load_too_and_stays(rig):
    damage = Softening(r=2.0, m_kpa=0.05, form="damage")
    elastic, answer = simulated(rig, CYCLES), simulated(rig, CYCLES, damage)
    first, again = push(answer, "first"), push(answer, "again")
    assert first[1] < 0.99 * push(elastic, "first")[1]
    # As stiff as it was left: softer than at first on the way, the same at the load that it has seen.
    assert again[1] < 0.97 * first[1]
    assert again[2] == pytest.approx(first[2], rel=1e-6)
    # Never softer than the share that is left where all is damaged.
    assert first[2] > 0.5 * push(elastic, "first")[2]


def test_a_set_stays_into_the_next_case(rig):
    answer = simulated(rig, CYCLES, Set(fraction=0.1))
    assert np.abs(answer["first"].displacement[0]).max() < 1e-6
    left = answer["again"].displacement[0][rig.actuator("push").nodes, 0].mean()
    # The pad is bonded to the shape that is left of the first push: some share of a tenth of 4 mm.
    assert 0.1 < left < 0.4 * 4.0
    moved = answer["again"].displacement[2][rig.actuator("push").nodes, 0].mean()
    assert moved == pytest.approx(left + 4.0, abs=1e-6)


def test_cases_that_share_a_memory_may_not_overlap(rig):
    with pytest.raises(ExperimentError, match="'again' begins at 11 s, before 'first' ends at 12 s"):
        simulated(rig, [CYCLES[0], replace(CYCLES[1], times=np.array([11.0, 12.0, 13.0]))], Set(fraction=0.1))


def test_swelling_follows_the_clock_and_lifts_the_body_that_is_held_below(rig):
    still = case("still", [0.0, 10.0, 20.0, 30.0], None)
    grown = simulated(rig, [still], Swelling(linear_strain=0.02, from_time_s=10.0, to_time_s=30.0))["still"]
    top = grown.displacement[:, rig.mesh.nodes[:, 2] == 40.0, 2].mean(axis=1)
    # Free growth lifts the top by 2 % of 40 mm; the held base adds what it keeps from widening.
    assert top[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert 0.8 < top[3] < 1.1
    assert top[2] == pytest.approx(0.5 * top[3], rel=0.02)


@pytest.mark.parametrize("pads", ["hold", "follow"])
def test_pads_hold_a_body_that_grows_or_follow_it(rig, pads):
    held = case("held", [10.0, 20.0, 30.0], [0.0, 0.0, 0.0])
    growth = Swelling(linear_strain=0.02, from_time_s=0.0, to_time_s=40.0, pads=pads)
    answer = simulated(rig, [held], growth)["held"]
    patch = rig.actuator("push").nodes
    moved = answer.displacement[2][patch].mean(axis=0) - answer.displacement[0][patch].mean(axis=0)
    free = simulated(rig, [case("free", [10.0, 30.0], None)], growth)["free"]
    wanted = (free.displacement[1] - free.displacement[0])[patch].mean(axis=0)
    against = np.linalg.norm(answer.forces["push"][2])
    if pads == "hold":
        np.testing.assert_allclose(moved, 0.0, atol=1e-9)
        assert against > 10.0
    else:
        np.testing.assert_allclose(moved, wanted, rtol=1e-3, atol=1e-4)
        stiff = np.linalg.norm(simulated(rig, [held], replace(growth, pads="hold"))["held"].forces["push"][2])
        assert against < 0.3 * stiff


def test_drainage_relaxes_volume_alone(rig):
    elastic = push(simulated(rig, [HOLD]))
    drained = push(simulated(rig, [HOLD], Drainage(share=0.8, tau_s=1.0)))
    assert drained[1] == pytest.approx(elastic[1], rel=1e-3)
    assert 0.2 * elastic[4] < drained[4] < 0.995 * elastic[4]


def test_sliding_on_stiff_springs_is_holding_and_on_soft_ones_gives_way(rig):
    lean = case("lean", [10.0, 11.0], [0.0, 2.0])
    base = rig.mesh.fixed_nodes
    held = simulated(rig, [lean])["lean"]
    stiff = simulated(rig, [lean], Sliding(boundary="base", spring_kpa_per_mm=1e4))["lean"]
    # Nodes at the edge of the base stand for few springs: they give by some micrometres.
    assert stiff.displacement[1] == pytest.approx(held.displacement[1], abs=0.02)
    assert stiff.forces["push"][1] == pytest.approx(held.forces["push"][1], rel=0.02, abs=2.0)
    slid = simulated(rig, [lean], Sliding(boundary="base", spring_kpa_per_mm=0.02))["lean"]
    assert slid.displacement[1][base, 0].mean() > 0.2
    assert np.abs(slid.displacement[1][base, 2]).max() < 0.02
    assert slid.forces["push"][1, 0] < 0.9 * held.forces["push"][1, 0]
    # All of the push goes through the springs.
    pulled = 0.02 * slid.displacement[1][base, 0].mean() * 600.0
    assert pulled == pytest.approx(slid.forces["push"][1, 0], rel=0.2)


def test_what_has_come_off_a_sliding_base_has_no_springs(rig):
    lean = case("lean", [10.0, 11.0], [0.0, 2.0])
    slide = Sliding(boundary="base", spring_kpa_per_mm=1.0)
    loose = Detachment(boundary="base", azimuth_deg=180.0, share=0.3)
    whole, part = (
        simulated(rig, [lean], *effects)["lean"].forces["push"][1, 0] for effects in ((slide,), (slide, loose))
    )
    assert part < 0.99 * whole


def test_a_boundary_of_loose_nodes_cannot_slide(rig):
    loose = replace(rig, boundaries=(replace(rig.boundaries[0], nodes=rig.mesh.fixed_nodes[:2]),))
    with pytest.raises(
        ExperimentError, match=r"a whole triangle of the surface to slide, it has 2 nodes in \[\[effect\]\]"
    ):
        simulated(loose, [HOLD], Sliding(boundary="base", spring_kpa_per_mm=1.0))


def test_a_mesh_that_hangs_already_stays_where_it_is_and_resists_otherwise(rig):
    still, lean = case("still", [10.0, 20.0], None), case("lean", [30.0, 31.0], [0.0, 2.0])
    heavy = replace(rig, material=replace(rig.material, density=3.0))
    hung = simulated(heavy, [still, lean], Reference(direction=(0, 0, -1), in_reference=True))
    assert np.abs(hung["still"].displacement).max() < 1e-5
    sagging = simulated(heavy, [still, lean], Gravity(direction=(0, 0, -1)))
    assert np.abs(sagging["still"].displacement).max() > 0.5
    plain = simulated(heavy, [lean])
    # A column under its own weight leans more easily.
    assert push(hung, "lean")[1] < 0.99 * push(plain, "lean")[1]


def test_a_base_sticks_until_friction_holds_it_no_more_and_stays_where_it_slid(rig):
    base = rig.mesh.fixed_nodes
    lean, again = case("lean", [10.0, 11.0, 12.0], [0.0, 2.0, 0.0]), case("again", [20.0, 21.0], [0.0, 2.0])
    held = simulated(rig, [lean])["lean"]
    sticks = simulated(rig, [lean], Sliding(boundary="base", friction=0.5, cohesion_kpa=1e3))["lean"]
    assert sticks.displacement[1] == pytest.approx(held.displacement[1], abs=0.02)
    assert sticks.forces["push"][1] == pytest.approx(held.forces["push"][1], rel=0.02, abs=2.0)
    # A coefficient of 0 leaves the cohesion alone: no more than that times the area goes through the base.
    slips = simulated(rig, [lean, again], Sliding(boundary="base", friction=0.0, cohesion_kpa=0.02))
    there, back = slips["lean"].forces["push"][1:, 0]
    assert there == pytest.approx(0.02 * 600.0, rel=0.02)
    assert back < -0.5 * there
    # The next case begins where this one has left the base, and needs no push for it.
    left = slips["again"].displacement[0][base, 0].mean()
    assert left == pytest.approx(slips["lean"].displacement[2][base, 0].mean(), rel=0.5)
    assert left > 0.1
    # Pressed down, more holds.
    rough = simulated(rig, [lean], Sliding(boundary="base", friction=0.5, cohesion_kpa=0.02))["lean"]
    assert rough.forces["push"][1, 0] > 1.05 * there


@pytest.mark.parametrize(
    ("effect", "solved"),
    [
        (Sliding(boundary="base", spring_kpa_per_mm=2.0), 2),
        (Sliding(boundary="base", friction=0.3, cohesion_kpa=0.1), 3),
        (Softening(r=2.0, m_kpa=0.05), 3),
        (Set(fraction=0.1), 6),
        (Relaxation(g=(0.4,), tau_s=(1.0,)), 6),
    ],
    ids=["springs", "friction", "softening", "set", "relaxation"],
)
def test_frames_that_equal_others_are_not_solved(rig, effect, solved, monkeypatch):
    lengths = []

    def counted(mesh, material, times, *given, **rest):
        lengths.append(len(times))
        return solve_frames(mesh, material, times, *given, **rest)

    solve_frames = memory.solve_frames
    monkeypatch.setattr(memory, "solve_frames", counted)
    seen = []
    answer = simulated(rig, [HOLD], effect, progress=lambda done, _: seen.append(done))["hold"]
    assert lengths == [solved]
    assert seen[-1] == len(HOLD.times)
    every = np.arange(len(HOLD.times))
    monkeypatch.setattr(memory, "frames_of_own", lambda *_: (every, every))
    each = simulated(rig, [HOLD], effect)["hold"]
    np.testing.assert_allclose(answer.displacement, each.displacement, atol=1e-4)
    np.testing.assert_allclose(push({"hold": answer}), push({"hold": each}), atol=0.01)


def test_progress_counts_the_frames_of_the_cases_alone(rig):
    said = []
    still = case("still", [10.0, 20.0], None)
    effects = (Gravity(direction=(0, 0, -1)), Relaxation(g=(0.5,), tau_s=(5.0,)))
    simulated(rig, [still, replace(still, name="later")], *effects, progress=lambda done, n: said.append((done, n)))
    assert said[-1] == (4, 4)
    assert [done for done, _ in said] == sorted(done for done, _ in said)


def test_registration_gets_the_relaxed_shape_as_its_simulation(rig):
    effects = (Gravity(direction=(0, 0, -1)), Relaxation(g=(0.5,), tau_s=(0.5,)))
    slow = replace(rig, effects=effects)
    given = frame_input(slow, "lean", 11.0)
    assert np.array_equal(given["simulation"], simulate_plain(slow)["lean"].displacement[2])
    assert "simulation" not in frame_input(rig, "lean", 11.0)
    soft = replace(rig, effects=(Set(fraction=0.1),))
    assert np.array_equal(frame_input(soft, "lean", 11.0)["simulation"], simulate_plain(soft)["lean"].displacement[2])
