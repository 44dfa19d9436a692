"""Runs `rig-capture` again and again, each in a child that is killed; started with the shim preloaded.

Reads one JSON object per line: {"arguments": [...], "at_write": n or 0, "after_s": seconds or 0, "output": file};
answers each with {"samples": recorded, "writes": done, "duration_s": ..., "exit": exit code, or minus the signal}.
"""

import ctypes
import json
import mmap
import os
import signal
import struct
import sys
import time

import cv2

import acquire.capture
import acquire.devices.simulated.rig  # noqa: F401 - so that the children find it loaded
from acquire.cli import main
from rigs.session.writer import SessionWriter

_MANY = 10**9
cv2.setNumThreads(1)  # a forked child has no threads to wait for
shim = ctypes.CDLL(None)
shim.shim_kill_at.argtypes = [ctypes.c_long]
shim.shim_writes_left.restype = ctypes.c_long
shared = mmap.mmap(-1, 16)
append_audio = SessionWriter.append_audio


def counted(writer, samples, **fields):
    first = append_audio(writer, samples, **fields)
    shared[:8] = struct.pack("<q", writer.n_samples)
    return first


def capture(task):
    output = os.open(task["output"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w", buffering=1), os.fdopen(2, "w", buffering=1)
    sys.argv = ["rig-capture", *task["arguments"]]
    shim.shim_kill_at(task["at_write"] or _MANY)
    code = 1
    try:
        main()
    except SystemExit as end:
        code = end.code or 0
    finally:
        shared[8:] = struct.pack("<q", _MANY - shim.shim_writes_left())
        sys.stdout.flush()
        os._exit(code)


SessionWriter.append_audio = counted
for line in sys.stdin:
    job = json.loads(line)
    shared[:] = bytes(16)
    began_s = time.monotonic()
    child = os.fork()
    if child == 0:
        capture(job)
    if job["after_s"]:
        time.sleep(job["after_s"])
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    n_samples, n_writes = struct.unpack("<qq", shared[:])
    answer = {"samples": n_samples, "writes": n_writes, "exit": os.waitstatus_to_exitcode(status)}
    sys.stdout.write(json.dumps(answer | {"duration_s": time.monotonic() - began_s}) + "\n")
    sys.stdout.flush()
