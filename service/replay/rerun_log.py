"""Answers as a Rerun recording (`.rrd`): the depth image, the bodies and the timings, side by side in time."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from service.client.result import Result
from service.client.ros import voxel_displacements_m
from service.core.camera import make_intrinsics
from service.core.colours import colours_of
from service.core.depth import decode_depth
from service.replay.force import Force
from service.replay.foxglove import ARROW_M_PER_N
from service.replay.frames import RecordedFrame

try:
    import rerun
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("A Rerun recording needs rerun-sdk: pip install 'physnet[rerun]'") from missing

APPLICATION = "physnet"


class RerunWriter:
    """Writes answers to a `.rrd` file; a context manager, whose end flushes it."""

    def __init__(self, path: Path) -> None:
        self._stream: Any = rerun.RecordingStream(APPLICATION)
        self._stream.save(path)
        # The camera's optical frame: x right, y down, z forward.
        self._stream.log("camera", rerun.ViewCoordinates.RDF, static=True)

    def write(
        self, frame: RecordedFrame, result: Result, round_trip_ms: float, force: Force | None = None
    ) -> None:
        """One answer; see `service.replay.foxglove.FoxgloveWriter.write`."""
        log = self._stream.log
        self._stream.set_time("recorded", timestamp=np.datetime64(frame.time_ns, "ns"))
        camera = frame.camera
        matrix = make_intrinsics(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, None).matrix
        log("camera/image", rerun.Pinhole(image_from_camera=matrix, resolution=[camera.width, camera.height]))
        depth_m = decode_depth(
            frame.depth.encoding, frame.depth.data, frame.depth.unit_m, camera.width, camera.height
        )
        log("camera/image/depth", rerun.DepthImage(np.nan_to_num(depth_m), meter=1.0))
        for layer, colour in (("reconstruction", (178, 178, 178, 64)), ("deformed", None)):
            mesh = result.mesh(layer)  # type: ignore[arg-type]
            colours: Any = colour
            if layer == "deformed":
                moved_m = np.linalg.norm(result.displacement_at(mesh.vertices_m, "deformed"), axis=1)
                colours = colours_of(moved_m, result.max_displacement_m)
            shade = {"albedo_factor": colour} if colour else {"vertex_colors": colours}
            log(f"camera/{layer}",
                rerun.Mesh3D(vertex_positions=mesh.vertices_m, triangle_indices=mesh.faces, **shade))  # fmt: skip
        log("camera/voxels", rerun.Points3D(
            result.points_camera(), radii=0.5 * result.grid.pitch_m,
            colors=colours_of(voxel_displacements_m(result), result.max_displacement_m),
        ))  # fmt: skip
        if force is not None:
            arrow_m = force.force_n * ARROW_M_PER_N
            log("camera/force", rerun.Arrows3D(origins=[force.contact_m - arrow_m], vectors=[arrow_m]))
        log("figures/max_displacement_m", rerun.Scalars(result.max_displacement_m))
        log("figures/round_trip_ms", rerun.Scalars(round_trip_ms))
        if flags := sorted(result.flags | result[0].flags):
            log("flags", rerun.TextLog(", ".join(flags)))

    def close(self) -> None:
        """Flush and close."""
        self._stream.flush()
        self._stream.disconnect()

    def __enter__(self) -> RerunWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
