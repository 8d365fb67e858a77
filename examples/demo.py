"""Start the service, push three real objects as a robot would over HTTP, print the answers and draw them.

    python examples/demo.py [--out build/demo] [--url http://HOST:PORT]

Everything a robot does here, from `Push` to `ask`, needs nothing but the standard library.
"""

from __future__ import annotations

import argparse
import base64
import json
import queue
import statistics
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from service.core.grids import Grid, unpack_bits
from service.picture import deformation_picture

FRAMES = Path(__file__).resolve().parent / "frames"
START_TIMEOUT_S = 300.0
"""The first start compiles, which a busy machine does slowly; later ones take three seconds."""

REPEATS = 5


@dataclass(frozen=True)
class Push:
    """A finger on one of the sample frames: `contact_px` is (u, v), the force points along the camera's axes."""

    frame: str
    material: str
    contact_px: tuple[int, int]
    force_n: tuple[float, float, float]


PUSHES = (
    Push("sugar_box", "dragon_skin_10", (385, 125), (9.0, 0.0, 4.5)),
    Push("mug", "dragon_skin_10", (365, 215), (0.0, 1.0, 4.0)),
    Push("bowl", "dragon_skin_10", (260, 225), (1.6, 0.5, 0.0)),
)


def request_body(push: Push) -> dict[str, Any]:
    folder = FRAMES / push.frame
    return {
        "camera": json.loads((folder / "intrinsics.json").read_text("utf-8")),
        "depth": {"encoding": "png16", "data": base64.b64encode((folder / "depth.png").read_bytes()).decode()},
        "material": {"name": push.material},
        "loads": [{"contact_px": push.contact_px, "force_n": push.force_n}],
        "outputs": ["reconstruction", "deformed", "displacement"],
    }


def ask(url: str, body: dict[str, Any]) -> tuple[dict[str, Any], float]:
    """The reply and the milliseconds until it was there."""
    request = urllib.request.Request(
        f"{url}/v1/deform", json.dumps(body).encode(), {"Content-Type": "application/json"}
    )
    start = time.perf_counter()
    try:
        with urllib.request.urlopen(request, timeout=60) as response:
            answer = response.read()
    except urllib.error.HTTPError as error:
        # An RFC 9457 problem document: says what is wrong, in which field, and what was expected.
        sys.exit(f"the service refused the request ({error.code}): {error.read().decode(errors='replace')}")
    round_trip_ms = (time.perf_counter() - start) * 1e3
    reply: dict[str, Any] = json.loads(answer)
    return reply, round_trip_ms


@contextmanager
def running_service(log_path: Path) -> Iterator[str]:
    """A service on free ports, and its URL; ended by the signal that a process manager would send."""
    command = [sys.executable, "-m", "service", "serve", "--http-port", "0", "--grpc-port", "0"]
    with log_path.open("wb") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            yield f"http://{_ready_address(process, log_path)}"
        finally:
            process.terminate()
            try:
                process.wait(timeout=15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    print(f"service stopped with exit code {process.returncode}")
    if process.returncode:
        sys.exit(f"the service did not stop cleanly; its log: {log_path}")


def _ready_address(process: subprocess.Popen[str], log_path: Path) -> str:
    """Read stdout until the line `ready http=HOST:PORT …`."""
    lines: queue.Queue[str] = queue.Queue()
    assert process.stdout is not None
    stdout = process.stdout

    def read() -> None:
        # Read to the end, so that the service never blocks on a full pipe.
        for line in stdout:
            lines.put(line)
        lines.put("")

    threading.Thread(target=read, daemon=True).start()
    deadline = time.monotonic() + START_TIMEOUT_S
    while (left_s := deadline - time.monotonic()) > 0:
        try:
            line = lines.get(timeout=left_s)
        except queue.Empty:
            break
        if not line:
            sys.exit(f"the service ended before it was ready:\n{log_path.read_text(errors='replace')[-2000:]}")
        if line.startswith("ready "):
            return dict(word.split("=", 1) for word in line.split()[1:])["http"]
    sys.exit(f"the service was not ready after {START_TIMEOUT_S:.0f} s; its log: {log_path}")


def grid_of(reply: dict[str, Any]) -> Grid:
    return Grid(reply["grid"]["voxel_size_m"], np.array(reply["grid"]["camera_from_grid"], np.float64))


def bits_of(document: dict[str, Any]) -> np.ndarray:
    return unpack_bits(np.frombuffer(base64.b64decode(document["data"]), np.uint8))


def displacement_of(document: dict[str, Any]) -> np.ndarray:
    field = np.frombuffer(base64.b64decode(document["data"]), "<f2").reshape(document["shape"])
    return field.astype(np.float32)


def describe(push: Push, reply: dict[str, Any]) -> str:
    load = reply["loads"][0]
    grid = grid_of(reply)
    observed, rest, deformed = (
        bits_of(part) for part in (reply["observed"], reply["reconstruction"], load["deformed"])
    )

    def size(body: np.ndarray) -> str:
        filled = np.argwhere(body)
        top_mm = (filled[:, 2].max(initial=-1) + 1) * grid.pitch_m * 1e3
        return f"{len(filled):6,} voxels, {len(filled) * grid.pitch_m**3 * 1e6:6.0f} cm³, {top_mm:4.0f} mm tall"

    force_n = float(np.linalg.norm(push.force_n))
    flags = sorted({*reply["flags"], *load["flags"]})
    return "\n".join(
        [
            f"{push.frame}: {force_n:.3g} N at pixel {push.contact_px}, if it were made of {push.material}",
            f"  grid            64³ voxels of {grid.pitch_m * 1e3:.2f} mm",
            f"  observed        {observed.sum():6,} voxels",
            f"  reconstruction  {size(rest)}",
            f"  deformed        {size(deformed)}",
            f"  displacement    peak {load['max_displacement_m'] * 1e3:.1f} mm, "
            f"mean {load['mean_displacement_m'] * 1e3:.1f} mm (load number {load['load_number']:.2g})",
            f"  flags           {', '.join(flags) or 'none'}",
        ]
    )


def timing_table(timings_ms: dict[str, dict[str, float]]) -> str:
    """Stages down, frames across; milliseconds."""
    stages = list(dict.fromkeys(stage for column in timings_ms.values() for stage in column))
    lines = [f"{'ms':<14}" + "".join(f"{frame:>12}" for frame in timings_ms)]
    lines += [
        f"{stage:<14}" + "".join(f"{column.get(stage, 0.0):12.2f}" for column in timings_ms.values())
        for stage in stages
    ]
    return "\n".join(lines)


def draw(push: Push, reply: dict[str, Any]) -> bytes:
    depth_mm = cv2.imread(str(FRAMES / push.frame / "depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth_mm is not None
    depth_m = np.where(depth_mm > 0, depth_mm / 1000.0, np.nan).astype(np.float32)
    camera = json.loads((FRAMES / push.frame / "intrinsics.json").read_text("utf-8"))
    u, v = push.contact_px
    z = float(np.nanmedian(depth_m[v - 2 : v + 3, u - 2 : u + 3]))
    contact_m = z * np.array([(u - camera["cx"]) / camera["fx"], (v - camera["cy"]) / camera["fy"], 1.0])
    load = reply["loads"][0]
    force_n = np.array(push.force_n)
    return deformation_picture(
        depth_m=depth_m,
        observed=bits_of(reply["observed"]),
        reconstruction=bits_of(reply["reconstruction"]),
        deformed=bits_of(load["deformed"]),
        displacement_m=displacement_of(load["displacement"]),
        grid=grid_of(reply),
        intrinsics=(camera["fx"], camera["fy"], camera["cx"], camera["cy"]),
        contact_m=contact_m,
        force_n=force_n,
        caption=f"{push.frame.replace('_', ' ')} as {push.material} · {np.linalg.norm(force_n):.3g} N · peak "
        f"displacement {load['max_displacement_m'] * 1e3:.1f} mm · answered in {reply['timing_ms']['total']:.0f} ms",
    )


def run(url: str, out: Path) -> None:
    timings_ms: dict[str, dict[str, float]] = {}
    replies = {}
    for push in PUSHES:
        body = request_body(push)
        answers = [ask(url, body) for _ in range(REPEATS)]
        replies[push] = answers[-1][0]
        stages = answers[0][0]["timing_ms"]
        timings_ms[push.frame] = {
            stage: statistics.median(reply["timing_ms"][stage] for reply, _ in answers) for stage in stages
        }
        timings_ms[push.frame]["round trip"] = statistics.median(round_trip_ms for _, round_trip_ms in answers)
        print(describe(push, replies[push]), end="\n\n", flush=True)
    print(f"stage timings, median of {REPEATS} requests")
    print(timing_table(timings_ms), end="\n\n", flush=True)
    for push, reply in replies.items():
        path = out / f"{push.frame}.png"
        path.write_bytes(draw(push, reply))
        print(f"picture {path}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Push three real objects and draw what happens.")
    parser.add_argument("--out", type=Path, default=Path("build/demo"), help="where the pictures go")
    parser.add_argument("--url", help="a service that runs already; else one is started and stopped")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.url:
        run(given.url.rstrip("/"), given.out)
        return
    print("starting `physnet serve`; the first time it compiles for this processor, up to a minute …", flush=True)
    with running_service(given.out / "service.log") as url:
        print(f"ready at {url}\n", flush=True)
        run(url, given.out)


if __name__ == "__main__":
    main()
