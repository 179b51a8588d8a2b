"""What a hard case is: a scene for each method, and what its result must fulfil."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dosui_post.result import Result


@dataclass(frozen=True)
class Method:
    """How the equations are solved."""

    name: str
    integrator: str
    is_two_pass: bool = False
    """the published recipe: two first derivatives, FLIP, no means over cells"""

    @property
    def has_inertia(self) -> bool:
        """Tells whether waves of the skeleton are computed."""
        return self.integrator != "quasi_static"


METHODS = (
    Method("explicit", "explicit"),
    Method("semi-implicit", "semi_implicit"),
    Method("quasi-static", "quasi_static"),
    Method("two-pass", "explicit", is_two_pass=True),
)


@dataclass(frozen=True)
class Quantity:
    """A measured value and the largest that is allowed."""

    name: str
    value: float
    limit: float

    @property
    def holds(self) -> bool:
        """NaN does not."""
        return bool(abs(self.value) <= self.limit)


@dataclass(frozen=True)
class Evidence:
    """What a run left behind, with the same scene on one rank if the case compares ranks."""

    result: Result
    serial: Result | None = None


@dataclass(frozen=True)
class Case:
    """One row of the record."""

    name: str
    title: str
    must: str
    """what must hold, in words"""
    scene: Callable[[Method], str | None]
    """the namelist; None where the method has no meaning"""
    check: Callable[[Evidence], Sequence[Quantity]]
    ranks: int = 1
    limit: float = 60.0
    """of wall time [s]"""


HELD, FAILED, STOPPED, REFUSED, SLOW = "held", "failed", "stopped", "refused", "too slow"
NOT_MEANT = "not meant"


@dataclass(frozen=True)
class Verdict:
    """How a case ended with a method."""

    case: str
    method: str
    state: str
    quantities: tuple[Quantity, ...] = ()
    message: str = ""
    wall: float = 0.0
    """[s]"""

    @property
    def worst(self) -> Quantity | None:
        """The quantity nearest to its limit, or farthest beyond."""
        if not self.quantities:
            return None

        def size(quantity: Quantity) -> float:
            if math.isnan(quantity.value):
                return math.inf
            if quantity.limit == 0.0:
                return 0.0 if quantity.value == 0.0 else math.inf
            return abs(quantity.value) / quantity.limit

        return max(self.quantities, key=size)
