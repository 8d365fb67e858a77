"""The authors' release, where it is at hand, and the file format on messages written here by hand."""

import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from service.core.grids import pack_bits, unpack_bits
from tests.conftest import ROOT
from training.data.physnet_2018 import PhysNet2018, masked_crc32c, records
from training.data.store import Store, StoreError
from training.metrics import iou

SHARED = Path(os.environ.get("PHYSNET_SHARED", ROOT.parent / "shared"))
RELEASE = SHARED / "data" / "physnet_2018" / "train.tfrecord"


def field(number: int, content: bytes) -> bytes:
    size, parts = len(content), []
    while size > 0x7F:
        parts.append(size & 0x7F | 0x80)
        size >>= 7
    return bytes([number << 3 | 2, *parts, size]) + content


def example(**features: bytes) -> bytes:
    entries = [
        field(1, field(1, key.encode()) + field(2, field(1, field(1, value)))) for key, value in features.items()
    ]
    return field(1, b"".join(entries))


def framed(message: bytes) -> bytes:
    size = struct.pack("<Q", len(message))
    return size + struct.pack("<I", masked_crc32c(size)) + message + struct.pack("<I", masked_crc32c(message))


def sample(**changes: bytes) -> bytes:
    rest = np.array([[1, 2, 3], [63, 0, 5]], np.uint8)
    return example(
        **{
            "pcl1": rest.tobytes(),
            "pcl2": rest[:1].tobytes(),
            "label": np.array([1, 0.25, 0.5, 1], "<f4").tobytes(),
            "label_name": b"one",
        }
        | changes
    )


def written(path: Path, *messages: bytes) -> Path:
    path.write_bytes(zlib.compress(b"".join(framed(message) for message in messages)))
    return path


def test_the_checksum_is_crc32c() -> None:
    """CRC-32C of "123456789" is e3069283 (RFC 3720, appendix B.4 gives the polynomial); TFRecord's mask on top."""
    crc = 0xE3069283
    assert masked_crc32c(b"123456789") == ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


def test_coordinates_become_grids(tmp_path: Path) -> None:
    release = PhysNet2018.load(written(tmp_path / "x.tfrecord", sample(), sample(label_name=b"two")))
    assert release.name == ("one", "two")
    rest = unpack_bits(release.rest[0])
    assert np.argwhere(rest).tolist() == [[1, 2, 3], [63, 0, 5]]
    assert np.argwhere(unpack_bits(release.deformed[1])).tolist() == [[1, 2, 3]]
    np.testing.assert_array_equal(release.label[0], [1, 0.25, 0.5, 1])


def test_it_goes_into_a_store_like_any_other(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    PhysNet2018.load(written(tmp_path / "x.tfrecord", sample())).write(store)
    ((index, group),) = store.groups()
    assert index == 0
    assert group["identity_iou"] == pytest.approx([0.5])
    assert group["rest"].tobytes() == pack_bits(unpack_bits(group["rest"])).tobytes()
    assert store.manifest()["samples"] == 1


def damaged(message: bytes) -> bytes:
    data = bytearray(framed(message))
    data[3] ^= 1
    return zlib.compress(bytes(data))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(b"not zlib", "no ZLIB", id="another format"),
        pytest.param(zlib.compress(framed(sample()))[:-40], "no ZLIB", id="cut off"),
        pytest.param(zlib.compress(framed(sample())[:-40]), "damaged", id="half a record"),
        pytest.param(damaged(sample()), "damaged", id="wrong length"),
        pytest.param(zlib.compress(b""), "no record", id="empty"),
        pytest.param(zlib.compress(framed(example(label=b"abcd"))), "record 0 is no sample", id="another message"),
        pytest.param(zlib.compress(framed(sample(pcl1=b"\x40\x00\x00"))), "coordinate 64", id="off the grid"),
    ],
)
def test_what_is_no_release_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "x.tfrecord"
    path.write_bytes(content)
    with pytest.raises(StoreError, match=message):
        PhysNet2018.load(path)


def test_records_come_back_whole(tmp_path: Path) -> None:
    assert list(records(written(tmp_path / "x", b"", b"abc" * 1000))) == [b"", b"abc" * 1000]


@pytest.mark.skipif(not RELEASE.exists(), reason=f"the authors' release is not at {RELEASE}; set PHYSNET_SHARED")
def test_the_release_is_as_its_notes_say() -> None:
    """280 samples of one body of 3,613 voxels, on a grid of 20 × 20 materials."""
    release = PhysNet2018.load(RELEASE)
    assert len(release) == 280
    rest = unpack_bits(release.rest[0])
    assert rest.sum() == 3613
    assert (release.rest == release.rest[0]).all()
    assert [len(np.unique(column)) for column in release.label.T] == [1, 20, 20, 1]
    assert (release.label.min(), release.label.max()) == (0, 1)
    # Softer is deformed more: the third of samples of the lowest second label overlap their body least.
    overlap = np.array([iou(rest, unpack_bits(bits)) for bits in release.deformed])
    soft = release.label[:, 1] < 1 / 3
    assert overlap[soft].mean() == pytest.approx(0.55, abs=0.05)
    assert overlap[~soft].mean() > 0.75
