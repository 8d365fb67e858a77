"""`physnet materials`: the named materials, and what a Shore hardness says."""

from __future__ import annotations

import argparse
import json
from itertools import groupby
from typing import Any

from service.commands.exits import EPILOG, OK, UsageError
from service.commands.options import output_options
from service.commands.terminal import Terminal, pascals
from service.core.errors import UnknownMaterial
from service.core.hardness import SHORE_00_RANGE, SHORE_A_RANGE, modulus_of, parse_hardness
from service.core.materials import NEARLY_INCOMPRESSIBLE, MaterialEntry, material_named, search_materials


def add_materials(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "materials", parents=[output_options()], help="list the named materials", epilog=EPILOG,
        description="List the materials whose name, description or kind holds every word; all without words. A ~ marks "
        "a value that could not be looked up in its source. A search that finds one tells all about it.",
    )  # fmt: skip
    parser.add_argument("words", nargs="*", help="such as: foam soft")
    parser.add_argument("--sources", action="store_true", help="where each value comes from")
    parser.add_argument("--shore", metavar="HARDNESS", help="Young's modulus of an elastomer: A30, 00-30")
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> int:
    terminal = Terminal(given.color)
    words = " ".join(given.words)
    if given.shore is not None or (given.words and parse_hardness(words)):
        return _shore(given.shore or words, given.json, terminal)
    found = search_materials(words)
    if given.json:
        terminal.print(json.dumps({"materials": [_document(entry) for entry in found]}))
    elif len(found) == 1:
        _tell(found[0], terminal)
    elif found:
        _list(found, given.sources, terminal)
    else:
        terminal.print(f"nothing is called {words!r}; names nearest to it: {_nearest(words)}")
        terminal.print("try one word, `physnet materials` for all, or a hardness: `physnet materials --shore A30`")
    return OK


def _nearest(words: str) -> str:
    try:
        return material_named(words).name or words
    except UnknownMaterial as unknown:
        return ", ".join(map(str, unknown.expected if isinstance(unknown.expected, list) else ()))


def _document(entry: MaterialEntry) -> dict[str, Any]:
    return {
        "name": entry.name,
        "category": entry.category,
        "young_modulus_pa": entry.material.young_modulus_pa,
        "poisson_ratio": entry.material.poisson_ratio,
        "young_modulus_range_pa": entry.young_modulus_range_pa,
        "description": entry.description,
        "source": entry.source,
        "checked": entry.checked,
    }


def _list(found: tuple[MaterialEntry, ...], sources: bool, terminal: Terminal) -> None:
    for category, entries in groupby(found, lambda entry: entry.category):
        terminal.print(terminal.paint(category, "bold", "cyan"))
        rows = []
        for entry in entries:
            low_pa, high_pa = (pascals(bound) for bound in entry.young_modulus_range_pa)
            mark = " " if entry.checked else "~"
            e_pa = mark + pascals(entry.material.young_modulus_pa)
            last = entry.source if sources else entry.description
            rows.append((entry.name, e_pa, f"{low_pa} to {high_pa}", f"ν {entry.material.poisson_ratio:.2f}", last))
        terminal.table(rows, right=(1,), indent="  ")


def _tell(entry: MaterialEntry, terminal: Terminal) -> None:
    low_pa, high_pa = entry.young_modulus_range_pa
    terminal.print(f"{terminal.paint(entry.name, 'bold')}: {entry.description} ({entry.category})")
    e_pa = pascals(entry.material.young_modulus_pa)
    terminal.print(f"Young's modulus  {e_pa}, {pascals(low_pa)} to {pascals(high_pa)}")
    terminal.print(f"Poisson's ratio  {entry.material.poisson_ratio:g}")
    terminal.print(f"source           {entry.source}")


def _shore(text: str, as_json: bool, terminal: Terminal) -> int:
    hardness = parse_hardness(text)
    if hardness is None:
        a, zero = ("{:g} to {:g}".format(*known) for known in (SHORE_A_RANGE, SHORE_00_RANGE))
        raise UsageError(f"--shore: {text!r} is not understood; write A30 (Shore A, {a}) or 00-30 (Shore 00, {zero})")
    found = modulus_of(hardness)
    low_pa, high_pa = found.young_modulus_range_pa
    if as_json:
        document = {
            "hardness": str(hardness),
            "young_modulus_pa": found.young_modulus_pa,
            "poisson_ratio": NEARLY_INCOMPRESSIBLE,
            "young_modulus_range_pa": found.young_modulus_range_pa,
            "source": found.source,
        }
        terminal.print(json.dumps(document))
        return OK
    e_pa = terminal.paint(pascals(found.young_modulus_pa), "bold")
    terminal.print(f"{hardness}: Young's modulus about {e_pa}, {pascals(low_pa)} to {pascals(high_pa)}")
    terminal.print(f"Poisson's ratio {NEARLY_INCOMPRESSIBLE:g}, as of all elastomers")
    terminal.print(f"source: {found.source}")
    terminal.print(terminal.paint(f"a request may say it as it is: --material '{hardness}'", "dim"))
    return OK
