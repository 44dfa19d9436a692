"""Draw the README's pictures from the demo's own files: `make demo figures`."""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import yaml
from matplotlib.axes import Axes

from calib.camera import View, look
from calib.corners import find_pose_corners
from rigs.board import board_corners_m, project
from rigs.session.reader import Session

SESSION, RESULT, PICTURE = Path("demo.h5"), Path("demo.calib.yaml"), Path("docs/figures/demo.png")
OVERLAY, VERIFIED = Path("demo.verify/pose-010.png"), Path("docs/figures/verify.jpg")
LABEL_OFFSET_M = np.array([0.02, 0.0, 0.0])
CAMERA, SOUND, BOARD = "#444444", "#c2410c", "#94a3b8"


def main() -> None:
    """Draw what the camera saw and what came out."""
    result = yaml.safe_load(RESULT.read_text())
    with Session.open(SESSION) as session:
        description = session.description
        view = look(description.camera, description.board, find_pose_corners(session))
        figure = plt.figure(figsize=(12, 4.6), layout="constrained")
        panels = figure.subplot_mosaic(
            [["seen", "found"]], width_ratios=[1.35, 1], per_subplot_kw={"found": {"projection": "3d"}}
        )
        draw_picture(panels["seen"], session, view, nearest_pose(view))
        draw_array(panels["found"], session, view, result)
    figure.savefig(PICTURE, dpi=95)
    shrink_overlay()


def shrink_overlay() -> None:
    """Make the verification's picture of a pose small enough for a page."""
    picture = cv2.imread(str(OVERLAY))
    size = (picture.shape[1] * 3 // 4, picture.shape[0] * 3 // 4)
    cv2.imwrite(str(VERIFIED), cv2.resize(picture, size, interpolation=cv2.INTER_AREA), [cv2.IMWRITE_JPEG_QUALITY, 85])


def nearest_pose(view: View) -> int:
    """Return the number of the pose nearest to the camera."""
    return int(view.pose[np.argmin([pose.translation_m[2] for pose in view.board_to_camera])])


def draw_picture(axes: Axes, session: Session, view: View, pose: int) -> None:
    """Show one camera frame, the corners and the buzzers as the calibration sees them."""
    board = session.description.board
    frame = int(np.flatnonzero(session.frames["pose"] == pose)[0])
    placed = view.board_to_camera[int(np.flatnonzero(view.pose == pose)[0])]
    corners = project(board_corners_m(board), placed, view.intrinsics)
    buzzers = project(np.array([buzzer.position_m for buzzer in board.buzzers]), placed, view.intrinsics)
    axes.imshow(session.picture(frame), cmap="gray", vmin=0, vmax=255)
    axes.plot(*corners.T, "+", color="#22c55e", markersize=6, label="corners found")
    axes.plot(*buzzers.T, "o", color=SOUND, markersize=11, fillstyle="none", markeredgewidth=1.8, label="buzzers")
    axes.set_axis_off()
    axes.legend(loc="upper right", framealpha=0.9)
    axes.set_title(f"Board position {pose + 1} of {len(view.pose)}, as the simulated camera saw it", fontsize=11)


def draw_array(axes: Axes, session: Session, view: View, result: dict) -> None:
    """Show the microphones found, the camera, and every board position."""
    board = session.description.board
    rim = board_corners_m(board).reshape(board.corners[1], board.corners[0], 3)[[0, 0, -1, -1, 0], [0, -1, -1, 0, 0]]
    for pose in view.board_to_camera:
        axes.plot(*as_drawn(pose.apply(rim)), color=BOARD, linewidth=0.7)
    positions = np.array([mic["position_m"] for mic in result["microphones"]])
    axes.scatter(*as_drawn(positions), color=SOUND, s=28, depthshade=False)
    for mic, position in zip(result["microphones"], positions, strict=True):
        std_mm = 1e3 * np.linalg.norm(mic["std_m"])
        axes.text(*as_drawn(position + LABEL_OFFSET_M), f"{mic['channel']} ±{std_mm:.2f} mm", fontsize=7.5)
    draw_frustum(axes, session, view)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("z, forward (m)")
    axes.set_zlabel("y, down (m)")
    axes.invert_zaxis()
    axes.set_box_aspect(
        [abs(high - low) for low, high in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())], zoom=0.9
    )
    axes.view_init(elev=18, azim=-58)
    axes.tick_params(labelsize=7)
    error_mm = 1e3 * result["evaluation"]["rmse_m"]
    axes.set_title(f"Microphones found, RMSE {error_mm:.2f} mm against the truth", fontsize=11)


def draw_frustum(axes: Axes, session: Session, view: View) -> None:
    """Show what the camera looks at, to 0.25 m."""
    width, height = session.description.camera.size_px
    (fx, fy), (cx, cy) = view.intrinsics.focal_px, view.intrinsics.principal_px
    rays = np.array(
        [((u - cx) / fx, (v - cy) / fy, 1.0) for u, v in ((0, 0), (width, 0), (width, height), (0, height))]
    )
    far = 0.25 * rays
    for corner in far:
        axes.plot(*as_drawn(np.array([np.zeros(3), corner])), color=CAMERA, linewidth=0.9)
    axes.plot(*as_drawn(np.vstack([far, far[:1]])), color=CAMERA, linewidth=0.9)


def as_drawn(points: np.ndarray) -> np.ndarray:
    """Turn camera coordinates into the drawing's: z along the second axis."""
    return np.moveaxis(points[..., [0, 2, 1]], -1, 0)


if __name__ == "__main__":
    main()
