"""Write the source of the site, which any builder of Markdown takes: `python tools/site_source.py build/site-source`.

The pages are those of `docs`, and NOTATION.md. Formulas become MathML, which browsers show without a script, and links
that leave the site the paths that they lead to. A page between code fences and backticks stays as it is.
"""

import html
import posixpath
import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

#: Pages that lie at the root of the repository, by their names in the site.
MIRRORED = {"notation.md": "NOTATION.md"}

#: A link that goes up, as out of `docs`.
UPWARDS = re.compile(r"\[([^\]\n]+)\]\((\.\./[^)\s]+)\)")

#: Code and options of API pages, which are left alone; a formula of lines of its own; one in a line.
CODE_OR_FORMULA = re.compile(
    r"(?P<code>^ *(?P<fence>`{3,})[^`\n]*\n.*?^ *(?P=fence) *$|(?P<ticks>`+)(?!`).+?(?<!`)(?P=ticks)(?!`)"
    r"|^::: [^\n]*\n(?: +[^\n]*\n)*)"
    r"|(?<![\\$])\$\$(?P<block>[^$]+)\$\$"
    r"|(?<![\\$])\$(?!\s)(?P<inline>(?:\\.|[^$\\])+?)(?<!\s)\$",
    re.DOTALL | re.MULTILINE,
)

#: What Markdown would read in the text of a formula.
MARKS = str.maketrans({mark: f"&#{ord(mark)};" for mark in "*_`\\[]|~^"})


def formula(tex: str, *, block: bool) -> str:
    """Return a formula as MathML that Markdown leaves alone, in one line."""
    import latex2mathml.converter

    made = latex2mathml.converter.convert(html.unescape(tex).strip(), display="block" if block else "inline")
    parts = re.split(r"(<[^>]+>)", " ".join(made.split()))
    text = "".join(part if part.startswith("<") else part.translate(MARKS) for part in parts)
    # In an element that Markdown takes for one of a line; `math` at its beginning would end the paragraph.
    return f'<span class="formula">{text}</span>'


def page(markdown: str, name: str) -> str:
    """Return the text of the page `name` (its path in the site) for a builder."""
    folder = posixpath.dirname(name) or "."
    for mirrored, source in MIRRORED.items():
        from_page = posixpath.relpath(posixpath.join("..", source), folder)
        markdown = markdown.replace(f"]({from_page}", f"]({posixpath.relpath(mirrored, folder)}")

    def named(match: re.Match[str]) -> str:
        text, path = match[1], posixpath.normpath(posixpath.join("docs", folder, match[2]))
        if path.startswith("docs/"):
            return match[0]
        return f"`{text}`" if text.startswith(path) else f"{text} (`{path}`)"

    def made(match: re.Match[str]) -> str:
        if match["code"]:
            return match[0]
        return formula(match["block"] or match["inline"], block=bool(match["block"]))

    return CODE_OR_FORMULA.sub(made, UPWARDS.sub(named, markdown))


def write(out: Path) -> None:
    """Write the source of the site into a folder, which is made anew."""
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(ROOT / "docs", out)
    for name, source in MIRRORED.items():
        shutil.copyfile(ROOT / source, out / name)
    for file in out.rglob("*.md"):
        text = page(file.read_text(encoding="utf-8"), file.relative_to(out).as_posix())
        file.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
