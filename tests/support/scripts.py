"""Scripts of the repository that belong to no package, loaded as modules."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

REPOSITORY = Path(__file__).resolve().parents[2]


def script(folder: str, name: str) -> ModuleType:
    """Return `folder/name.py` of the repository as a module, known to Python by its name as `folder_name`."""
    spec = importlib.util.spec_from_file_location(f"{folder}_{name}", REPOSITORY / folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses need their module in `sys.modules`.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
