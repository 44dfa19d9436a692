"""The bench's plugs: board, camera and sound can be pulled out and put back while it runs."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from simboard import SimulatedBoard, running_board

from virtual_bench.loudspeaker import Loudspeaker
from virtual_bench.mjpeg import MjpegServer
from virtual_bench.pins import PinTrace
from virtual_bench.pulse import PulseServer

PORT_LINK = "board"  # in the bench's folder: a board that comes back has another pseudo-terminal


class BoardPlug:
    """The board at the end of a cable: pulled out it has no power, put back it starts anew.

    Parameters
    ----------
    folder : Path
        Where the link to its port goes.
    """

    def __init__(self, folder: Path) -> None:
        self.port = folder / PORT_LINK
        self._running, self._board, self._trace = ExitStack(), None, None
        self.put_in()

    def __enter__(self) -> BoardPlug:
        return self

    def __exit__(self, *_: object) -> None:
        self.pull_out()

    def put_in(self) -> None:
        """Start the board and link its port."""
        board = self._running.enter_context(running_board(may_be_killed=True))
        self._board: SimulatedBoard | None = board
        self._trace: PinTrace | None = PinTrace(board.trace_path)
        self._running.callback(self._trace.close)
        self.port.unlink(missing_ok=True)
        self.port.symlink_to(board.port)

    def pull_out(self) -> None:
        """End the board; harmless where there is none."""
        self.port.unlink(missing_ok=True)
        self._board = self._trace = None
        self._running.close()

    def is_in(self) -> bool:
        """Tell whether there is a board, dead or alive."""
        return self._board is not None

    def has_died(self) -> bool:
        """Tell whether somebody killed it."""
        return self._board is not None and self._board.process.poll() is not None

    def new_edges(self) -> list:
        """Return what the pins did since the last call."""
        return self._trace.new_edges() if self._trace else []


class Plugs:
    """All of them, each by the letter that is typed for it.

    Parameters
    ----------
    board : BoardPlug
    camera : MjpegServer
    sound : PulseServer
    loudspeaker : Loudspeaker
    """

    def __init__(self, board: BoardPlug, camera: MjpegServer, sound: PulseServer, loudspeaker: Loudspeaker) -> None:
        self.board, self._camera, self._sound, self._loudspeaker = board, camera, sound, loudspeaker

    def toggle(self, letter: str) -> str:
        """Pull out what is in, or put back what is out: "b", "c" or "s"; return what was done, in words."""
        toggles = {"b": self._toggle_board, "c": self._toggle_camera, "s": self._toggle_sound}
        if letter not in toggles:
            return "b: board, c: camera, s: sound, out or back in; Ctrl-C: end"
        return toggles[letter]()

    def fault(self) -> str | None:
        """Say in words what was killed and makes the bench useless; None while all is well."""
        if self._sound.daemon.poll() is not None:
            return "the bench's PulseAudio has ended"
        return "the bench's pacat has ended" if self._loudspeaker.has_ended() else None

    def _toggle_board(self) -> str:
        if self.board.is_in():
            self.board.pull_out()
            return "board pulled out"
        self.board.put_in()
        return "board put back"

    def _toggle_camera(self) -> str:
        if self._camera.is_up():
            self._camera.drop()
            return "camera pulled out"
        self._camera.come_back()
        return "camera put back"

    def _toggle_sound(self) -> str:
        if self._loudspeaker.is_paused():
            self._sound.control("suspend-sink", self._sound.sink, "0")
            self._loudspeaker.go_on()
            return "sound put back"
        self._loudspeaker.pause()
        self._sound.control("suspend-sink", self._sound.sink, "1")
        return "sound pulled out"
