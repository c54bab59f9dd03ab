"""Does `docs/howto/own-network.md` train and register? All of its blocks run here, those that need torch among them."""

from dataclasses import replace
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def test_the_page_trains_and_registers(tmp_path, monkeypatch):
    pytest.importorskip("tissuereg")
    monkeypatch.syspath_prepend(str(REPOSITORY / "tests"))
    from support.blocks import blocks, run_block

    folder = tmp_path / "page"
    folder.mkdir()
    monkeypatch.chdir(folder)
    environment = {"TISSUEREG_CACHE": str(tmp_path / "cache")}
    names = {"__name__": "page"}
    ran = [block for block in blocks(REPOSITORY / "docs" / "howto" / "own-network.md") if not installs(block)]
    for block in ran:
        run_block(replace(block, not_run=None), folder, names, environment)
    assert sum(block.not_run is not None for block in ran) == 3
    assert (folder / "model" / "decoder.onnx").is_file()
    assert names["result"].model["kind"] != "contacts"


def installs(block):
    """Whether a block sets up what these tests run in."""
    return block.not_run is not None and block.not_run.startswith("installs")
