import errno
import json
import os
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
    store.write_manifest({})
    header = json.loads(store.header_path.read_text())
    store.header_path.write_text(json.dumps({**header, "store_version": STORE_VERSION + 1}))
    message = f"version {STORE_VERSION + 1}, this code reads 2 to {STORE_VERSION}"
    for use in (store.manifest, lambda: list(store.groups()), lambda: store.group(0), lambda: store.begin({})):
        with pytest.raises(StoreError, match=message):
            use()


def test_a_store_of_the_first_version_is_refused(tmp_path: Path) -> None:
    """It had no header."""
    store = Store(tmp_path)
    store.write_group(0, GROUP)
    store.header_path.unlink()
    with pytest.raises(StoreError, match="version 1, this code reads 2 to 3"):
        list(store.groups())


def test_a_set_of_the_second_version_is_read_and_goes_on_as_it_began(tmp_path: Path) -> None:
    """It has no stress: groups that are added get none either, and the manifest says version 2."""
    old, new = Store(tmp_path / "old"), Store(tmp_path / "new")
    group = {**GROUP, "von_mises": np.ones((2, 4), np.float16), "peak_von_mises": np.ones(2, np.float32)}
    old.begin({"set": "x"})
    header = json.loads(old.header_path.read_text())
    old.header_path.write_text(json.dumps({**header, "store_version": 2}))
    old.begin({"set": "x"})
    for store in (old, new):
        store.write_group(0, group)
    assert old.group(0).keys() == GROUP.keys()
    assert new.group(0).keys() == group.keys()
    assert old.write_manifest({})["store_version"] == 2
    assert new.write_manifest({})["store_version"] == 3


def test_a_folder_of_another_configuration_is_not_drawn_into(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.begin({"set": "x", "seed": 1, "range": (1, 2), "groups": 5})
    store.begin({"set": "x", "seed": 1, "range": (1, 2), "groups": 50})  # only more of the same
    store.begin({"set": "x", "seed": 1, "range": (1, 2), "later": None, "groups": 5})  # what older code did not know
    with pytest.raises(StoreError, match=r"drawn otherwise \(seed differ\)"):
        store.begin({"set": "x", "seed": 2, "range": (1, 2), "groups": 5})


def test_one_group_is_read_without_the_others(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write_group(7, GROUP)
    store.group_path(6).write_bytes(b"damaged")
    np.testing.assert_array_equal(store.group(7)["value"], GROUP["value"])
    with pytest.raises(StoreError, match="no group 5"):
        store.group(5)


@pytest.mark.parametrize("keep", [0, 10, -40], ids=["empty", "head only", "end cut off"])
def test_a_damaged_group_is_named(tmp_path: Path, keep: int) -> None:
    store = Store(tmp_path)
    store.write_group(3, GROUP)
    path = store.group_path(3)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(StoreError, match=r"000003\.npz is damaged"):
        list(store.groups())


def test_partial_files_do_not_count(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write_group(0, GROUP)
    digest = store.write_manifest({})["digest"]
    (tmp_path / "groups" / "000001.99.partial").write_bytes(b"half a")
    assert not store.is_done(1)
    assert store.write_manifest({})["digest"] == digest


@pytest.mark.parametrize("what", ["replace", "write"])
def test_a_full_disk_is_said_and_costs_nothing_that_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    store = Store(tmp_path)
    store.write_group(0, GROUP)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(*((os, "replace") if what == "replace" else (np.lib.format, "write_array")), full)
        with pytest.raises(StoreError, match="no space left"):
            store.write_group(1, GROUP)
    assert not list(tmp_path.rglob("*.partial"))
    assert [index for index, _ in store.groups()] == [0]
    store.write_group(1, GROUP)
    assert [index for index, _ in store.groups()] == [0, 1]


def test_the_same_arrays_give_the_same_file(tmp_path: Path) -> None:
    for index in (0, 1):
        Store(tmp_path).write_group(index, GROUP)
    assert Store(tmp_path).group_path(0).read_bytes() == Store(tmp_path).group_path(1).read_bytes()
