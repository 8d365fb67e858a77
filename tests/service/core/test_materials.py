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
    young_modulus_from_shore_a,
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


def test_search_wants_every_word():
    names = {entry.name for entry in search_materials("soft SILICONE")}
    assert "ecoflex_00_30" in names
    assert all("foam" not in name for name in names)
    assert len(search_materials("")) == len(MATERIALS)
    assert search_materials("no such thing") == ()


def test_shore_hardness_of_an_ordinary_rubber():
    # Gent's own example: about 1.1 MPa at Shore A 30 and 5.5 MPa at 70.
    assert young_modulus_from_shore_a(30.0) == pytest.approx(1.14e6, rel=0.01)
    assert young_modulus_from_shore_a(70.0) == pytest.approx(5.52e6, rel=0.01)
