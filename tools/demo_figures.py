"""What the pages show of the embedded phantom: the table of the shipped models, and the picture.

    python tools/demo_figures.py            # docs/results.md, docs/phantom.png
    python tools/demo_figures.py --table    # docs/results.md alone

Run it after a change of a model in ``python/tissuereg/phantom`` or of the phantom. The picture is of a
registration of the same markers without the model, by contacts.
"""

import argparse
import json
import sys
from pathlib import Path

import own_sources  # noqa: F401 (before the package)

from tissuereg.phantom import SHIPPED_MODELS, shipped_model_folder
from tissuereg.phantom.event import LESION_MM, make_event
from tissuereg.registration.register import register

ROOT = Path(__file__).resolve().parents[1]
RESULTS, PICTURE = ROOT / "docs" / "results.md", ROOT / "docs" / "phantom.png"


def model_table() -> str:
    """Return the test errors on the shipped models' cards as a table."""
    lines = [
        "| shipped models of the phantom (`make phantom-model`) | folder, MB | test error, mm |\n| --- | --- | --- |\n"
    ]
    for name in SHIPPED_MODELS:
        folder = shipped_model_folder(name)
        card = json.loads((folder / "model.json").read_text(encoding="utf-8"))
        size = sum(path.stat().st_size for path in folder.iterdir()) / 1e6
        made = f"`{card['kind']}`, {card['n_latent']} latents, {card['trained_on']:,} simulations"
        lines.append(f'| `model="{name}"`: {made} | {size:.1f} | {card["errors_mm"]["test"]:.3f} |\n')
    lines.append(f"| {card['n_latent']} principal components, same split | | {card['errors_mm']['pca']:.3f} |\n")
    return "".join(lines)


def draw() -> None:
    """Draw the demonstration's markers registered without a model."""
    event = make_event(seed=0)
    result = register(event.mesh, event.markers, targets={"lesion": LESION_MM})
    result.plot().savefig(PICTURE, dpi=110)


def main() -> None:
    """Write the table, and the picture."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--table", action="store_true", help="write no picture")
    args = parser.parse_args()
    sys.path.insert(0, str(ROOT / "benchmarks"))
    from readme import write_table

    write_table("model", model_table(), RESULTS)
    if not args.table:
        draw()


if __name__ == "__main__":
    main()
