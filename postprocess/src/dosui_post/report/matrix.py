"""What is run: scene x spacing x integrator x operator x control of the step x ranks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from dosui_post.errors import DosuiPostError
from dosui_post.report.scenes import PROBLEMS, Method, Problem, scene_text

EXPLICIT = Method("explicit", "explicit")
TWO_PASS = Method("explicit, two-pass", "explicit", operator="two_pass")
SCALED = Method("explicit, scaled inertia", "explicit", is_scaled=True)
QUASI_STATIC = Method("quasi-static", "quasi_static")
LINE = Method("quasi-static, 1-D", "quasi_static", is_line=True)
QUASI_STATIC_TWO_PASS = Method("quasi-static, two-pass", "quasi_static", operator="two_pass")
SEMI_IMPLICIT = Method("semi-implicit", "semi_implicit")
SEMI_SCALED = Method("semi-implicit, scaled inertia", "semi_implicit", is_scaled=True)

METHODS = (
    QUASI_STATIC,
    LINE,
    SEMI_IMPLICIT,
    SEMI_SCALED,
    EXPLICIT,
    SCALED,
    TWO_PASS,
    QUASI_STATIC_TWO_PASS,
)
"""In the order of lines and tables."""

_COURANT = "courant = 0.5"
_TOLERANCES = tuple(f"relative_tolerance = {rtol}" for rtol in ("1e-3", "1e-4", "1e-5"))


@dataclass(frozen=True)
class Job:
    """One run."""

    problem: Problem
    method: Method
    spacing: float
    """[m]"""
    control: str
    """keys of &time"""
    ranks: int = 1

    @property
    def is_estimate(self) -> bool:
        """Too long to be run: only its steps are asked for."""
        is_unscaled = self.method.is_explicit and not self.method.is_scaled
        return is_unscaled and self.problem.is_stiff

    @property
    def label(self) -> str:
        """One line, for people and for --only."""
        ranks = f"{self.ranks} rank" + ("s" if self.ranks > 1 else "")
        name, method = self.problem.name, self.method.name
        return f"{name}: {method}, dx = {self.spacing:g} m, {self.control}, {ranks}"

    def text(self) -> str:
        """The namelist."""
        return scene_text(self.problem, self.method, self.spacing, self.control)


def quick_matrix() -> list[Job]:
    """A few minutes on two cores; Terzaghi and Mandel."""
    jobs: list[Job] = []
    for name, spacings in {"terzaghi": (0.125, 0.05, 0.025), "mandel": (0.04, 0.02, 0.01)}.items():
        soft, stiff = PROBLEMS[name], PROBLEMS[f"{name}-stiff"]
        fine = (*spacings, 0.5 * spacings[-1])
        for method in (EXPLICIT, TWO_PASS):
            jobs += [Job(soft, method, dx, _COURANT) for dx in spacings]
        for method in (SCALED, SEMI_SCALED):
            jobs += [Job(soft, method, dx, _COURANT) for dx in fine]
        jobs += [Job(soft, SEMI_IMPLICIT, dx, _COURANT) for dx in spacings[:2]]
        jobs.append(Job(soft, SCALED, spacings[-1], _COURANT, 2))
        jobs += [Job(stiff, EXPLICIT, dx, _COURANT) for dx in spacings]
        jobs += [Job(stiff, SCALED, dx, _COURANT) for dx in spacings[:2]]
        jobs += [Job(stiff, SEMI_SCALED, dx, _COURANT) for dx in fine]
        for problem in (soft, stiff):
            jobs += _cross(problem, QUASI_STATIC, fine, _TOLERANCES, (1,))
            jobs += _cross(problem, QUASI_STATIC_TWO_PASS, spacings[1:2], _TOLERANCES[1:2], (1,))
            jobs += _cross(problem, QUASI_STATIC, fine[-1:], _TOLERANCES[1:2], (2,))
            if name == "terzaghi":
                jobs += _cross(problem, LINE, fine, _TOLERANCES, (1,))
    return jobs


def full_matrix() -> list[Job]:
    """Hours: finer spacings, the drainage, other Courant numbers, one and two ranks."""
    jobs: list[Job] = []
    ladders = {
        "terzaghi": (0.125, 0.05, 0.025, 0.0125),
        "mandel": (0.04, 0.02, 0.01, 0.005),
        "drainage": (0.1, 0.05, 0.025, 0.0125),
    }
    courants = ("courant = 0.9", _COURANT, "courant = 0.25")
    for name, spacings in ladders.items():
        soft, stiff = PROBLEMS[name], PROBLEMS.get(f"{name}-stiff")
        fine = (*spacings, 0.5 * spacings[-1])
        for method in (EXPLICIT, TWO_PASS, SCALED, SEMI_IMPLICIT, SEMI_SCALED):
            if method.is_scaled and soft.soil.is_rigid:
                continue  # no inertia to scale
            jobs += _cross(soft, method, spacings, courants, (1,))
            jobs += _cross(soft, method, spacings[-1:], (_COURANT,), (2,))
        for problem in (soft, stiff):
            if problem is None:
                continue
            jobs += _cross(problem, QUASI_STATIC, fine, _TOLERANCES, (1, 2))
            if name == "terzaghi":
                jobs += _cross(problem, LINE, fine, _TOLERANCES, (1,))
            jobs += _cross(problem, QUASI_STATIC_TWO_PASS, spacings, _TOLERANCES, (1,))
        if stiff is not None:
            jobs += _cross(stiff, EXPLICIT, spacings, (_COURANT,), (1,))
            jobs += _cross(stiff, SCALED, spacings[:3], (_COURANT,), (1,))
            jobs += _cross(stiff, SEMI_SCALED, spacings, courants, (1, 2))
    return jobs


def selected(jobs: Sequence[Job], pattern: str) -> list[Job]:
    """The jobs in whose label a regular expression is found."""
    try:
        wanted = re.compile(pattern, re.IGNORECASE)
    except re.error as error:
        raise DosuiPostError(f"--only: {error} in '{pattern}'") from error
    return [job for job in jobs if wanted.search(job.label)]


def _cross(
    problem: Problem,
    method: Method,
    spacings: Sequence[float],
    controls: Sequence[str],
    ranks: Sequence[int],
) -> list[Job]:
    return [
        Job(problem, method, spacing, control, count)
        for count in ranks
        for spacing in spacings
        for control in controls
    ]
