"""Make a verification's picture small enough for README: `make figures`, after `make demo`."""

from __future__ import annotations

import sys

import cv2


def main(picture: str, small: str) -> None:
    """Write three quarters of the picture's size as JPEG."""
    overlay = cv2.imread(picture)
    if overlay is None:
        sys.exit(f"{picture}: no such picture: run rig-verify first")
    size = (overlay.shape[1] * 3 // 4, overlay.shape[0] * 3 // 4)
    cv2.imwrite(small, cv2.resize(overlay, size, interpolation=cv2.INTER_AREA), [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main(*sys.argv[1:])
