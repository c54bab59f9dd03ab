"""Sensitivities as sums of kept rows, and what is linear in them, against the same sums of all of them at once."""

import numpy as np
import pytest

from tissuereg.registration.contacts.sensed import KeptRows, Sensed, apart, matrix, together
from tissuereg.simulation.sensitivity import Compliance

N_NODES, N_HELD = 7, 2


def key_of(row):
    return row[0].tobytes() + b"|" + row[1].tobytes()


def keyed(rows):
    return {key_of(row): row for row in rows}


def along(node, *axes):
    return [(np.array([node]), np.array([axis], np.float64)) for axis in axes]


def true_sensitivities(rows):
    """Return sensitivities that are linear in the weights, as those of a body are."""
    rng = np.random.default_rng(4)
    by_node = rng.normal(size=(N_NODES, 3, 3 * (N_NODES + N_HELD + 1)))
    flat = np.array([np.einsum("kx,kxs->s", weights, by_node[nodes]) for nodes, weights in rows])
    forces, prescribed, body_force = np.split(flat, [3 * N_NODES, 3 * (N_NODES + N_HELD)], axis=1)
    return Compliance(forces.reshape(-1, N_NODES, 3), body_force, prescribed.reshape(-1, N_HELD, 3))


def kept_of(*groups):
    kept = KeptRows()
    for rows in groups:
        kept.add(keyed(rows), true_sensitivities(rows))
    return kept


def sensed_of(kept, rows):
    return Sensed(None, kept, matrix([key_of(row) for row in rows], kept.shares(keyed(rows)), len(kept)))


def first_axis(one):
    return one.forces[:, :, 0]


GROUPS = (along(0, (1, 0, 0), (0, 1, 0)), along(3, (1, 0, 0), (0, 0, 1)), along(0, (0, 0, 1)))


@pytest.mark.parametrize(
    "rows",
    [
        [*along(0, (0.6, 0.0, 0.8), (0.0, -1.0, 0.0)), *along(3, (0.0, 0.0, 1.0))],
        [*along(3, (0.0, 0.0, 1.0)), *along(0, (0, 0, 1), (1, 0, 0))],
        [*along(0, (0.0, 0.0, 1.0)), *along(0, (0.0, 0.0, 1.0))],
        along(3, (0.8, 0.0, -0.6)),
        along(3, (1.5, 0.0, 0.0), (0.0, 0.0, -1.0)),
    ],
)
def test_sums_of_kept_rows_are_the_sensitivities_of_the_sum(rows):
    sensed, wanted = sensed_of(kept_of(*GROUPS), rows), true_sensitivities(rows)
    for name in ("forces", "body_force", "prescribed"):
        np.testing.assert_allclose(getattr(sensed.compliance, name), getattr(wanted, name), rtol=0, atol=1e-12)
    for name in (None, "first"):
        np.testing.assert_allclose(sensed.image(name, first_axis), first_axis(wanted), rtol=0, atol=1e-12)


def test_a_kept_row_has_its_own_bits_in_any_order():
    kept, rows = kept_of(*GROUPS), [*along(3, (0, 0, 1)), *along(0, (0, 1, 0))]
    wanted = first_axis(true_sensitivities(rows))
    for name in (None, "first"):
        assert np.array_equal(sensed_of(kept, rows).image(name, first_axis), wanted)


def test_rows_are_no_sums_of_those_of_other_nodes_nor_of_too_few_axes():
    kept = kept_of(*GROUPS)
    there = keyed([*along(3, (0, 1, 0)), *along(5, (1, 0, 0)), *along(0, (1, 1, 1))])
    assert list(kept.shares(there)) == list(there)[2:]
    # Far more of one axis than is kept: errors of the kept row would grow with it.
    assert not kept.shares(keyed(along(3, (2.5, 0, 0))))
    assert kept.shares(keyed(along(3, (1.5, 0, 0))))
    # Off what is kept by more than rounding.
    assert not kept.shares(keyed(along(3, (1.0, 1e-9, 0.0))))


def test_a_function_is_made_once_of_each_kept_row():
    made = []

    def counted(one):
        made.append(len(one.forces))
        return one.body_force

    kept = kept_of(GROUPS[0])
    for _ in range(2):
        sensed_of(kept, GROUPS[0]).image("counted", counted)
    assert made == [2]
    kept.add(keyed(GROUPS[1]), true_sensitivities(GROUPS[1]))
    kept.add(keyed(GROUPS[2]), true_sensitivities(GROUPS[2]))
    every = [row for rows in GROUPS for row in rows]
    found = sensed_of(kept, every).image("counted", counted)
    assert made == [2, 2, 1]
    assert np.array_equal(found, true_sensitivities(every).body_force)
    # Values that are not kept are computed for the rows that are asked for, and for no others.
    made.clear()
    sensed_of(kept, GROUPS[0]).image(None, counted)
    assert made == [2]


def test_what_was_seen_before_more_rows_were_kept_stays_what_it_was():
    kept = kept_of(GROUPS[0])
    early = sensed_of(kept, along(0, (0.6, 0.8, 0.0)))
    before = early.image("first", first_axis)
    kept.add(keyed(GROUPS[1]), true_sensitivities(GROUPS[1]))
    sensed_of(kept, GROUPS[1]).image("first", first_axis)
    for name in (None, "first"):
        assert np.array_equal(early.image(name, first_axis), before)


def test_a_copy_grows_alone():
    kept = kept_of(GROUPS[0])
    sensed_of(kept, GROUPS[0]).image("first", first_axis)
    other = kept.copy()
    other.add(keyed(GROUPS[1]), true_sensitivities(GROUPS[1]))
    wanted = first_axis(true_sensitivities([*GROUPS[0], *GROUPS[1]]))
    assert np.array_equal(sensed_of(other, [*GROUPS[0], *GROUPS[1]]).image("first", first_axis), wanted)
    assert (len(kept), len(other)) == (2, 4)
    assert not kept.shares(keyed(GROUPS[1]))
    assert np.array_equal(sensed_of(kept, GROUPS[0]).image("first", first_axis), wanted[:2])


def test_parts_and_their_whole_are_each_other():
    whole = true_sensitivities([row for rows in GROUPS for row in rows])
    again = together(apart(whole))
    for name in ("forces", "body_force", "prescribed"):
        assert np.array_equal(getattr(again, name), getattr(whole, name))
