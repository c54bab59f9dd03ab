"""Who may import whom, read from the syntax trees; what `import tissuereg` may load."""

import ast
import subprocess
import sys
from pathlib import Path

import tissuereg

PACKAGE = Path(tissuereg.__file__).parent
HEAVY = ("torch", "onnxruntime", "meshio", "scipy", "trimesh", "pyvista", "matplotlib", "pytetwild", "tqdm")


def imports_of(path: Path) -> set[str]:
    """Names that a file imports, function bodies included, imports for annotations alone left out."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = [n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    skipped = {id(inner) for block in for_types for inner in ast.walk(block)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def module_of(path: Path) -> str:
    parts = ("tissuereg", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def test_importing_the_package_loads_nothing_heavy():
    code = f"import sys, tissuereg; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_module_imports_itself_in_a_circle():
    needs = {name: {i for i in imports_of(path) if i in MODULES and i != "tissuereg"} for name, path in MODULES.items()}
    done, open_ = set(), []

    def visit(name: str) -> None:
        assert name not in open_, f"circle: {' > '.join([*open_[open_.index(name) :], name])}"
        if name in done:
            return
        open_.append(name)
        for needed in sorted(needs[name]):
            # A package's own __init__ re-exports its parts; its parts do not import it.
            if needed != name:
                visit(needed)
        open_.pop()
        done.add(name)

    for name in MODULES:
        visit(name)


def test_torch_and_the_training_package_are_reached_by_the_train_command_alone():
    for name, path in MODULES.items():
        roots = {i.split(".")[0] for i in imports_of(path)}
        assert "torch" not in roots, name
        text = path.read_text(encoding="utf-8")
        if name != "tissuereg.cli.train":
            assert "tissuereg_training" not in text, name


def test_layers_point_downwards():
    layers = [
        {"errors", "_arguments", "_arrays", "_choice", "_core", "_clock", "_locking", "_machine", "_version"},
        {
            "mesh",
            "material",
            "material_tests",
            "markers",
            "load",
            "surface",
            "triangles",
            "experiment",
            "material_experiment",
            "trust",
        },
        {"effects", "_per_mesh"},
        {"observe", "simulate", "latent", "assimilate", "io", "posterior", "widen", "phantom", "baselines", "readings"},
        {"contacts", "inputs", "meshing"},
        {
            "registration",
            "contact_registration",
            "contact_answer",
            "latent_registration",
            "result",
            "report",
            "diagnose",
        },
        {"demo", "bench", "frames"},
        {"cli", "__main__"},
    ]
    rank = {part: level for level, parts in enumerate(layers) for part in parts}
    for name, path in MODULES.items():
        if name == "tissuereg":
            continue
        own = name.split(".")[1]
        for needed in imports_of(path):
            parts = needed.split(".")
            if parts[0] == "tissuereg" and len(parts) > 1 and parts[1] in rank:
                assert rank[parts[1]] <= rank[own], f"{name} imports {needed}"


def test_the_cores_know_nothing_of_each_other_nor_of_python():
    root = Path(__file__).resolve().parents[2] / "crates"
    contacts = (root / "contacts" / "Cargo.toml").read_text(encoding="utf-8")
    assert "fem" not in contacts.split("[dependencies]")[1]
    assert "esmda" not in contacts.split("[dependencies]")[1]
    fem = (root / "fem" / "Cargo.toml").read_text(encoding="utf-8")
    esmda = (root / "esmda" / "Cargo.toml").read_text(encoding="utf-8")
    assert "esmda" not in fem.split("[dependencies]")[1]
    assert "fem" not in esmda.split("[dependencies]")[1]
    assert "pyo3" not in fem + esmda + contacts
