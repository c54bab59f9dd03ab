"""The version of tissuereg, read from the compiled core, so that it is defined in one place."""

from tissuereg._core import __version__

__all__ = ["__version__"]
