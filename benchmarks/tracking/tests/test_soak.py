"""What is said of an hour of frames, and that broken messages are broken."""

from types import SimpleNamespace

import numpy as np
import pytest

from support.openigtlink import point_message
from tissuereg.errors import FormatError
from tissuereg.live.protocol import HEADER_BYTES, header_of, message_of, points_in
from tracking import soak


def test_the_slope_of_the_memory_is_that_after_the_first_minutes():
    rows = [{"s": 60.0 * k, "rss_mb": 200.0 + 10.0 * min(k, 5) + 0.5 * k / 60.0} for k in range(1, 61)]
    kept, slope = soak.settled(rows)
    assert (kept[0]["s"], len(kept)) == (360.0, 55)
    assert slope == pytest.approx(0.5)
    kept, slope = soak.settled(rows[:3])
    assert len(kept) == 3
    assert slope == pytest.approx(10.0 * 60.0 + 0.5)


def test_latencies_are_those_of_the_frames_that_were_answered_and_waits_are_not_the_sockets():
    sent = [10.0 + 0.05 * k for k in range(6)]
    answers = [  # frame, when its targets came, own time
        (0, 10.020, 15.0),
        (2, 10.130, 20.0),
        (3, 10.160, 20.0),  # sent at 10.15, after the answer before it
        (4, 10.290, 30.0),
        (5, 10.300, 5.0),  # sent at 10.25, before: it waited
    ]
    said = [(came, {"time_s": 77.5 + 0.05 * k, "step_ms": own}) for k, came, own in answers]
    ear = SimpleNamespace(answers=said, bytes=5e6)
    live = SimpleNamespace(used=lambda: {"rss_mb": 100.0})
    row = soak._minute(live, ear, sent, 20.0, 60.0)
    assert ear.answers == []
    assert (row["answered"], row["matched"], row["rss_mb"], row["read_mb"]) == (5, 5, 100.0, 5.0)
    assert row["total_50_ms"] == pytest.approx(30.0)
    assert row["total_max_ms"] == pytest.approx(90.0)
    assert row["step_50_ms"] == 20.0
    assert row["step_10_ms"] == pytest.approx(9.0)
    # Of the first four: 5, 10, -10 and 60 ms.
    assert row["added_50_ms"] == pytest.approx(7.5)
    assert row["added_max_ms"] == pytest.approx(60.0)


def test_messages_are_broken_in_every_way():
    good = point_message(np.zeros((3, 3)), time_s=5.0)
    rng, found = np.random.default_rng(0), {}
    for _ in range(400):
        how, data = soak.broken([good], rng)
        found.setdefault(how, []).append(data)
    assert set(found) == {"bytes", "content", "length", "numbers", "half", "noise", "huge", "extended"}
    # Those whose check sum is right come as far as their content.
    for how in ("content", "numbers", "length", "extended"):
        for data in found[how]:
            header = header_of(data)
            assert header.size == len(data) - HEADER_BYTES
            if how != "extended":  # whose parts may have any length
                assert message_of(header, data[HEADER_BYTES:]).content == data[HEADER_BYTES:]
    spoilt = [data for data in found["length"] if (len(data) - HEADER_BYTES) % 136]
    with pytest.raises(FormatError, match="must have 136 bytes for each part"):
        points_in(spoilt[0][HEADER_BYTES:])
    assert all(header_of(data).size >= 2**20 for data in found["huge"])
    assert all(len(data) < len(good) for data in found["half"])
    assert all(data != good for some in found.values() for data in some if len(data) != len(good))
