"""Words of which one must be chosen."""

from collections.abc import Collection
from typing import Any

from tissuereg._base.arguments import found
from tissuereg.errors import TissueRegError


def check_choice(name: str, value: Any, choices: Collection[str], error: type[TissueRegError]) -> None:
    """Raise an error unless a value is one of the choices; the message names all of them.

    `name`: the argument; `value`: the given value; `choices`: the allowed values; `error`: raised where the value is
    none of these.
    """
    if not isinstance(value, str) or value not in choices:
        message = f"`{name}` must be one of {', '.join(choices)}, got {found(value)}"
        raise error(message, where=name)
