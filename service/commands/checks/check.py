"""One thing that was looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

State: TypeAlias = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Check:
    """What was found.

    Attributes:
        name: What was looked at.
        state: `ok`; `warn`: it works, but not as well as it could; `fail`: it does not work.
        found: What there is.
        mend: What to do about it; empty where nothing is to be done.
    """

    name: str
    state: State
    found: str
    mend: str = ""
