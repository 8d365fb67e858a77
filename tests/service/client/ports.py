"""Ports for services that are started twice, or before anybody listens."""

from __future__ import annotations

import socket


def free_ports() -> tuple[int, int]:
    """Two ports that were free a moment ago."""
    first, second = (socket.create_server(("127.0.0.1", 0)) for _ in range(2))
    with first, second:
        return first.getsockname()[1], second.getsockname()[1]
