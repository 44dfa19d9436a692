"""What a rig is: its description, its board, the signals its buzzers play, and the session file it records."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("acoustic-camera-rig")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0.0.0"
