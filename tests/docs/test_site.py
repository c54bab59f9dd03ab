"""Does the site lead to every page, name every public name, and find what it would lack without a network?"""

import importlib.util
import pkgutil
import re

import pytest

import tissuereg as tr
from support.blocks import REPOSITORY

DOCS = REPOSITORY / "docs"


def loaded(name):
    """Return a script of `tools` as a module."""
    spec = importlib.util.spec_from_file_location(name, REPOSITORY / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def nav():
    """Return the pages that mkdocs.yml leads to."""
    text = (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    return re.findall(r"^ +- [^#]*?([\w./-]+\.md)$", text, flags=re.MULTILINE)


def mirrored():
    """Return the pages that the build makes of files elsewhere."""
    return loaded("site_source").MIRRORED


def test_the_nav_leads_to_every_page_once_and_to_no_other():
    pages = [page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")]
    assert sorted(nav()) == sorted([*pages, *mirrored()])
    assert all((REPOSITORY / source).is_file() for source in mirrored().values())


def test_every_public_name_is_on_a_page_of_the_api():
    pages = "\n".join(page.read_text(encoding="utf-8") for page in sorted((DOCS / "api").glob("*.md")))
    shown = [pkgutil.resolve_name(name) for name in re.findall(r"^::: (tissuereg[\w.]+)$", pages, flags=re.MULTILINE)]
    assert all(found.__doc__ for found in shown)
    missing = [name for name in tr.__all__ if not any(getattr(tr, name) is found for found in shown)]
    assert missing == ["__version__"]


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ('<script src="https://cdn.example/x.js"></script>', "lies elsewhere"),
        ('<link rel="stylesheet" href="//cdn.example/x.css">', "lies elsewhere"),
        ('<img src="../picture.png">', "lies outside of the site"),
        ('<img src="picture.png">', "does not exist"),
        ('<p style="background: url(http://x.example/y.png)">', "lies elsewhere"),
        ('<a href="other.html#there">', "does not exist"),
        ("<p>of $x$ mm</p>", "were not rendered"),
        ("<code>of $x$ mm</code>", None),
        ('<a href="https://doi.example/10">', None),
        ('<a href="#here">', None),
        ('<img src="data:image/png;base64,">', None),
        ('<a href="page.html">', None),
    ],
)
def test_what_a_page_would_lack_without_a_network_is_found(line, fault, tmp_path):
    (tmp_path / "page.html").write_text(f"<!doctype html><body>{line}</body>", encoding="utf-8")
    found = loaded("check_site").faults(tmp_path)
    assert [fault in line for line in found] == ([] if fault is None else [True])


def test_pages_that_another_builder_words_otherwise_are_named(tmp_path):
    for site, words in {"a": "one  <b>two</b>", "b": "one two"}.items():
        (tmp_path / site).mkdir()
        (tmp_path / site / "same.html").write_text(f"<article>{words}</article>", encoding="utf-8")
        (tmp_path / site / "other.html").write_text(f"<article>{site}</article>", encoding="utf-8")
    (tmp_path / "a" / "more.html").write_text("<article></article>", encoding="utf-8")
    assert loaded("check_site").differing(tmp_path / "a", tmp_path / "b") == ["more.html", "other.html"]


def test_formulas_are_found_and_code_is_left_alone(monkeypatch):
    tool = loaded("site_source")
    monkeypatch.setattr(tool, "formula", lambda tex, *, block: f"<{'B' if block else 'I'}{tex}>")
    page = """Of $a_1$ and `$b$`, 5 \\$ and $c$:

$$ d
 = e $$

```bash
echo $HOME $f$
```
| `$g` | $\\tfrac{h}{2}$ |
"""
    wanted = page.replace("$a_1$", "<Ia_1>").replace("$c$", "<Ic>").replace("$$ d\n = e $$", "<B d\n = e >")
    assert tool.page(page, "a.md") == wanted.replace("$\\tfrac{h}{2}$", "<I\\tfrac{h}{2}>")


def test_no_formula_of_a_page_is_left(monkeypatch):
    tool = loaded("site_source")
    monkeypatch.setattr(tool, "formula", lambda tex, *, block: "")
    for page in [*DOCS.rglob("*.md"), REPOSITORY / "NOTATION.md"]:
        left = tool.CODE_OR_FORMULA.sub("", page.read_text(encoding="utf-8"))
        assert "$" not in left, page


def test_links_lead_to_the_mirrored_page_and_name_what_the_site_lacks():
    page = loaded("site_source").page
    assert page("[units](../NOTATION.md#units)", "files.md") == "[units](notation.md#units)"
    assert page("[units](../../NOTATION.md)", "theory/a.md") == "[units](../notation.md)"
    assert page("[files](../files.md)", "theory/a.md") == "[files](../files.md)"
    assert page("[examples/beam.py](../examples/beam.py)", "a.md") == "`examples/beam.py`"
    assert page("[the beam](../../examples/beam.py)", "theory/a.md") == "the beam (`examples/beam.py`)"


def test_style_sheets_are_looked_into(tmp_path):
    (tmp_path / "page.html").write_text("<!doctype html>", encoding="utf-8")
    (tmp_path / "own.css").write_text("@import 'far.css'; p { background: url(https://x.example/y.png) }")
    assert len(loaded("check_site").faults(tmp_path)) == 2
