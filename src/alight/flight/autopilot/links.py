"""Links to an autopilot: UDP, TCP and serial by name. They wait no longer than a time-out, and reopen after a break."""

from __future__ import annotations

import logging
import os
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any

from alight.records import AlightError, InputError, MissingExtraError, OutputError

log = logging.getLogger(__name__)

_CHUNK = 65_535
_AGAIN = 1.0  # s between attempts to open a broken link
_FIRST, _LATER = 2.0, 0.5  # s that a TCP server may take to answer, before a flight and in it: nobody listens meanwhile
_PEER = 10.0  # s for which a sender of datagrams is answered
_BROKEN = (OSError, ValueError, TypeError)  # the last two: of a socket or a port that another thread has just closed
NAMES = (
    "udp:HOST:PORT (listen, as a companion of a ground station), udpout:HOST:PORT (send to), tcp:HOST:PORT, "
    "serial:DEVICE:BAUD"
)


class Link(ABC):
    """Bytes in and out. A broken link is opened again by itself; `broken` holds the reason while it is not open.

    One thread reads, and it alone reopens a broken link: no other thread closes a socket that it waits on, except by
    `close` at the end. Any thread may write.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.broken = ""  # reason why the link is not open now; empty: it is open
        self._again, self._closed = 0.0, False
        self._lock = threading.Lock()  # guards the socket or port against closing and exchange; not held for reading

    @abstractmethod
    def _open(self) -> None:
        """Open; raises OSError. The lock is held."""

    @abstractmethod
    def _read(self, timeout: float) -> list[bytes]:
        """Wait for bytes; raises OSError."""

    @abstractmethod
    def _write(self, data: bytes) -> None:
        """Send without waiting; raises OSError. The lock is held."""

    @abstractmethod
    def _shut(self) -> None:
        """Close the socket or port, if it is open. The lock is held."""

    def open(self, patient: bool = False) -> None:
        """Open it for the first time; raises OSError. Patient: a refused connection is tried again later."""
        try:
            self._open()
        except ConnectionRefusedError as e:
            if not patient:
                raise
            self._wait(e)

    def read(self, timeout: float = 0.0) -> list[bytes]:
        """Return the received bytes, one entry a datagram or chunk; wait for them at most `timeout` seconds."""
        if self.broken and not self._reopened():
            time.sleep(min(timeout, _AGAIN))
            return []
        try:
            return self._read(timeout)
        except _BROKEN as e:
            self._break(e)
            self._let_go()
            return []

    def write(self, data: bytes) -> bool:
        """Send; False: the link is broken or full, and the bytes are lost (the protocol sends again)."""
        if self.broken:  # do not wait: to open it again may take a second
            return False
        with self._lock:
            try:
                self._write(data)
            except BlockingIOError:
                return False
            except _BROKEN as e:
                self._break(e)
                return False
        return True

    def close(self) -> None:
        """Close the socket or the port for good."""
        self._closed = True
        self._let_go()

    def _let_go(self) -> None:
        with self._lock, suppress(*_BROKEN):
            self._shut()

    def _break(self, error: Exception) -> None:
        if not self.broken and not self._closed:
            log.warning("%s: %s; trying again", self.name, error)
        self._wait(error)

    def _wait(self, error: Exception) -> None:
        """Note the reason why it is not open, and the time of the next attempt."""
        self.broken = str(error) or type(error).__name__
        self._again = time.monotonic() + _AGAIN

    def _reopened(self) -> bool:
        self._let_go()  # at once: a device that is still held comes back under another name
        if time.monotonic() < self._again:
            return False
        with self._lock:
            if self._closed:
                return False
            try:
                self._open()
            except OSError as e:
                self._break(e)
                return False
        log.warning("%s: open again", self.name)
        self.broken = ""
        return True


class UdpLink(Link):
    """Datagrams. A listening link answers every recent sender; a sending link writes to one address."""

    def __init__(self, name: str, host: str, port: int, listen: bool) -> None:
        super().__init__(name)
        self._address, self._listen = (host, port), listen
        self._peers: dict[Any, float] = {}

    @property
    def port(self) -> int:
        """The port of this machine that the link is bound to."""
        return int(self._socket.getsockname()[1])

    def _open(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if self._listen:
            try:
                self._socket.bind(self._address)
            except OSError:
                self._socket.close()
                raise
        else:
            self._address = (socket.gethostbyname(self._address[0]), self._address[1])

    def _read(self, timeout: float) -> list[bytes]:
        if not select.select([self._socket], [], [], timeout)[0]:
            return []
        out = []
        with suppress(BlockingIOError, ConnectionRefusedError):  # refused: nobody listens there yet
            while True:
                data, sender = self._socket.recvfrom(_CHUNK)
                if self._listen or sender == self._address:
                    with self._lock:
                        self._peers[sender] = time.monotonic()
                    out.append(data)
        return out

    def _write(self, data: bytes) -> None:
        now = time.monotonic()
        self._peers = {peer: t for peer, t in self._peers.items() if now - t < _PEER}
        for peer in self._peers if self._listen else [self._address]:
            with suppress(ConnectionRefusedError):
                self._socket.sendto(data, peer)

    def _shut(self) -> None:
        self._socket.close()


class _StreamLink(Link):
    """Bytes in order. The rest of a message that was sent in part goes first; until then no other message is sent."""

    _unsent = b""

    @abstractmethod
    def _send(self, data: bytes) -> int:
        """Send as much as fits now; return the number of bytes. Raises BlockingIOError if none fits."""

    def _write(self, data: bytes) -> None:
        """Send; raises BlockingIOError, and drops the message, while an earlier one is not sent completely."""
        if self._unsent:
            self._unsent = self._unsent[self._send(self._unsent) :]
        if self._unsent:
            raise BlockingIOError
        self._unsent = data[self._send(data) :]


class TcpLink(_StreamLink):
    """A stream to a server (ArduPilot's SITL, a telemetry bridge)."""

    def __init__(self, name: str, host: str, port: int) -> None:
        super().__init__(name)
        self._address = (host, port)
        self._resolved: list[tuple[str, int]] = []  # once: a name server that is lost with the link is not waited for
        self._socket: socket.socket | None = None  # not connected yet

    def _open(self) -> None:
        first = not self._resolved
        if first:
            found = socket.getaddrinfo(*self._address, type=socket.SOCK_STREAM)
            self._resolved = list(dict.fromkeys((str(a[4][0]), int(a[4][1])) for a in found))
        self._socket = self._connected(_FIRST if first else _LATER)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        self._unsent = b""

    def _connected(self, timeout: float) -> socket.socket:
        """Connect to the first address that answers, the only one from then on; all of them share the time-out."""
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

    def _read(self, timeout: float) -> list[bytes]:
        assert self._socket is not None
        if not select.select([self._socket], [], [], timeout)[0]:
            return []
        with suppress(BlockingIOError):
            data = self._socket.recv(_CHUNK)
            if not data:
                raise ConnectionResetError("the other side has closed the connection")
            return [data]
        return []

    def _send(self, data: bytes) -> int:
        assert self._socket is not None
        return self._socket.send(data)

    def _shut(self) -> None:
        if self._socket is not None:
            self._socket.close()


class SerialLink(_StreamLink):
    """A serial port, as a telemetry radio or the autopilot's own USB."""

    def __init__(self, name: str, device: str, baud: int) -> None:
        super().__init__(name)
        self._device, self._baud = device, baud

    def _open(self) -> None:
        try:
            import serial
        except ImportError as e:
            raise MissingExtraError("pyserial", "fly") from e
        try:
            self._port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0)
        except ValueError as e:  # a speed that the port cannot do
            raise OSError(str(e)) from e
        self._unsent = b""

    def _read(self, timeout: float) -> list[bytes]:
        if not select.select([self._port.fileno()], [], [], timeout)[0]:
            return []
        data = self._port.read(_CHUNK)
        if not data:
            raise OSError("the device is gone")
        return [data]

    def _send(self, data: bytes) -> int:
        """Send by the system call: pyserial's write without a time-out tries again until there is room."""
        return os.write(self._port.fileno(), data)

    def _shut(self) -> None:
        with suppress(Exception):  # termios has an error of its own
            self._port.reset_output_buffer()  # else closing waits until all is sent
        self._port.close()


def _host_port(name: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.rpartition(":")
    if not host or not port.isdigit() or not int(port) < 65536:
        raise InputError(f"{name}: no address; write {NAMES}")
    return host, int(port)


def _closed_link(name: str, kind: str, rest: str) -> Link:
    if kind in ("udp", "udpin", "udpout"):
        return UdpLink(name, *_host_port(name, rest), listen=kind != "udpout")
    if kind == "tcp":
        return TcpLink(name, *_host_port(name, rest))
    device, _, baud = rest.rpartition(":")
    if kind != "serial" or not device or not baud.isdigit():
        raise InputError(f"{name}: no link; write {NAMES}")
    return SerialLink(name, device, int(baud))


def open_link(name: str, patient: bool = False) -> Link:
    """Open a link by its name.

    Args:
        name: `udp:0.0.0.0:14550`, `udpout:192.168.1.10:14555`, `tcp:127.0.0.1:5760` or `serial:/dev/ttyACM0:57600`.
        patient: try a TCP server that does not answer yet again and again, like a broken link.

    Raises:
        InputError: the name is malformed, or there is no such host or device.
        OutputError: the port is taken, or there is no permission for it.
        MissingExtraError: pyserial is not installed.
    """
    kind, _, rest = name.partition(":")
    link = _closed_link(name, kind, rest)
    try:
        link.open(patient)
    except AlightError:
        raise
    except PermissionError as e:
        raise OutputError(f"{name}: no permission; for a serial port add yourself to its group (dialout)") from e
    except ConnectionRefusedError as e:
        raise InputError(f"{name}: nobody answers there; start the autopilot or the bridge first") from e
    except (FileNotFoundError, socket.gaierror) as e:
        raise InputError(f"{name}: there is no such host or device") from e
    except OSError as e:
        if e.errno in (98, 48, 10048):  # EADDRINUSE of Linux, macOS and Windows
            raise OutputError(f"{name}: the port is taken; end the program that uses it, or name another") from e
        if "could not open port" in str(e) and "No such file" in str(e):
            raise InputError(f"{name}: there is no such host or device") from e
        raise InputError(f"{name}: {e}") from e
    return link
