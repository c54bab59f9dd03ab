"""The training split: rows of the first data set, and all members of further ones, read part by part."""

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from tissuereg_training.data import Dataset, FieldArray, read_chunk, read_chunk_files
from tissuereg_training.errors import ExperimentError, MeshError

#: Fields of the first data set in a part.
_PART = 500


class TrainingSplit:
    """Fields to train on, in parts; can be walked through again and again.

    Parameters
    ----------
    dataset : Dataset
        In memory; gives its training split, and its validation and test splits are what no further set may hold.
    further : sequence of Path
        Folders of more members from the same recipe with another seed, on the same mesh. All of them are trained on,
        whatever splits they name. They stay on disk: each pass reads them again.

    Raises
    ------
    FormatError
        If a folder is no data set, or holds numbers that are not finite.
    MeshError
        If one was made on another mesh.
    ExperimentError
        If one holds a field of the first set, which would be trained on twice or, worse, also tested on.

    Notes
    -----
    Cost: one pass over everything, which makes the fingerprints.
    """

    def __init__(self, dataset: Dataset, further: Sequence[Path] = ()) -> None:
        self._dataset = dataset
        self._files: list[Path] = []
        #: SHA-256 of the fields of every further folder.
        self.fingerprints: list[str] = []
        self._n_further = 0
        known = {hashlib.sha256(field).digest() for field in dataset.fields} if further else set()
        for folder in further:
            digest, files = read_chunk_files(folder)
            if digest != dataset.mesh_digest:
                message = (
                    f"{folder} must hold fields on the mesh of {dataset.folder}, {dataset.mesh_digest[:12]}; "
                    f"its mesh is {digest[:12]}"
                )
                raise MeshError(message, where=str(folder))
            self._files += files
            self._add(folder, files, known)

    def _add(self, folder: Path, files: list[Path], known: set[bytes]) -> None:
        whole = hashlib.sha256()
        for file in files:
            for number, field in zip(*read_chunk(file, self._dataset.n_nodes), strict=True):
                digest = hashlib.sha256(field).digest()
                if digest in known:
                    message = (
                        f"{folder} must hold other members than the data before it; its member {number} is there "
                        "already. Make it with another seed"
                    )
                    raise ExperimentError(message, where=str(file))
                known.add(digest)
                whole.update(digest)
                self._n_further += 1
        self.fingerprints.append(whole.hexdigest())

    def __len__(self) -> int:
        return len(self._dataset.split.train) + self._n_further

    def __iter__(self) -> Iterator[FieldArray]:
        """Return an iterator over parts, float32, (n_part, n_nodes, 3), mm."""
        rows = self._dataset.split.train
        for start in range(0, len(rows), _PART):
            yield self._dataset.fields[rows[start : start + _PART]]
        for file in self._files:
            yield read_chunk(file, self._dataset.n_nodes)[1]
