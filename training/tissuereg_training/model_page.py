"""The model card as a page for people, `MODEL.md`; `model.json` is the same for programs, and more."""

from typing import Any

_NAMES = {
    "gnn-vae": "Graph network of Table II",
    "closure": "Principal components combined by a perceptron",
    "graph-closure": "Principal components combined by a perceptron, and a graph network",
}


def model_page(card: dict[str, Any]) -> str:
    """Return the page.

    Parameters
    ----------
    card : dict
        Content of ``model.json``.

    Returns
    -------
    str
        Markdown.
    """
    errors, training, spread = card["errors_mm"], card["training"], card["code_spread"]
    rows = [
        ("training split", errors["train"]),
        ("validation split", errors["valid"]),
        ("test split", errors["test"]),
        (f"{card['n_latent']} principal components, test split", errors["pca"]),
        ("constant mean shape, test split", errors["mean_shape"]),
    ]
    if "test_mm_without_graph" in card:
        rows.insert(3, ("test split, graph network switched off", card["test_mm_without_graph"]))
    lines = [
        f"# {_NAMES[card['kind']]}",
        "",
        f"{card['n_latent']} latents, {card['n_nodes']:,} nodes. {_sizes(card)}",
        "",
        "| mean Euclidean node error | mm |",
        "| --- | --- |",
        *(f"| {name} | {value:.4f} |" for name, value in rows),
        "",
        f"Share of the principal components' error: {errors['test'] / errors['pca']:.3f}.",
        "",
        "![Curves of the training](training.png)",
        "",
        "## Data and training",
        "",
        *(f"* {_data(each)}" for each in card["data"]),
        f"* Trained on {card['trained_on']:,} fields; {card['split']['valid']:,} for validation, "
        f"{card['split']['test']:,} for the test.",
        f"* {card['epochs']} epochs{' (stopped early)' if training['stopped_early'] else ''}, the best was "
        f"{card['best_epoch']}; {training['hours']:.2f} hours on {training['device']}, {training['threads']} threads, "
        f"{training['machine']['processor']}.",
        f"* Seed {card['seed']}; settings and versions: `model.json`.",
        "",
        "## Latents",
        "",
        f"* KL weight {card['kl_weight']:g}; {spread['active']} of {card['n_latent']} latents carry information.",
        f"* Spread of the test split's codes, q included: {spread['aggregate_std_mean']:.3f} "
        "(1 under the prior N(0, 1)).",
        f"* {_inversions('Decoded draws of N(0, I)', card['samples'])}",
        f"* {_inversions('Reconstructions of the test split', card['reconstructions'])}",
        "",
    ]
    return "\n".join(lines)


def _sizes(card: dict[str, Any]) -> str:
    found = []
    if "hidden" in card:
        widths = (card["n_latent"], *card["hidden"], card["n_components"])
        found.append(f"Latents to coefficients {' > '.join(map(str, widths))}, {card['activation']}.")
    if "levels" in card:
        found.append(f"Levels {' > '.join(f'{n:,}' for n in card['levels'])}, channels {card['channels']}.")
    return " ".join(found)


def _data(each: dict[str, Any]) -> str:
    return f"{each['members']:,} members of the recipe `{each['recipe_sha256'][:12]}` with seed {each['seed']}."


def _inversions(what: str, found: dict[str, Any]) -> str:
    return (
        f"{what} ({found['fields']:,}): smallest det F {found['min_det_f']:.3f}, {found['inverted_tets']:.2e} of all "
        f"tetrahedra inverted, {found['fields_with_inverted_tets']:.1%} of the fields with any."
    )
