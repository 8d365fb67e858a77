"""From Shore hardness, which data sheets give, to Young's modulus, which elasticity wants.

A durometer presses a small indenter into the rubber with a spring and reads how far it does not go in. That depth
depends on Young's modulus, but also on friction, on how long one waits and on how the rubber stiffens: the answer is
good to a factor of about two, and `young_modulus_range_pa` says so. A tensile test is always better.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from service.core.errors import MaterialOutOfRange

TOLERANCE = 5.0
"""Points by which trade specifies hardness."""

SHORE_A_RANGE = (10.0, 90.0)
"""Hardness that is converted. Below about 20 a type 00 durometer tells more, above 80 a type D."""

SHORE_00_RANGE = (5.0, 55.0)
"""The measured silicones are of 10, 30 and 50 points; a specification's tolerance is granted beyond them."""

_SOFTEST_SILICONE = 0.3
"""Young's modulus of nine silicones of 10 to 44 Shore A in tension up to 20 % is 0.30 to 0.50 of Gent's relation."""

_SHORE_00_PA = ((10.0, 56.27e3), (30.0, 103.46e3), (50.0, 158.80e3))
_TENSION_SHARE = 0.35
"""The same three silicones in tension up to 20 %, against compression: 0.34 to 0.40."""
_SPHERE_SHARE = 1.7
"""What the theory of a rigid sphere pressed into an elastic half-space gives for them: 1.0 to 1.7 times as much."""

_SILICONES = "Marechal et al., Soft Robotics 8 (2021) 284, tensile records"
_GENT = (
    "Gent, Rubber Chem. Technol. 31 (1958) 896: E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S)) MPa; "
    f"lower end: silicones, {_SILICONES}; upper end: 5 points harder, or lg E = 0.0235 S - 0.6403 (Ruess) if more"
)
_DAWOOD = (
    "Ecoflex 00-10, 00-30 and 00-50 in compression, Dawood et al. (2026), interpolated in lg E; "
    f"lower end: the same in tension, {_SILICONES}; upper end: a rigid sphere on an elastic half-space"
)


@dataclass(frozen=True)
class Hardness:
    """A reading of a durometer.

    Attributes:
        scale: `A` or `00`.
        points: 0 to 100.
    """

    scale: str
    points: float

    def __str__(self) -> str:
        return f"Shore {self.scale} {self.points:g}"


@dataclass(frozen=True)
class HardnessModulus:
    """What a hardness says about Young's modulus.

    Attributes:
        young_modulus_pa: The relation's value.
        young_modulus_range_pa: Within which rubbers of that hardness were measured.
        source: Of the relation and of its range.
    """

    young_modulus_pa: float
    young_modulus_range_pa: tuple[float, float]
    source: str


def parse_hardness(text: str) -> Hardness | None:
    """A hardness as people write it: `A30`, `30A`, `Shore A 30`, `00-30`, `shore_00_30`, `OO 30`; else None."""
    plain = re.sub(r"[\s_\-:]+", "", text.strip().lower()).removeprefix("shore")
    points = r"(?P<points>\d{1,3}(?:\.\d+)?)"
    found = re.fullmatch(rf"(?P<scale>a|00|oo){points}", plain) or re.fullmatch(rf"{points}(?P<scale>a|oo)", plain)
    return Hardness("A" if found["scale"] == "a" else "00", float(found["points"])) if found else None


def modulus_of(hardness: Hardness) -> HardnessModulus:
    """Young's modulus of an elastomer of a hardness, with the range in which it may lie.

    Raises:
        MaterialOutOfRange: The hardness lies outside what the relation was measured on.
    """
    low, high = SHORE_A_RANGE if hardness.scale == "A" else SHORE_00_RANGE
    if not low <= hardness.points <= high:
        raise MaterialOutOfRange(
            f"{hardness} is not converted: the relation holds from {low:g} to {high:g} points. "
            "Measure on another scale, or give Young's modulus.",
            field="material.name",
            expected=f"{low:g} to {high:g}",
            actual=hardness.points,
        )
    if hardness.scale == "A":
        e_pa = young_modulus_from_shore_a(hardness.points)
        harder = hardness.points + TOLERANCE
        highest = max(young_modulus_from_shore_a(harder), _ruess(harder))
        return HardnessModulus(e_pa, (_SOFTEST_SILICONE * e_pa, highest), _GENT)
    e_pa = young_modulus_from_shore_00(hardness.points)
    return HardnessModulus(e_pa, (_TENSION_SHARE * e_pa, _SPHERE_SHARE * e_pa), _DAWOOD)


def young_modulus_from_shore_a(points: float) -> float:
    """Young's modulus in Pa of an elastomer of a Shore A hardness in [0, 100).

    Source: Gent, Rubber Chem. Technol. 31 (1958) 896: E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S)) MPa.
    """
    return 1e6 * 0.0981 * (56.0 + 7.62336 * points) / (0.137505 * (254.0 - 2.54 * points))


def young_modulus_from_shore_00(points: float) -> float:
    """Young's modulus in Pa of a very soft silicone of a Shore 00 hardness: piecewise linear in the logarithm.

    Source: Dawood et al., Tissue Phantom Materials Database (2026): 56.27, 103.46 and 158.80 kPa in compression for
    Ecoflex 00-10, 00-30 and 00-50. Beyond them the nearer piece goes on.
    """
    piece = _SHORE_00_PA[:2] if points <= _SHORE_00_PA[1][0] else _SHORE_00_PA[1:]
    (low, low_pa), (high, high_pa) = piece
    share = (points - low) / (high - low)
    return math.exp(math.log(low_pa) + share * math.log(high_pa / low_pa))


def _ruess(points: float) -> float:
    """Young's modulus in Pa by lg E = 0.0235 S - 0.6403 (MPa), which is given for 20 to 80 points; else 0.

    Source: Ruess, as in Larson, Can you estimate modulus from durometer hardness for silicones? (Dow, 2016).
    """
    return float(1e6 * 10.0 ** (0.0235 * points - 0.6403)) if 20.0 <= points <= 80.0 else 0.0
