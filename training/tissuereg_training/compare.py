"""A table of trained networks beside principal components and the constant mean shape, on one data set's splits.

Networks are measured from their files by onnxruntime, as they are used. Their cards tell how they were trained and
nothing else.
"""

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg_training.data import Dataset, FieldArray, read_dataset
from tissuereg_training.errors import FormatError, MeshError, OutputError
from tissuereg_training.folder import CARD
from tissuereg_training.inversion import N_SAMPLES, inversions
from tissuereg_training.pca import moments, pca_error, principal_components
from tissuereg_training.training_split import TrainingSplit

Float64Array = npt.NDArray[np.float64]

SCHEMA = "tissuereg.compare/1"
BEGIN, END = "<!-- networks: begin -->", "<!-- networks: end -->"
_PART = 50


def compare(models: Sequence[str | os.PathLike[str]], data: str | os.PathLike[str]) -> dict[str, Any]:
    """Return errors of networks and of their rivals on the same splits.

    Parameters
    ----------
    models : sequence of path-like
        Model folders.
    data : path-like
        Data set on whose validation and test splits all are measured; principal components are those of its training
        split, also where a network had further data.

    Returns
    -------
    dict
        ``schema``; ``split`` (sizes); ``networks``, one entry a folder: ``name``, ``kind``, ``n_latent``,
        ``n_nodes``, ``valid_mm``, ``test_mm``, ``share_of_pca`` (test; as many components as latents), ``spread``
        (of the test split's codes, q included, mean over latents), ``samples`` (`inversion.inversions` of draws of
        N(0, I)), ``megabytes``, and from the card ``trained_on``, ``epochs``, ``hours`` (None where not stated),
        ``kl_weight``; ``rivals``, the same errors of ``pca`` with ``n_components`` and of ``mean_shape``.

    Raises
    ------
    FormatError
        If a folder holds no model, or the data set is spoilt.
    MeshError
        If a network belongs to another mesh.
    """
    cards = [_card(Path(folder)) for folder in models]
    dataset = read_dataset(data)
    for folder, card in zip(models, cards, strict=True):
        if card["mesh_digest"] != dataset.mesh_digest:
            message = (
                f"{folder} must be a model of the data's mesh, {dataset.mesh_digest[:12]}; it is of "
                f"{card['mesh_digest'][:12]}"
            )
            raise MeshError(message, where=str(folder))
    parts = {"valid": dataset.fields[dataset.split.valid], "test": dataset.fields[dataset.split.test]}
    train = TrainingSplit(dataset)
    about, n_components = moments(train), max(card["n_latent"] for card in cards)
    components, _ = principal_components(train, about, n_components)
    rivals = {
        name: {f"{part}_mm": pca_error(kept, about.mean, fields) for part, fields in parts.items()}
        for name, kept in (("pca", components), ("mean_shape", components[:0]))
    }
    networks = []
    for folder, card in zip(models, cards, strict=True):
        found = _measured(Path(folder), card, dataset, parts)
        rival = pca_error(components[: card["n_latent"]], about.mean, parts["test"])
        networks.append({**found, "share_of_pca": found["test_mm"] / rival})
    return {
        "schema": SCHEMA,
        "split": {"train": len(dataset.split.train), **{part: len(fields) for part, fields in parts.items()}},
        "networks": networks,
        "rivals": {**rivals, "n_components": n_components},
    }


def table(content: dict[str, Any]) -> str:
    """Return what `compare` found as a Markdown table.

    Parameters
    ----------
    content : dict
        Of `compare`.

    Returns
    -------
    str
        Lines, best test error first, the rivals last.
    """
    rivals, split = content["rivals"], content["split"]
    pca = rivals["pca"]["test_mm"]
    lines = [
        f"Mean Euclidean node error in mm; {split['valid']:,} fields for validation, {split['test']:,} for the test.",
        "",
        "| network | validation | test | share of PCA | trained on | epochs, hours | KL weight | spread of codes | "
        "draws of N(0, I): least det F, inverted anywhere | MB |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [_row(each) for each in sorted(content["networks"], key=lambda network: float(network["test_mm"]))]
    names = (("pca", f"{rivals['n_components']} principal components"), ("mean_shape", "constant mean shape"))
    for key, name in names:
        errors = rivals[key]
        lines.append(
            f"| {name} | {errors['valid_mm']:.3f} | {errors['test_mm']:.3f} | {errors['test_mm'] / pca:.2f} | "
            f"{split['train']:,} | | | | | |"
        )
    return "\n".join(lines) + "\n"


def _row(network: dict[str, Any]) -> str:
    hours = "" if network["hours"] is None else f", {network['hours']:.2f}"
    samples = network["samples"]
    return (
        f"| {network['name']} ({network['kind']}) | {network['valid_mm']:.3f} | {network['test_mm']:.3f} | "
        f"{network['share_of_pca']:.2f} | {network['trained_on']:,} | {network['epochs']}{hours} | "
        f"{network['kl_weight']:g} | {network['spread']:.2f} | {samples['min_det_f']:.2f}, "
        f"{samples['fields_with_inverted_tets']:.1%} | {network['megabytes']:.1f} |"
    )


def write_into(page: str | os.PathLike[str], text: str) -> None:
    """Replace what stands between `BEGIN` and `END` in a page.

    Parameters
    ----------
    page : path-like
        Text file with both marks, each once, in this order.
    text : str
        What shall stand there.

    Raises
    ------
    OutputError
        If the marks are not there or the page cannot be written; it stays as it is.
    """
    page = Path(page)
    try:
        whole = page.read_text(encoding="utf-8")
        if whole.count(BEGIN) != 1 or whole.count(END) != 1 or whole.index(BEGIN) > whole.index(END):
            message = f"{page} must hold the lines {BEGIN} and {END}, each once, for the table to stand between"
            raise OutputError(message, where=str(page))
        before, after = whole.split(BEGIN)[0], whole.split(END)[1]
        unfinished = page.with_name(f".{page.name}.part")
        unfinished.write_text(f"{before}{BEGIN}\n{text}{END}{after}", encoding="utf-8")
        unfinished.replace(page)
    except OSError as error:
        message = f"the page {page} must be readable and writable: {error.strerror or error}"
        raise OutputError(message, where=str(page)) from error


def _card(folder: Path) -> dict[str, Any]:
    path = folder / CARD
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        message = f"a model folder must hold a readable {CARD}: {error}"
        raise FormatError(message, where=str(path)) from error
    wanted = ("kind", "mesh_digest", "n_latent", "n_nodes", "epochs", "kl_weight", "split")
    missing = [name for name in wanted if not isinstance(card, dict) or name not in card]
    if missing:
        message = f"{path} must state {', '.join(wanted)}; it lacks {', '.join(missing)}"
        raise FormatError(message, where=str(path))
    return dict(card)


def _measured(folder: Path, card: dict[str, Any], dataset: Dataset, parts: dict[str, FieldArray]) -> dict[str, Any]:
    """Return what the networks in a folder do on the data's splits, and what its card tells of their training."""
    encoder, decoder = (_session(folder / f"{name}.onnx") for name in ("encoder", "decoder"))

    def decoded(z: FieldArray) -> FieldArray:
        found: FieldArray = decoder.run(["displacement"], {"z": z})[0]
        return found

    codes = {name: _codes(encoder, fields) for name, fields in parts.items()}
    missed = {
        f"{name}_mm": float(
            np.concatenate([_distances(decoded(z), x) for z, x in _pieces(codes[name][0], parts[name])]).mean()
        )
        for name in parts
    }
    mean, log_variance = (values.astype(np.float64) for values in codes["test"])
    draws = np.random.default_rng(0).standard_normal((N_SAMPLES, card["n_latent"]), dtype=np.float32)
    shapes = inversions(dataset.nodes, dataset.tets, (decoded(z) for z in np.array_split(draws, N_SAMPLES // _PART)))
    return {
        "name": folder.resolve().name,
        **{key: card[key] for key in ("kind", "n_latent", "n_nodes", "epochs", "kl_weight")},
        "trained_on": card.get("trained_on", card["split"]["train"]),
        "hours": card.get("training", {}).get("hours"),
        **missed,
        "spread": float(np.sqrt(mean.var(axis=0) + np.exp(log_variance).mean(axis=0)).mean()),
        "samples": shapes,
        "megabytes": sum((folder / name).stat().st_size for name in card["files"]) / 1e6,
    }


def _codes(encoder: Any, fields: FieldArray) -> list[FieldArray]:
    found = [encoder.run(["mean", "log_variance"], {"displacement": part}) for (part,) in _pieces(fields)]
    return [np.concatenate(each) for each in zip(*found, strict=True)]


def _pieces(*arrays: FieldArray) -> Iterator[tuple[FieldArray, ...]]:
    for start in range(0, len(arrays[0]), _PART):
        yield tuple(array[start : start + _PART] for array in arrays)


def _distances(found: FieldArray, wanted: FieldArray) -> Float64Array:
    """Return the mean Euclidean node distance of each field, (n_fields,)."""
    distances: Float64Array = np.linalg.norm(found - wanted, axis=2).mean(axis=1, dtype=np.float64)
    return distances


def _session(path: Path) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises classes of its own for missing and for spoilt files
        message = f"{path} must be a network in ONNX: {str(error).splitlines()[0]}"
        raise FormatError(message, where=str(path)) from error
