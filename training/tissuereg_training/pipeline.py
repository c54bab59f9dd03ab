"""From a recipe and a data set to a model folder: the main path, in order."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tissuereg_training.checkpoint import Checkpoint
from tissuereg_training.curves import training_curves
from tissuereg_training.data import (
    Dataset,
    FieldArray,
    Split,
    check_recipe_fits,
    check_split,
    read_dataset,
    read_dataset_recipe,
    read_origin,
)
from tissuereg_training.digits import ERROR_STEP, rounded_rows, stored
from tissuereg_training.errors import CheckpointError
from tissuereg_training.evaluate import (
    change_error_fields,
    code_spread,
    codes,
    decoded,
    error_fields,
    mean_error,
    measured_prior,
    root_mean_square,
)
from tissuereg_training.fit import FitState, fit, stalled
from tissuereg_training.folder import check_out, put_back, write_model
from tissuereg_training.graph_closure import GraphClosure
from tissuereg_training.host import Clock, best_device, device_name, machine, prepare, versions
from tissuereg_training.inversion import inversions, sampled_inversions
from tissuereg_training.kinds import KINDS, Material, new_network
from tissuereg_training.model_page import model_page
from tissuereg_training.network import Network
from tissuereg_training.parity import checked_parity
from tissuereg_training.pca import moments, pca_error, principal_components
from tissuereg_training.recipe import Recipe, read_recipe
from tissuereg_training.settings import TrainSettings
from tissuereg_training.spread import fit_spread
from tissuereg_training.training_split import TrainingSplit

SCHEMA = "tissuereg.train/1"
MODEL_SCHEMA = "tissuereg.model/1"


def train(
    recipe_path: str | os.PathLike[str],
    data: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    seed: int | None = None,
    threads: int = 0,
    start: str = "auto",
    report: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Train the network of a recipe on a data set and write the model folder.

    Parameters
    ----------
    recipe_path : path-like
        A TOML file with a table `[train]`.
    data : path-like, or several
        Folders made by `tissuereg simulate`. The members of all but the first join the training split; validation and
        test stay the first one's.
    out : path-like
        Model folder, written whole or not at all; an existing model is replaced. Checkpoints lie next to it in
        `OUT.training` until it is written.
    seed : int, optional
        Of split, start and noise, instead of the recipe's.
    threads : int
        0 takes all cores. Results agree to rounding between numbers of threads.
    start : {"auto", "resume", "fresh"}
        Continue from a checkpoint where there is one, insist on one, or discard it.
    report : callable of str, optional
        Hears what is going on, a line at a time.

    Returns
    -------
    dict
        ``schema``, ``errors_mm``, ``epochs``, ``best_epoch``, ``parity``, ``kl_weight``, ``members``, the sizes of
        the network (``levels`` and so on), ``seconds``, ``threads``, ``device``, ``machine``, ``versions``, ``seed``.

    Raises
    ------
    ExperimentError, FormatError, MeshError, OutputError, CheckpointError
        If recipe, data, place or checkpoint cannot be used.
    EnsembleError
        If there are too few members.
    DivergenceError
        If training leaves the finite numbers.
    ParityError
        If torch and onnxruntime disagree; nothing is written.
    """
    notify = report or (lambda _line: None)
    clock, threads, out = Clock(), prepare(threads), Path(out)
    with clock.stage("total"):
        with clock.stage("read"):
            recipe = read_recipe(recipe_path)
            check_out(out)
            put_back(out, _scratch(out))
            first, *further = _folders(data)
            check_recipe_fits(recipe, read_dataset_recipe(first))
            dataset = read_dataset(first)
            seed = recipe.seed if seed is None else seed
            settings = recipe.settings
            split = dataset.split
            check_split(split, settings.n_latent)
            train_split = TrainingSplit(dataset, further)
            checkpoint = _checkpoint(out, dataset, train_split, settings, seed, start)
        with clock.stage("start"):
            material = Material(dataset.tets, train_split, moments(train_split))
            model, sizes = new_network(material, settings, seed)
            notify(sizes)
            model.to(best_device())
        if checkpoint.exists():
            notify(f"continuing from {checkpoint.path}")
        with clock.stage("train"):
            valid = dataset.fields[split.valid]
            state = fit(model, train_split, valid, settings, seed=seed, checkpoint=checkpoint, report=report)
            if settings.spread_weight:
                fit_spread(model, train_split, settings, seed=seed, report=report)
        with clock.stage("evaluate"):
            card = _card(model, dataset, material, recipe, seed, state)
            card["data"] = [read_origin(folder) for folder in (first, *further)]
            card["training"] = _training(state, settings, model, threads)
            errors = _error_fields(model, dataset, split, settings.error_fields)
            notify("mean error in mm: " + ", ".join(f"{k} {v:.4f}" for k, v in card["errors_mm"].items()))
        with clock.stage("export"):
            facts, kind = _facts(card, model), KINDS[settings.kind]
            model.to("cpu")
            encoder, decoder = kind.encoder_onnx(model, facts), kind.decoder_onnx(model, facts)
            fields = dataset.fields[split.test][:32]
            card["parity"] = checked_parity(model, encoder, decoder, fields, seed)
            weights = {**kind.decoder_weights(model), **errors}
            curves = training_curves(state.history, card["scale_mm"], card["errors_mm"])
            pages = {"MODEL.md": model_page(card).encode(), "training.png": curves}
            write_model(out, checkpoint.folder, encoder, decoder, weights, card, pages)
            checkpoint.discard()
    record = {k: card[k] for k in ("errors_mm", "epochs", "best_epoch", "parity", "kl_weight", "members")}
    return {
        "schema": SCHEMA,
        **record,
        **model.facts(),
        "seconds": clock.seconds,
        "threads": threads,
        "device": card["training"]["device"],
        "machine": machine(),
        "versions": versions(),
        "seed": seed,
    }


def _scratch(out: Path) -> Path:
    return out.with_name(f"{out.name}.training")


def _folders(data: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[Path]:
    return [Path(data)] if isinstance(data, str | os.PathLike) else [Path(folder) for folder in data]


def _checkpoint(
    out: Path, dataset: Dataset, train_split: TrainingSplit, settings: TrainSettings, seed: int, start: str
) -> Checkpoint:
    identity = [settings.identity(), seed, dataset.fingerprint(), *train_split.fingerprints]
    fingerprint = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
    checkpoint = Checkpoint(_scratch(out), fingerprint)
    if start == "fresh":
        checkpoint.discard()
    elif start == "resume" and not checkpoint.exists():
        message = f"to resume there must be a checkpoint {checkpoint.path}; there is none"
        raise CheckpointError(message, where=str(checkpoint.path))
    return checkpoint


def _card(
    model: Network, dataset: Dataset, material: Material, recipe: Recipe, seed: int, state: FitState
) -> dict[str, Any]:
    fields, settings, split = dataset.fields, recipe.settings, dataset.split
    rows = {"train": split.train, "valid": split.valid, "test": split.test}
    errors = {name: mean_error(model, fields[part]) for name, part in rows.items()}
    about, test = material.moments, fields[split.test]
    components, _ = principal_components(material.parts, about, settings.n_latent)
    errors["pca"] = pca_error(components, about.mean, test)
    errors["mean_shape"] = pca_error(components[:0], about.mean, test)
    return {
        "schema": MODEL_SCHEMA,
        "kind": model.kind,
        "mesh_digest": dataset.mesh_digest,
        "n_nodes": dataset.n_nodes,
        "n_latent": settings.n_latent,
        **model.facts(),
        "seed": seed,
        "recipe": recipe.raw,
        "settings": settings.as_dict(),
        "members": len(fields),
        "trained_on": about.n_fields,
        "split": {name: len(part) for name, part in rows.items()},
        "epochs": state.epoch,
        "best_epoch": state.best_epoch,
        "errors_mm": errors,
        **_closure_alone(model, test),
        "scale_mm": float(model.scale_mm),
        "kl_weight": settings.kl_weight,
        "spread_weight": settings.spread_weight,
        "code_spread": code_spread(model, fields[split.test], seed),
        "prior": measured_prior(model, fields[split.train], dataset.simulations, dataset.truths),
        "samples": sampled_inversions(model, dataset.nodes, dataset.tets, seed),
        "reconstructions": inversions(dataset.nodes, dataset.tets, _reconstructed(model, test)),
        "versions": versions(),
    }


def _closure_alone(model: Network, test: FieldArray) -> dict[str, float]:
    """Return what a closure errs without the graph network that was trained with it; nothing of other networks."""
    if not isinstance(model, GraphClosure):
        return {}
    with model.graph_switched_off():
        return {"test_mm_without_graph": mean_error(model, test)}


def _reconstructed(model: Network, fields: FieldArray) -> Iterator[FieldArray]:
    for start in range(0, len(fields), 50):
        yield decoded(model, codes(model, fields[start : start + 50])[0])


def _training(state: FitState, settings: TrainSettings, model: Network, threads: int) -> dict[str, Any]:
    """Return how it was trained: hours of all runs, and the machine of the last."""
    seconds = [row["seconds"] for row in state.history]
    return {
        "hours": sum(seconds) / 3600,
        "seconds_an_epoch": float(np.median(seconds)) if seconds else 0.0,
        "stopped_early": stalled(state, settings) and state.epoch < settings.epochs,
        "device": device_name(model.device),
        "threads": threads,
        "machine": machine(),
    }


def _error_fields(
    model: Network, dataset: Dataset, split: Split, n_most: int
) -> dict[str, np.ndarray[Any, np.dtype[Any]]]:
    """Return what the network misses of fields it never saw: the pairs' truths, or the test split without pairs.

    ``error_fields_mm`` of whole fields, ``change_error_fields_mm`` of the change from simulation to truth, both
    (e, n_nodes, 3), and ``error_sizes_mm``, ``change_sizes_mm``, the root mean square of the true fields.
    """
    unseen = (dataset.truths if len(dataset.truths) else dataset.fields[split.test])[:n_most]
    simulated, true = dataset.simulations[:n_most], dataset.truths[:n_most]
    return {
        **_stored_errors("error_fields_mm", error_fields(model, unseen)),
        "error_sizes_mm": root_mean_square(unseen),
        **_stored_errors("change_error_fields_mm", change_error_fields(model, simulated, true)),
        "change_sizes_mm": root_mean_square(true - simulated),
    }


def _stored_errors(name: str, errors: FieldArray) -> dict[str, np.ndarray[Any, np.dtype[Any]]]:
    return stored(name, rounded_rows(torch.from_numpy(errors), ERROR_STEP).numpy())


def _facts(card: dict[str, Any], model: Network) -> dict[str, Any]:
    named = ("kind", "mesh_digest", "n_latent", "kl_weight", "seed")
    return {**{key: card[key] for key in named}, **model.facts()}
