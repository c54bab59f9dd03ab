"""The selection of causes: what is accepted, exchanged, tested again and taken out, and in which order."""

from types import SimpleNamespace

from tissuereg.diagnosis.answer import PossibleCause
from tissuereg.diagnosis.selection import selected


class Made:
    """Models that accept `order`, one id after another, and in which `failing` gives evidence to those that fail."""

    def __init__(self, order, failing=(), exchanges=()):
        self.order, self.failing, self.exchanges = order, failing, dict(exchanges)
        self.done = []

    def grown(self, known):
        more = next((name for name in self.order if name not in known.ids), None)
        return known if more is None else SimpleNamespace(ids=(*known.ids, more))

    def exchanged(self, known):
        self.done.append(("exchanged", known.ids))
        return SimpleNamespace(ids=tuple(self.exchanges.get(name, name) for name in known.ids))

    def tested(self, known):
        self.done.append(("tested", known.ids))
        gains = next((gains for ids, gains in self.failing if ids == known.ids), {})
        failed = {known.ids.index(name): PossibleCause(name, 0.1, gain, 6.0) for name, gain in gains.items()}
        return known, failed

    def without(self, known, part, failed):
        assert failed.id == known.ids[part]
        self.done.append(("without", failed.id))
        return SimpleNamespace(ids=(*known.ids[:part], *known.ids[part + 1 :]))


NONE = SimpleNamespace(ids=())


def test_causes_are_accepted_until_there_is_none_or_enough():
    assert selected(Made("ab"), NONE, 3).ids == ("a", "b")
    assert selected(Made("abcd"), NONE, 3).ids == ("a", "b", "c")
    assert selected(Made(""), NONE, 3) is NONE


def test_one_cause_alone_is_exchanged_for_nothing():
    alone, pair = Made("a", exchanges={"a": "z"}), Made("ab", exchanges={"a": "z"})
    assert selected(alone, NONE, 3).ids == ("a",)
    assert alone.done == [("tested", ("a",))]
    assert selected(pair, NONE, 3).ids == ("z", "b")
    assert pair.done == [("exchanged", ("a", "b")), ("tested", ("z", "b"))]


def test_of_several_that_fail_the_one_with_the_least_evidence_is_taken_out_and_the_rest_is_tested_again():
    failing = [(("a", "b", "c"), {"a": 5.0, "c": 3.0}), (("a", "b"), {"b": 1.0})]
    models = Made("abc", failing)
    assert selected(models, NONE, 3).ids == ("a",)
    assert models.done[1:] == [
        ("tested", ("a", "b", "c")),
        ("without", "c"),
        ("tested", ("a", "b")),
        ("without", "b"),
        ("tested", ("a",)),
    ]
