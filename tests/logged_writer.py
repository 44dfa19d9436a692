"""A program that records a session while its sync thread goes one step at a time, so that every run writes the same.

Started with the shim preloaded; arguments: FOLDER N_POSES. After each flush a line in crash.marker tells what is in it.
"""

import ctypes
import json
import sys
from pathlib import Path
from threading import Semaphore

from crash_images import JOURNAL, SESSION, SYNC_BEGINS, SYNC_DONE
from example_sessions import TRUTH, add_frame_and_emission, new_session, samples

from rigs.session import durability

BLOCKS = 5  # a pose
_MANY = 10**6
shim = ctypes.CDLL(None)


class Turns:
    """Lets the sync thread take one step when the writer says so."""

    def __init__(self) -> None:
        self._waiting, self._allowed, self._taken = Semaphore(0), Semaphore(0), Semaphore(0)

    def sync(self, descriptor: int) -> None:
        """Stand in for a slow sync: it begins at one step and is done at the next."""
        file = JOURNAL if Path(f"/proc/self/fd/{descriptor}").readlink().match("*.journal*") else SESSION
        for operation in (SYNC_BEGINS, SYNC_DONE):
            self._waiting.release()
            self._allowed.acquire()
            shim.shim_note(operation, file)
            self._taken.release()

    def give(self) -> None:
        """Let one step happen; something must have been flushed since the last sync began."""
        self._waiting.acquire()
        self._allowed.release()
        self._taken.acquire()

    def end(self) -> None:
        """Let all further steps happen at once."""
        self._allowed.release(_MANY)


def main(folder: Path, n_poses: int) -> None:
    """Record; a file and its journal take four steps to sync, a pose each, and every third pose is flushed."""
    turns = Turns()
    durability.SYNC_INTERVAL_S, durability._sync = 0.0, turns.sync
    writer = new_session(folder / "crash.h5", truth=TRUTH)
    with (folder / "crash.marker").open("wb", buffering=0) as marker:
        for pose in range(n_poses):
            for block in range(BLOCKS):
                writer.append_audio(samples(BLOCKS * pose + block, 1024), host_time_s=pose + 0.1, adc_time_s=0.0)
                if pose and block == 3 * pose % BLOCKS:
                    turns.give()
            add_rest_of_pose(writer, pose)
            if pose % 3 == 0:
                writer.flush()
                marker.write(json.dumps([writer.n_samples, writer.n_frames, pose + 1]).encode())
        turns.end()
        writer._file.settle()  # so that what `close` writes comes after it
        writer.close()


def add_rest_of_pose(writer, pose: int) -> None:
    """Append all of a pose but its sound."""
    add_frame_and_emission(writer, pose, expected_sample=1024 * BLOCKS * pose)
    writer.append_pose(pose=pose, start_host_time_s=pose + 0.2, end_host_time_s=pose + 0.9, accepted=True)
    writer.append_log(float(pose), "info", f"line {pose}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
