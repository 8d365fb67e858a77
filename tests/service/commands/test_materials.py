"""`physnet materials`: listing, searching, hardness."""

from __future__ import annotations

import json

import pytest

from service.__main__ import main
from service.commands.exits import OK, REFUSED, USAGE
from service.core.materials import MATERIALS


def test_all_are_listed_by_kind(capsys):
    assert main(["materials"]) == OK
    lines = capsys.readouterr().out.splitlines()
    kinds = [line for line in lines if not line.startswith(" ")]
    assert kinds == list(dict.fromkeys(entry.category for entry in MATERIALS.values()))
    assert len(lines) == len(MATERIALS) + len(kinds)


def test_a_search_that_finds_several_lists_them(capsys):
    assert main(["materials", "foam", "soft"]) == OK
    told = capsys.readouterr().out
    assert "foam_soft" in told
    assert "steel" not in told
    # Not looked up, and said so.
    assert "~2 MPa" in told


def test_a_search_that_finds_one_tells_all_about_it(capsys):
    assert main(["materials", "pdms_20_1"]) == OK
    told = capsys.readouterr().out
    assert "1 MPa, 800 kPa to 1.2 MPa" in told
    assert "Wang et al." in told


def test_a_search_that_finds_nothing_says_what_to_try(capsys):
    assert main(["materials", "dragonskin"]) == OK
    told = capsys.readouterr().out
    assert "'dragonskin'" in told
    assert "dragon_skin_10" in told


def test_sources_are_listed(capsys):
    assert main(["materials", "gelatin", "--sources"]) == OK
    assert capsys.readouterr().out.count("Nguyen et al.") == 5


def test_a_program_gets_json(capsys):
    assert main(["materials", "--json", "low-carbon", "steel"]) == OK
    (entry,) = json.loads(capsys.readouterr().out)["materials"]
    assert entry["young_modulus_pa"] == 2.1e11
    assert entry["category"] == "metal"
    assert entry["checked"] is True


def test_a_hardness_is_converted(capsys):
    assert main(["materials", "--shore", "A30"]) == OK
    told = capsys.readouterr().out
    assert "Shore A 30: Young's modulus about 1.14 MPa" in told
    assert "Gent" in told
    assert main(["materials", "shore", "A", "30"]) == OK
    assert capsys.readouterr().out == told
    assert main(["materials", "--shore", "00-30", "--json"]) == OK
    document = json.loads(capsys.readouterr().out)
    assert document["young_modulus_pa"] == pytest.approx(103.46e3)
    assert document["young_modulus_range_pa"][0] < document["young_modulus_pa"]


def test_a_hardness_that_cannot_be_read_or_converted(capsys):
    assert main(["materials", "--shore", "soft"]) == USAGE
    assert "A30" in capsys.readouterr().err
    assert main(["materials", "--shore", "A99"]) == REFUSED
    assert "10 to 90" in capsys.readouterr().err
