"""What the pages show of the embedded phantom: the tables of `tissuereg demo` and of the shipped model, the picture.

    python tools/demo_figures.py            # docs/results.md, docs/phantom.png
    python tools/demo_figures.py --tables   # docs/results.md alone

Run it after a change of the model in ``python/tissuereg/phantom/model`` or of the phantom. The picture is of a
registration of the same markers without the model, by contacts.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg.phantom import shipped_model_folder
from tissuereg.phantom.demo import run_demo
from tissuereg.phantom.event import LESION_MM, make_event
from tissuereg.registration.register import register

ROOT = Path(__file__).resolve().parents[1]
RESULTS, PICTURE = ROOT / "docs" / "results.md", ROOT / "docs" / "phantom.png"


def demo_table(answer: dict[str, Any]) -> str:
    """Return the errors of the demonstration as a table, from its JSON."""
    truth, target = answer["truth"], answer["targets"]["lesion"]
    lesion = truth["targets"]["lesion"]
    axes = " x ".join(f"{radius:.2f}" for radius in target["region90_radii_mm"])
    region = f"90 % region {axes} mm {'contains' if lesion['inside_region90'] else 'misses'} the truth"
    motion = np.linalg.norm(make_event(seed=answer["seed"]).true_displacement, axis=1).mean()
    rows = [
        ("markers", truth["markers"], ""),
        ("lesion inside", lesion, f"; {region}"),
        (f"whole body ({motion:.1f} mm mean motion)", truth["body"], ""),
    ]
    head = f"| mean error, mm (`make demo`, seed {answer['seed']}) | simulation | registered |\n| --- | --- | --- |\n"
    return head + "".join(f"| {name} | {e['before_mm']:.2f} | {e['after_mm']:.2f}{more} |\n" for name, e, more in rows)


def model_table() -> str:
    """Return the test errors on the shipped model's card as a table."""
    card = json.loads((shipped_model_folder() / "model.json").read_text(encoding="utf-8"))
    made = (
        f"`{card['kind']}`, {card['n_latent']} latents, {card['trained_on']:,} simulations of {card['n_nodes']:,} nodes"
    )
    return (
        "| shipped model of the phantom (`make phantom-model`) | test error, mm |\n| --- | --- |\n"
        f"| {made} | {card['errors_mm']['test']:.3f} |\n"
        f"| 26 principal components, same split | {card['errors_mm']['pca']:.3f} |\n"
    )


def draw() -> None:
    """Draw the demonstration's markers registered without a model."""
    event = make_event(seed=0)
    result = register(event.mesh, event.markers, targets={"lesion": LESION_MM})
    result.plot().savefig(PICTURE, dpi=110)


def main() -> None:
    """Write the tables, and the picture."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--tables", action="store_true", help="write no picture")
    args = parser.parse_args()
    sys.path.insert(0, str(ROOT / "benchmarks"))
    from readme import write_table

    with tempfile.TemporaryDirectory() as folder:
        write_table("demo", demo_table(run_demo(Path(folder) / "demo", seed=0)), RESULTS)
    write_table("model", model_table(), RESULTS)
    if not args.tables:
        draw()


if __name__ == "__main__":
    main()
