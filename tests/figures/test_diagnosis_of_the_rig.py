"""Hidden effects of supports, weight and actuators in data of another solver are named by `diagnose`.

Those of the tracker and of growth: `tests/pipeline/test_simulate_then_diagnose.py`.
"""

import pytest

import tissuereg as tr
from figures.open_cases import hiding


@pytest.mark.parametrize("cause", ["detachment", "gravity", "actuator_direction"])
def test_a_hidden_effect_is_named(cause, tmp_path):
    rig, alike = hiding(cause, tmp_path)
    told = tr.diagnose(rig, keep=False)
    assert told.verdict == "named"
    assert {finding.id for finding in told.findings} <= set(alike)
