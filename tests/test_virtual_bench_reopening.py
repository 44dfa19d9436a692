"""A sound server that stands still in the middle of a session at the virtual bench, with the real stacks."""

import os
import subprocess
import time
from threading import Timer

import numpy as np
from virtual_bench.bench import RIG_FILE, virtual_bench
from virtual_bench.session import BIN, onset_offsets_s

from rigs.library import find_description
from rigs.session.layout import FLAG_GAP
from rigs.session.reader import Session

POSES, GONE_S, LIMIT_S = 3, 4.0, 300.0


def captured_with_a_break(folder):
    """Capture while the sound server stands still for a while after the first emission of the second pose."""
    command = [BIN / "rig-capture", "--session", folder / "s.h5", "--rig", folder / RIG_FILE, "--poses", str(POSES)]
    with virtual_bench(find_description("virtual").description, folder) as bench:
        server = bench.loudspeaker.server
        thaw = Timer(GONE_S, server.thaw)
        environment = os.environ | bench.environment
        with (folder / "said.txt").open("w") as said:
            program = subprocess.Popen(command, stdout=said, stderr=said, env=environment)
        end_s = time.monotonic() + LIMIT_S
        try:
            while program.poll() is None and time.monotonic() < end_s:
                heard = bench.ears.emissions
                if not thaw.ident and heard and heard[-1].place > heard[0].place:
                    server.freeze()
                    thaw.start()
                bench.run_for(0.1)
        finally:
            program.kill()  # harmless after its end
            program.wait(LIMIT_S)
            if thaw.ident:
                thaw.join(LIMIT_S)
    said = (folder / "said.txt").read_text()
    assert program.returncode == 0, said
    return said


def test_after_the_sound_device_was_gone_every_buzzer_is_heard_where_expected(tmp_path):
    said = captured_with_a_break(tmp_path)
    assert "waiting for the sound device" in said
    assert "the sound device is there again" in said
    with Session.open(tmp_path / "s.h5") as session:
        poses, emissions = session.poses, session.emissions
        assert np.count_nonzero(session.audio_blocks["flags"] & FLAG_GAP) == 1, said
        assert poses["accepted"].tolist()[-4:] == [1, 0, 1, 1], said
        assert not poses["accepted"][:-4].any(), said  # on a busy machine the first pose may be taken again
        for pose in poses["pose"][poses["accepted"] == 1]:
            heard = emissions[(emissions["pose"] == pose) & (emissions["accepted"] == 1)]
            assert heard["buzzer"].tolist() == [1, 2, 3, 4, 5, 6], said
        offsets_s = onset_offsets_s(session)
        assert np.abs(offsets_s - np.median(offsets_s)).max() < 0.01, said
