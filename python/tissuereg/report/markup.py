"""HTML shared by all reports: style sheet, tables, escaped text, whole pages."""

import html
from collections.abc import Sequence

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
img { max-width: 100%; } h2 { margin-top: 2rem; } table { border-collapse: collapse; margin: .5rem 0 1rem; }
td, th { padding: .25rem .8rem; border-bottom: 1px solid #d7dbe0; text-align: right; }
td:first-child, th:first-child { text-align: left; }
.yes { color: #176f2c; } .no { color: #a3180d; }
"""


def escape(text: object) -> str:
    """Return text escaped for HTML, quotes included: safe in an element or an attribute.

    >>> escape("a < b & 'c'")
    'a &lt; b &amp; &#x27;c&#x27;'
    """
    return html.escape(str(text), quote=True)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return an HTML table with a head and rows of cells, all of which must be HTML already.

    >>> table(["a"], [["1"]])
    '<table><tr><th>a</th></tr><tr><td>1</td></tr></table>'
    """
    top = "".join(f"<th>{cell}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"


def document(title: str, parts: Sequence[str], style: str = "") -> str:
    """Return a whole HTML page; `title` is plain text, `parts` are HTML, `style` is CSS in addition to `STYLE`."""
    return (
        f"<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><title>{escape(title)}</title>"
        f"<style>{STYLE}{style}</style></head><body>\n" + "\n".join(parts) + "\n</body></html>\n"
    )
