"""Fail if a built site needs anything that is not in it: `python tools/check_site.py build/site [OTHER]`.

OTHER is the same site by another builder; how many of its pages read otherwise is said.
"""

import html
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

#: What is not prose, and formulas in prose.
NO_PROSE = ("code", "pre", "script", "style")
FORMULA = re.compile(r"\$[^$\s][^$]*\$")

#: What a page says; names of elements are none of it.
ARTICLE, ELEMENT = re.compile(r"<article.*?</article>", re.DOTALL), re.compile(r"<[^>]+>|\s+")

#: What a style sheet loads.
STYLE = re.compile(r"""url\(\s*['"]?(?!data:|#)([^'")]+)|@import\s+['"]([^'"]+)""")


class Loaded(HTMLParser):
    """Gathers what a page loads, its links, and formulas that were left as text."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.raw_formulas = 0
        self.in_code = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record what an element loads."""
        given = dict(attrs)
        self.in_code += tag in NO_PROSE
        if (found := given.get(LOADS.get(tag, ""))) is not None:
            self.loads.append(found)
        if tag == "a" and (found := given.get("href")) is not None:
            self.links.append(found)
        if (style := given.get("style")) is not None:
            self.loads += style_loads(style)

    def handle_endtag(self, tag: str) -> None:
        """Record where code ends."""
        self.in_code -= tag in NO_PROSE

    def handle_data(self, data: str) -> None:
        """Count formulas that were left as text."""
        self.raw_formulas += 0 if self.in_code else len(FORMULA.findall(data))


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


def text_of(page: Path) -> str:
    """Return what a page says, without elements and blanks."""
    found = ARTICLE.search(page.read_text(encoding="utf-8"))
    return html.unescape(ELEMENT.sub("", found[0] if found else ""))


def differing(root: Path, other: Path) -> list[str]:
    """Return the pages of a site that another builder lacks or words otherwise."""
    pages = [page.relative_to(root) for page in sorted(root.rglob("*.html"))]
    return [
        page.as_posix()
        for page in pages
        if not (other / page).is_file() or text_of(root / page) != text_of(other / page)
    ]


def main() -> int:
    """Check the folders that are named, and compare them."""
    failed = False
    for root in map(Path, sys.argv[1:]):
        pages, found = len(list(root.rglob("*.html"))), faults(root)
        print(*found, f"{root}: {pages} pages, {len(found)} faults", sep="\n")
        failed |= bool(found) or pages == 0
    if len(sys.argv) > 2:
        unlike = differing(Path(sys.argv[1]), Path(sys.argv[2]))
        print(f"{len(unlike)} pages read otherwise in {sys.argv[2]}", *unlike, sep="\n  ")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
