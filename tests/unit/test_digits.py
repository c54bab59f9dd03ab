"""Tables of a model in digits: how far they are rounded, that nothing is lost on the way, and what is refused."""

import numpy as np
import pytest

from tissuereg.errors import FormatError
from tissuereg.io.fields import open_npz
from tissuereg.registration.learned.digits import in_digits, rounded, table_in


@pytest.fixture
def table():
    """Rows of very different size, one of them zero."""
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((60, 50, 3)) * np.logspace(-6, 4, 60)[:, None, None]
    rows[7] = 0.0
    return rows


def written(path, arrays):
    np.savez(path / "t.npz", **arrays)
    return path / "t.npz"


@pytest.mark.parametrize("share", [1e-3, 0.03, 0.4])
def test_rounding_goes_to_steps_of_a_share_of_each_row_and_nothing_is_lost_after_it(table, share, tmp_path):
    found = rounded(table, share)
    sizes = np.sqrt((table**2).mean(axis=(1, 2)))
    off = np.abs(found - table).max(axis=(1, 2))
    # Half of a step that lies within a factor of the root of two of the share.
    assert (off <= 0.5 * np.sqrt(2.0) * share * sizes).all()
    assert (off > 0.5 * 0.5 * share * sizes).mean() > 0.9
    assert (found[7] == 0.0).all()
    arrays = in_digits("t", found)
    assert {name: array.dtype for name, array in arrays.items()} == {"t": np.int8, "t.exponents": np.int8}
    with open_npz(written(tmp_path, arrays)) as file:
        np.testing.assert_array_equal(table_in(file, "t", None, 50, 3), found)


def test_steps_are_larger_where_two_digits_would_not_do(table):
    found = rounded(table, 1e-9)
    most = np.abs(table).max(axis=(1, 2))
    # The largest number of two digits is 127 * 257; a step is a power of two.
    assert (np.abs(found - table).max(axis=(1, 2)) <= most / (127 * 257)).all()
    assert np.abs(found - table).max(axis=(1, 2)).max() > 0.25 * most.max() / (127 * 257)
    assert set(in_digits("t", found)) == {"t", "t.exponents"}


def test_a_table_that_digits_do_not_hold_is_stored_in_half_precision(table):
    assert in_digits("t", table)["t"].dtype == np.float16
    spoilt = np.where(np.arange(6) == 2, np.nan, 1.0).reshape(2, 3)
    assert np.isnan(in_digits("t", spoilt)["t"][0, 2])


def test_digits_are_what_the_page_of_files_says(tmp_path):
    digits = np.array([[[1, -128, 127], [0, 5, -6]], [[2, -1, 0], [0, 0, 1]]], np.int8)
    with open_npz(written(tmp_path, {"t": digits, "t.exponents": np.array([-1, 3], np.int8)})) as file:
        assert table_in(file, "t", 2, 3).tolist() == [[256.5, -192.0, 63.5], [0.0, 40.0, 2000.0]]


def test_a_table_without_exponents_is_read_as_it_is_and_an_empty_one_stays_empty(tmp_path):
    plain = np.array([[1.5, -2.0]], np.float16)
    with open_npz(written(tmp_path, {"t": plain, **in_digits("none", np.empty((0, 4, 3)))})) as file:
        assert table_in(file, "t", None, 2).tolist() == [[1.5, -2.0]]
        assert table_in(file, "none", None, 4, 3).shape == (0, 4, 3)


@pytest.mark.parametrize(
    ("digits", "exponents"),
    [
        (np.zeros((3, 2, 4), np.int8), np.zeros(2, np.int8)),  # three digits
        (np.zeros((2, 4), np.int8), np.zeros(4, np.int8)),  # no table
        (np.zeros((1, 2, 4), np.int8), np.zeros(3, np.int8)),  # a row without exponent
        (np.zeros((1, 2, 5), np.int8), np.zeros(2, np.int8)),  # rows too long
        (np.zeros((1, 2, 4), np.int8), np.array([0, 2000])),  # not a number that anything has
        (np.zeros((1, 2, 4), np.int8), np.array([0.0, np.nan])),
        (np.zeros((1, 2, 4), np.int8), np.array([0, -(2**63)])),
        (np.zeros((1, 2, 4), np.int8), np.array([0, 101])),  # beyond single precision, with two digits
        (np.full((1, 2, 4), 0.3), np.zeros(2, np.int8)),  # no digits
        (np.full((1, 2, 4), 1e300), np.full(2, 100)),
    ],
)
def test_arrays_that_are_no_table_in_digits_are_refused(digits, exponents, tmp_path):
    path = written(tmp_path, {"t": digits, "t.exponents": exponents})
    with open_npz(path) as file, pytest.raises(FormatError, match=r"array ['`]t\b"):
        table_in(file, "t", 2, 4)
