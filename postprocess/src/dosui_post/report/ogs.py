"""OpenGeoSys on the same problems."""

from __future__ import annotations

from collections.abc import Callable

from dosui_post.report.store import Run, Store


def measure_all(
    program: str | None, is_quick: bool, only: str, store: Store, tell: Callable[[str], None]
) -> list[Run]:
    """Placeholder."""
    return []
