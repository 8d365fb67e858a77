"""`physnet serve`: answer requests until told to stop."""

from __future__ import annotations

import argparse
import gc

from service.commands.exits import EPILOG
from service.commands.options import models_options, settings_of

_SETTINGS = (
    "host", "http_port", "grpc_port", "workers", "log_level", "log_format", "reconstruction_bytes",
    "reconstruction_lifetime_s", "tracing_endpoint",
)  # fmt: skip


def add_serve(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "serve", parents=[models_options()], help="answer requests over HTTP and gRPC", epilog=EPILOG,
        description="Serve until SIGTERM. Prints one line on stdout once it answers, `ready http=HOST:PORT "
        "grpc=HOST:PORT`; logs go to stderr. Every setting is also an environment variable: PHYSNET_HOST, …",
    )  # fmt: skip
    parser.add_argument("--host", help="address to listen on (PHYSNET_HOST)")
    parser.add_argument("--http-port", type=int, metavar="PORT", help="0 picks a free one (PHYSNET_HTTP_PORT)")
    parser.add_argument("--grpc-port", type=int, metavar="PORT", help="0 picks a free one (PHYSNET_GRPC_PORT)")
    parser.add_argument("--workers", type=int, metavar="N", help="requests answered at once (PHYSNET_WORKERS)")
    parser.add_argument("--log-level", choices=["debug", "info", "warning", "error"], help="(PHYSNET_LOG_LEVEL)")
    parser.add_argument("--log-format", choices=["text", "json"], help="for people or machines (PHYSNET_LOG_FORMAT)")
    parser.add_argument(
        "--reconstruction-bytes", type=int, metavar="N",
        help="memory for reconstructions to ask again by their id, 0 for none (PHYSNET_RECONSTRUCTION_BYTES)",
    )  # fmt: skip
    parser.add_argument(
        "--reconstruction-lifetime-s", type=float, metavar="S",
        help="how long one is kept after its last use (PHYSNET_RECONSTRUCTION_LIFETIME_S)",
    )  # fmt: skip
    parser.add_argument(
        "--tracing-endpoint", metavar="URL",
        help="collector of traces, OTLP over gRPC; needs physnet[tracing] (PHYSNET_TRACING_ENDPOINT)",
    )  # fmt: skip
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> int:
    gc.disable()  # nothing that is imported is garbage, and looking for some takes a tenth of the time
    from service.app import run

    gc.enable()
    return run(settings_of(given, *_SETTINGS))
