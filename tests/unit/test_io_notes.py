"""What headers and comments of files state about frame and unit, in the spellings that people use."""

import contextlib
import time

import pytest

import tissuereg as tr
from support.grids import write_xdmf
from support.meshes import block
from tissuereg.errors import FormatError
from tissuereg.io.notes import frame_in, unit_in


@pytest.mark.parametrize(
    ("note", "frame"),
    [
        *[(f"a liver, {words}", "RAS") for words in ("space:=RAS", "SPACE RAS", "Space: [ras]", "SPACE=R-A-S")],
        *[(f"{key} = RAS (mm)", "RAS") for key in ("coordinateSystem", "Coordinate System", "patient_frame")],
        *[(f"SPACE: {words}", "LPS") for words in ("left_posterior_superior", "Left Posterior Superior", "L, P, S")],
        *[(words, None) for words in ("airspace=RAS", "space of a rasp", "RAST", "SPACE=scanner", "in a space, lip 3")],
    ],
)
def test_a_frame_may_be_spelt_in_many_ways(note, frame):
    assert frame_in([note]) == frame


@pytest.mark.parametrize("note", ["SPACE=ALS", "frame: R-P-S", "coordinateSystem=LAS", "SPACE:=RAS SPACE=LPS"])
def test_other_axes_are_refused(note):
    with pytest.raises(FormatError, match="must be LPS or RAS, got"):
        frame_in([note])


@pytest.mark.parametrize(
    ("note", "unit"),
    [
        *[(f"liver {words}", "m") for words in ("unit: [m]", "length_unit=m", "lengthUnit: 'metre'", "UNITS:=m")],
        *[(f"a liver, {words} cm", "cm") for words in ("lengths in", "coordinates are in", "Dimensions in")],
        *[(words, "mm") for words in ("units (mm)", "units in millimetres", "unit is mm", "unit: mm; units=mm")],
        *[
            (words, None)
            for words in (
                "unit: kPa",
                "units: mmHg",
                "unit in which",
                "a subunit: m",
                "unit cell 3",
                "wavelengths in m",
            )
        ],
    ],
)
def test_a_unit_may_be_spelt_in_many_ways(note, unit):
    assert unit_in([note]) == unit


@pytest.mark.parametrize(
    "note",
    [
        "Units: inches",
        "unit: in",
        "unit = ft",
        "lengths in inches",
        "unit=um",
        "units in micrometers",
        "unit: mm, unit: cm",
    ],
)
def test_other_units_of_length_are_refused(note):
    with pytest.raises(FormatError, match="must be mm, cm or m, got"):
        unit_in([note])


@pytest.mark.parametrize(
    "part", [" ", "space ", "unit ", "unit:=", "coordinate_", "frame: r ", "length units in ", "lengths in "]
)
def test_a_long_comment_takes_no_time(part):
    begin = time.perf_counter()
    with contextlib.suppress(FormatError):
        assert (frame_in([part * 30_000]), unit_in([part * 30_000])) == (None, None)
    assert time.perf_counter() - begin < 2.0


@pytest.mark.parametrize(
    ("note", "frame", "factor"),
    [('<Information Name="SPACE" Value="RAS"/>', "RAS", 1.0), ("<!-- SPACE=LPS unit: cm -->", "LPS", 10.0)],
)
def test_an_xdmf_file_states_them_too(tmp_path, note, frame, factor):
    body = block(cells=(2, 1, 2))
    tags = [1] * len(body.surface)
    path = write_xdmf(tmp_path / "b.xdmf", body.nodes, [("triangle", body.surface), ("tetra", body.tets)], tags)
    path.write_text(path.read_text().replace("<Domain>", f"<Domain>{note}"))
    mesh = tr.read_mesh(path)
    assert (mesh.frame, mesh.extent) == (frame, factor * body.extent)
