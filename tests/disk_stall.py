"""A disk that stalls: a library, preloaded into a program, whose next write to a file waits."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

_SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/types.h>
#include <unistd.h>

typedef ssize_t (*write_at)(int, const void *, size_t, off_t);

static void stall(void)
{
    const char *wish = getenv("DISK_STALL_WISH");
    if (wish && unlink(wish) == 0)
        usleep(1000000 * atoi(getenv("DISK_STALL_S")));
}

ssize_t pwrite(int file, const void *bytes, size_t count, off_t offset)
{
    stall();
    return ((write_at)dlsym(RTLD_NEXT, "pwrite"))(file, bytes, count, offset);
}

ssize_t pwrite64(int file, const void *bytes, size_t count, off_t offset)
{
    stall();
    return ((write_at)dlsym(RTLD_NEXT, "pwrite64"))(file, bytes, count, offset);
}
"""


def stalling_disk(folder: Path, wish: Path, duration_s: int) -> dict[str, str]:
    """Build the library and return the environment of a program whose next write stalls whenever `wish` is made."""
    library = folder / "stall.so"
    command = ["gcc", "-shared", "-fPIC", "-x", "c", "-o", str(library), "-"]
    subprocess.run(command, input=_SOURCE, text=True, check=True)
    stall = {"LD_PRELOAD": str(library), "DISK_STALL_WISH": str(wish), "DISK_STALL_S": str(duration_s)}
    return dict(os.environ) | stall
