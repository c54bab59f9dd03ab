"""HTML shared by all reports: style sheet, tables, escaped text, whole pages."""

import html
from collections.abc import Sequence

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; color: #20262e; }
img, svg { max-width: 100%; } h1 { font-size: 1.7rem; } h2 { margin-top: 2rem; font-size: 1.25rem; }
h1, h2, h3, p, li, td { overflow-wrap: break-word; }
table { border-collapse: collapse; margin: .5rem 0 1rem; } .wide { overflow-x: auto; }
td, th { padding: .25rem .8rem; border-bottom: 1px solid #d7dbe0; text-align: right; }
td:first-child, th:first-child { text-align: left; }
.yes { color: #176f2c; } .no { color: #a3180d; }
.viewer { margin: .8rem 0 1.2rem; } .viewer .stage { position: relative; }
.viewer .stage canvas { display: block; width: 100%; height: min(33rem, 92vw); border: 1px solid #d7dbe0;
  border-radius: 6px; background: #fbfcfd; touch-action: none; cursor: grab; }
.viewer .tip { position: absolute; display: none; background: #fffffff2; border: 1px solid #9aa2ab; border-radius: 4px;
  padding: .2rem .5rem; font-size: 13px; white-space: pre-line; pointer-events: none; max-width: 22rem; }
.viewer .controls, .viewer .legend { display: flex; flex-wrap: wrap; gap: .35rem 1.1rem; align-items: center;
  font-size: 13.5px; margin: .5rem 0; }
.viewer label, .viewer .patch { display: inline-flex; align-items: center; gap: .35rem; max-width: 100%; }
.viewer button, .viewer select { font: inherit; padding: .15rem .6rem; border: 1px solid #b4bcc5; background: #fff;
  border-radius: 4px; max-width: 11rem; } .viewer button[aria-pressed=true] { background: #20374f; color: #fff; }
.viewer .switch { display: inline-flex; flex-wrap: wrap; gap: .2rem; } .viewer input[type=range] { width: 6.5rem; }
.viewer input.frames { width: min(22rem, 56vw); } .viewer .mark { width: 18px; height: 14px; }
.viewer .patch i { width: 13px; height: 13px; border-radius: 3px; } .viewer .figures { font-size: 13.5px; margin: 0; }
.hint { font-size: 13.5px; color: #59626c; margin: .3rem 0; } .viewer output { min-width: 4.2em; }
@media (max-width: 40rem) { body { margin: 1rem auto; padding: 0 .7rem; } td, th { padding: .25rem .45rem; } }
@media print { .viewer .controls, .viewer input { display: none; } }
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
    "<div class='wide'><table><tr><th>a</th></tr><tr><td>1</td></tr></table></div>"
    """
    top = "".join(f"<th>{cell}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<div class='wide'><table><tr>{top}</tr>{body}</table></div>"


def document(title: str, parts: Sequence[str], style: str = "") -> str:
    """Return a whole HTML page; `title` is plain text, `parts` are HTML, `style` is CSS in addition to `STYLE`."""
    return (
        f"<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        f"<meta name='viewport' content='width=device-width, initial-scale=1'><title>{escape(title)}</title>"
        f"<style>{STYLE}{style}</style></head><body>\n" + "\n".join(parts) + "\n</body></html>\n"
    )
