"""A camera at 30 frames a second and a service that may be slower: answers are about the newest frame there is.

    python examples/client_stream.py [--url grpc://127.0.0.1:8001] [--seconds 5]

The sample frame stands in for a camera, with noise of its own on every frame.
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path

import cv2
import numpy as np

from service.client import Camera, PhysNetClient, Push

FRAME = Path(__file__).resolve().parent / "frames" / "mug"
PERIOD_S = 1.0 / 30.0


def main() -> None:
    parser = argparse.ArgumentParser(description="Stream depth frames.")
    parser.add_argument("--url", default="grpc://127.0.0.1:8001")
    parser.add_argument("--seconds", type=float, default=5.0)
    given = parser.parse_args()
    depth_mm = cv2.imread(str(FRAME / "depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth_mm is not None
    camera = Camera.from_json(FRAME / "intrinsics.json")
    push = Push((0.0, 2.0, 8.0), contact_px=(365, 215))
    random = np.random.default_rng(0)

    with PhysNetClient(given.url) as client, client.stream() as stream:

        def camera_loop() -> None:
            end = time.monotonic() + given.seconds
            while time.monotonic() < end:
                noise = random.integers(-1, 2, depth_mm.shape) * (depth_mm > 0)
                # `send` never waits: a frame that is still here when the next one comes is overtaken by it.
                stream.send((depth_mm + noise).astype(np.uint16), camera, push, "dragon_skin_10")
                time.sleep(PERIOD_S)
            stream.close()

        threading.Thread(target=camera_loop).start()
        ages_ms = []
        for answer in stream:
            if answer.error is not None:
                print(f"frame {answer.frame_id}: {answer.error.code}: {answer.error.message}")
            elif answer.result is not None:
                ages_ms.append(answer.round_trip_ms)
        counts = stream.counts()
    print(f"{counts.sent} frames sent, {counts.answered} answered, {counts.skipped} overtaken, {counts.failed} failed")
    if ages_ms:
        print(f"from frame to answer: median {np.median(ages_ms):.0f} ms, longest {max(ages_ms):.0f} ms")


if __name__ == "__main__":
    main()
