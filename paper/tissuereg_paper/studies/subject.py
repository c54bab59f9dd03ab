"""What a study is about: a body, a model of it, and shapes that the model was not trained on."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import ModelError
from tissuereg.phantom import shipped_model_folder
from tissuereg.registration.learned.card import read_card
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.network import NetworkModel
from tissuereg_paper.studies.layers import Layer, layers_of
from tissuereg_paper.studies.shapes import HeldOut, held_out_of


class StudyModel(Protocol):
    """A latent model with an encoder; `NetworkModel` is one."""

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        ...

    @property
    def n_nodes(self) -> int:
        """Number of mesh nodes."""
        ...

    def encode(self, field: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and variance (n_latent,) of q(z | field), of a field (n_nodes, 3) in mm."""
        ...

    def decode(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return fields (n_members, k, 3) in mm of latents (n_latent, n_members), at some nodes or at all."""
        ...

    def errors(self) -> FloatArray:
        """Return errors of reconstruction (n_fields, n_nodes, 3), mm."""
        ...

    def prior(self) -> Gaussian:
        """Return the distribution of the codes of all training fields."""
        ...


@dataclass(frozen=True, eq=False)
class Subject:
    """A body, a model of it, and its held-out shapes.

    Attributes
    ----------
    held_out : HeldOut
        Shapes, with the mesh.
    model : StudyModel
        Encoder and decoder.
    facts : dict
        About the model: ``kind``, ``source``, ``n_nodes``, ``n_latent``, ``members``, ``errors_mm``.
    layers : tuple of Layer
        Of the network; none where they are not known.
    mean : ndarray of float64, shape (n_nodes, 3), or None
        Mean of the training fields in mm, where it is known.
    """

    held_out: HeldOut
    model: StudyModel
    facts: dict[str, Any]
    layers: tuple[Layer, ...] = ()
    mean: FloatArray | None = None

    @property
    def name(self) -> str:
        """The model and the body in a few words."""
        return f"{self.facts['kind']} on {self.held_out.mesh.n_nodes} nodes"


def subject_of(model: str | os.PathLike[str] | None = None) -> Subject:
    """Return the subject of a trained model.

    Parameters
    ----------
    model : path-like, optional
        Its folder; by default that of the shipped model.

    Returns
    -------
    Subject
        Decoding takes one thread a call.

    Raises
    ------
    ModelError
        If the folder holds no model, a spoilt one, or one of a body whose recipe does not travel with the package.
    """
    folder = shipped_model_folder() if model is None else place("model", model, error=ModelError)
    card = read_card(Path(folder))
    held_out = held_out_of(card["mesh_digest"])
    source = "shipped" if model is None else Path(folder).name
    network = NetworkModel(folder, held_out.mesh, threads=1, source=source)
    facts = {name: card[name] for name in ("kind", "n_nodes", "n_latent", "members", "errors_mm")}
    tables = network.tables
    mean = None if tables is None else (getattr(tables, "closure", None) or tables).mean
    return Subject(held_out, network, {**facts, "source": source}, layers_of(card), mean)
