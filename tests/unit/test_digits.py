"""Tables of a model in digits: how far they are rounded, that nothing is lost on the way, and what is refused."""

import numpy as np
import pytest

from tissuereg.errors import FormatError
from tissuereg.io.fields import open_npz
from tissuereg.registration.learned.digits import in_digits, table_in


@pytest.fixture
def table():
    """Rows of very different size, one of them zero, one with a number that is thousands of times as large as most."""
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((60, 50, 3)) * np.logspace(-6, 4, 60)[:, None, None]
    rows[7] = 0.0
    rows[8, 3, 1] = 5e4 * np.abs(rows[8]).max()
    return rows


def written(path, arrays):
    np.savez(path / "t.npz", **arrays)
    return path / "t.npz"


@pytest.mark.parametrize("share", [1e-3, 0.03, 0.4])
def test_a_table_is_read_as_it_was_rounded_to_steps_of_a_share_of_each_row(table, share, tmp_path):
    arrays = in_digits("t", table, share)
    assert {name: array.dtype for name, array in arrays.items()} == {"t": np.int8, "t.exponents": np.int8}
    with open_npz(written(tmp_path, arrays)) as file:
        found = table_in(file, "t", None, 50, 3)
    sizes = np.sqrt((table**2).mean(axis=(1, 2)))
    off = np.abs(found - table).max(axis=(1, 2))
    # Half of a step that lies within a factor of the root of two of the share.
    plain = np.delete(np.arange(60), 8)
    assert (off[plain] <= 0.5 * np.sqrt(2.0) * share * sizes[plain]).all()
    assert off[plain].max() > 0.2 * (share * sizes[plain]).min()
    assert (found[7] == 0.0).all()
    # The largest number of two digits is 127 * 257.
    assert np.abs(found[8]).max() == pytest.approx(np.abs(table[8]).max(), rel=1.0 / 127)
    assert (found != 0).any()


def test_digits_are_what_the_page_of_files_says(tmp_path):
    digits = np.array([[[1, -128, 127], [0, 5, -6]], [[2, -1, 0], [0, 0, 1]]], np.int8)
    with open_npz(written(tmp_path, {"t": digits, "t.exponents": np.array([-1, 3], np.int8)})) as file:
        assert table_in(file, "t", 2, 3).tolist() == [[256.5, -192.0, 63.5], [0.0, 40.0, 2000.0]]


def test_a_table_without_exponents_is_read_as_it_is_and_an_empty_one_stays_empty(tmp_path):
    plain = np.array([[1.5, -2.0]], np.float16)
    with open_npz(written(tmp_path, {"t": plain, **in_digits("none", np.empty((0, 4, 3)), 0.1)})) as file:
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
    ],
)
def test_arrays_that_are_no_table_in_digits_are_refused(digits, exponents, tmp_path):
    path = written(tmp_path, {"t": digits, "t.exponents": exponents})
    with open_npz(path) as file, pytest.raises(FormatError, match=r"array ['`]t\b"):
        table_in(file, "t", 2, 4)
