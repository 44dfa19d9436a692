"""A network camera: MJPEG over HTTP on loopback, with the faults that network cameras have.

Give pictures some noise, of another seed each: a camera whose pictures are the same for a second counts as frozen.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

_BOUNDARY = "picture"
_SEND_TIMEOUT_S = 2.0  # for a client that is open but reads no more


class MjpegServer(ThreadingHTTPServer):
    """Streams pictures to every client at a frame rate; each stream has a thread of its own.

    Parameters
    ----------
    next_jpeg : callable
        Takes the host monotonic time (s) of the picture and returns its JPEG bytes. Called by several threads where
        there are several clients.
    fps : float
    port : int
        0: any that is free.
    """

    daemon_threads = False  # they end when the server does, and are waited for

    def __init__(self, next_jpeg: Callable[[float], bytes], fps: float, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), _Stream)
        self.next_jpeg, self.fps = next_jpeg, fps
        self.url = f"http://127.0.0.1:{self.server_port}/stream.mjpeg"
        self.sent_s: list[float] = []  # when each picture began to be sent
        self.streams = 0  # how many clients there have been
        self._running, self._sending, self._live, self._flowing = (threading.Event() for _ in range(4))
        self.come_back()
        self._frozen_jpeg = b""
        self._epoch = 0

    def freeze(self) -> None:
        """Send the same picture again and again, as a camera does whose sensor hangs."""
        self._frozen_jpeg = self.next_jpeg(time.monotonic())
        self._live.clear()

    def stall(self) -> None:
        """Keep the connections and send nothing, as a switched-off radio link does."""
        self._sending.clear()

    def hold(self) -> None:
        """Take pictures and keep them back, as a network does that is jammed; they come all at once afterwards."""
        self._flowing.clear()

    def drop(self) -> None:
        """End every connection, and every new one at once, as a camera without power does."""
        self._epoch += 1
        self._running.clear()

    def come_back(self) -> None:
        """End all faults."""
        for event in (self._running, self._sending, self._live, self._flowing):
            event.set()

    def stream(self, send: Callable[[bytes], object]) -> None:
        """Send pictures until the server drops the connection; one that is late is left out."""
        epoch, start_s, number, held = self._epoch, time.monotonic(), 0, b""
        while epoch == self._epoch:
            now_s = time.monotonic()
            number = max(number + 1, int((now_s - start_s) * self.fps))
            time.sleep(max(0.0, start_s + number / self.fps - now_s))
            if self._sending.is_set() and epoch == self._epoch:
                self.sent_s.append(time.monotonic())
                jpeg = self.next_jpeg(self.sent_s[-1]) if self._live.is_set() else self._frozen_jpeg
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                held += head.encode() + jpeg + b"\r\n"
            if held and self._flowing.is_set():
                send(held)
                held = b""

    def is_up(self) -> bool:
        """Tell whether new clients are served."""
        return self._running.is_set()

    def handle_error(self, request: object, client_address: object) -> None:
        """Keep quiet: a client that went away is no fault."""


class _Stream(BaseHTTPRequestHandler):
    server: MjpegServer
    timeout = _SEND_TIMEOUT_S

    def do_GET(self) -> None:
        if not self.server.is_up():
            return
        self.server.streams += 1
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        self.end_headers()
        self.server.stream(self.wfile.write)

    def log_message(self, *_: object) -> None:
        """Keep the tests' output clean."""


@contextmanager
def mjpeg_server(next_jpeg: Callable[[float], bytes], fps: float = 30.0, port: int = 0) -> Iterator[MjpegServer]:
    """Serve pictures at `server.url` until the block ends."""
    with MjpegServer(next_jpeg, fps, port) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.drop()
            server.shutdown()
            thread.join()
