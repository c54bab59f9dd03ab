"""Checks that every HTML report must pass."""

import base64
import json
import re
from html.parser import HTMLParser

import numpy as np

VOID = {"br", "input", "meta"}
KINDS = {"i2": "<i2", "u2": "<u2", "u4": "<u4", "f4": "<f4"}


def scenes_of(text):
    """Return the data of the bodies to turn in a page."""
    return [json.loads(one) for one in re.findall(r"<script type='application/json'>(.*?)</script>", text, re.DOTALL)]


def unpacked(given):
    """Return the numbers of an array in a scene."""
    raw = np.frombuffer(base64.b64decode(given["data"]), KINDS[given["as"]]).reshape(given["shape"])
    if given["as"] != "i2":
        return raw
    return np.where(raw == -32768, np.nan, raw * given["by"])


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
