"""What is kept to be asked again: for how long, how much of it, and what goes first."""

import pytest

from service.core.errors import ReconstructionGone
from service.reconstructions import Reconstructions


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_what_is_kept_is_found_until_its_time_is_up_and_a_use_starts_it_again():
    clock = Clock()
    kept = Reconstructions[str](max_bytes=100, lifetime_s=60.0, clock=clock)
    name = kept.keep("mug", 10)
    assert name is not None
    clock.now += 59.9
    assert kept.find(name) == "mug"
    clock.now += 59.9
    assert kept.find(name) == "mug"
    clock.now += 60.0
    with pytest.raises(ReconstructionGone) as gone:
        kept.find(name)
    assert (gone.value.field, gone.value.actual) == ("reconstruction_id", name)
    assert (kept.hits, kept.misses, kept.entries, kept.nbytes) == (2, 1, 0, 0)


def test_within_its_memory_what_was_not_used_for_the_longest_time_goes_first():
    kept = Reconstructions[str](max_bytes=30, lifetime_s=60.0)
    mug, bowl, box = (kept.keep(name, 10) for name in ("mug", "bowl", "box"))
    assert mug and bowl and box
    assert kept.find(mug) == "mug"
    tin = kept.keep("tin", 15)
    assert tin is not None
    for gone in (bowl, box):
        with pytest.raises(ReconstructionGone):
            kept.find(gone)
    assert [kept.find(mug), kept.find(tin)] == ["mug", "tin"]
    assert (kept.entries, kept.nbytes) == (2, 25)


def test_what_is_too_large_has_no_id_and_drives_nothing_out():
    kept = Reconstructions[str](max_bytes=30, lifetime_s=60.0)
    mug = kept.keep("mug", 30)
    assert mug is not None
    assert kept.keep("house", 31) is None
    assert kept.find(mug) == "mug"


def test_a_memory_of_nothing_keeps_nothing_and_says_so():
    kept = Reconstructions[str](max_bytes=0, lifetime_s=60.0)
    assert kept.keep("mug", 1) is None
    with pytest.raises(ReconstructionGone) as gone:
        kept.find("mug")
    assert gone.value.expected == "none: nothing is kept"


def test_ids_are_not_to_be_guessed():
    kept = Reconstructions[int](max_bytes=1000, lifetime_s=60.0)
    names = {kept.keep(number, 1) for number in range(500)}
    assert len(names) == 500
    assert all(name is not None and len(name) == 32 for name in names)
