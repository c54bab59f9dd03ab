"""Fail if the built site needs anything that is not in it: `python tools/check_site.py build/site`."""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Elements with the attribute that loads something; links for readers to follow are not listed.
LOADS = {
    "audio": "src",
    "embed": "src",
    "iframe": "src",
    "image": "href",
    "img": "src",
    "input": "src",
    "link": "href",
    "object": "data",
    "script": "src",
    "source": "src",
    "use": "href",
    "video": "src",
}

#: What a style sheet loads.
STYLE = re.compile(r"""url\(\s*['"]?(?!data:|#)([^'")]+)|@import\s+['"]([^'"]+)""")


class Loaded(HTMLParser):
    """Gathers what a page loads, its links, and formulas that were left as text."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.raw_formulas = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record what an element loads."""
        given = dict(attrs)
        if (found := given.get(LOADS.get(tag, ""))) is not None:
            self.loads.append(found)
        if tag == "a" and (found := given.get("href")) is not None:
            self.links.append(found)
        if (style := given.get("style")) is not None:
            self.loads += style_loads(style)
        self.raw_formulas += given.get("class") == "arithmatex"


def style_loads(text: str) -> list[str]:
    """Return what a style sheet loads."""
    return [one or other for one, other in STYLE.findall(text)]


def fault(page: Path, target: str, root: Path) -> str | None:
    """Return what is wrong with a target that a page loads or links to, or None."""
    parts = urlsplit(target)
    if parts.scheme == "data" or not (parts.scheme or parts.netloc or parts.path):
        return None
    file = (page.parent / unquote(parts.path)).resolve()
    if parts.scheme or parts.netloc:
        why = "lies elsewhere"
    elif not file.is_relative_to(root.resolve()):
        why = "lies outside of the site"
    elif not file.is_file():
        why = "does not exist"
    else:
        return None
    return f"{page.relative_to(root)}: {target} {why}"


def faults_of_page(page: Path, root: Path) -> list[str]:
    """Return a line for everything that a page would lack without a network."""
    reader = Loaded()
    reader.feed(page.read_text(encoding="utf-8"))
    inside = [link for link in reader.links if not urlsplit(link).scheme]
    found = [line for target in reader.loads + inside if (line := fault(page, target, root)) is not None]
    if reader.raw_formulas:
        found.append(f"{page.relative_to(root)}: {reader.raw_formulas} formulas were not rendered")
    return found


def faults(root: Path) -> list[str]:
    """Return a line for everything that the site would lack without a network."""
    found = [line for page in sorted(root.rglob("*.html")) for line in faults_of_page(page, root)]
    for sheet in sorted(root.rglob("*.css")):
        targets = style_loads(sheet.read_text(encoding="utf-8"))
        found += [line for target in targets if (line := fault(sheet, target, root)) is not None]
    return found


def main() -> int:
    """Check the folder that is named."""
    root = Path(sys.argv[1])
    pages = len(list(root.rglob("*.html")))
    found = faults(root)
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{root}: {pages} pages, {len(found)} faults")
    return int(bool(found) or pages == 0)


if __name__ == "__main__":
    sys.exit(main())
