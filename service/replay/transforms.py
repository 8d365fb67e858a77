"""The tree of frames that a recording tells of, as far as `up` needs it: rotations alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from service.client.ros import rotation_of
from service.core.arrays import Matrix3, Vector3


class Rotations:
    """The newest rotation of each frame in its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Matrix3]] = {}

    def update(self, message: Any) -> None:
        """Take in a `tf2_msgs/TFMessage`."""
        for transform in message.transforms:
            child, parent = _name(transform.child_frame_id), _name(transform.header.frame_id)
            self._parents[child] = (parent, rotation_of(transform.transform.rotation))

    def up(self, camera_frame: str, fixed_frame: str) -> Vector3 | None:
        """The z axis of `fixed_frame` in `camera_frame`; None while the two are not connected."""
        to_camera, to_fixed = self._path(_name(camera_frame)), self._path(_name(fixed_frame))
        common = next((frame for frame in to_fixed if frame in to_camera), None)
        if common is None:
            return None
        common_from_fixed, common_from_camera = to_fixed[common], to_camera[common]
        return np.asarray((common_from_camera.T @ common_from_fixed)[:, 2], np.float64)

    def _path(self, frame: str) -> dict[str, Matrix3]:
        """Each ancestor, itself first, with the rotation from the frame to it."""
        found: dict[str, Matrix3] = {frame: np.eye(3)}
        rotation = found[frame]
        while frame in self._parents:
            frame, parent_from_child = self._parents[frame]
            if frame in found:  # a loop is no tree, and its first turn tells all it has
                break
            rotation = parent_from_child @ rotation
            found[frame] = rotation
        return found


def _name(frame: str) -> str:
    """ROS 1 wrote some frames with a leading slash."""
    return frame.lstrip("/")
