"""Hooks of mkdocs: formulas become MathML when the site is built, and NOTATION.md becomes a page."""

import html
import posixpath
import re
from pathlib import Path
from typing import Any

import latex2mathml.converter
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent

#: Pages that lie at the root of the repository, by their names in the site.
MIRRORED = {"notation.md": "NOTATION.md"}

#: Output of pymdownx.arithmatex for `$...$` and `$$...$$`.
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_config(config: Any) -> Any:
    """Leave out the 404 page: its links begin at the root of a server, and the site is also read from files."""
    config.theme.static_templates.discard("404.html")
    return config


def on_files(files: Files, *, config: Any) -> Files:
    """Add the mirrored pages."""
    for name, source in MIRRORED.items():
        files.append(File.generated(config, name, content=(ROOT / source).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Files) -> str:
    """Rewrite links to a mirrored file so that they lead to its page."""
    folder = posixpath.dirname(page.file.src_uri)
    for name, source in MIRRORED.items():
        from_page = posixpath.relpath(posixpath.join("..", source), folder or ".")
        markdown = markdown.replace(f"]({from_page}", f"]({posixpath.relpath(name, folder or '.')}")
    return markdown


def on_page_content(content: str, *, page: Any, config: Any, files: Files) -> str:
    """Turn formulas into MathML, which browsers show without a script."""

    def formula(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        return latex2mathml.converter.convert(html.unescape(match[2]).strip(), display=display)

    return FORMULA.sub(formula, content)
