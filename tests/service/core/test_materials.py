"""Materials by name and by number."""

from __future__ import annotations

import math

import pytest

from service.core.errors import MaterialOutOfRange, UnknownMaterial
from service.core.materials import (
    MATERIALS,
    Material,
    material,
    material_named,
    search_materials,
)


@pytest.mark.parametrize("entry", MATERIALS.values(), ids=lambda entry: entry.name)
def test_table_entry_is_usable(entry):
    low_pa, high_pa = entry.young_modulus_range_pa
    assert 0.0 < low_pa <= entry.material.young_modulus_pa <= high_pa
    # Named materials must not come back flagged: the models know Poisson's ratios up to 0.49.
    assert 0.0 <= entry.material.poisson_ratio <= 0.49
    assert MATERIALS[entry.name] is entry
    assert material_named(entry.name) == entry.material
    assert entry.description
    assert entry.source


def test_table_has_the_usual_objects_of_a_robot():
    assert len(MATERIALS) >= 25
    for name in ("silicone", "foam_soft", "natural_rubber", "steel", "wood_along_grain", "polypropylene"):
        assert name in MATERIALS


@pytest.mark.parametrize("name", ["Ecoflex 00-30", " ECOFLEX_00_30 ", "ecoflex-00-30"])
def test_spelling_of_a_name_does_not_matter(name):
    assert material_named(name).name == "ecoflex_00_30"


def test_unknown_name_lists_the_nearest():
    with pytest.raises(UnknownMaterial) as caught:
        material_named("silicon")
    assert caught.value.field == "material.name"
    assert caught.value.expected[0] == "silicone"
    assert "silicone" in caught.value.message


def test_unknown_name_like_no_other_still_lists_some():
    with pytest.raises(UnknownMaterial) as caught:
        material_named("ü" * 10_000)
    assert len(caught.value.expected) == 5
    assert len(caught.value.message) < 500


def test_numbers_pass_unchanged():
    assert material(1e5, 0.0) == Material(1e5, 0.0, None)
    # The incompressible limit is not an error: the pipeline clamps and flags it.
    assert material(1e5, 0.5).poisson_ratio == 0.5


@pytest.mark.parametrize("young_modulus_pa", [0.0, -1.0, math.nan, math.inf, -math.inf])
def test_bad_young_modulus(young_modulus_pa):
    with pytest.raises(MaterialOutOfRange) as caught:
        material(young_modulus_pa, 0.3)
    assert caught.value.field == "material.young_modulus_pa"
    assert isinstance(caught.value.actual, str) or math.isfinite(caught.value.actual)


@pytest.mark.parametrize("poisson_ratio", [-1e-9, 0.5000001, math.nan, math.inf])
def test_bad_poisson_ratio(poisson_ratio):
    with pytest.raises(MaterialOutOfRange) as caught:
        material(1e5, poisson_ratio)
    assert caught.value.field == "material.poisson_ratio"


@pytest.mark.parametrize(
    ("category", "fewest"),
    [("foam", 10), ("silicone", 20), ("rubber", 8), ("gel", 6), ("food", 12), ("tissue", 12), ("plastic", 12),
     ("wood", 6), ("textile", 5), ("metal", 8)],
)  # fmt: skip
def test_there_are_materials_of_every_kind(category, fewest):
    of_kind = [entry for entry in MATERIALS.values() if entry.category == category]
    assert len(of_kind) >= fewest
    assert {entry.name for entry in of_kind} <= {entry.name for entry in search_materials(category)}
    moduli = [entry.material.young_modulus_pa for entry in of_kind]
    assert moduli == sorted(moduli)


def test_what_was_not_looked_up_says_so():
    unchecked = [entry for entry in MATERIALS.values() if not entry.checked]
    assert all(
        entry.source.endswith("(cited from memory, not looked up)") or entry.source.startswith("estimate: ")
        for entry in unchecked
    )
    # Honest, and still mostly looked up.
    assert 0 < len(unchecked) < 0.2 * len(MATERIALS)
    assert not any("looked up" in entry.source for entry in MATERIALS.values() if entry.checked)


@pytest.mark.parametrize(
    ("name", "young_modulus_pa", "rel"),
    [
        # Of Johnston et al. 2014: 1.32 to 2.97 MPa; of Nguyen et al. 2014: 3 × 2.01 kPa and 3 × 10.24 kPa.
        ("pdms", 2.0e6, 0.35), ("gelatin_3_percent", 3 * 2.01e3, 0.01), ("gelatin_7_percent", 3 * 10.24e3, 0.01),
        # Of Dawood et al. 2026 in compression; of Dowling's table 5.2.
        ("ecoflex_00_30", 103.46e3, 0.01), ("polycarbonate", 2.4e9, 0.0), ("steel", 212e9, 0.01),
    ],
)  # fmt: skip
def test_published_values(name, young_modulus_pa, rel):
    assert material_named(name).young_modulus_pa == pytest.approx(young_modulus_pa, rel=rel)


@pytest.mark.parametrize("name", ["Shore A 30", "shore_a_30", "SHORE 30A"])
def test_a_hardness_is_a_name(name):
    found = material_named(name)
    assert found.young_modulus_pa == pytest.approx(1.14e6, rel=0.01)
    assert (found.poisson_ratio, found.name) == (0.49, "Shore A 30")


def test_a_hardness_that_no_relation_covers_is_refused():
    with pytest.raises(MaterialOutOfRange) as caught:
        material_named("shore a 98")
    assert caught.value.field == "material.name"
    assert caught.value.expected == "10 to 90"


def test_search_wants_every_word():
    names = {entry.name for entry in search_materials("soft SILICONE")}
    assert "ecoflex_00_30" in names
    assert all("foam" not in name for name in names)
    assert len(search_materials("")) == len(MATERIALS)
    assert search_materials("no such thing") == ()


