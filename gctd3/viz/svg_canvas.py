"""Flat pictures of polygons, lines, discs and words, written as SVG or PNG. Lengths in pixels, y downwards."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

from PIL import Image, ImageDraw, ImageFont

from gctd3.files import write_bytes, write_text

Point = tuple[float, float]
_FINER = 3  # times as many pixels while drawing a PNG, so that edges come out smooth


@dataclass(frozen=True)
class Polygon:
    """Represent a filled polygon, or a straight line if it has two points and no fill."""

    points: tuple[Point, ...]
    fill: str | None
    stroke: str
    width: float = 1.0


@dataclass(frozen=True)
class Disc:
    """Represent a filled circle."""

    centre: Point
    radius: float
    fill: str
    stroke: str
    width: float = 1.5


@dataclass(frozen=True)
class Words:
    """Represent a line of text; ``at`` is its vertical middle and its left end, or its middle if ``centred``."""

    at: Point
    text: str
    size: float
    fill: str
    centred: bool = False


@dataclass(frozen=True)
class Picture:
    """Represent a picture by its shapes, the first at the back.

    Attributes:
        width: Width (pixels).
        height: Height (pixels).
        things: Polygons, discs and lines of text.
    """

    width: int
    height: int
    things: tuple[Polygon | Disc | Words, ...]

    def save(self, path: Path) -> None:
        """Write the picture as a ``.svg`` or a ``.png``."""
        if path.suffix == ".svg":
            write_text(path, self.svg())
        else:
            content = io.BytesIO()
            self.image().save(content, format="PNG")
            write_bytes(path, content.getvalue())

    def svg(self) -> str:
        """Return the picture as the text of an SVG file."""
        size = f'width="{self.width}" height="{self.height}" viewBox="0 0 {self.width} {self.height}"'
        head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="Helvetica, Arial, sans-serif">'
        return "\n".join([head, '<rect width="100%" height="100%" fill="white"/>', *map(_svg, self.things), "</svg>\n"])

    def image(self) -> Image.Image:
        """Render the picture as pixels."""
        page = Image.new("RGB", (self.width * _FINER, self.height * _FINER), "white")
        pen = ImageDraw.Draw(page)
        for thing in self.things:
            _draw(pen, thing)
        return page.resize((self.width, self.height), Image.Resampling.LANCZOS)


def _svg(thing: Polygon | Disc | Words) -> str:
    if isinstance(thing, Polygon):
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in thing.points)
        fill = thing.fill or "none"
        line = f'stroke="{thing.stroke}" stroke-width="{thing.width:g}" stroke-linejoin="round"'
        return f'<{"polygon" if thing.fill else "polyline"} points="{points}" fill="{fill}" {line}/>'
    if isinstance(thing, Disc):
        (x, y), line = thing.centre, f'stroke="{thing.stroke}" stroke-width="{thing.width:g}"'
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{thing.radius:g}" fill="{thing.fill}" {line}/>'
    x, y = thing.at
    anchor = ' text-anchor="middle"' if thing.centred else ""
    # A baseline a third of the size below the middle centres the letters vertically.
    place = f'x="{x:.1f}" y="{y + 0.35 * thing.size:.1f}" font-size="{thing.size:g}"'
    return f'<text {place} fill="{thing.fill}"{anchor}>{escape(thing.text)}</text>'


def _draw(pen: ImageDraw.ImageDraw, thing: Polygon | Disc | Words) -> None:
    if isinstance(thing, Polygon):
        points = [(x * _FINER, y * _FINER) for x, y in thing.points]
        if thing.fill:
            pen.polygon(points, fill=thing.fill)
            points.append(points[0])
        pen.line(points, fill=thing.stroke, width=max(1, round(thing.width * _FINER)), joint="curve")
    elif isinstance(thing, Disc):
        (x, y), r = thing.centre, thing.radius
        box = ((x - r) * _FINER, (y - r) * _FINER, (x + r) * _FINER, (y + r) * _FINER)
        pen.ellipse(box, fill=thing.fill, outline=thing.stroke, width=round(thing.width * _FINER))
    else:
        at, font = (thing.at[0] * _FINER, thing.at[1] * _FINER), ImageFont.load_default(thing.size * _FINER)
        pen.text(at, thing.text, fill=thing.fill, font=font, anchor="mm" if thing.centred else "lm")
