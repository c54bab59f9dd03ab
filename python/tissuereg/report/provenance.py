"""How an answer was made, as HTML for the pages of all commands: date, call, files, beliefs, warnings, settings."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from tissuereg._base.provenance import RESEARCH
from tissuereg.report.markup import escape, table


def provenance_section(made: Mapping[str, Any], beliefs: Sequence[tuple[str, str]] = ()) -> str:
    """Return the last section of a page, HTML.

    `made`: the entry ``provenance`` of the answer's JSON; `beliefs`: further rows, what is believed and the words for
    it, plain text.
    """
    rows = [
        ("date", made["date"]),
        ("tissuereg", made["version"]),
        ("call" if "(" in made["command"] else "command", made["command"]),
        *beliefs,
    ]
    files = [
        (escape(one["path"]), f"<code>{escape(one['sha256'] or 'read from a pipe')}</code>") for one in made["inputs"]
    ]
    warned = "".join(f"<li>{escape(text)}</li>" for text in made["warnings"])
    settings = escape(json.dumps(made["settings"], indent=1, ensure_ascii=False))
    return (
        "<h2>How this answer was made</h2>"
        + table(("", ""), [(escape(what), escape(words)) for what, words in rows])
        + (table(("input file", "SHA-256"), files) if files else "<p>No input was read from a file.</p>")
        + (f"<p>Warnings:</p><ul class='no'>{warned}</ul>" if warned else "<p>No warning was given.</p>")
        + f"<details><summary>All settings</summary><pre>{settings}</pre></details><p>{RESEARCH}</p>"
    )
