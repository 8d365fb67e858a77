import json
from pathlib import Path

import numpy as np
import pytest

from training.data.store import STORE_VERSION, Store, StoreError

GROUP = {"value": np.arange(6.0).reshape(2, 3), "family": np.array("mug"), "sample": np.arange(2)}


def test_groups_come_back_in_order_whatever_order_they_came_in(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for index in (12, 3, 100):
        store.write_group(index, {**GROUP, "value": GROUP["value"] + index})
    groups = dict(store.groups())
    assert list(groups) == [3, 12, 100]
    np.testing.assert_array_equal(groups[12]["value"], GROUP["value"] + 12)
    assert str(groups[12]["family"]) == "mug"


def test_a_group_that_cannot_be_written_leaves_nothing_that_counts(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write_group(1, GROUP)
    with pytest.raises(ValueError, match="allow_pickle"):
        store.write_group(2, {**GROUP, "value": np.array([object()])})
    assert store.is_done(1)
    assert not store.is_done(2)
    assert [index for index, _ in store.groups()] == [1]
    store.write_group(2, GROUP)
    assert [index for index, _ in store.groups()] == [1, 2]
    assert not list(tmp_path.rglob("*.partial"))


def test_dropped_draws_are_done_and_counted_by_reason(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write_group(0, GROUP)
    for index, reason in ((1, "thin"), (2, "no_solution"), (3, "thin")):
        store.write_drop(index, reason)
    assert store.is_done(2)
    manifest = store.write_manifest({"seed": 5})
    assert manifest["dropped"] == {"no_solution": 1, "thin": 2}
    assert (manifest["groups"], manifest["samples"]) == (1, 2)
    assert manifest["configuration"] == {"seed": 5}
    assert store.manifest() == manifest


def test_the_digest_is_of_the_arrays_and_of_nothing_else(tmp_path: Path) -> None:
    one, same, other = Store(tmp_path / "one"), Store(tmp_path / "same"), Store(tmp_path / "other")
    one.write_group(4, GROUP)
    same.write_group(4, dict(reversed(GROUP.items())))
    changed = GROUP["value"].copy()
    changed[1, 2] = np.nextafter(changed[1, 2], 9.0)
    other.write_group(4, {**GROUP, "value": changed})
    digests = [store.write_manifest({"root": str(store.root)})["digest"] for store in (one, same, other)]
    assert digests[0] == digests[1] != digests[2]
    assert digests[0].startswith("sha256:")


def test_a_set_without_a_manifest_is_unfinished(tmp_path: Path) -> None:
    Store(tmp_path).write_group(0, GROUP)
    with pytest.raises(StoreError, match="no manifest"):
        Store(tmp_path).manifest()


def test_another_store_version_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write_group(0, GROUP)
    manifest = store.write_manifest({})
    (tmp_path / "manifest.json").write_text(json.dumps({**manifest, "store_version": STORE_VERSION + 1}))
    with pytest.raises(StoreError, match=f"version {STORE_VERSION + 1}, this code reads {STORE_VERSION}"):
        store.manifest()
