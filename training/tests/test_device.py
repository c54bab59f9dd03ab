"""Networks follow the device. Without a graphics card "meta" stands in, which computes shapes and no numbers."""

import dataclasses

import pytest
import torch
from conftest import make_block, smooth_fields

from tissuereg_training.checkpoint import Checkpoint
from tissuereg_training.evaluate import codes, decoded
from tissuereg_training.fit import fit
from tissuereg_training.host import best_device, device_name
from tissuereg_training.kinds import Material, new_network
from tissuereg_training.pca import moments
from tissuereg_training.settings import ClosureSettings, GraphClosureSettings, GraphSettings

GRAPH = GraphSettings(epochs=2, batch=8, n_latent=4, channels=(4, 8))
CLOSURE = ClosureSettings(epochs=2, batch=8, n_latent=4, n_components=10, hidden=(16,), encoder_hidden=(16,))
GRAPH_CLOSURE = GraphClosureSettings(
    epochs=2, batch=8, n_latent=4, n_components=10, hidden=(16,), encoder_hidden=(16,), channels=(4, 8)
)
ALL = pytest.mark.parametrize("settings", [GRAPH, CLOSURE, GRAPH_CLOSURE], ids=lambda each: each.kind)
DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


@pytest.fixture(scope="module")
def fields():
    return smooth_fields(make_block(3, 3, 4), 40, 1)


def network(settings, fields):
    return new_network(Material(make_block(3, 3, 4).tets, [fields], moments([fields])), settings, 0)[0]


@ALL
def test_every_table_of_a_network_follows_it(fields, settings):
    model = network(settings, fields).to("meta")
    assert model.device.type == "meta"
    assert {t.device.type for t in model.state_dict().values()} == {"meta"}
    x = model.normalised(torch.zeros(2, 36, 3, device="meta"))
    assert x.device.type == "meta"
    for module in model.modules():
        pattern = getattr(module, "pattern", None)
        if pattern is not None:
            values = torch.zeros(pattern.n_values, pattern.n_edges, device="meta")
            pattern._follow(values)
            assert {v.device.type for v in vars(pattern).values() if isinstance(v, torch.Tensor)} == {"meta"}


@pytest.mark.parametrize("device", DEVICES)
@ALL
def test_a_training_moves_between_devices_with_its_checkpoint(fields, settings, device, tmp_path):
    parts, valid = [fields[:32]], fields[32:]
    model = network(settings, fields).to(device)
    fit(model, parts, valid, dataclasses.replace(settings, epochs=1), seed=0, checkpoint=Checkpoint(tmp_path, "mine"))
    assert model.device.type == device
    moved = network(settings, fields)
    state = fit(moved, parts, valid, settings, seed=0, checkpoint=Checkpoint(tmp_path, "mine"))
    assert (state.epoch, moved.device.type) == (2, "cpu")
    assert codes(model, valid)[0].device.type == "cpu"
    assert decoded(model, torch.zeros(3, 4)).shape == (3, 36, 3)


def test_the_graphics_card_is_taken_where_there_is_one(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert best_device().type == "cuda"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert best_device().type == "cpu"
    assert device_name(best_device()) == "the processor"
