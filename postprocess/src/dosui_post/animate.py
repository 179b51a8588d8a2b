"""Animated GIFs."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from dosui_post.errors import DosuiPostError
from dosui_post.plot import (
    box_of,
    column_of,
    constants_text,
    draw_isochrones,
    draw_map,
    field_values,
    limits_of,
)
from dosui_post.result import Result
from dosui_post.style import caption, house_style, new_figure
from dosui_post.units import number

_DPI = 110
_LAST_FRAME_SECONDS = 1.5
_ALMOST_WHITE = 244


def animate_map(
    result: Result,
    output: Path,
    name: str = "pore_pressure",
    component: str | None = None,
    every: int = 1,
    frames_per_second: float = 8.0,
) -> Path:
    """A field on the particles through all steps, with colours that keep their meaning."""
    steps = _steps(result, every)
    limits = limits_of([field_values(result, name, component, step) for step in steps])
    box = box_of(result, steps)

    def frame(step: int) -> Figure:
        return draw_map(result, name, component, step, limits, box)

    return _write(frame, steps, output, frames_per_second)


def animate_isochrones(
    result: Result, output: Path, every: int = 1, frames_per_second: float = 8.0
) -> Path:
    """The isochrone moving through all steps after t = 0, exact and computed."""
    case = column_of(result)
    steps = [step for step in _steps(result, every) if result.times[step] > 0]
    if not steps:
        raise DosuiPostError(f"{result.path} has no output step after t = 0")

    def frame(step: int) -> Figure:
        figure, axes = new_figure(4.6, 5.0)
        draw_isochrones(axes, result, case, [step], with_labels=False)
        factor = case.time_factor(float(result.times[step]))
        caption(figure, f"{case.title}: T = {number(factor)}", constants_text(case, result))
        return figure

    return _write(frame, steps, output, frames_per_second)


def _steps(result: Result, every: int) -> list[int]:
    """Every n-th step and the last."""
    if every < 1:
        raise DosuiPostError("every must be 1 or more")
    return sorted({*range(0, result.n_steps, every), result.n_steps - 1})


def _write(
    frame: Callable[[int], Figure], steps: list[int], output: Path, frames_per_second: float
) -> Path:
    if not 0 < frames_per_second <= 50:
        raise DosuiPostError("frames per second must be between 0 and 50")
    if output.suffix.lower() != ".gif":
        raise DosuiPostError(f"an animation is a GIF: {output} must end in .gif")
    with house_style():
        images = [_image(frame(step)) for step in steps]
    # One palette for all frames, else colours flicker. The busiest frame has the most colours.
    busiest = max(images, key=lambda image: len(image.getcolors(image.width * image.height) or []))
    palette = _palette(busiest)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = [round(1000 / frames_per_second)] * len(images)
    durations[-1] = max(durations[-1], round(1000 * _LAST_FRAME_SECONDS))
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        images[0].save(
            output,
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            disposal=1,
        )
    except OSError as error:
        raise DosuiPostError(f"cannot write {output}: {error}") from error
    return output


def _palette(image: Image.Image) -> Image.Image:
    """The 256 best colours of an image; what is almost white is white, for a clean background."""
    colours = image.quantize(256, dither=Image.Dither.NONE).getpalette("RGB") or []
    triples = [colours[k : k + 3] for k in range(0, len(colours), 3)]
    clean = [[255] * 3 if min(triple) > _ALMOST_WHITE else triple for triple in triples]
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for triple in clean for value in triple])
    return palette


def _image(figure: Figure) -> Image.Image:
    memory = BytesIO()
    figure.savefig(memory, format="png", dpi=_DPI)
    memory.seek(0)
    return Image.open(memory).convert("RGB")
