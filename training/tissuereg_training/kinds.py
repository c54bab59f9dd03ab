"""The kinds of network, by the recipe's word: how one is started and how it is exported."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy.typing as npt
import onnx
import torch

from tissuereg_training import closure_export, export, graph_closure_export
from tissuereg_training.closure import Closure
from tissuereg_training.data import FieldArray
from tissuereg_training.errors import EnsembleError
from tissuereg_training.graph import IntArray, hierarchy
from tissuereg_training.graph_closure import GraphClosure
from tissuereg_training.model import GraphVae
from tissuereg_training.network import Network
from tissuereg_training.pca import Moments, principal_components
from tissuereg_training.settings import ClosureSettings, GraphClosureSettings, GraphSettings, TrainSettings

N = TypeVar("N", bound=Network)
S = TypeVar("S", bound=TrainSettings)


@dataclass(frozen=True, eq=False)
class Material:
    """What a network is started from.

    Attributes
    ----------
    tets : ndarray of int64, shape (n_tets, 4)
        The mesh.
    parts : iterable of ndarray of float32, shape (n_part, n_nodes, 3)
        Training split in mm, in parts; can be walked through again and again.
    moments : Moments
        Its mean field and scale.
    """

    tets: IntArray
    parts: Iterable[FieldArray]
    moments: Moments


@dataclass(frozen=True)
class Kind(Generic[N, S]):
    """What differs between kinds of network.

    Attributes
    ----------
    start : callable
        Returns an untrained network, normalised, and a line about its sizes.
    encoder_onnx, decoder_onnx : callable
        Return an ONNX file of a network and metadata.
    decoder_weights : callable
        Returns the content of ``decoder_weights.npz``.
    """

    start: Callable[[Material, S], tuple[N, str]]
    encoder_onnx: Callable[[N, dict[str, Any]], onnx.ModelProto]
    decoder_onnx: Callable[[N, dict[str, Any]], onnx.ModelProto]
    decoder_weights: Callable[[N], dict[str, npt.NDArray[Any]]]


def new_network(material: Material, settings: TrainSettings, seed: int) -> tuple[Network, str]:
    """Return an untrained network of the settings' kind, and a line about its sizes.

    Parameters
    ----------
    material : Material
        Mesh and training split.
    settings : TrainSettings
        Their class tells the kind.
    seed : int
        Of its start, which depends on nothing else that is random.

    Returns
    -------
    network : Network
        Normalised.
    line : str
        Sizes.

    Raises
    ------
    EnsembleError
        If the training split is too small for the components asked for.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network, line = KINDS[settings.kind].start(material, settings)
    return network, line


def _new_graph(material: Material, settings: GraphSettings) -> tuple[GraphVae, str]:
    n_nodes = len(material.moments.mean)
    levels = hierarchy(n_nodes, material.tets, len(settings.channels), settings.coarse_edges)
    model = GraphVae(levels, settings.channels, settings.n_bases, settings.n_latent)
    model.mean_mm.copy_(torch.from_numpy(material.moments.mean))
    model.scale_mm.fill_(material.moments.scale)
    return model, levels.summary()


def _new_closure(material: Material, settings: ClosureSettings) -> tuple[Closure, str]:
    n_nodes, n_wanted = len(material.moments.mean), settings.n_components
    model = Closure(n_nodes, n_wanted, settings.n_latent, settings.hidden, settings.encoder_hidden, settings.activation)
    return model, _on_components(model, material, settings)


def _new_graph_closure(material: Material, settings: GraphClosureSettings) -> tuple[GraphClosure, str]:
    levels = hierarchy(len(material.moments.mean), material.tets, len(settings.channels), settings.coarse_edges)
    model = GraphClosure(
        levels,
        settings.channels,
        settings.n_bases,
        settings.n_components,
        settings.n_latent,
        settings.hidden,
        settings.encoder_hidden,
        settings.activation,
    )
    return model, f"{_on_components(model, material, settings)}; {levels.summary()}"


def _on_components(model: Closure, material: Material, settings: ClosureSettings) -> str:
    """Give a closure the components of the training split; return a line about its sizes."""
    about, n_wanted = material.moments, settings.n_components
    if about.n_fields <= n_wanted:
        message = (
            f"{n_wanted} principal components must be taken of more than {n_wanted} training fields, "
            f"got {about.n_fields}; simulate more, or lower [train] n_components"
        )
        raise EnsembleError(message, where="members")
    components, std = principal_components(material.parts, about, n_wanted)
    model.set_components(about, torch.from_numpy(components), torch.from_numpy(std))
    widths = (settings.n_latent, *settings.hidden, n_wanted)
    return f"latents > coefficients {' > '.join(map(str, widths))}, {len(about.mean)} nodes"


#: By the name in a recipe.
KINDS: dict[str, Kind[Any, Any]] = {
    "graph": Kind(_new_graph, export.encoder_onnx, export.decoder_onnx, export.decoder_weights),
    "closure": Kind(
        _new_closure, closure_export.encoder_onnx, closure_export.decoder_onnx, closure_export.decoder_weights
    ),
    "graph-closure": Kind(
        _new_graph_closure,
        closure_export.encoder_onnx,
        graph_closure_export.decoder_onnx,
        graph_closure_export.decoder_weights,
    ),
}
