"""Principal components: the baseline for every network's error."""

import numpy as np

from tissuereg_training.data import FieldArray


def pca_error(train: FieldArray, test: FieldArray, n_components: int) -> float:
    """Return the mean Euclidean node error with which principal components reconstruct unseen fields.

    Parameters
    ----------
    train : ndarray of float32, shape (n_train, n_nodes, 3)
        Fields in mm that the components are fitted to, about their mean.
    test : ndarray of float32, shape (n_test, n_nodes, 3)
        Fields in mm to reconstruct.
    n_components : int
        Components; as many as the network has latents.

    Returns
    -------
    float
        mm.

    Notes
    -----
    Cost: one symmetric eigenvalue problem of size n_train.
    """
    mean = train.mean(axis=0, dtype=np.float64)
    rows = (train - mean).reshape(len(train), -1)
    _, vectors = np.linalg.eigh(rows @ rows.T)
    components, _ = np.linalg.qr(rows.T @ vectors[:, ::-1][:, :n_components])
    unseen = (test - mean).reshape(len(test), -1)
    missed = unseen - (unseen @ components) @ components.T
    return float(np.linalg.norm(missed.reshape(test.shape), axis=2).mean())
