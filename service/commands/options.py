"""Options that commands share, and what completes them in a shell."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

from service.commands.exits import UsageError
from service.settings import Settings

# What shtab.FILE and shtab.DIRECTORY are; written out, so that only `completion` needs shtab.
FILE = {
    "bash": "_shtab_compgen_files", "zsh": "_files", "tcsh": "f", "fish": "(__fish_complete_path (commandline -ct))",
}  # fmt: skip
DIRECTORY = {
    "bash": "_shtab_compgen_dirs", "zsh": "_files -/", "tcsh": "d",
    "fish": "(__fish_complete_directories (commandline -ct))",
}  # fmt: skip
MATERIAL = {"bash": "_physnet_materials", "zsh": "_physnet_materials", "fish": "(__physnet_materials)"}

_SIGNED = "up|press|force|direction"
"""Options whose values may begin with a minus."""


def complete_with(action: argparse.Action, completion: dict[str, str]) -> argparse.Action:
    """Tell shells how to complete an option's value."""
    action.complete = completion  # type: ignore[attr-defined]  # where shtab looks
    return action


def models_options() -> argparse.ArgumentParser:
    """Parent of commands that open models."""
    parent = argparse.ArgumentParser(add_help=False)
    group = parent.add_argument_group("the models of this machine")
    complete_with(
        group.add_argument("--models", type=Path, metavar="DIR", help="directory of the models (PHYSNET_MODELS)"),
        DIRECTORY,
    )
    group.add_argument("--threads", type=int, metavar="N", help="threads of each network (PHYSNET_THREADS)")
    return parent


def output_options() -> argparse.ArgumentParser:
    """Parent of commands that print results."""
    parent = argparse.ArgumentParser(add_help=False)
    group = parent.add_argument_group("what is printed")
    group.add_argument("--json", action="store_true", help="print one JSON document")
    group.add_argument(
        "--no-color", dest="color", action="store_false", help="plain text; so does NO_COLOR=1, and a pipe"
    )
    return parent


def check_folder(option: str, path: Path) -> None:
    """Before anything is computed: a file can only be written into a folder that is there.

    Raises:
        UsageError: It is not.
    """
    if not path.parent.is_dir():
        raise UsageError(f"{option}: there is no folder {path.parent}")


def settings_of(given: argparse.Namespace, *names: str) -> Settings:
    """The settings of the environment, with what the command line says in their place."""
    chosen = {name: getattr(given, name) for name in ("models", "threads", *names)}
    return Settings(**{name: value for name, value in chosen.items() if value is not None})


def join_negatives(arguments: Sequence[str]) -> list[str]:
    """`--force -1,0,0` as `--force=-1,0,0`: argparse takes a value that begins with a minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        after_option = joined and re.fullmatch(rf"--({_SIGNED})", joined[-1])
        if after_option and re.match(r"-[\d.]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined
