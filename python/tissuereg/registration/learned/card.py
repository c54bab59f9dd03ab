"""The card of a trained model, the file ``model.json``: reads it, and checks every entry that is used."""

import json
import math
import re
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tissuereg._base.arguments import is_number
from tissuereg._base.arrays import FloatArray
from tissuereg._base.provenance import note_file, sha256_of
from tissuereg.errors import FormatError, ModelError
from tissuereg.io.bounds import FILES, existing_file, read_text, regular_file

CARD_SCHEMA = "tissuereg.model/1"

#: Files of a model in addition to its card.
MODEL_FILES = ("encoder.onnx", "decoder.onnx", "decoder_weights.npz")

#: Where a network names a file of its tables: key and value of an entry in ONNX's own form.
_LOCATIONS = re.compile(rb"\x0a\x08location\x12([\x01-\x7f])([^\x00]{1,127})", re.DOTALL)


def card_text(card: dict[str, Any]) -> str:
    """Return the text of ``model.json`` for a card: one line for each entry, and one line for each row of a matrix."""
    return _json(card, 0) + "\n"


def _json(value: Any, depth: int) -> str:
    """Return a value as JSON, with each table or list that holds only single values on one line.

    `depth` is the number of tables and lists around the value, and thus its indentation in spaces.
    """
    inner = list(value.values()) if isinstance(value, dict) else value
    if not isinstance(value, dict | list) or (depth and not any(isinstance(one, dict | list) for one in inner)):
        return json.dumps(value, allow_nan=False)
    opened, closed = "{}" if isinstance(value, dict) else "[]"
    names = [f"{json.dumps(name)}: " for name in value] if isinstance(value, dict) else [""] * len(value)
    lines = [f"{' ' * (depth + 1)}{name}{_json(one, depth + 1)}" for name, one in zip(names, inner, strict=True)]
    return "\n".join([opened, ",\n".join(lines), " " * depth + closed])


def read_card(folder: Path) -> dict[str, Any]:
    """Return the card of the model in a folder, the content of its file ``model.json``.

    The result holds ``kind`` and ``mesh_digest`` (str), ``n_nodes``, ``n_latent`` and ``members`` (int), ``errors_mm``
    with the numbers ``test`` and ``pca``, ``prior`` with a mean (n_latent,) and covariances (n_latent, n_latent), and
    ``files`` with the SHA-256 of `MODEL_FILES`; other entries are ignored. Raises `ModelError` if there is no card, it
    is no JSON, or an entry is missing or not of this type and size.
    """
    path = folder / "model.json"
    if not path.exists():
        message = f"a model folder must hold model.json; there is none in {folder}"
        raise ModelError(message, where=str(folder))
    try:
        card = json.loads(read_text(existing_file(path, FILES.text_mb)))
    except (OSError, ValueError, RecursionError, FormatError) as error:
        message = f"{path} must be a JSON model card: {error}"
        raise ModelError(message, where=str(path)) from error
    if not isinstance(card, dict) or card.get("schema") != CARD_SCHEMA:
        _refuse(path, f"be a card of schema {CARD_SCHEMA}", card.get("schema") if isinstance(card, dict) else card)
    for name in ("kind", "mesh_digest"):
        if not isinstance(card.get(name), str):
            _refuse(path, f"have text as `{name}`", card.get(name))
    for name in ("n_nodes", "n_latent", "members"):
        if type(card.get(name)) is not int or card[name] < 1:
            _refuse(path, f"have a whole number of at least 1 as `{name}`", card.get(name))
    _check_tables(path, card)
    return card


def check_files(folder: Path, card: dict[str, Any]) -> None:
    """Check that the files of the model in a folder are those that its card describes.

    `card` is what `read_card` returns. Pages for people, which no registration reads, are not checked. Raises
    `ModelError` if a file is missing, too large, or differs from its size or SHA-256 in the card, or if a network takes
    tables from a file that the card does not list.
    """
    for name in card["files"]:
        if name in MODEL_FILES or name.endswith(".npy"):
            check_file(folder, card, name)
    for name in MODEL_FILES:
        if name.endswith(".onnx"):
            content = (folder / name).read_bytes()
            others = {found[2][: found[1][0]].decode("utf-8", "replace") for found in _LOCATIONS.finditer(content)}
            if unlisted := others - card["files"].keys():
                message = f"{folder / name} must take tables from files of its card alone, got {min(unlisted)[:60]!r}"
                raise ModelError(message, where=str(folder / name))


def check_file(folder: Path, card: dict[str, Any], name: str) -> Path:
    """Return the path of a file of the model in a folder, after checking it against `card` as `read_card` returns it.

    Raises `ModelError` if it is missing, no regular file or too large, or has another size or SHA-256.
    """
    path = folder / name
    if not path.exists():
        message = f"the model folder {folder} must hold {name}, as its card states; it is missing"
        raise ModelError(message, where=str(path))
    try:
        size = regular_file(path, FILES.mesh_mb).stat().st_size
    except FormatError as error:
        raise ModelError(str(error), where=str(path)) from error
    wanted_size, wanted = card.get("sizes", {}).get(name, size), card["files"][name]
    if size != wanted_size:
        message = f"{path} must be the file its card describes ({wanted_size} bytes), got {size} bytes"
        raise ModelError(message, where=str(path))
    found = sha256_of(path)
    if found != wanted:
        message = f"{path} must be the file its card describes (SHA-256 {wanted[:12]}), got {found[:12]}"
        raise ModelError(message, where=str(path))
    note_file(path, found)
    return path


def list_file(card: dict[str, Any], path: Path) -> None:
    """Enter size and SHA-256 of a file of the model into its card."""
    card["files"][path.name] = sha256_of(path)
    card.setdefault("sizes", {})[path.name] = path.stat().st_size


def _check_tables(path: Path, card: dict[str, Any]) -> None:
    errors, prior, files = (card.get(name) for name in ("errors_mm", "prior", "files"))
    if not isinstance(errors, dict) or not all(is_number(errors.get(name)) for name in ("test", "pca")):
        _refuse(path, "have the numbers `test` and `pca` in `errors_mm`", errors)
    if not all(errors[name] >= 0.0 and math.isfinite(errors[name]) for name in ("test", "pca")):
        _refuse(path, "have finite errors of at least 0 in `errors_mm`", errors)
    if not isinstance(files, dict) or not all(isinstance(files.get(name), str) for name in MODEL_FILES):
        _refuse(path, f"have the SHA-256 of {', '.join(MODEL_FILES)} in `files`", files)
    if not all(isinstance(one, str) and Path(name).name == name for name, one in files.items()):
        _refuse(path, "have in `files` plain names, each with its SHA-256", files)
    sizes = card.get("sizes", {})
    if not isinstance(sizes, dict) or not all(type(one) is int and one >= 0 for one in sizes.values()):
        _refuse(path, "have whole numbers of bytes in `sizes`", sizes)
    if not isinstance(prior, dict):
        _refuse(path, "have a table `prior`", prior)
    q = card["n_latent"]
    shapes = {"mean": (q,), "covariance": (q, q), "mismatch_covariance": (q, q)}
    if prior.get("relative_mismatch_covariance") is not None:
        shapes["relative_mismatch_covariance"] = (q, q)
    for name, shape in shapes.items():
        try:
            array = np.asarray(prior.get(name), dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.full(1, math.nan)
        if array.shape != shape or not np.isfinite(array).all():
            _refuse(path, f"have finite numbers of shape {shape} as `{name}` in `prior`", f"shape {array.shape}")
        if name == "covariance" and np.diag(array).min() <= 0.0:
            _refuse(path, "have positive variances in the `covariance` in `prior`", float(np.diag(array).min()))
        if len(shape) == 2 and not is_covariance(array):
            _refuse(
                path, f"have a covariance as `{name}` in `prior`: symmetric, no variance negative", "another matrix"
            )


def is_covariance(matrix: FloatArray) -> bool:
    """Return whether a finite matrix (n, n) is a covariance: symmetric, and no variance in any direction negative."""
    size = float(np.abs(matrix).max())
    symmetric = np.abs(matrix - matrix.T).max() <= 1e-6 * size
    return bool(symmetric and np.linalg.eigvalsh(matrix).min() >= -1e-6 * size)


def _refuse(path: Path, rule: str, found: object) -> NoReturn:
    got = repr(found)
    message = f"{path} must {rule}, got {got if len(got) <= 60 else got[:57] + '...'}"
    raise ModelError(message, where=str(path))
