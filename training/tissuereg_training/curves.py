"""The curves of a training as a picture."""

import io
from collections.abc import Sequence


def training_curves(history: Sequence[dict[str, float]], scale_mm: float, errors_mm: dict[str, float]) -> bytes:
    """Return a picture of a training's course.

    Parameters
    ----------
    history : sequence of dict
        A row an epoch: ``epoch``, ``reconstruction`` (in units of the scale), ``valid_mm``.
    scale_mm : float
        The scale, mm.
    errors_mm : dict
        ``pca`` and ``mean_shape`` of the test split, drawn as level lines.

    Returns
    -------
    bytes
        PNG.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    epochs = [row["epoch"] for row in history]
    axes.plot(epochs, [row["reconstruction"] * scale_mm for row in history], label="train (latents drawn)")
    axes.plot(epochs, [row["valid_mm"] for row in history], label="validation")
    for name, label, style in (("mean_shape", "constant mean shape", ":"), ("pca", "principal components", "--")):
        axes.axhline(errors_mm[name], color="black", linestyle=style, linewidth=1.0, label=f"{label}, test")
    axes.set(xlabel="epoch", ylabel="reconstruction error, mm", yscale="log")
    axes.grid(visible=True, which="both", linewidth=0.3)
    axes.legend()
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=100)
    return picture.getvalue()
