"""Declare the layers of the package and of the crates, and draw them into ARCHITECTURE.md.

    python tools/layers.py            # print the diagram
    python tools/layers.py --write    # write it into ARCHITECTURE.md, between its two markers

`tests/layout` checks that the code keeps to this declaration and that the page shows the diagram.
"""

import argparse
import textwrap
from pathlib import Path

#: Layers of `python/tissuereg`, from the top: a title, and its modules and packages. A module may
#: import from its own layer (without a circle) and from lower ones.
LAYERS: tuple[tuple[str, str], ...] = (
    ("commands", "__main__ cli"),
    ("what the simulation gets wrong", "diagnosis"),
    ("the embedded body and its demo; a surface becomes a body", "phantom meshing"),
    ("pages and pictures", "report"),
    ("markers in, a registered body out, over the network", "live"),
    ("a body in motion", "tracking"),
    ("one state of a body", "registration"),
    ("equilibria, histories, data sets", "simulation"),
    ("grid transforms, warped images", "imaging"),
    ("files, the only place of other units", "io"),
    ("many tasks, the only place of processes and Dask", "parallel"),
    ("a rig, what was measured, what may have happened", "experiment"),
    ("plain data of a body and what is seen of it", "body"),
    ("what every room may use", "_base"),
    ("compiled core, its version", "_core _version"),
    ("exceptions", "errors"),
)

#: Imports from a room to a higher one. Each stands in a function, so that nothing is loaded before it is needed.
LATE: dict[tuple[str, str], str] = {
    ("registration", "report"): "a result draws and writes itself when it is asked to",
    ("registration", "phantom"): 'the word "phantom" names the embedded model',
    ("simulation", "phantom"): 'a recipe may name the mesh "breast"',
}

#: Crates, and the crates of this repository that each may depend on.
CRATES: dict[str, tuple[str, ...]] = {
    "bindings": ("boundary", "contacts", "esmda", "fem"),
    "boundary": ("fem",),
    "contacts": (),
    "esmda": (),
    "fem": (),
}

#: Layers of the sources of a crate, from the top: a title, and its modules. A module may use its own
#: layer (without a circle among files) and lower ones.
RUST_LAYERS: dict[str, tuple[tuple[str, str], ...]] = {
    "fem": (
        ("derivatives of equilibria", "sensitivity"),
        ("many members, frame after frame, the shape without load", "ensemble history rest_shape"),
        ("equilibrium", "solve"),
        ("loads on a body, materials with a memory", "load memory surface"),
        ("a body, analysed once", "body"),
        ("loops over elements", "assembly"),
        ("elements, supports and what they leave free, systems of one unknown a node", "element rigid scalar supports"),
        ("meshes, laws, sparse systems", "material mesh system"),
        ("plain data and checks, rotations", "check error groups raster resultant rotation springs"),
    ),
}

#: The only module that may name the training package, which it imports when it is run.
TRAINING_MODULE = "tissuereg.cli.train"

BEGIN, END = "<!-- layers: written by tools/layers.py -->", "<!-- end of layers -->"
PAGE = Path(__file__).resolve().parent.parent / "ARCHITECTURE.md"
WIDTH = 100


def ranks() -> dict[str, int]:
    """Return the height of every module's layer, 0 for the lowest.

    Raises
    ------
    ValueError
        If a module is declared in two layers.
    """
    found: dict[str, int] = {}
    for height, (title, modules) in enumerate(reversed(LAYERS)):
        for module in modules.split():
            if module in found:
                message = f"`{module}` must be in one layer, found in two, the upper one being `{title}`"
                raise ValueError(message)
            found[module] = height
    return found


def rust_ranks(crate: str) -> dict[str, int]:
    """Return the height of the layer of every module of a crate, 0 for the lowest.

    Raises
    ------
    KeyError
        If the crate has no layers.
    """
    rows = enumerate(reversed(RUST_LAYERS[crate]))
    return {module: height for height, (_, modules) in rows for module in modules.split()}


def diagram() -> str:
    """Return the diagram as plain text, one box per layer, the crates below."""
    lines = []
    for title, modules in LAYERS:
        lines += [_rim(title), *(_row(line) for line in textwrap.wrap("  ".join(modules.split()), WIDTH - 4))]
    for name in (name for name, needs in CRATES.items() if needs):
        lines += [_rim(f"crates/{name}, compiled into _core"), _row(f"uses {', '.join(CRATES[name])}")]
    cores = [f" crates/{name}" for name, needs in CRATES.items() if not needs]
    cell = (WIDTH - 1) // len(cores) - 1
    widths = [cell] * (len(cores) - 1) + [WIDTH - 1 - len(cores) - cell * (len(cores) - 1)]
    rim = "+" + "+".join("-" * width for width in widths) + "+"
    row = "|" + "|".join(text.ljust(width) for text, width in zip(cores, widths, strict=True)) + "|"
    return "\n".join([*lines, rim, row, rim]) + "\n"


def written(page: str) -> str:
    """Return a page with the current diagram between its markers.

    Parameters
    ----------
    page : str
        Text with both markers, once each.

    Returns
    -------
    str
        All else as it is.

    Raises
    ------
    ValueError
        If the page lacks a marker or has it twice.
    """
    if page.count(BEGIN) != 1 or page.count(END) != 1:
        message = f"the page must hold `{BEGIN}` and `{END}` once each"
        raise ValueError(message)
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n```text\n{diagram()}```\n{END}{rest.split(END)[1]}"


def _rim(title: str) -> str:
    return f"+-- {title} ".ljust(WIDTH - 1, "-") + "+"


def _row(text: str) -> str:
    return f"| {text}".ljust(WIDTH - 1) + "|"


def main() -> None:
    """Print the diagram, or write it."""
    parser = argparse.ArgumentParser(description="The layers of the package, drawn.")
    parser.add_argument("--write", action="store_true", help="write the diagram into ARCHITECTURE.md")
    if parser.parse_args().write:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(diagram(), end="")


if __name__ == "__main__":
    main()
