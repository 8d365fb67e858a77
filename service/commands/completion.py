"""`physnet completion`: a script that lets a shell complete commands, options, files and names of materials."""

from __future__ import annotations

import argparse

from service.commands.exits import EPILOG, OK
from service.core.materials import MATERIALS

SHELLS = ("bash", "zsh", "fish", "tcsh")

_HOW = """\
bash:  physnet completion bash > ~/.local/share/bash-completion/completions/physnet
zsh:   physnet completion zsh > "${fpath[1]}/_physnet"    (then start a new shell)
fish:  physnet completion fish > ~/.config/fish/completions/physnet.fish
tcsh:  physnet completion tcsh >> ~/.complete.tcsh
"""


def add_completion(
    commands: argparse._SubParsersAction[argparse.ArgumentParser], whole: argparse.ArgumentParser
) -> None:
    """Register the command; `whole` is the parser that it completes."""
    parser = commands.add_parser(
        "completion", help="print a completion script for a shell",
        description=f"Print a completion script.\n\n{_HOW}", epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("shell", choices=SHELLS)
    parser.set_defaults(run=lambda given: _run(given.shell, whole))


def _run(shell: str, whole: argparse.ArgumentParser) -> int:
    import shtab

    print(shtab.complete(whole, shell=shell, preamble=_preamble()))  # type: ignore[arg-type]  # its annotation knows one shell
    return OK


def _preamble() -> dict[str, str]:
    """Functions that complete names of materials, with the names written into them: no start of Python per key."""
    names = " ".join(MATERIALS)
    return {
        "bash": f'_physnet_materials() {{ compgen -W "{names}" -- "$1"; }}\n',
        "zsh": f"_physnet_materials() {{ compadd {names} }}\n",
        "fish": f"function __physnet_materials; string split ' ' '{names}'; end\n",
    }
