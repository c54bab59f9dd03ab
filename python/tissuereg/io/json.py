"""JSON in which every number is finite or null."""

import json
import math
import os
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from tissuereg.errors import FormatError
from tissuereg.io.atomic import atomic_file


def plain(value: Any) -> Any:
    """Return `value` as a structure of dicts, lists, strings, bools, finite numbers and None only, as JSON can hold it.

    `value`: mappings, sequences, sets, numpy arrays and scalars, paths, nested in any way. NaN and infinities become
    None, arrays become lists. Raises `FormatError` if something else is found.

    Examples
    --------
    >>> import numpy as np
    >>> plain({"a": np.array([1.0, np.nan]), "n": np.int64(3)})
    {'a': [1.0, None], 'n': 3}
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    message = f"JSON must be made of numbers, text, lists and tables, got {type(value).__name__}"
    raise FormatError(message, where=type(value).__name__)


def dumps(value: Any) -> str:
    """Return `value` as JSON text, indented by two, one newline at the end.

    `value`: mappings, sequences, sets, numpy arrays and scalars, paths, nested in any way. Result: strict JSON, in
    which NaN and infinities are null. Raises `FormatError` if something else is found.
    """
    return json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write `value` as a JSON file, whole or not at all.

    `value`: mappings, sequences, sets, numpy arrays and scalars, paths, nested in any way; NaN and infinities become
    null.
    """
    text = dumps(value)
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
