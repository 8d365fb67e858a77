"""From a recording's messages to the frames that a robot would have sent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from service.client.question import Camera, Image
from service.client.ros import DEPTH_TYPES, INFO_TYPE, TF_TYPES, camera_of, depth_of, stamp_ns
from service.replay.recording import Recording, RecordingError
from service.replay.transforms import Rotations

T = TypeVar("T")


@dataclass(frozen=True)
class RecordedFrame:
    """A depth frame of a recording.

    Attributes:
        time_ns: When it was recorded.
        stamp_ns: When it was taken.
        frame_id: The camera's frame.
        depth: The image.
        camera: Its intrinsics.
        up: Against gravity in the camera's frame, where asked for and known by then.
    """

    time_ns: int
    stamp_ns: int
    frame_id: str
    depth: Image
    camera: Camera
    up: tuple[float, float, float] | None


@dataclass(frozen=True)
class Topics:
    """Where a recording has what: the depth images, their CameraInfo, and transforms (ROS 1: `/tf`, `/tf_static`)."""

    depth: str
    info: str
    transforms: tuple[str, ...]


def find_topics(recording: Recording, depth: str | None = None, info: str | None = None) -> Topics:
    """Topics as given, and the only ones that fit where not.

    Raises:
        RecordingError: A topic is not there, or several fit; lists them.
    """
    of_type = {
        kind: [topic for topic, found in recording.topics.items() if found == kind]
        for kind in (*DEPTH_TYPES, INFO_TYPE, *TF_TYPES)
    }
    images = [topic for kind in DEPTH_TYPES for topic in of_type[kind]]
    if depth is None:
        depth = _only("depth", "--depth", [topic for topic in images if "depth" in topic.lower()] or images)
    elif depth not in images:
        raise RecordingError(f"--depth: no images on {depth}; there are {_list(images)}")
    if info is None:
        # `/camera/depth/image_raw` goes with `/camera/depth/camera_info`; its compressed twin lies one level deeper.
        folder = depth
        infos: list[str] = []
        while "/" in folder and not infos:
            folder = folder.rpartition("/")[0]
            infos = [topic for topic in of_type[INFO_TYPE] if topic == f"{folder}/camera_info"]
        info = _only("CameraInfo", "--info", infos or of_type[INFO_TYPE])
    elif info not in of_type[INFO_TYPE]:
        raise RecordingError(f"--info: no CameraInfo on {info}; there are {_list(of_type[INFO_TYPE])}")
    return Topics(depth, info, tuple(topic for kind in TF_TYPES for topic in of_type[kind]))


def recorded_frames(recording: Recording, topics: Topics, up_frame: str | None = None) -> Iterator[RecordedFrame]:
    """Depth frames in the order of time, each with the newest CameraInfo, those before the first one with that.

    Args:
        recording: Open.
        topics: Where it has what.
        up_frame: A frame whose z axis points against gravity, such as `base_link`; `up` is taken from it as soon as
            transforms connect it with the camera.

    Raises:
        RecordingError: A message is no depth image, a camera cannot be used, or none ever told of itself.
    """
    rotations = Rotations()
    first = next(iter(recording.messages({topics.info})), None)
    if first is None:
        raise RecordingError(f"{topics.info} says nothing: a depth image has no scale without its camera")
    camera = _usable(camera_of, first[2], topics.info)
    wanted = {topics.depth, topics.info, *(topics.transforms if up_frame else ())}
    for topic, time_ns, message in recording.messages(wanted):
        if topic == topics.depth:
            yield _frame(time_ns, message, camera, rotations, topics.depth, up_frame)
        elif topic == topics.info:
            camera = _usable(camera_of, message, topic)
        else:
            rotations.update(message)


def _frame(
    time_ns: int, image: Any, camera: Camera, rotations: Rotations, topic: str, up_frame: str | None
) -> RecordedFrame:
    header = image.header
    up = rotations.up(header.frame_id, up_frame) if up_frame else None
    return RecordedFrame(
        time_ns=time_ns,
        stamp_ns=stamp_ns(header) or time_ns,  # simulators that do not stamp leave it 0
        frame_id=header.frame_id,
        depth=_usable(depth_of, image, topic),
        camera=camera,
        up=None if up is None else (float(up[0]), float(up[1]), float(up[2])),
    )


def _usable(convert: Callable[[Any], T], message: Any, topic: str) -> T:
    try:
        return convert(message)
    except ValueError as error:
        raise RecordingError(f"{topic}: {error}") from error


def _only(what: str, option: str, topics: list[str]) -> str:
    if len(topics) == 1:
        return topics[0]
    if not topics:
        raise RecordingError(f"the recording has no topic with {what}")
    raise RecordingError(f"several topics have {what}: choose with {option}: {_list(topics)}")


def _list(topics: list[str]) -> str:
    return ", ".join(sorted(topics)) or "none"
