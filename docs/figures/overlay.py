"""Make the verification's picture of a pose small enough for a page: `make demo figures`."""

from __future__ import annotations

from pathlib import Path

import cv2

OVERLAY, SHRUNK = Path("demo.verify/pose-010.png"), Path("docs/figures/verify.jpg")


def main() -> None:
    """Write a JPEG of three quarters of the size."""
    picture = cv2.imread(str(OVERLAY))
    size = (picture.shape[1] * 3 // 4, picture.shape[0] * 3 // 4)
    cv2.imwrite(str(SHRUNK), cv2.resize(picture, size, interpolation=cv2.INTER_AREA), [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
