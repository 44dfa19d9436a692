"""Names of the report and of its plots, and what each plot shows."""

from __future__ import annotations

REPORT = ".report.html"
LABELS = {
    "array": "Array, camera and boards from above, from the camera, and from the side",
    "coverage": "Corners of the board in the picture, and tilts and distances of the board",
    "residuals": "Residuals by microphone and by buzzer",
    "residuals-by-pose": "Residuals of arrivals and of corners by pose",
    "residuals-by-distance": "Residuals against distance",
    "held-out": "Scatter of noise floor, fitted poses and held-out poses",
}
