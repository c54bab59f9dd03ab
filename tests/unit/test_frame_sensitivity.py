"""Derivatives of frames, from Python, against differences of the whole history."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.errors import LoadError, MaterialError, ShapeError, TissueRegError
from tissuereg.simulation.behaviour import (
    Behaviour,
    Drainage,
    Rate,
    Relaxation,
    Set,
    Skin,
    Softening,
    Springs,
    Swelling,
)
from tissuereg.simulation.frame_sensitivity import (
    FrameObservation,
    Loads,
    Motion,
    frame_adjoints,
    frame_derivatives,
)
from tissuereg.simulation.frames import Acting, FrameSettings, Pad, solve_frames
from tissuereg.simulation.sensitivity import Field, Observation, Parameter

MESH = block(cells=(2, 1, 3))
TOP = np.flatnonzero(MESH.nodes[:, 2] > 39.9)
SIDE = MESH.surface[(MESH.nodes[MESH.surface][..., 0] > 29.9).all(axis=1)]
TIMES = np.array([0.0, 0.6, 1.3, 2.0])
MOTION = np.array([[np.nan] * 3, [1.0, 0.4, -2.0], [0.4, 0.1, -0.8], [np.nan] * 3])
WEIGHT = np.array([1e-3, 0.0, -4e-3])
NUMBERS = {
    "relaxation.g": 0.3,
    "relaxation.tau_s": 0.7,
    "rate.viscosity_kpa_s": 0.5,
    "softening.r": 1.7,
    "softening.m_kpa": 0.1,
    "softening.beta": 0.2,
    "set.fraction": 0.2,
    "drainage.share": 0.3,
    "drainage.tau_s": 1.1,
    "swelling.linear_strain": 0.05,
    "swelling.from_time_s": 0.1,
    "swelling.to_time_s": 1.7,
    "springs.normal_kpa_per_mm": 0.05,
    "springs.tangential_kpa_per_mm": 0.03,
    "skins.young_kpa": 30.0,
    "skins.thickness_mm": 0.4,
    "young": 9.0,
    "poisson": 0.4,
}


def story(element="tet4", *, field=0.0, weight=0.0, motion=0.0, record=False, **moved):
    """Return frames with every behaviour; arguments move a number by how much, dots as underscores."""
    by = {name: moved.get(name.replace(".", "_"), 0.0) for name in NUMBERS}
    v = {name: value + by[name] for name, value in NUMBERS.items()}
    behaviour = Behaviour(
        relaxation=Relaxation([v["relaxation.g"], 0.2], [v["relaxation.tau_s"], 5.0], "isochoric"),
        rate=Rate(v["rate.viscosity_kpa_s"]),
        softening=Softening(v["softening.r"], v["softening.m_kpa"], v["softening.beta"]),
        set=Set(v["set.fraction"]),
        drainage=Drainage(v["drainage.share"], v["drainage.tau_s"]),
        swelling=Swelling(v["swelling.linear_strain"], v["swelling.from_time_s"], v["swelling.to_time_s"]),
    )
    springs = Springs(SIDE, v["springs.normal_kpa_per_mm"], v["springs.tangential_kpa_per_mm"])
    rates = np.linspace(-1.0, 1.0, MESH.n_tets)
    return solve_frames(
        MESH,
        tr.Material(v["young"] + field * rates, v["poisson"]),
        TIMES,
        Acting(
            loads=[tr.Load(body_force=WEIGHT * (1.0 + weight * k)) for k in range(len(TIMES))],
            pads=[Pad("cap", TOP, MOTION * (1.0 + motion))],
            springs=[springs],
            skins=[Skin(SIDE, v["skins.thickness_mm"], v["skins.young_kpa"], 0.3)],
        ),
        behaviour=behaviour,
        settings=FrameSettings(element=element, record=record, tolerance=1e-13),
    )


@pytest.fixture(scope="module", params=["tet4", "tet4-averaged", "tet10"])
def recorded(request):
    return request.param, story(request.param, record=True)


def assert_follows(found, cause, element, step, name):
    plus, minus = (story(element, **{name: sign * step}) for sign in (1.0, -1.0))
    derivative = frame_derivatives(found, [cause])
    for ours, theirs in [
        (derivative.displacement[0], (plus.displacement - minus.displacement) / (2 * step)),
        (derivative.reactions[0], (plus.reactions - minus.reactions) / (2 * step)),
        (derivative.pad_forces["cap"][0], (plus.pad_forces["cap"] - minus.pad_forces["cap"]) / (2 * step)),
    ]:
        assert np.nanmax(np.abs(theirs)) > 0.0
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-5 * np.nanmax(np.abs(theirs)))


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_agree_with_differences(name, recorded):
    element, found = recorded
    assert_follows(found, Parameter(name), element, 1e-5 * max(NUMBERS[name], 0.3), name.replace(".", "_"))


def test_fields_loads_and_motions_agree_with_differences(recorded):
    element, found = recorded
    growing = Loads([tr.Load(body_force=WEIGHT * k) for k in range(len(TIMES))])
    assert_follows(found, Field("young", np.linspace(-1.0, 1.0, MESH.n_tets)), element, 1e-4, "field")
    assert_follows(found, growing, element, 1e-4, "weight")
    assert_follows(found, Motion("cap", MOTION), element, 1e-5, "motion")


def test_adjoints_are_the_transpose_of_derivatives(recorded):
    _, found = recorded
    rng = np.random.default_rng(4)
    weights, held, pull = rng.normal(size=(2, 3)), rng.normal(size=(1, 3)), rng.normal(size=3)
    marker = Observation([20, 5], weights, MESH.fixed_nodes[:1], held)
    seen = [FrameObservation(2, marker, {"cap": pull}), FrameObservation(3, marker)]
    adjoints = frame_adjoints(found, seen)
    n_points = adjoints.young.shape[2]
    assert adjoints.young.shape == adjoints.poisson.shape == (2, MESH.n_tets, n_points)
    fields = rng.normal(size=(2, MESH.n_tets, n_points))
    by = frame_derivatives(found, [Field("young", fields[0]), Field("poisson", fields[1])])
    for k, one in enumerate(seen):
        wanted = np.einsum("ki,cki->c", weights, by.displacement[:, one.frame][:, [20, 5]])
        wanted += by.reactions[:, one.frame, 0] @ held[0]
        if one.pad_weights:
            wanted += by.pad_forces["cap"][:, one.frame] @ pull
        ours = [np.sum(adjoints.young[k] * fields[0]), np.sum(adjoints.poisson[k] * fields[1])]
        np.testing.assert_allclose(ours, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_a_load_of_all_frames_is_the_same_load_in_every_frame(recorded):
    _, found = recorded
    push = tr.Load(body_force=[0.0, 1e-3, 0.0], prescribed=np.full((len(MESH.fixed_nodes), 3), 0.1))
    alike = frame_derivatives(found, [push, Loads([push] * len(TIMES))]).displacement
    np.testing.assert_array_equal(alike[0], alike[1])


def test_frames_that_failed_are_rows_of_nan():
    material, motion = tr.Material(9.0, 0.4), np.outer([-1.0, -60.0, -2.0], [0.0, 0.0, 1.0])
    found = solve_frames(
        MESH, material, [0.0, 1.0, 2.0], Acting(pads=[Pad("cap", TOP, motion)]), settings=FrameSettings(record=True)
    )
    alone = solve_frames(
        MESH, material, [0.0, 2.0], Acting(pads=[Pad("cap", TOP, motion[[0, 2]])]), settings=FrameSettings(record=True)
    )
    assert [frame for frame, _ in found.failed] == [1]
    poisson = Parameter("poisson")
    ours, theirs = (frame_derivatives(frames, [poisson]).displacement[0] for frames in (found, alone))
    assert np.isnan(ours[1]).all()
    np.testing.assert_allclose(ours[[0, 2]], theirs, atol=1e-6 * np.abs(theirs).max())
    marker = Observation([20], [[0.0, 0.0, 1.0]])
    by_tet = frame_adjoints(found, [FrameObservation(2, marker)]).poisson
    np.testing.assert_allclose(by_tet.sum(), ours[2, 20, 2], rtol=1e-9)
    with pytest.raises(LoadError, match="got frame 1 of 3"):
        frame_adjoints(found, [FrameObservation(1, marker)])


def test_what_does_not_fit_is_named():
    pad = Pad("cap", TOP, MOTION)
    unrecorded = solve_frames(MESH, tr.Material(9.0, 0.4), TIMES, Acting(pads=[pad]))
    with pytest.raises(LoadError, match="record=True"):
        frame_derivatives(unrecorded, [Parameter("young")])
    with pytest.raises(LoadError, match="record=True"):
        frame_adjoints(unrecorded, [])
    found = solve_frames(MESH, tr.Material(9.0, 0.4), TIMES, Acting(pads=[pad]), settings=FrameSettings(record=True))
    for error, match, cause in [
        (MaterialError, "SetFraction of this behaviour", Parameter("set.fraction")),
        (MaterialError, "springs 0 of 0", Parameter("springs.normal_kpa_per_mm")),
        (TissueRegError, "got `set.share`", Parameter("set.share")),
        (LoadError, "there is no pad 'hand'; there are cap", Motion("hand", MOTION)),
        (LoadError, "one rate of the load per frame, got 1 for 4", Loads([tr.Load()])),
        (ShapeError, "`rates of pad 'cap'` must have shape", Motion("cap", MOTION[:2])),
        (LoadError, "motion of a pad", Motion("cap", np.full_like(MOTION, np.nan))),
    ]:
        with pytest.raises(error, match=match):
            frame_derivatives(found, [cause])
    with pytest.raises(LoadError, match="there is no pad 'hand'"):
        frame_adjoints(found, [FrameObservation(1, pad_weights={"hand": [1.0, 0.0, 0.0]})])
    with pytest.raises(LoadError, match="which is not held"):
        frame_adjoints(found, [FrameObservation(0, pad_weights={"cap": [1.0, 0.0, 0.0]})])
