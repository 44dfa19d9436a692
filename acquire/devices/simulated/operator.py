"""The simulated operator: does at once what it is asked, and never tires."""

from __future__ import annotations

from acquire.devices.simulated.stage import Stage


class SimulatedOperator:
    """Moves the board of a stage."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage

    def ask_for_pose(self, pose: int) -> None:
        """Ask for a board position, counted from 0; returns at once, the board is there some 1.3 s later."""
        self._stage.ask_for_pose(pose)
