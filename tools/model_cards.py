"""Enter size and SHA-256 of each listed file into the cards of models: ``python tools/model_cards.py FOLDER ...``.

Files whose SHA-256 is listed and differs are refused: the command adds sizes, it does not sign what was changed.
"""

import sys
from pathlib import Path

import own_sources  # noqa: F401 (before the package)

from tissuereg.registration.learned.card import card_text, list_file, read_card, sha256_of


def main(folders: list[str]) -> int:
    """Write the cards of the given folders; return 1 if a file is not the one listed."""
    for folder in map(Path, folders):
        card = read_card(folder)
        for name, wanted in list(card["files"].items()):
            if sha256_of(folder / name) != wanted:
                print(f"{folder / name} is not the file that its card lists", file=sys.stderr)
                return 1
            list_file(card, folder / name)
        (folder / "model.json").write_text(card_text(card), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
