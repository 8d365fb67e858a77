"""The grammar of loads, clamps and points."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from training.commands import grammar


def test_a_load_has_a_contact_a_force_and_perhaps_a_radius() -> None:
    load = grammar.load("10,-5,2.5:0,0,-3e-1")
    assert (load.contact.tolist(), load.force_n.tolist(), load.radius) == ([10, -5, 2.5], [0, 0, -0.3], None)
    assert grammar.load("1,2,3:4,5,6:7.5").radius == 7.5


def test_clamps() -> None:
    assert grammar.clamp("ground") is None
    below, above, box = (grammar.clamp(text) for text in ("below:z=-2", "above:x=1.5", "box:0,1,2,3,4,5"))
    assert below is not None and above is not None and box is not None
    assert below.high.tolist() == [np.inf, np.inf, -2] and np.isneginf(below.low).all()
    assert above.low.tolist() == [1.5, -np.inf, -np.inf] and np.isposinf(above.high).all()
    assert (box.low.tolist(), box.high.tolist()) == ([0, 1, 2], [3, 4, 5])


@pytest.mark.parametrize(
    ("parse", "text", "words"),
    [
        (grammar.vector, "1,2", "holds 2 numbers; three are wanted"),
        (grammar.vector, "1,2,up", "'up' is no number"),
        (grammar.vector, "1,2,nan", "'nan' is no number"),
        (grammar.load, "1,2,3", "write x,y,z:fx,fy,fz"),
        (grammar.load, "1,2,3:4,5", "holds 2 numbers"),
        (grammar.load, "1,2,3:4,5,6:0", "must be positive"),
        (grammar.clamp, "floor", "write ground, box:"),
        (grammar.clamp, "ground:z=0", "write ground, box:"),
        (grammar.clamp, "below:w=1", "write ground, box:"),
        (grammar.clamp, "below:z", "write ground, box:"),
        (grammar.clamp, "below:z=low", "'low' is no number"),
        (grammar.clamp, "box:1,2,3,4,5", "holds 5 numbers; six are wanted"),
        (grammar.clamp, "box:1,2,3,0,5,6", "its low corner comes first"),
    ],
)
def test_what_is_not_understood_says_what_would_be(parse, text: str, words: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=words):
        parse(text)
