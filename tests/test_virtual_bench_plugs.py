"""The virtual bench's plugs: board, camera and sound are pulled out and put back, and what was killed is told."""

import os
import signal
from types import SimpleNamespace

import pytest
from simboard import Talk
from virtual_bench.mjpeg import mjpeg_server
from virtual_bench.plugs import BoardPlug, Plugs


class Speaker:
    """A loudspeaker and its sound server, of which only the plug counts."""

    def __init__(self):
        self.sink, self.paused, self.said, self.ended = "rig", False, [], None
        self.daemon = SimpleNamespace(poll=lambda: self.ended)

    def control(self, *words):
        self.said.append(words)

    def is_paused(self):
        return self.paused

    def pause(self):
        self.paused = True

    def go_on(self):
        self.paused = False

    def has_ended(self):
        return False


def test_a_board_comes_back_behind_the_same_port(tmp_path):
    with BoardPlug(tmp_path) as plug:
        plug.pull_out()
        assert not os.path.lexists(plug.port)
        assert plug.new_edges() == []
        plug.put_in()
        with Talk(str(plug.port)) as host:
            assert host.restart(plug._board)["reset"] == "external"
        os.kill(plug._board.pid, signal.SIGKILL)
        plug._board.process.wait(timeout=10)
        assert plug.has_died()
    assert not os.path.lexists(plug.port)


def test_letters_pull_out_and_put_back():
    speaker = Speaker()
    with mjpeg_server(lambda _: b"") as camera:
        plugs = Plugs(None, camera, speaker, speaker)
        assert plugs.toggle("c") == "camera pulled out"
        assert not camera.is_up()
        assert plugs.toggle("c") == "camera put back"
        assert camera.is_up()
        assert [plugs.toggle("s"), plugs.toggle("s")] == ["sound pulled out", "sound put back"]
        assert [words[-1] for words in speaker.said] == ["1", "0"]
        assert plugs.toggle("x").startswith("b: board")


@pytest.mark.parametrize(("ended", "fault"), [(None, None), (-9, "the bench's PulseAudio has ended")])
def test_a_killed_sound_server_is_told(ended, fault):
    speaker = Speaker()
    speaker.ended = ended
    assert Plugs(None, None, speaker, speaker).fault() == fault
