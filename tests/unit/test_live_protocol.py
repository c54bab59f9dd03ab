"""Messages of OpenIGTLink: the protocol's own test data, what is packed is unpacked, broken ones are refused."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.spoilt import CHANGES, FUZZED, reads_or_refuses, spoilt
from tissuereg.errors import FormatError
from tissuereg.live import protocol
from tissuereg.live.protocol import HEADER_BYTES, NamedPlace, Status, header_of, message_of, packed

DATA = Path(__file__).resolve().parent.parent / "data" / "openigtlink.txt"
PARTS = re.findall(r"(?m)^([a-z]\w+)\n((?:[0-9a-f]+\n)+)", DATA.read_text())
GOLDEN = {name: bytes.fromhex(text) for name, text in PARTS}
READ = {
    "POINT": protocol.points_in,
    "TRANSFORM": protocol.transform_in,
    "TDATA": protocol.tools_in,
    "STRING": protocol.text_in,
    "STATUS": protocol.status_in,
    "POLYDATA": protocol.surface_in,
}


def opened(data):
    return message_of(header_of(data), data[HEADER_BYTES:])


def read(data):
    """Read a message whose type is a known one."""
    message = opened(data)
    return READ.get(message.header.type, bytes)(message.content)


def test_the_header_of_the_protocol_s_test_data_is_read():
    for name, data in GOLDEN.items():
        header = header_of(data)
        assert header.device == "DeviceName"
        assert header.time_s == 1234567892 / 2**32
        assert header.size == len(data) - HEADER_BYTES
        assert header.version == (2 if name.endswith("Format2") else 1)
    assert len(GOLDEN) == 8


@pytest.mark.parametrize("name", ["transform", "transformFormat2"])
def test_a_pose_of_the_test_data(name):
    np.testing.assert_allclose(read(GOLDEN[name])[:3, 3], [46.0531, 19.4709, 46.0531], atol=1e-4)
    # The first column comes first.
    assert read(GOLDEN[name])[1, 0] == pytest.approx(0.196632)
    assert read(GOLDEN[name])[0, 1] == pytest.approx(-0.196632)


def test_metadata_of_version_two_are_read():
    assert opened(GOLDEN["transformFormat2"]).metadata == {"First patient age": "22", "Second patient age": "25"}


@pytest.mark.parametrize("name", ["tdata", "tdataFormat2"])
def test_tools_of_the_test_data(name):
    found = read(GOLDEN[name])
    assert list(found) == ["Tracker0", "Tracker1", "Tracker2"]
    for pose in found.values():
        np.testing.assert_allclose(pose[:3, 3], [46.0531, 19.4709, 46.0531], atol=1e-4)


def test_points_status_text_and_surface_of_the_test_data():
    points = read(GOLDEN["point"])
    assert [one.name for one in points] == [f"POINT_DESCRIPTION_{i}" for i in range(3)]
    assert [one.place.tolist() for one in points] == [[10, 15, 20], [25, 30, 35], [40, 45, 50]]
    assert [one.radius for one in points] == [5.0, 3.0, 1.0]
    assert read(GOLDEN["status"]) == Status(15, "ACTUATOR_DISABLED", "Actuator A is disabled.")
    assert read(GOLDEN["string"]) == "Welcome to OpenIGTLink"
    cube = read(GOLDEN["polydata"])
    assert cube.points[6].tolist() == [1, 1, 1]
    assert [one.tolist() for one in cube.polygons[:3]] == [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4]]
    assert cube.scalars["attr"].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]


def test_what_is_packed_is_the_test_data_again():
    def again(name, content):
        message = opened(GOLDEN[name])
        return packed(message.header.type, "DeviceName", content, message.header.time_s)

    assert again("tdata", protocol.tools_packed(read(GOLDEN["tdata"]))) == GOLDEN["tdata"]
    assert again("transform", protocol.transform_packed(read(GOLDEN["transform"]))) == GOLDEN["transform"]
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    values = np.arange(8.0)
    cube = read(GOLDEN["polydata"])
    made = read(packed("POLYDATA", "x", protocol.surface_packed(cube.points, triangles, {"attr": values})))
    np.testing.assert_array_equal(made.points, read(GOLDEN["polydata"]).points)
    assert [one.tolist() for one in made.polygons] == triangles.tolist()
    assert made.scalars["attr"].tolist() == values.tolist()


@pytest.mark.parametrize("length", [0, 1, 1024, 1025, 5000, 100_003])
def test_a_long_check_sum_is_the_one_that_goes_bit_by_bit(length):
    data = np.random.default_rng(length).bytes(length)
    if length > 10_000:  # bit by bit takes long: that of all is that of its parts, one after another
        begin = protocol.crc64(data[:-1])
        assert protocol.crc64(data) == by_bits(data[-1:], begin)
    else:
        assert protocol.crc64(data) == by_bits(data, 0)


def by_bits(data, found):
    for byte in data:
        found ^= byte << 56
        for _ in range(8):
            found = (found << 1) ^ (0x142F0E1EBA9EA3693 if found >> 63 else 0)
    return found


def test_a_wrong_check_sum_version_or_length_is_refused():
    good = GOLDEN["point"]
    for spoilt_one, said in (
        (good[:-1] + b"\1", "fit its check sum"),
        (good[:-1], "must be whole"),
        (b"\0\7" + good[2:], "version of a message must be 1, 2 or 3, got 7"),
        (good[:40], "a header must have 58 bytes"),
    ):
        with pytest.raises(FormatError, match=said):
            opened(spoilt_one)


@pytest.mark.parametrize("name", GOLDEN)
@FUZZED
@given(changes=st.lists(CHANGES, min_size=1, max_size=3))
def test_a_broken_message_is_read_or_refused(name, changes):
    message = opened(GOLDEN[name])
    reads_or_refuses(read, spoilt(GOLDEN[name], changes))
    for content in (spoilt(message.content, changes), spoilt(GOLDEN[name], changes)):
        reads_or_refuses(READ[message.header.type], content)
        body = packed(message.header.type, "d", content)[HEADER_BYTES:]
        header = message.header._replace(version=2, size=len(body), crc=protocol.crc64(body))
        reads_or_refuses(partial(message_of, header), body)


def test_names_that_are_too_long_are_cut_at_a_letter():
    name = "é" * 60
    found = read(packed("POINT", "x", protocol.points_packed([NamedPlace(name, np.zeros(3), 1.0)], "", (0, 0, 0, 0))))
    assert found[0].name == "é" * 31
