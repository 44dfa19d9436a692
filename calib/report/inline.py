"""Plots as part of the page: their colours are the page's variables, their names theirs alone."""

from __future__ import annotations

import re

from calib.report.plots import COLOURS

_FONT = re.compile(r"font: ([0-9.]+px) [^;\"]*")


def inlined(svg: bytes, name: str, label: str) -> str:
    """Return an SVG file of Matplotlib's as an element of an HTML page.

    Parameters
    ----------
    svg : bytes
    name : str
        Of the plot: goes before every id, since ids must differ within a page.
    label : str
        What it shows, for those who cannot see it; must need no escaping.
    """
    text = svg.decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = _FONT.sub(r"font-size: \1", text)
    for colour, variable in COLOURS.items():
        text = text.replace(colour, f"var({variable})")
    size = re.search(r'viewBox="0 0 ([0-9.]+) ([0-9.]+)"', text)
    assert size is not None
    return re.sub(
        r"<svg[^>]*>",
        f'<svg class="plot" role="img" aria-label="{label}" viewBox="0 0 {size[1]} {size[2]}" '
        'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">',
        text,
        count=1,
    )
