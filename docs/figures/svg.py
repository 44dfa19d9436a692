"""Line drawings as SVG, in millimetres on the sheet."""

from __future__ import annotations

from html import escape
from pathlib import Path

INK, GRAY, SOUND, GREEN, BLUE, PALE = "#1f2937", "#6b7280", "#c2410c", "#15803d", "#1d4ed8", "#e5e7eb"


class Drawing:
    """A sheet to draw on; x to the right, y down."""

    def __init__(self, width_mm: float, height_mm: float, title: str) -> None:
        self._size, self._title = (width_mm, height_mm), title
        self._parts: list[str] = [f'<rect width="{width_mm}" height="{height_mm}" fill="#ffffff"/>']

    def line(
        self, x1: float, y1: float, x2: float, y2: float, ink: str = INK, width: float = 0.4, dash: str = ""
    ) -> None:
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<line x1="{x1:.2f}" y1="{y1:.2f}" x2="{x2:.2f}" y2="{y2:.2f}" stroke="{ink}" '
            f'stroke-width="{width}"{dashes}/>'
        )

    def rect(
        self, x: float, y: float, width: float, height: float, fill: str = "none", ink: str = INK, line: float = 0.4,
        turn_deg: float = 0.0,
    ) -> None:  # fmt: skip
        turn = f' transform="rotate({turn_deg} {x + width / 2:.2f} {y + height / 2:.2f})"' if turn_deg else ""
        self._parts.append(
            f'<rect x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" fill="{fill}" stroke="{ink}" '
            f'stroke-width="{line}"{turn}/>'
        )

    def circle(self, x: float, y: float, radius: float, fill: str = "none", ink: str = INK, line: float = 0.4) -> None:
        self._parts.append(
            f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{radius}" fill="{fill}" stroke="{ink}" stroke-width="{line}"/>'
        )

    def polygon(self, points: list[tuple[float, float]], fill: str = "none", ink: str = INK, line: float = 0.4) -> None:
        places = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
        self._parts.append(f'<polygon points="{places}" fill="{fill}" stroke="{ink}" stroke-width="{line}"/>')

    def text(
        self, x: float, y: float, words: str, size: float = 4.0, ink: str = INK, anchor: str = "start", *,
        bold: bool = False,
    ) -> None:  # fmt: skip
        weight = ' font-weight="bold"' if bold else ""
        self._parts.append(
            f'<text x="{x:.2f}" y="{y:.2f}" font-size="{size}" fill="{ink}" text-anchor="{anchor}"{weight}>'
            f"{escape(words)}</text>"
        )

    def arrow(self, x1: float, y1: float, x2: float, y2: float, ink: str = INK, width: float = 0.4) -> None:
        """Draw a line with a head at its end."""
        self.line(x1, y1, x2, y2, ink, width)
        length = max(((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5, 1e-9)
        ux, uy = (x2 - x1) / length, (y2 - y1) / length
        wings = [(x2 - 2.4 * ux - side * 0.9 * uy, y2 - 2.4 * uy + side * 0.9 * ux) for side in (-1, 1)]
        self.polygon([(x2, y2), *wings], fill=ink, ink=ink, line=0.1)

    def size(self, x1: float, y1: float, x2: float, y2: float, words: str, ink: str = GRAY) -> None:
        """Draw a dimension line, its words at the middle: above a level one, to the right of an upright one."""
        middle = ((x1 + x2) / 2, (y1 + y2) / 2)
        self.arrow(*middle, x1, y1, ink, 0.3)
        self.arrow(*middle, x2, y2, ink, 0.3)
        if abs(x2 - x1) > abs(y2 - y1):
            self.text(middle[0], middle[1] - 1.5, words, 3.6, ink, "middle")
        else:
            self.text(middle[0] + 1.8, middle[1] + 1.2, words, 3.6, ink)

    def save(self, path: Path) -> None:
        """Write the drawing; on paper it has the size that its millimetres say."""
        width, height = self._size
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
            f'viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif" role="img">'
            f"<title>{escape(self._title)}</title>"
        )
        path.write_text("\n".join([head, *self._parts, "</svg>"]) + "\n", encoding="utf-8")
