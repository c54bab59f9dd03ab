"""Table II of the paper: the network's layers, its reconstruction errors, and whether decoded samples are bodies."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import det_f
from tissuereg.registration.learned.model import Gaussian
from tissuereg_paper.studies.cases import Cases
from tissuereg_paper.studies.claims import Agreement, Claim
from tissuereg_paper.studies.layers import PAPER, PAPER_LATENTS, Layer
from tissuereg_paper.studies.measures import Errors
from tissuereg_paper.studies.study import Given
from tissuereg_paper.studies.subject import Subject

#: Reconstruction errors of the paper's network, mm.
PAPER_ERRORS_MM = {"train": 0.205, "test": 0.24}

#: Sizes of levels that differ by no more than this share are the paper's as near as the mesh allows.
NEAR = 0.25

#: Random latents that are decoded, and how many at a time.
N_SAMPLES, _BATCH = 1000, 25


@dataclass(frozen=True, eq=False)
class Table2:
    """What the study found.

    Attributes
    ----------
    rows : list of dict
        As those of the sweeps, with ``what`` in place of a setting: the card's splits, PCA-26, shapes made here.
    samples : dict of str to dict
        By distribution of the latents: ``samples``, ``min_det_f``, ``share_inverted_tets``, ``samples_with_inverted``.
    agreement : Agreement
        With the paper.
    """

    rows: list[dict[str, Any]]
    samples: dict[str, dict[str, Any]]
    agreement: Agreement


def table2_study(given: Given) -> dict[str, Any]:
    """Return the entries of the study's JSON."""
    found = run_table2(given.subject, given.cases, given.seed)
    agree = {"table2": found.agreement.to_json()}
    return {"rows": found.rows, "agree": agree, "layers": layer_rows(given.subject.layers), "samples": found.samples}


def run_table2(subject: Subject, cases: Cases, seed: int, n_samples: int = N_SAMPLES) -> Table2:
    """Return errors of reconstruction and the quality of decoded samples.

    Parameters
    ----------
    subject : Subject
        Body and model.
    cases : Cases
        Whose shapes are coded and decoded.
    seed : int
        Of the samples.
    n_samples : int
        Decoded samples of each distribution.

    Returns
    -------
    Table2
        Cost: two full decodes a sample.
    """
    n_latent = subject.model.n_latent
    standard = Gaussian(np.zeros(n_latent), np.eye(n_latent))
    rng = np.random.default_rng([seed, 24])
    samples = {
        "N(0, I)": _sampled(subject, standard, n_samples, rng),
        "codes of the training set": _sampled(subject, subject.model.prior(), n_samples, rng),
    }
    return Table2(_rows(subject, cases), samples, _agreement(subject))


def reconstructed(subject: Subject, fields: FloatArray) -> FloatArray:
    """Return fields (n, n_nodes, 3) coded and decoded, mm."""
    codes = np.stack([subject.model.encode(np.asarray(one, np.float64))[0] for one in fields], axis=1)
    return subject.model.decode(codes)


def layer_rows(layers: tuple[Layer, ...]) -> list[dict[str, str | None]]:
    """Return the paper's layers beside a model's where these are of the same kinds, otherwise above them."""
    if [layer.name for layer in layers] == [layer.name for layer in PAPER]:
        return [
            {"layer": paper.name, "paper": paper.size, "here": here.size}
            for paper, here in zip(PAPER, layers, strict=True)
        ]
    return [
        *({"layer": layer.name, "paper": layer.size, "here": None} for layer in PAPER),
        *({"layer": layer.name, "paper": None, "here": layer.size} for layer in layers),
    ]


def _rows(subject: Subject, cases: Cases) -> list[dict[str, Any]]:
    errors = subject.facts["errors_mm"]
    fields = cases.fields.astype(np.float64)
    here = Errors.of(reconstructed(subject, fields), fields)
    mean = subject.mean
    constant = None if mean is None else float(Errors.of(np.broadcast_to(mean, fields.shape), fields).mean.mean())
    kind, known = subject.facts["kind"], {"test": errors.get("mean_shape")}
    rows = [
        _row(
            f"{kind}, {split} (its card)",
            end=errors.get(split),
            start=known.get(split),
            paper=PAPER_ERRORS_MM.get(split),
        )
        for split in ("train", "valid", "test")
    ]
    rows.append(_row("PCA-26, test (its card)", end=errors["pca"]))
    whole = _row(f"{kind}, test shapes made here", end=float(here.mean.mean()), start=constant)
    rms, largest = float(np.sqrt((here.rms**2).mean())), float(here.largest.max())
    paper = PAPER_ERRORS_MM["test"]
    rows.append({**whole, "n_pairs": len(fields), "end_rms_mm": rms, "end_max_mm": largest, "paper_mm": paper})
    return rows


def _row(what: str, *, end: Any, start: float | None = None, paper: float | None = None) -> dict[str, Any]:
    empty = dict.fromkeys(("cd_mm2", "n_e", "n_a", "n_pairs"))
    ends = {"start_mean_mm": start, "end_mean_mm": end, "end_rms_mm": None, "end_max_mm": None}
    return {"study": "table2", "what": what, **empty, **ends, "coverage90": None, "paper_mm": paper}


def _sampled(subject: Subject, latents: Gaussian, n_samples: int, rng: np.random.Generator) -> dict[str, Any]:
    root = np.linalg.cholesky(latents.covariance)
    draws = latents.mean[:, None] + root @ rng.standard_normal((len(latents.mean), n_samples))
    least, inverted, spoilt = np.inf, 0, 0
    mesh = subject.held_out.mesh
    for first in range(0, n_samples, _BATCH):
        ratios = det_f(mesh, subject.model.decode(np.ascontiguousarray(draws[:, first : first + _BATCH])))
        least = min(least, float(ratios.min()))
        inverted += int((ratios <= 0.0).sum())
        spoilt += int((ratios <= 0.0).any(axis=1).sum())
    share = inverted / (n_samples * mesh.n_tets)
    return {"samples": n_samples, "min_det_f": least, "share_inverted_tets": share, "samples_with_inverted": spoilt}


def _agreement(subject: Subject) -> Agreement:
    test, paper = subject.facts["errors_mm"]["test"], PAPER_ERRORS_MM["test"]
    same = len(subject.layers) == len(PAPER) and all(map(_near, subject.layers, PAPER))
    shown = ", ".join(layer.size for layer in subject.layers) or "not known"
    claims = (
        Claim(f"layers as in Table II, levels within {NEAR:.0%}", same, f"outputs {shown}"),
        Claim(f"{PAPER_LATENTS} latents", subject.model.n_latent == PAPER_LATENTS, f"{subject.model.n_latent}"),
        Claim(f"test error of {paper} mm or less", test <= paper, f"{test:.3f} mm"),
    )
    return Agreement({"Table II": claims})


def _near(one: Layer, other: Layer) -> bool:
    if one.name != other.name or len(one.output) != len(other.output):
        return False
    # Channels and latents are free to choose; the numbers of nodes are the mesh's.
    nodes = abs(one.output[0] / other.output[0] - 1.0) <= NEAR
    flat = one.output[0] == 1 and abs(one.output[1] / other.output[1] - 1.0) <= NEAR
    return nodes and (flat or one.output[1] == other.output[1])
