"""What a body is made of: Young's modulus and Poisson's ratio, given as numbers or by a material's name.

The table holds typical values at room temperature and small strain. Real samples scatter over `young_modulus_range_pa`,
so a robot that has measured its object should send the numbers. Nearly incompressible materials (elastomers, gels) are
entered with ν = 0.49, the largest the models know, although their true value lies above 0.499.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from service.core.errors import MaterialOutOfRange, UnknownMaterial

POISSON_RATIO_MAX = 0.5
"""The incompressible limit; what lies above 0.49 is answered as 0.49 with a flag."""

NEAREST_NAMES = 5
"""How many names an unknown one is answered with."""


@dataclass(frozen=True)
class Material:
    """A homogeneous isotropic material.

    Attributes:
        young_modulus_pa: Young's modulus E, positive.
        poisson_ratio: Poisson's ratio ν in [0, 0.5].
        name: Its name in `MATERIALS`, or None where the numbers came from the request.
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
        source: Publication the values are taken from.
    """

    material: Material
    young_modulus_range_pa: tuple[float, float]
    description: str
    source: str

    @property
    def name(self) -> str:
        """Name under which a request may ask for it."""
        return self.material.name or ""


_CUED = "Cambridge University Engineering Department, Materials Data Book (2003)"
_CUED_FOAM = f"{_CUED}; Poisson's ratio: Gibson & Ashby, Cellular Solids (1997)"
_GENT = "Shore A hardness by Gent, Rubber Chem. Technol. 31 (1958) 896-906"
_SMOOTH_ON = "100 % modulus {} kPa of the maker's data sheet (Smooth-On), E = 3 σ / (λ - λ⁻²) at λ = 2 (neo-Hookean)"


def _entry(
    name: str, e_pa: float, nu: float, range_pa: tuple[float, float], description: str, source: str
) -> tuple[str, MaterialEntry]:
    return name, MaterialEntry(Material(e_pa, nu, name), range_pa, description, source)


def young_modulus_from_shore_a(hardness: float) -> float:
    """Young's modulus in Pa of an elastomer of a Shore A hardness in [0, 100).

    Source: Gent, Rubber Chem. Technol. 31 (1958) 896: E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S)) MPa.
    """
    return 1e6 * 0.0981 * (56.0 + 7.62336 * hardness) / (0.137505 * (254.0 - 2.54 * hardness))


def _shore_a(name: str, hardness: float, description: str) -> tuple[str, MaterialEntry]:
    # Hardness is specified to within 5 points in trade.
    e_pa, low_pa, high_pa = (
        float(f"{young_modulus_from_shore_a(hardness + offset):.3g}") for offset in (0.0, -5.0, 5.0)
    )
    return _entry(name, e_pa, 0.49, (low_pa, high_pa), description, _GENT)


MATERIALS: Mapping[str, MaterialEntry] = MappingProxyType(
    dict(
        (
            # Foams: Poisson's ratio of about 1/3 whatever the density.
            _entry("foam_very_soft", 6e5, 0.3, (3e5, 1e6), "flexible polymer foam, very low density", _CUED_FOAM),
            _entry("foam_soft", 2e6, 0.3, (1e6, 3e6), "flexible polymer foam, low density", _CUED_FOAM),
            _entry("foam_firm", 8e6, 0.3, (4e6, 1.2e7), "flexible polymer foam, medium density", _CUED_FOAM),
            _entry("foam_rigid", 5e7, 0.3, (2.3e7, 8e7), "rigid polymer foam, low density", _CUED_FOAM),
            _entry("cork", 3e7, 0.05, (1.3e7, 5e7), "cork", _CUED_FOAM),
            # Silicones
            _entry("ecoflex_00_10", 9.4e4, 0.49, (5.5e4, 1.3e5), "very soft silicone", _SMOOTH_ON.format(55)),
            _entry("ecoflex_00_30", 1.2e5, 0.49, (6.9e4, 1.6e5), "soft silicone of soft robots", _SMOOTH_ON.format(69)),
            _entry("ecoflex_00_50", 1.4e5, 0.49, (8.3e4, 1.8e5), "soft silicone", _SMOOTH_ON.format(83)),
            _entry("dragon_skin_10", 2.6e5, 0.49, (1.5e5, 4e5), "silicone of soft grippers", _SMOOTH_ON.format(151)),
            _entry("dragon_skin_30", 1.0e6, 0.49, (5.9e5, 1.3e6), "firm silicone of soft grippers",
                   _SMOOTH_ON.format(593)),
            _shore_a("silicone_shore_10a", 10.0, "silicone rubber, Shore A 10"),
            _shore_a("silicone_shore_20a", 20.0, "silicone rubber, Shore A 20"),
            _shore_a("silicone_shore_30a", 30.0, "silicone rubber, Shore A 30"),
            _shore_a("silicone_shore_50a", 50.0, "silicone rubber, Shore A 50"),
            _entry("silicone", 1.14e6, 0.49, (2.5e5, 5.5e6), "silicone rubber of medium hardness, Shore A 30", _GENT),
            _entry("pdms", 1.75e6, 0.49, (1.32e6, 2.97e6), "Sylgard 184 silicone, 10:1",
                   "Johnston et al., J. Micromech. Microeng. 24 (2014) 035017"),
            # Rubbers
            _entry("natural_rubber", 2.0e6, 0.49, (1.5e6, 2.5e6), "natural rubber, unfilled", _CUED),
            _entry("neoprene", 1.4e6, 0.49, (7e5, 2e6), "polychloroprene rubber", _CUED),
            _entry("butyl_rubber", 1.5e6, 0.49, (1e6, 2e6), "butyl rubber", _CUED),
            _shore_a("rubber_shore_40a", 40.0, "rubber, Shore A 40"),
            _shore_a("rubber_shore_70a", 70.0, "rubber of tyres and soles, Shore A 70"),
            _entry("eva", 2.5e7, 0.48, (1e7, 4e7), "ethylene vinyl acetate, solid", _CUED),
            # Gels and tissue
            _entry("gelatin_3_percent", 6.0e3, 0.49, (5.3e3, 6.8e3), "gelatin gel, 3 % by mass: a soft jelly",
                   "E = 3 μ, Nguyen et al., Ultrasound Med. Biol. 40 (2014) 168-176"),
            _entry("gelatin_7_percent", 3.07e4, 0.49, (2.5e4, 3.6e4), "gelatin gel, 7 % by mass: a firm jelly",
                   "E = 3 μ, Nguyen et al., Ultrasound Med. Biol. 40 (2014) 168-176"),
            _entry("polyacrylamide_gel", 3.49e4, 0.49, (3.2e4, 3.8e4), "polyacrylamide hydrogel, 10 % / 0.3 % bis",
                   "Tse & Engler, Curr. Protoc. Cell Biol. 47 (2010) 10.16"),
            _entry("muscle", 1.2e4, 0.49, (8e3, 1.7e4), "relaxed skeletal muscle, raw meat across the grain",
                   "Engler et al., Cell 126 (2006) 677-689"),
            # Natural materials
            _entry("leather", 3e8, 0.4, (1e8, 5e8), "leather", _CUED),
            _entry("wood_along_grain", 1.1e10, 0.37, (6e9, 2e10), "wood, loaded along the grain", _CUED),
            _entry("wood_across_grain", 1.2e9, 0.37, (5e8, 3e9), "wood, loaded across the grain", _CUED),
            # Plastics
            _entry("polyethylene", 7.5e8, 0.42, (6.21e8, 8.96e8), "polyethylene: bottles, lids, toys", _CUED),
            _entry("polypropylene", 1.2e9, 0.41, (8.96e8, 1.55e9), "polypropylene: food boxes, cups", _CUED),
            _entry("abs", 2.1e9, 0.39, (1.1e9, 2.9e9), "ABS: bricks, housings, 3D prints", _CUED),
            _entry("pet", 3.0e9, 0.39, (2.76e9, 4.14e9), "PET: drinks bottles, solid", _CUED),
            _entry("acrylic", 3.0e9, 0.39, (2.24e9, 3.8e9), "PMMA, acrylic glass", _CUED),
            # Ceramics and metals
            _entry("glass", 7.0e10, 0.22, (6.8e10, 7.2e10), "soda-lime glass: jars, bottles", _CUED),
            _entry("aluminium", 7.0e10, 0.33, (6.8e10, 8.2e10), "aluminium alloys: cans", _CUED),
            _entry("steel", 2.1e11, 0.29, (2.0e11, 2.15e11), "low-carbon steel", _CUED),
        )
    )
)  # fmt: skip


def material_named(name: str) -> Material:
    """Typical values of a named material; case, spaces, hyphens and underscores do not matter.

    Raises:
        UnknownMaterial: No material of that name; `expected` lists the nearest ones.
    """
    wanted = _normal(name)
    by_normal = {_normal(known): entry for known, entry in MATERIALS.items()}
    if wanted in by_normal:
        return by_normal[wanted].material
    nearest = difflib.get_close_matches(wanted, by_normal, n=NEAREST_NAMES, cutoff=0.0)
    names = [by_normal[key].name for key in nearest]
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
    """Entries whose name or description holds every word, in the order of the table; all of them for no words."""
    wanted = [_normal(word) for word in words.split()]
    return tuple(
        entry
        for entry in MATERIALS.values()
        if all(word in _normal(entry.name) or word in _normal(entry.description) for word in wanted)
    )


def _normal(name: str) -> str:
    return name.strip().lower().replace("-", "_").replace(" ", "_")


def _readable(number: float) -> float | str:
    """JSON has no NaN and no infinity, so a problem document spells them."""
    return number if math.isfinite(number) else str(number)
