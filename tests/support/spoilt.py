"""Files that are nearly right: bytes flipped, ends cut, lines exchanged, words replaced."""

import os
import re
import warnings

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from tissuereg.errors import TissueRegError

#: Examples of each file; `make test-sturdy` asks for 10,000.
CASES = int(os.environ.get("TISSUEREG_CASES", "60"))

#: The same examples at every run; a file is read within so many ms, whatever it holds.
FUZZED = settings(
    max_examples=CASES,
    derandomize=True,
    deadline=3000 if CASES <= 60 else None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

#: Replacements for a number or a word.
STRANGE = st.sampled_from(
    [
        "nan",
        "inf",
        "-1",
        "0",
        "1e308",
        "1e999",
        "99999999999999999999",
        "0x10",
        "",
        '"',
        "'",
        "[]",
        "{}",
        "a,b",
        "\0",
        "é",
    ]
)

PLACES = st.floats(0.0, 1.0, exclude_max=True)


def _flipped(content: bytes, at: float, with_: int) -> bytes:
    spot = int(at * len(content))
    return content[:spot] + bytes([content[spot] ^ with_]) + content[spot + 1 :] if content else content


def _cut(content: bytes, begin: float, length: float) -> bytes:
    first = int(begin * len(content))
    return content[:first] + content[first + int(length * (len(content) - first)) :]


def _lines_exchanged(content: bytes, one: float, other: float) -> bytes:
    lines = content.split(b"\n")
    i, j = int(one * len(lines)), int(other * len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def _line_repeated(content: bytes, at: float) -> bytes:
    lines = content.split(b"\n")
    return b"\n".join([*lines[: int(at * len(lines)) + 1], *lines[int(at * len(lines)) :]])


def _word_replaced(content: bytes, at: float, word: str) -> bytes:
    words = list(re.finditer(rb"[\w.+-]+", content))
    if not words:
        return content
    found = words[int(at * len(words))]
    return content[: found.start()] + word.encode() + content[found.end() :]


#: One thing that goes wrong with a file.
CHANGES = st.one_of(
    st.tuples(st.just(_flipped), PLACES, st.integers(1, 255)),
    st.tuples(st.just(_cut), PLACES, st.one_of(st.just(1.0), st.floats(0.0, 0.1))),
    st.tuples(st.just(_lines_exchanged), PLACES, PLACES),
    st.tuples(st.just(_line_repeated), PLACES),
    st.tuples(st.just(_word_replaced), PLACES, STRANGE),
)


def spoilt(content: bytes, changes) -> bytes:
    for change, *how in changes:
        content = change(content, *how)
    return content


def reads_or_refuses(read, path):
    refused = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            read(path)
        except TissueRegError as error:
            refused = error
    if refused is not None:
        assert str(refused)
        assert isinstance(refused.where, str)
