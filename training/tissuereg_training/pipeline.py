"""From a recipe and a data set to a model folder: the main path, in order."""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg_training.checkpoint import Checkpoint
from tissuereg_training.data import (
    Dataset,
    Split,
    check_recipe_fits,
    check_split,
    read_dataset,
    read_dataset_recipe,
)
from tissuereg_training.errors import CheckpointError
from tissuereg_training.evaluate import (
    change_error_fields,
    code_spread,
    error_fields,
    mean_error,
    measured_prior,
    root_mean_square,
)
from tissuereg_training.export import decoder_onnx, decoder_weights, encoder_onnx
from tissuereg_training.fit import FitState, fit, new_model, set_normalisation
from tissuereg_training.folder import check_out, put_back, write_model
from tissuereg_training.graph import hierarchy
from tissuereg_training.host import Clock, machine, prepare, versions
from tissuereg_training.model import GraphVae
from tissuereg_training.parity import checked_parity
from tissuereg_training.pca import pca_error
from tissuereg_training.recipe import Recipe, TrainSettings, read_recipe

SCHEMA = "tissuereg.train/1"
MODEL_SCHEMA = "tissuereg.model/1"
#: Reconstruction errors kept in the model folder, at most.
N_ERROR_FIELDS = 64


def train(
    recipe_path: str | os.PathLike[str],
    data: str | os.PathLike[str],
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
    data : path-like
        Folder made by `tissuereg simulate`.
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
        ``schema``, ``errors_mm``, ``epochs``, ``best_epoch``, ``parity``, ``kl_weight``, ``levels``, ``members``,
        ``seconds``, ``threads``, ``machine``, ``versions``, ``seed``.

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
            check_recipe_fits(recipe, read_dataset_recipe(data))
            dataset = read_dataset(data)
            seed = recipe.seed if seed is None else seed
            settings = recipe.settings
            split = dataset.split
            check_split(split, settings.n_latent)
            checkpoint = _checkpoint(out, dataset, settings, seed, start)
        with clock.stage("coarsen"):
            levels = hierarchy(dataset.n_nodes, dataset.tets, len(settings.channels), settings.coarse_edges)
            notify(levels.summary())
        model = new_model(levels, settings, seed)
        set_normalisation(model, dataset.fields[split.train])
        if checkpoint.exists():
            notify(f"continuing from {checkpoint.path}")
        with clock.stage("train"):
            state = fit(model, dataset.fields, split, settings, seed=seed, checkpoint=checkpoint, report=report)
        with clock.stage("evaluate"):
            card = _card(model, dataset, split, recipe, seed, state)
            errors = _error_fields(model, dataset, split)
            notify("mean error in mm: " + ", ".join(f"{k} {v:.4f}" for k, v in card["errors_mm"].items()))
        with clock.stage("export"):
            facts = _facts(card)
            encoder, decoder = encoder_onnx(model, facts), decoder_onnx(model, facts)
            fields = dataset.fields[split.test][:32]
            card["parity"] = checked_parity(model, encoder, decoder, fields, seed)
            weights = {**decoder_weights(model), **errors}
            write_model(out, checkpoint.folder, encoder, decoder, weights, card)
            checkpoint.discard()
    record = {k: card[k] for k in ("errors_mm", "epochs", "best_epoch", "parity", "kl_weight", "levels", "members")}
    return {
        "schema": SCHEMA,
        **record,
        "seconds": clock.seconds,
        "threads": threads,
        "machine": machine(),
        "versions": versions(),
        "seed": seed,
    }


def _scratch(out: Path) -> Path:
    return out.with_name(f"{out.name}.training")


def _checkpoint(out: Path, dataset: Dataset, settings: TrainSettings, seed: int, start: str) -> Checkpoint:
    identity = [settings.as_dict(), seed, dataset.fingerprint()]
    fingerprint = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
    checkpoint = Checkpoint(_scratch(out), fingerprint)
    if start == "fresh":
        checkpoint.discard()
    elif start == "resume" and not checkpoint.exists():
        message = f"to resume there must be a checkpoint {checkpoint.path}; there is none"
        raise CheckpointError(message, where=str(checkpoint.path))
    return checkpoint


def _card(
    model: GraphVae, dataset: Dataset, split: Split, recipe: Recipe, seed: int, state: FitState
) -> dict[str, Any]:
    fields, settings = dataset.fields, recipe.settings
    rows = {"train": split.train, "valid": split.valid, "test": split.test}
    errors = {name: mean_error(model, fields[part]) for name, part in rows.items()}
    errors["pca"] = pca_error(fields[split.train], fields[split.test], settings.n_latent)
    return {
        "schema": MODEL_SCHEMA,
        "kind": "gnn-vae",
        "mesh_digest": dataset.mesh_digest,
        "n_nodes": dataset.n_nodes,
        "n_latent": settings.n_latent,
        "levels": list(model.levels.sizes),
        "channels": list(settings.channels),
        "n_bases": settings.n_bases,
        "seed": seed,
        "recipe": recipe.raw,
        "settings": settings.as_dict(),
        "members": len(fields),
        "split": {name: len(part) for name, part in rows.items()},
        "epochs": state.epoch,
        "best_epoch": state.best_epoch,
        "errors_mm": errors,
        "scale_mm": float(model.scale_mm),
        "kl_weight": settings.kl_weight,
        "code_spread": code_spread(model, fields[split.test], seed),
        "prior": measured_prior(model, fields[split.train], dataset.simulations, dataset.truths),
        "versions": versions(),
    }


def _error_fields(model: GraphVae, dataset: Dataset, split: Split) -> dict[str, np.ndarray[Any, np.dtype[Any]]]:
    """Return what the network misses of fields it never saw: the pairs' truths, or the test split without pairs.

    ``error_fields_mm`` of whole fields, ``change_error_fields_mm`` of the change from simulation to truth, both
    (e, n_nodes, 3), and ``error_sizes_mm``, ``change_sizes_mm``, the root mean square of the true fields.
    """
    unseen = (dataset.truths if len(dataset.truths) else dataset.fields[split.test])[:N_ERROR_FIELDS]
    simulated, true = dataset.simulations[:N_ERROR_FIELDS], dataset.truths[:N_ERROR_FIELDS]
    return {
        "error_fields_mm": error_fields(model, unseen).astype(np.float16),
        "error_sizes_mm": root_mean_square(unseen),
        "change_error_fields_mm": change_error_fields(model, simulated, true).astype(np.float16),
        "change_sizes_mm": root_mean_square(true - simulated),
    }


def _facts(card: dict[str, Any]) -> dict[str, Any]:
    named = ("kind", "mesh_digest", "levels", "channels", "n_bases", "n_latent", "kl_weight", "seed")
    return {key: card[key] for key in named}
