"""Hooks of mkdocs: formulas become MathML, NOTATION.md a page, and links out of the pages the paths they lead to."""

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

#: A link that goes up, as out of `docs`.
UPWARDS = re.compile(r"\[([^\]\n]+)\]\((\.\./[^)\s]+)\)")

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
    """Lead links to a mirrored file to its page, and name files that the site does not have in place of a link."""
    folder = posixpath.dirname(page.file.src_uri)
    for name, source in MIRRORED.items():
        from_page = posixpath.relpath(posixpath.join("..", source), folder or ".")
        markdown = markdown.replace(f"]({from_page}", f"]({posixpath.relpath(name, folder or '.')}")

    def named(match: re.Match[str]) -> str:
        text, path = match[1], posixpath.normpath(posixpath.join("docs", folder, match[2]))
        if path.startswith("docs/"):
            return match[0]
        return f"`{text}`" if text.startswith(path) else f"{text} (`{path}`)"

    return UPWARDS.sub(named, markdown)


def on_page_content(content: str, *, page: Any, config: Any, files: Files) -> str:
    """Turn formulas into MathML, which browsers show without a script."""

    def formula(match: re.Match[str]) -> str:
        display = "block" if match[1] == "div" else "inline"
        return latex2mathml.converter.convert(html.unescape(match[2]).strip(), display=display)

    return FORMULA.sub(formula, content)
