"""Who may import whom, read from the syntax trees; what `import tissuereg` may load."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import tissuereg
from support.scripts import REPOSITORY, script

layers = script("tools", "layers")

PACKAGE = Path(tissuereg.__file__).parent
HEAVY = (
    "torch",
    "onnxruntime",
    "scipy",
    "trimesh",
    "pyvista",
    "matplotlib",
    "pytetwild",
    "tqdm",
    "h5py",
    "SimpleITK",
    "fsspec",
    "distributed",
    "dask",
)


def imports_of(path: Path, *, in_functions: bool = True) -> set[str]:
    """Names that a file imports, imports for annotations alone left out."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = [n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    late = [] if in_functions else [n for n in ast.walk(tree) if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef))]
    skipped = {id(inner) for block in [*for_types, *late] for inner in ast.walk(block)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def modules_of(package: Path) -> dict[str, Path]:
    """Modules of a package folder by dotted name, each with its file."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = ("tissuereg", *path.relative_to(package).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def upward_imports(package: Path) -> list[str]:
    """Imports that point to a higher layer, or to no layer, as sentences; declared late ones left out."""
    rank, wrong = layers.ranks(), []
    highest = max(rank.values()) + 1
    for name, path in modules_of(package).items():
        if name == "tissuereg":
            continue
        own = name.split(".")[1]
        at_once = imports_of(path, in_functions=False)
        for needed in sorted(imports_of(path)):
            parts = needed.split(".")
            if parts[0] != "tissuereg" or len(parts) == 1 or rank.get(parts[1], highest) <= rank[own]:
                continue
            if (own, parts[1]) not in layers.LATE or needed in at_once:
                wrong.append(f"{name} imports {needed}")
    return wrong


def top_level_of(package: Path) -> set[str]:
    """Names directly below a package folder: modules, packages, compiled modules (by their stubs)."""
    stubs = {path.stem for path in package.glob("*.pyi")}
    return stubs | {name.split(".")[1] for name in modules_of(package) if name != "tissuereg"}


def circle_of(package: Path) -> list[str]:
    """Modules of a package folder that import one another in a circle; empty where there is none."""
    modules = modules_of(package)
    needs = {
        name: {i for i in imports_of(path) if i in modules} - {"tissuereg", name} for name, path in modules.items()
    }
    done, open_ = set(), []

    def visit(name: str) -> list[str]:
        if name in open_:
            return [*open_[open_.index(name) :], name]
        if name in done:
            return []
        open_.append(name)
        for needed in sorted(needs[name]):
            if circle := visit(needed):
                return circle
        open_.pop()
        done.add(name)
        return []

    return next((circle for name in modules if (circle := visit(name))), [])


def crate_needs(crate: str) -> set[str]:
    """Crates of this repository that a crate depends on, its tests and benches left out."""
    manifest = (REPOSITORY / "crates" / crate / "Cargo.toml").read_text(encoding="utf-8")
    dependencies = re.split(r"^\[", manifest.split("[dependencies]")[1], flags=re.MULTILINE)[0]
    return set(re.findall(r"^tissuereg-(\w+)", dependencies, flags=re.MULTILINE))


def tree(folder: Path, files: dict[str, str]) -> Path:
    """Write a package folder of some files."""
    for name, text in {"__init__.py": "", **files}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def test_importing_the_package_loads_nothing_heavy():
    code = f"import sys, tissuereg; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_module_imports_itself_in_a_circle():
    assert circle_of(PACKAGE) == []


def test_torch_and_the_training_package_are_reached_by_the_train_command_alone():
    for name, path in modules_of(PACKAGE).items():
        roots = {i.split(".")[0] for i in imports_of(path)}
        assert "torch" not in roots, name
        text = path.read_text(encoding="utf-8")
        if name != layers.TRAINING_MODULE:
            assert "tissuereg_training" not in text, name


def test_every_module_stands_in_one_layer():
    assert set(layers.ranks()) == top_level_of(PACKAGE)


def test_a_module_in_two_layers_is_refused(monkeypatch):
    monkeypatch.setattr(layers, "LAYERS", (("upper", "io cli"), ("lower", "body io")))
    with pytest.raises(ValueError, match="`io` must be in one layer, found in two, the upper one being `upper`"):
        layers.ranks()


def test_layers_point_downwards():
    assert upward_imports(PACKAGE) == []


def test_every_late_import_that_is_declared_is_made(monkeypatch):
    declared = set(layers.LATE)
    monkeypatch.setattr(layers, "LATE", {})
    made = [sentence.split(" imports ") for sentence in upward_imports(PACKAGE)]
    assert {(importer.split(".")[1], needed.split(".")[1]) for importer, needed in made} == declared


def test_a_late_import_stands_in_a_function(tmp_path):
    late = "def f():\n    import tissuereg.report.page"
    assert upward_imports(tree(tmp_path / "late", {"registration/a.py": late})) == []
    found = upward_imports(tree(tmp_path / "at_once", {"registration/a.py": "import tissuereg.report.page"}))
    assert found == ["tissuereg.registration.a imports tissuereg.report.page"]


def test_a_public_name_is_found_where_its_type_is_declared():
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    blocks = [n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    typed = {}
    for imported in (n for n in ast.walk(blocks[0]) if isinstance(n, ast.ImportFrom)):
        for alias in imported.names:
            room = f"{imported.module}.{alias.name}" if alias.name in tissuereg._ROOMS else imported.module
            typed[alias.name] = room
    assert typed == tissuereg._MODULES
    assert {*typed, "__version__"} == set(tissuereg.__all__) <= set(dir(tissuereg))
    with pytest.raises(AttributeError, match="has no attribute 'reproduce_all'"):
        tissuereg.reproduce_all  # noqa: B018


@pytest.mark.parametrize(
    ("file", "text", "wrong"),
    [
        ("body/mesh.py", "from tissuereg.io.meshes import read_mesh", "tissuereg.body.mesh imports tissuereg.io"),
        ("io/points.py", "def f():\n    from tissuereg import cli", "tissuereg.io.points imports tissuereg.cli"),
        ("io/__init__.py", "import tissuereg.report.page", "tissuereg.io imports tissuereg.report.page"),
        ("io/points.py", "from tissuereg import register", "tissuereg.io.points imports tissuereg.register"),
        (
            "simulation/a.py",
            "if True:\n    import tissuereg.tracking",
            "tissuereg.simulation.a imports tissuereg.tracking",
        ),
    ],
)
def test_an_import_from_a_higher_layer_is_caught(file, text, wrong, tmp_path):
    right = {"cli/__init__.py": "from tissuereg.io import points", "io/points.py": "import tissuereg.errors"}
    assert upward_imports(tree(tmp_path / "right", right)) == []
    found = upward_imports(tree(tmp_path / "wrong", {**right, file: text}))
    assert any(sentence.startswith(wrong) for sentence in found)
    assert (
        upward_imports(tree(tmp_path / "types", {file: f"if TYPE_CHECKING:\n    {text.splitlines()[-1].strip()}"}))
        == []
    )


def test_a_circle_and_an_undeclared_module_are_caught(tmp_path):
    package = tree(
        tmp_path, {"io/a.py": "import tissuereg.io.b", "io/b.py": "from tissuereg.io import a", "new.py": ""}
    )
    assert circle_of(package) == ["tissuereg.io.a", "tissuereg.io.b", "tissuereg.io.a"]
    assert top_level_of(package) - set(layers.ranks()) == {"new"}


def test_the_cores_know_nothing_of_each_other_nor_of_python():
    for crate, allowed in layers.CRATES.items():
        assert crate_needs(crate) == set(allowed), crate
        manifest = (REPOSITORY / "crates" / crate / "Cargo.toml").read_text(encoding="utf-8")
        assert ("pyo3" in manifest) == bool(allowed), crate
    assert {path.parent.name for path in REPOSITORY.glob("crates/*/Cargo.toml")} == set(layers.CRATES)


def test_the_page_shows_the_layers_that_are_held():
    page = layers.PAGE.read_text(encoding="utf-8")
    assert layers.written(page) == page, "python tools/layers.py --write"
    assert layers.written(page.replace("| errors", "| mirrors")) == page
    with pytest.raises(ValueError, match="once each"):
        layers.written(page.replace(layers.END, ""))


def pools_of(path: Path) -> set[str]:
    """Names that a file imports and that make processes for tasks."""
    makes = re.compile(r"(multiprocessing|distributed|dask|dask_jobqueue|joblib|concurrent\.futures\.process)(\.|$)")
    named = "concurrent.futures.ProcessPoolExecutor"
    return {name for name in imports_of(path) if makes.match(name) or name == named}


def test_only_parallel_makes_processes_for_tasks_and_knows_dask():
    own = PACKAGE / "parallel"
    runners = [path for path in (REPOSITORY / "benchmarks").rglob("*.py") if "tests" not in path.parts]
    others = [path for path in PACKAGE.rglob("*.py") if own not in path.parents]
    assert {str(path): pools_of(path) for path in [*others, *runners] if pools_of(path)} == {}
    assert {path.name for path in own.glob("*.py") if pools_of(path)} >= {"executor.py", "cluster.py", "jobs.py"}


def test_every_warning_goes_into_the_provenance_of_answers():
    """By `warn` of `tissuereg._base.provenance`: what is given in another way no answer in Python knows of."""
    given = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if re.search(r"\bwarnings\.warn\(|from warnings import", path.read_text(encoding="utf-8"))
    }
    assert given == {"_base/provenance.py"}
