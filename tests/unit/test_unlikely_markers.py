"""Which markers a registration with a trained model leaves out, and which of them speak against its answer."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissuereg.registration.learned.registration import _without_unlikely


class Events:
    """Calibration events of which a share of `chance` looks as bad in all, and a fifth for a good worst marker."""

    level = 0.02

    def __init__(self, chance):
        self.chance = chance

    def __len__(self):
        return 100

    def share(self, number, value):
        return 0.2 if value < 1.0 else 0.04

    def p_value(self, row):
        return self.chance


@pytest.mark.parametrize(("chance", "against"), [(0.03, {}), (0.01, {4: 0.04})])
def test_a_marker_that_is_left_out_speaks_against_the_answer_only_where_the_whole_is_rare(chance, against):
    def smoothed(used):
        rows = np.where(used == 4, 9.0, 0.0)
        statistics = SimpleNamespace(row=np.array([0.0, rows.max(), 0.0, 0.0, 0.0]), marker_rows=rows)
        rehearsal = SimpleNamespace(calibration_set=Events(chance))
        return SimpleNamespace(used=used, statistics=statistics, rehearsal=rehearsal)

    found, dropped, surely = _without_unlikely(smoothed, np.array([1, 2, 4, 5, 8, 9]))
    assert list(found.used) == [1, 2, 5, 8, 9]
    assert (dropped, surely) == ({4: 0.04}, against)
