"""`physnet completion`: scripts that shells accept and that complete what there is."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from service.__main__ import main
from service.commands.completion import SHELLS
from service.commands.exits import OK


@pytest.mark.parametrize("shell", SHELLS)
def test_a_script_names_commands_and_options(shell, capsys):
    assert main(["completion", shell]) == OK
    script = capsys.readouterr().out
    for name in ("predict", "doctor", "material"):
        assert name in script


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        (("do",), {"doctor"}),
        (("predict", "--material", "ecoflex_00_3"), {"ecoflex_00_30"}),
        (("predict", "--intr"), {"--intrinsics"}),
        (("completion", "z"), {"zsh"}),
    ],
)
@pytest.mark.skipif(shutil.which("bash") is None, reason="this machine has no bash")
def test_bash_completes(typed, completed, capsys):
    assert main(["completion", "bash"]) == OK
    words = " ".join(("physnet", *typed))
    asked = f'COMP_WORDS=({words}); COMP_CWORD={len(typed)}; _shtab_physnet; printf "%s\\n" "${{COMPREPLY[@]}}"'
    script = f"{capsys.readouterr().out}\n{asked}\n"
    found = subprocess.run(["bash"], input=script, capture_output=True, text=True, timeout=30, check=True).stdout
    assert set(found.split()) == completed
