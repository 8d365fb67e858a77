"""What a body is made of: Young's modulus and Poisson's ratio, given as numbers or by a material's name.

`service.core.material_table` holds typical values at room temperature and small strain, `service.core.hardness` those
of elastomers of which only the Shore hardness is known. Real samples scatter over `young_modulus_range_pa`, so a robot
that has measured its object should send the numbers. Nearly incompressible materials (elastomers, gels) are entered
with ν = 0.49, the largest the models know, although their true value lies above 0.499.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from service.core.errors import MaterialOutOfRange, UnknownMaterial
from service.core.hardness import Hardness, modulus_of, parse_hardness
from service.core.material_table import TABLE, Row

POISSON_RATIO_MAX = 0.5
"""The incompressible limit; what lies above 0.49 is answered as 0.49 with a flag."""

NEAREST_NAMES = 5
"""How many names an unknown one is answered with."""

NEARLY_INCOMPRESSIBLE = 0.49
"""Poisson's ratio of elastomers: the largest that the models know."""


@dataclass(frozen=True)
class Material:
    """A homogeneous isotropic material.

    Attributes:
        young_modulus_pa: Young's modulus E, positive.
        poisson_ratio: Poisson's ratio ν in [0, 0.5].
        name: Its name in `MATERIALS` or its hardness, or None where the numbers came from the request.
    """

    young_modulus_pa: float
    poisson_ratio: float
    name: str | None = None


@dataclass(frozen=True)
class MaterialEntry:
    """A named material and where its numbers come from.

    Attributes:
        material: The typical values.
        young_modulus_range_pa: Lowest and highest Young's modulus that is sold or grows under this name.
        description: What it is, in a few words to search in.
        source: Publication the values are taken from, or what else they rest on.
        category: `foam`, `silicone`, `rubber`, `gel`, `food`, `tissue`, `plastic`, `wood`, `textile`, `metal` or
            `mineral`.
        checked: Whether the source was looked up when the entry was made; if not, `source` says so in words.
    """

    material: Material
    young_modulus_range_pa: tuple[float, float]
    description: str
    source: str
    category: str
    checked: bool

    @property
    def name(self) -> str:
        """Name under which a request may ask for it."""
        return self.material.name or ""


def _of_row(category: str, row: Row) -> MaterialEntry:
    return MaterialEntry(
        Material(row.young_modulus_pa, row.poisson_ratio, row.name),
        (row.low_pa, row.high_pa),
        row.description,
        row.source.text,
        category,
        row.source.checked,
    )


def _of_hardness(category: str, name: str, scale_and_points: tuple[str, int], description: str) -> MaterialEntry:
    scale, points = scale_and_points
    hardness = Hardness(scale, float(points))
    found = modulus_of(hardness)
    low_pa, high_pa = (_rounded(bound_pa) for bound_pa in found.young_modulus_range_pa)
    return MaterialEntry(
        Material(_rounded(found.young_modulus_pa), NEARLY_INCOMPRESSIBLE, name),
        (low_pa, high_pa),
        f"{description}, {hardness}",
        found.source,
        category,
        True,
    )


def _rounded(e_pa: float) -> float:
    return float(f"{e_pa:.3g}")


def _by_hardness() -> Iterator[MaterialEntry]:
    for points in (10, 20, 30, 40, 50):
        yield _of_hardness("silicone", f"silicone_shore_00_{points}", ("00", points), "very soft silicone")
    for points in (10, 20, 30, 40, 50, 60, 70):
        yield _of_hardness("silicone", f"silicone_shore_{points}a", ("A", points), "silicone rubber")
    for points, use in ((40, "erasers, hoses"), (50, "seals"), (60, "seals"), (70, "tyres, soles"), (80, "wheels")):
        yield _of_hardness("rubber", f"rubber_shore_{points}a", ("A", points), f"rubber: {use}")
    yield _of_hardness("plastic", "tpu_85a", ("A", 85), "flexible TPU: phone cases, 3D prints")


def _table() -> dict[str, MaterialEntry]:
    entries = [_of_row(category, row) for category, rows in TABLE.items() for row in rows] + list(_by_hardness())
    order = {category: number for number, category in enumerate(TABLE)}
    ranked = sorted(entries, key=lambda entry: (order[entry.category], entry.material.young_modulus_pa))
    return {entry.name: entry for entry in ranked}


MATERIALS: Mapping[str, MaterialEntry] = MappingProxyType(_table())
"""By name, kind after kind, in each of them from soft to stiff."""


def material_named(name: str) -> Material:
    """Typical values of a named material, or of an elastomer by its hardness (`Shore A 30`, `shore_00_30`).

    Case, spaces, hyphens and underscores do not matter.

    Raises:
        UnknownMaterial: No material of that name; `expected` lists the nearest ones.
        MaterialOutOfRange: A hardness that cannot be converted.
    """
    wanted = _normal(name)
    if wanted in _BY_NORMAL:
        return _BY_NORMAL[wanted].material
    hardness = parse_hardness(name[:80]) if wanted.startswith("shore") else None
    if hardness is not None:
        return Material(modulus_of(hardness).young_modulus_pa, NEARLY_INCOMPRESSIBLE, str(hardness))
    nearest = difflib.get_close_matches(wanted, _BY_NORMAL, n=NEAREST_NAMES, cutoff=0.0)
    names = [_BY_NORMAL[key].name for key in nearest]
    raise UnknownMaterial(
        f"No material is named {name[:80]!r}. The nearest names: {', '.join(names)}. "
        "Send `young_modulus_pa` and `poisson_ratio` for any other material.",
        field="material.name",
        expected=names,
        actual=name[:80],
    )


def material(young_modulus_pa: float, poisson_ratio: float) -> Material:
    """A material given by its numbers.

    Args:
        young_modulus_pa: Young's modulus in Pa, finite and positive.
        poisson_ratio: Poisson's ratio in [0, 0.5].

    Raises:
        MaterialOutOfRange: One of the two is NaN, infinite or out of its range.
    """
    if not (math.isfinite(young_modulus_pa) and young_modulus_pa > 0.0):
        raise MaterialOutOfRange(
            "Young's modulus must be a positive number of pascals.",
            field="material.young_modulus_pa",
            expected="finite, > 0",
            actual=_readable(young_modulus_pa),
        )
    if not 0.0 <= poisson_ratio <= POISSON_RATIO_MAX:
        raise MaterialOutOfRange(
            "Poisson's ratio must lie between 0 and 0.5.",
            field="material.poisson_ratio",
            expected="0 to 0.5",
            actual=_readable(poisson_ratio),
        )
    return Material(float(young_modulus_pa), float(poisson_ratio))


def search_materials(words: str = "") -> tuple[MaterialEntry, ...]:
    """Entries whose name, description or category holds every word, in the order of the table; all for no words."""
    wanted = [_normal(word) for word in words.split()]
    return tuple(
        entry
        for entry in MATERIALS.values()
        if all(word in _normal(f"{entry.name} {entry.description} {entry.category}") for word in wanted)
    )


def _normal(name: str) -> str:
    return name.strip().lower().replace("-", "_").replace(" ", "_")


_BY_NORMAL = {_normal(known): entry for known, entry in MATERIALS.items()}


def _readable(number: float) -> float | str:
    """JSON has no NaN and no infinity, so a problem document spells them."""
    return number if math.isfinite(number) else str(number)
