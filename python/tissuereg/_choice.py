"""Words of which one must be chosen."""

from collections.abc import Collection

from tissuereg.errors import TissueRegError


def check_choice(name: str, value: str, choices: Collection[str], error: type[TissueRegError]) -> None:
    """Raise an error unless a value is one of the choices; the message names all of them.

    Parameters
    ----------
    name : str
        The argument.
    value : str
        What was given for it.
    choices : collection of str
        What it may be.
    error : type of TissueRegError
        Raised where the value is none of these.
    """
    if value not in choices:
        message = f"`{name}` must be one of {', '.join(choices)}, got {value!r}"
        raise error(message, where=name)
