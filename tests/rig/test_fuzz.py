"""What `make fuzz` fuzzes, without its guidance: each input to begin with is taken, and bytes like it do no harm."""

from __future__ import annotations

import random

import pytest

from tests import fuzz
from tests.fuzz_targets import TARGETS, fault_of, seeds

TIMES = {name: 400 if name in fuzz.CODECS else 12 for name in TARGETS}
WORDS = (b"", b"\0", b"\xff", b"-", b"1e999", b"nan", b"\n", b'"', b",", b"[", b"=", b"\r", b"\x1f", b"99999999999")


def damaged(data: bytes, draw: random.Random) -> bytes:
    for _ in range(draw.randint(1, 4)):
        at = draw.randrange(len(data) + 1)
        data = data[:at] + draw.choice(WORDS) + data[at + draw.choice((0, 0, 1, 1, 2, 20)) :]
    return data


def test_every_target_is_fuzzed():
    assert {*fuzz.CODECS, *fuzz.READERS} == TARGETS.keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_inputs_are_taken_and_damaged_ones_are_taken_or_refused_in_words(name):
    draw = random.Random(name)
    begun = seeds(name)
    assert all(TARGETS[name](seed) for seed in begun)
    faults = {fault_of(name, damaged(draw.choice(begun), draw)) for _ in range(TIMES[name])}
    assert faults == {""}


def test_what_a_codec_makes_of_other_bytes_is_a_fault(monkeypatch):
    monkeypatch.setattr("tests.fuzz_targets.registers.number_of", lambda *_: 7)
    assert "other registers" in fault_of("numbers", seeds("numbers")[0])
