"""The command line: `physnet serve | predict | replay | bench | materials | models | doctor | completion`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Generator, Sequence

# NumPy's BLAS reads this as it is loaded: the products here are small, and its threads cost 5 ms an answer in waiting
# for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))

from pydantic import ValidationError

from service.commands.bench import add_bench
from service.commands.completion import add_completion
from service.commands.doctor import add_doctor
from service.commands.exits import EPILOG, FAILED, INTERRUPTED, OK, REFUSED, USAGE, UsageError
from service.commands.materials import add_materials
from service.commands.models import add_models
from service.commands.options import join_negatives
from service.commands.predict import add_predict
from service.commands.replay import add_replay
from service.commands.serve import add_serve
from service.core.errors import ModelMismatch, PhysNetError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code (`service.commands.exits`)."""
    arguments = sys.argv[1:] if arguments is None else arguments
    whole = parser()
    if not arguments:
        whole.print_help(sys.stderr)
        return USAGE
    given = whole.parse_args(join_negatives(arguments))
    try:
        return int(given.run(given))
    except UsageError as error:
        return _fail(str(error), USAGE)
    except ValidationError as error:
        for detail in error.errors():
            name = "_".join(str(step) for step in detail["loc"])
            _fail(f"setting {name} (PHYSNET_{name.upper()}): {detail['msg']}", USAGE)
        return USAGE
    except BrokenPipeError:
        return OK
    except KeyboardInterrupt:
        return INTERRUPTED
    except OSError as error:
        if error.filename is None:
            return _fail(str(error), FAILED)
        return _fail(f"{error.filename}: {str(error.strerror).lower()}", USAGE)
    except ModuleNotFoundError as error:
        return _fail(str(error), FAILED)
    except ModelMismatch as error:
        return _fail(f"{error.message} `physnet doctor` says more.", FAILED)
    except PhysNetError as error:
        return _fail(f"{error.code}: {error.message}", REFUSED)


def parser() -> argparse.ArgumentParser:
    """The whole grammar."""
    whole = argparse.ArgumentParser(
        prog="physnet", description="From one depth frame to the shape an object takes under a push.", epilog=EPILOG,
        formatter_class=_Commands,
    )
    whole.add_argument("--version", action=_Version, nargs=0, help="say which version this is, and leave")
    commands = whole.add_subparsers(required=True, metavar="COMMAND", title="commands")
    # Each imports what it needs when it runs: `physnet materials` loads neither ONNX Runtime nor a web server.
    add_serve(commands)
    add_predict(commands)
    add_replay(commands)
    add_bench(commands)
    add_materials(commands)
    add_models(commands)
    add_doctor(commands)
    add_completion(commands, whole)
    return whole


class _Commands(argparse.HelpFormatter):
    """Commands as a list, each with its line beside it, not below."""

    def _format_action(self, action: argparse.Action) -> str:
        text = super()._format_action(action)
        return text.partition("\n")[2] if isinstance(action, argparse._SubParsersAction) else text

    def _iter_indented_subactions(self, action: argparse.Action) -> Generator[argparse.Action, None, None]:
        yield from getattr(action, "_get_subactions", tuple)()


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib import metadata

        try:
            print(f"physnet {metadata.version('physnet')}")
        except metadata.PackageNotFoundError:
            print("physnet, not installed: run from its sources")
        parser.exit()


def _fail(message: str, code: int) -> int:
    print(f"physnet: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
