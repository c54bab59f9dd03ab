"""When an answer is right, and how parts of material tests are compared."""

import numpy as np
import pytest

from common import read_archive
from diagnosis import febio, material_parts
from support.material_curves import in_modes


def test_an_answer_is_right_with_every_true_cause_and_no_other():
    def row(truth, *groups, detectability=50.0):
        causes = [{"id": group[0], "group": list(group)} for group in groups]
        verdict = "named" if groups else "consistent"
        return {"truth": truth, "causes": causes, "verdict": verdict, "detectability": detectability}

    assert febio.is_right(row([]))
    assert not febio.is_right(row([], ["layer"]))
    assert febio.is_right(row(["layer"], ["fibre", "layer"]))
    assert not febio.is_right(row(["layer"]))
    assert febio.is_right(row(["layer"], detectability=4.0))
    assert not febio.is_right(row(["layer"], ["layer"], ["fibre"]))
    assert not febio.is_right(row(["layer", "latency"], ["layer"]))


def test_parameters_of_one_part_of_the_adhesive_lie_within_two_stated_deviations_of_another():
    adhesive = read_archive(material_parts.ARCHIVE)["measured"]["adhesive"]["pairs"]
    kinds = material_parts.KINDS
    apart = {kind: [z for pair in adhesive if pair["same_form"] for z in pair[kind].values()] for kind in kinds}
    # By curvature alone they would not.
    assert max(apart["stated"]) <= 2.0 < max(apart["right"])


def test_parts_are_compared_by_their_difference_or_by_the_smaller_one():
    one, other = {"b": [1.0, 0.3]}, {"b": [1.5, 0.4]}
    assert material_parts.distances(one, other, "apart")["b"] == pytest.approx(1.0)
    assert material_parts.distances(one, other, "within")["b"] == pytest.approx(0.5 / 0.3)
    a, b = object(), object()
    assert material_parts.pairs({"a": [a], "b": [b], "both": [a, b]}) == [
        ("a", "b", "apart"),
        ("a", "both", "within"),
        ("b", "both", "within"),
    ]


def test_a_part_is_answered_with_the_numbers_of_a_right_form_beside_the_stated_ones():
    curves = in_modes(np.random.default_rng(1), ("fung", 1.0), modes=("tension", "compression"))
    row = material_parts.answered("made", curves)
    assert row["forms"]
    assert set(row["right"]) == set(row["stated"])
    for value, deviation in row["right"].values():
        assert np.isfinite(value)
        assert deviation > 0.0
