"""Any sample of a set without its group, as fast as the network's loader could want it."""

import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from training.data.random_access import RandomAccess
from training.data.store import Store, StoreError

SAMPLES, NODES = 9, 5000


def group(seed: int) -> dict[str, np.ndarray]:
    """Of the size of an everyday group: voxels that compress well, fields that do not."""
    rng = np.random.default_rng(seed)
    ball = ((np.indices((64, 64, 64)) - 32) ** 2).sum(axis=0) < rng.integers(200, 500)
    bits = np.packbits(ball)
    return {
        "rest": bits,
        "nodes": np.packbits(rng.random(32**3) < 0.15),
        "family": np.array("bottle"),
        "deformed": np.stack([np.roll(bits, i) for i in range(SAMPLES)]),
        "displacement": (0.1 * rng.normal(size=(SAMPLES, 3, NODES))).astype(np.float16),
        "forward": (0.1 * rng.normal(size=(SAMPLES, 3, NODES))).astype(np.float16),
        "condition": rng.normal(size=(SAMPLES, 9)).astype(np.float32),
        "sample": np.arange(2 * SAMPLES, dtype=np.float32).reshape(SAMPLES, 2),
    }


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("set"))
    for index in range(6):
        store.write_group(index, group(index))
    return store


def test_a_sample_is_the_row_of_its_group(store: Store) -> None:
    access = RandomAccess(store)
    assert access.rows(4) == SAMPLES
    whole, sample = store.group(4), access.sample(4, 7)
    assert sample.keys() == whole.keys() == group(4).keys()
    for key, value in whole.items():
        np.testing.assert_array_equal(value, group(4)[key])
        np.testing.assert_array_equal(sample[key], value if key in ("rest", "nodes", "family") else value[7])


def test_a_group_written_before_rows_stood_apart_is_read_alike(tmp_path: Path) -> None:
    old = Store(tmp_path)
    old.write_group(0, {key: value[:2] for key, value in group(0).items() if key == "sample"})  # the header
    with zipfile.ZipFile(old.group_path(0), "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in group(0).items():
            with archive.open(f"{key}.npy", "w") as file:
                np.lib.format.write_array(file, value)
    np.testing.assert_array_equal(old.group(0)["forward"], group(0)["forward"])
    np.testing.assert_array_equal(RandomAccess(old).sample(0, 3)["forward"], group(0)["forward"][3])


def test_a_sample_takes_less_than_two_milliseconds(store: Store) -> None:
    """Processor time, the median of all in random order, groups opened before: 1.05 ms were inflation alone."""
    access = RandomAccess(store)
    for index in range(6):
        access.rows(index)
    took = []
    for place in np.random.default_rng(0).permutation(6 * SAMPLES):
        start = time.thread_time()
        access.sample(int(place) // SAMPLES, int(place) % SAMPLES)
        took.append(time.thread_time() - start)
    assert np.median(took) < 2e-3


def test_what_is_not_there_is_named(store: Store, tmp_path: Path) -> None:
    access = RandomAccess(store)
    with pytest.raises(StoreError, match="no group 99"):
        access.sample(99, 0)
    with pytest.raises(IndexError, match="9 samples, no row 9"):
        access.sample(0, 9)
    damaged = Store(tmp_path)
    damaged.write_group(0, group(0))
    path = damaged.group_path(0)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))
    access = RandomAccess(damaged)
    with pytest.raises(StoreError, match=r"000000\.npz is damaged"):
        for row in range(SAMPLES):
            access.sample(0, row)
