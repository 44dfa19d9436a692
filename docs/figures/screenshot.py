"""Take README's picture of a report, in a real browser: python docs/figures/screenshot.py REPORT PICTURE."""

from __future__ import annotations

import io
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

CHROMIUM = "/usr/bin/chromium"
VIEW = {"width": 1000, "height": 1240}
GAP_PX = 24


def main(report: Path, picture: Path) -> None:
    """Show the verdict on the left, the array and the board positions on the right."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM)
        page = browser.new_page(viewport=VIEW, color_scheme="light")
        page.goto(report.resolve().as_uri())
        left = part(page)
        page.evaluate("document.getElementById('array').scrollIntoView()")
        right = part(page)
        browser.close()
    both = Image.new("RGB", (left.width + GAP_PX + right.width, left.height), "white")
    both.paste(left, (0, 0))
    both.paste(right, (left.width + GAP_PX, 0))
    both.save(picture, optimize=True)


def part(page: Page) -> Image.Image:
    """Return what the window shows."""
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
