"""`physnet doctor`: looks at the machine, the install and the models, and says what is wrong and how to mend it."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
from collections.abc import Iterator

from pydantic import ValidationError

from service.commands.checks.check import Check
from service.commands.exits import EPILOG, FAILED, OK
from service.commands.options import models_options, output_options, settings_of
from service.commands.terminal import Terminal

_SIGNS = {"ok": ("✓", "green"), "warn": ("!", "yellow"), "fail": ("✗", "red")}


def add_doctor(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "doctor", parents=[models_options(), output_options()], help="check this machine and install", epilog=EPILOG,
        description="Check processor, cores, memory, packages, settings, the models' digests, and time a prediction. "
        "Ends with 1 if something does not work, with 0 if all works, also where it could work better.",
    )  # fmt: skip
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> int:
    terminal = Terminal(given.color)
    checks = []
    for check in _checks(given, terminal):
        checks.append(check)
        if not given.json:
            _tell(check, terminal)
    failed = [check for check in checks if check.state == "fail"]
    if given.json:
        terminal.print(json.dumps({"ok": not failed, "checks": [dataclasses.asdict(check) for check in checks]}))
    elif failed:
        terminal.print(terminal.paint(f"\n{len(failed)} of {len(checks)} checks failed", "red", "bold"))
    else:
        warned = sum(check.state == "warn" for check in checks)
        told = f", {warned} could be better" if warned else ""
        terminal.print(terminal.paint(f"\nall {len(checks)} checks passed{told}", "green", "bold"))
    return FAILED if failed else OK


def _checks(given: argparse.Namespace, terminal: Terminal) -> Iterator[Check]:
    from service.commands.checks.machine import check_machine
    from service.commands.checks.models import check_models, check_settings
    from service.commands.checks.packages import check_packages
    from service.commands.checks.prediction import check_prediction

    yield from check_machine()
    packages = list(check_packages())
    yield from packages
    try:
        settings = settings_of(given)
    except ValidationError as error:
        for detail in error.errors():
            name = "PHYSNET_" + "_".join(str(step) for step in detail["loc"]).upper()
            yield Check("setting", "fail", f"{name}: {detail['msg']}", "mend or unset it")
        return
    yield from check_settings(os.environ, settings)
    with terminal.working("reading the models"):
        models = list(check_models(settings))
    yield from models
    if any(check.state == "fail" for check in (*packages, *models)):
        return
    with terminal.working("predicting"):
        predicted = list(check_prediction(settings))
    yield from predicted


def _tell(check: Check, terminal: Terminal) -> None:
    sign, colour = _SIGNS[check.state]
    terminal.print(f"{terminal.paint(sign, colour, 'bold')} {check.name:11} {check.found}")
    if check.mend:
        terminal.print(terminal.paint(f"  {'':11} {check.mend}", colour))
