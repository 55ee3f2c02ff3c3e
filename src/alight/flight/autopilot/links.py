"""Links to an autopilot by name: UDP, TCP and serial. Reading has a time-out; a broken link is opened again."""

from __future__ import annotations

import errno
import logging
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Protocol

from alight.records import AlightError, InputError, MissingExtraError, OutputError

log = logging.getLogger(__name__)

_CHUNK = 65_535
_BROKEN = (OSError, ValueError, TypeError)  # the last two: of a socket or a port that another thread has just closed
_ERRORS: Mapping[int, tuple[type[AlightError], str]] = {
    errno.EACCES: (OutputError, "no permission; for a serial port add yourself to its group (dialout)"),
    errno.EPERM: (OutputError, "no permission; name another port"),
    errno.EADDRINUSE: (OutputError, "the port is taken; end the program that uses it, or name another"),
    errno.ECONNREFUSED: (InputError, "nobody answers there; start the autopilot or the bridge first"),
    errno.ENOENT: (InputError, "there is no such host or device"),
}
NAMES = (
    "udp:HOST:PORT (listen, as a companion of a ground station), udpout:HOST:PORT (send to), tcp:HOST:PORT, "
    "serial:DEVICE:BAUD"
)


class Port(Protocol):
    """An open socket or serial port. Methods may raise OSError; `send` raises BlockingIOError instead of waiting."""

    def fileno(self) -> int: ...
    def receive(self) -> list[bytes]: ...  # one entry per datagram or chunk
    def send(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class Link:
    """Sends and receives bytes. A broken link is opened again; until then `broken` holds the reason.

    One thread reads, and only this thread reopens a broken link. So no other thread closes a socket that the reader
    waits on, except by `close` at the end. Any thread may write.

    Args:
        name: name of the link, for messages.
        connect: opens the port, at first and after a break; raises OSError.
        patient: whether a connection that is refused at first is tried again later.
        retry: seconds between attempts to open a broken link.
    """

    def __init__(self, name: str, connect: Callable[[], Port], patient: bool = False, retry: float = 1.0) -> None:
        self.name, self._connect, self._retry = name, connect, retry
        self.broken = ""  # reason why the link is not open now; empty: it is open
        self._again, self._closed = 0.0, False
        self._lock = threading.Lock()  # guards the port against closing and exchange; not held for reading
        self._port: Port | None = None
        try:
            self._port = connect()
        except ConnectionRefusedError as e:
            if not patient:
                raise
            self._wait(e)

    def read(self, timeout: float = 0.0) -> list[bytes]:
        """Return the received bytes, one entry per datagram or chunk; wait for them at most `timeout` seconds."""
        if self.broken and not self._reopened():
            time.sleep(min(timeout, self._retry))
            return []
        port = self._port
        try:
            return port.receive() if port is not None and select.select([port], [], [], timeout)[0] else []
        except _BROKEN as e:
            self._break(e)
            self._let_go()
            return []

    def write(self, data: bytes) -> bool:
        """Send bytes; return False if the link is broken or full and the bytes are lost (the protocol repeats them)."""
        if self.broken:  # do not wait: to open it again may take a second
            return False
        with self._lock:
            try:
                if self._port is not None:
                    self._port.send(data)
            except BlockingIOError:
                return False
            except _BROKEN as e:
                self._break(e)
                return False
        return True

    def reopen(self) -> None:
        """Close the port, with all that waits in it to be sent, and open it again later; called by the reading thread.

        A connection that stalls would deliver old orders when it goes on.
        """
        self._break(ConnectionResetError("the vehicle is silent"))
        self._let_go()

    def close(self) -> None:
        """Close the link for good."""
        self._closed = True
        self._let_go()

    def _let_go(self) -> None:
        with self._lock, suppress(*_BROKEN):
            if self._port is not None:
                self._port.close()

    def _break(self, error: Exception) -> None:
        if not self.broken and not self._closed:
            log.warning("%s: %s; trying again", self.name, error)
        self._wait(error)

    def _wait(self, error: Exception) -> None:
        self.broken = str(error) or type(error).__name__
        self._again = time.monotonic() + self._retry

    def _reopened(self) -> bool:
        self._let_go()  # at once: a device that is still held comes back under another name
        if time.monotonic() < self._again:
            return False
        with self._lock:
            if self._closed:
                return False
            try:
                self._port = self._connect()
            except OSError as e:
                self._break(e)
                return False
        log.warning("%s: open again", self.name)
        self.broken = ""
        return True


class _UdpPort:
    """A UDP socket. A listening one answers at most eight senders of the last ten seconds, another has one address."""

    def __init__(self, host: str, port: int, listen: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.fileno, self.close = self._socket.fileno, self._socket.close
        self._listen, self._peers = listen, dict[Any, float]()  # s, newest datagram by sender
        try:
            self._address = (host if listen else socket.gethostbyname(host), port)
            if listen:
                self._socket.bind(self._address)
        except OSError:
            self._socket.close()
            raise

    def receive(self) -> list[bytes]:
        out = []
        with suppress(BlockingIOError, ConnectionRefusedError):  # refused: nobody listens there yet
            for _ in range(1000):  # a flood must not keep the reader here
                data, sender = self._socket.recvfrom(_CHUNK)
                if self._listen or sender == self._address:
                    self._note_peer(sender)
                    out.append(data)
        return out

    def _note_peer(self, sender: Any) -> None:
        """Note a datagram's sender; of forged ones without number only the first eight are answered."""
        now = time.monotonic()
        if sender not in self._peers:
            self._peers = {peer: t for peer, t in self._peers.items() if t > now - 10.0}
        if sender in self._peers or len(self._peers) < 8:
            self._peers = {**self._peers, sender: now}

    def send(self, data: bytes) -> None:
        since = time.monotonic() - 10.0
        for peer in [p for p, t in self._peers.items() if t > since] if self._listen else [self._address]:
            with suppress(ConnectionRefusedError):
                self._socket.sendto(data, peer)


class _StreamPort:
    """A byte stream. The rest of a message that was sent in part goes first; until then, nothing else is sent."""

    def __init__(self, port: Any, receive: Callable[[int], bytes], send: Callable[[bytes], int], gone: str) -> None:
        self._port, self._receive, self._send, self._gone = port, receive, send, gone
        self.fileno, self._unsent = port.fileno, b""

    def receive(self) -> list[bytes]:
        try:
            data = self._receive(_CHUNK)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionResetError(self._gone)
        return [data]

    def send(self, data: bytes) -> None:
        if self._unsent:
            self._unsent = self._unsent[self._send(self._unsent) :]
        if self._unsent:
            raise BlockingIOError
        self._unsent = data[self._send(data) :]

    def close(self) -> None:
        with suppress(Exception):  # only a serial port has it; termios has an error of its own
            self._port.reset_output_buffer()  # else closing waits until all is sent
        self._port.close()


class _TcpServer:
    """Connects to a TCP server. The host name is resolved only once, as its name server may become unreachable."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._resolved: list[tuple[str, int]] = []

    def connect(self) -> Port:
        first = not self._resolved
        if first:
            found = socket.getaddrinfo(*self._address, type=socket.SOCK_STREAM)
            self._resolved = list(dict.fromkeys((str(a[4][0]), int(a[4][1])) for a in found))
        opened = self._connected(2.0 if first else 0.5)  # s; nobody reads the link meanwhile
        opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        at_once = struct.pack("ii", 1, 0)  # closing drops what waits to be sent, as in `_StreamPort.close`
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, at_once)
        opened.setblocking(False)
        return _StreamPort(opened, opened.recv, opened.send, "the other side has closed the connection")

    def _connected(self, timeout: float) -> socket.socket:
        """Connect to the first address that answers, in at most `timeout` seconds; later, try only that address."""
        error: OSError | None = None
        for address in self._resolved:
            try:
                found = socket.create_connection(address, timeout=timeout / len(self._resolved))
            except OSError as e:
                error = error or e
            else:
                self._resolved = [address]
                return found
        raise error or ConnectionRefusedError


def _serial_port(device: str, baud: int) -> Port:
    """Open a serial port that is written with `os.write`, as pyserial's `write` waits until there is room."""
    try:
        import serial
    except ImportError as e:
        raise MissingExtraError("pyserial", "fly") from e
    try:
        port = serial.Serial(device, baud, timeout=0, write_timeout=0)
    except ValueError as e:  # a speed that the port cannot do
        raise OSError(str(e)) from e
    return _StreamPort(port, port.read, lambda data: os.write(port.fileno(), data), "the device is gone")


def _connector(name: str) -> Callable[[], Port]:
    kind, _, rest = name.partition(":")
    where, _, number = rest.rpartition(":")
    is_complete = bool(where) and number.isdigit()
    if kind == "serial" and is_complete:
        return lambda: _serial_port(where, int(number))
    if kind not in ("udp", "udpin", "udpout", "tcp") or not is_complete or not int(number) < 65536:
        raise InputError(f"{name}: not a link; write {NAMES}")
    if kind == "tcp":
        return _TcpServer(where, int(number)).connect
    return lambda: _UdpPort(where, int(number), listen=kind != "udpout")


def open_link(name: str, patient: bool = False, retry: float = 1.0) -> Link:
    """Open a link by its name.

    Args:
        name: `udp:0.0.0.0:14550`, `udpout:192.168.1.10:14555`, `tcp:127.0.0.1:5760` or `serial:/dev/ttyACM0:57600`.
        patient: whether to retry a TCP server that does not answer yet, instead of raising an error.
        retry: seconds between attempts to open a broken link.

    Raises:
        InputError: the name is malformed, or there is no such host or device.
        OutputError: the port is in use, or there is no permission for it.
        MissingExtraError: pyserial is not installed.
    """
    try:
        return Link(name, _connector(name), patient, retry)
    except OSError as e:
        number = errno.ENOENT if isinstance(e, socket.gaierror) else e.errno
        kind, why = _ERRORS.get(number or 0, (InputError, str(e)))
        raise kind(f"{name}: {why}") from e
