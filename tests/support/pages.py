"""Checks that every HTML report must pass."""

import re
from html.parser import HTMLParser

VOID = {"br", "input", "meta"}


class Balance(HTMLParser):
    """Records elements that are closed out of order, ids, and what is loaded."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.wrong, self.reaches = [], [], [], []

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.ids += [found["id"]] if "id" in found else []
        self.reaches += [found[key] for key in ("src", "href", "action") if key in found]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append((tag, self.getpos()))


def assert_sound_page(text, reaches=()):
    """Check that a page is well formed, loads nothing but these files, and shows no NaN or infinity."""
    reader = Balance()
    reader.feed(text)
    assert (reader.wrong, reader.open) == ([], [])
    assert len(set(reader.ids)) == len(reader.ids)
    assert reader.reaches == list(reaches)
    assert "http" not in text
    assert "@import" not in text
    assert not {"nan", "inf"} & set(
        re.findall(r"[\d.]+|\bnan\b|\binf\b", re.sub(r"<script.*", "", text, flags=re.DOTALL))
    )
    assert len(text) < 2_000_000
