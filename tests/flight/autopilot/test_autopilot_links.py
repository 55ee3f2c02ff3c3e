"""Links by name: real sockets on this machine, a pseudo-terminal, and a real ArduPilot where there is one."""

from __future__ import annotations

import builtins
import importlib
import os
import pty
import select
import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from length import BOTH
from over_a_link import drive, free_port, ready_vehicle

from alight.flight.autopilot import Autopilot, Link, TelemetryEvents, open_link
from alight.records import FlightMode, InputError, MissingExtraError, NavSample, NoticeKind, OutputError
from alight.records.telemetry import FirmwareName
from alight_sim.autopilot import DIALECTS, LossyChannel, SimulatedAutopilot, UdpServer

LOCAL = "127.0.0.1"


@BOTH
def test_a_flight_over_a_real_socket(dialect: FirmwareName) -> None:
    """Over UDP with a loss of a tenth, ten times as fast as the clock: heard, armed, up, and the clocks tied."""
    port, events = free_port(), TelemetryEvents()
    link = open_link(f"udp:{LOCAL}:{port}")
    ours, bad = Autopilot(events=events), LossyChannel(loss=0.1, seed=1)
    sim = SimulatedAutopilot(DIALECTS[dialect])
    with UdpServer(sim, (LOCAL, port), speed=10.0, step=0.05, outwards=bad):
        assert drive(link, ours, 8, lambda: ours.telemetry is not None and ours.telemetry.ready)
        assert ours.vehicle is not None
        ours.vehicle.set_mode(FlightMode.GUIDED)
        ours.vehicle.arm()
        assert drive(link, ours, 8, lambda: bool(ours.telemetry and ours.telemetry.armed))
        ours.vehicle.take_off(8.0)
        assert drive(link, ours, 8, lambda: bool(ours.telemetry and ours.telemetry.place
                                                 and ours.telemetry.place.above_home > 7.0))  # fmt: skip
    link.close()
    rows = [s for s in ours.samples() if isinstance(s, NavSample) and s.position_world is not None]
    assert rows
    assert not [n for n in ours.notices() if n.kind in (NoticeKind.TAKEOVER, NoticeKind.REBOOT)]


def test_udp_out_speaks_to_one_address_and_listens_to_no_other() -> None:
    server, other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    server.bind((LOCAL, 0))
    server.settimeout(2.0)
    link = open_link(f"udpout:{LOCAL}:{server.getsockname()[1]}")
    assert link.write(b"hello")
    data, sender = server.recvfrom(100)
    assert data == b"hello"
    other.sendto(b"intruder", sender)
    server.sendto(b"answer", sender)
    got: list[bytes] = []
    end = time.monotonic() + 20.0
    while not got and time.monotonic() < end:
        got = link.read(1.0)
    assert got == [b"answer"]
    for s in (server, other):
        s.close()
    link.close()


def test_a_patient_link_waits_for_a_server() -> None:
    """A SITL opens its second port only after a connection to the first one; a patient link waits for it."""
    with socket.create_server((LOCAL, 0)) as server:
        port = server.getsockname()[1]
    link, never = (open_link(f"tcp:{LOCAL}:{port}", patient=True, retry=0.05) for _ in range(2))
    never.close()
    assert not link.write(b"lost")
    assert "refused" in link.broken
    with socket.create_server((LOCAL, port)) as server:
        server.settimeout(5.0)
        end = time.monotonic() + 5.0
        while link.broken and time.monotonic() < end:
            assert link.read(0.02) == []
        peer, _ = server.accept()
        assert link.write(b"hello")
        assert peer.recv(10) == b"hello"
        peer.close()
    link.close()


def test_tcp_comes_back_after_the_other_side_has_gone() -> None:
    server = socket.create_server((LOCAL, 0))
    port = server.getsockname()[1]
    link = open_link(f"tcp:{LOCAL}:{port}", retry=0.05)
    peer, _ = server.accept()
    peer.sendall(b"one")
    assert link.read(2.0) == [b"one"]
    peer.close()
    assert link.read(2.0) == []
    assert "closed" in link.broken
    assert not link.write(b"lost")
    end, back = time.monotonic() + 5, False
    server.settimeout(5.0)
    while not back and time.monotonic() < end:
        link.read(0.02)
        back = not link.broken
    assert back
    peer, _ = server.accept()
    assert link.write(b"two")
    assert peer.recv(10) == b"two"
    for s in (peer, server):
        s.close()
    link.close()


def test_what_waits_in_a_link_is_dropped_when_it_is_opened_again() -> None:
    """A stalled connection once delivered eleven set-points after the flight was over."""
    with socket.create_server((LOCAL, 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link = open_link(f"tcp:{LOCAL}:{server.getsockname()[1]}", retry=0.0)
        peer, _ = server.accept()
        written = 0
        while link.write(bytes(2000)):  # nobody reads
            written += 2000
        link.reopen()
        assert link.broken
        arrived = 0
        with suppress(ConnectionResetError):
            while data := peer.recv(65_535):
                arrived += len(data)
        assert arrived < written - 10_000
        assert link.read(0.02) == []
        assert not link.broken
        peer.close()
    link.close()


def test_a_serial_port_is_read_and_written() -> None:
    ours, theirs = pty.openpty()
    link = open_link(f"serial:{os.ttyname(theirs)}:57600")
    os.write(ours, b"\xfd\x00\x11")
    assert link.read(2.0) == [b"\xfd\x00\x11"]
    assert link.read(0.0) == []
    assert link.write(b"\xfd\x0a\x0d")
    assert os.read(ours, 10) == b"\xfd\x0a\x0d"  # raw: nothing is translated
    link.close()
    os.close(ours)
    os.close(theirs)


def test_a_serial_port_that_nobody_reads_makes_nobody_wait() -> None:
    """A full port drops whole messages: the rest of a started message is sent first, and none is cut."""
    ours, theirs = pty.openpty()
    link: Any = open_link(f"serial:{os.ttyname(theirs)}:57600")
    start, sent, full = time.monotonic(), 0, False
    while time.monotonic() < start + 5.0 and not full:
        full = not link.write(b"<" + b"x" * 278 + b">")
        sent += not full
    assert full
    got = b""
    while len(got) < 280 * sent:
        assert select.select([ours], [], [], 20.0)[0]
        got += os.read(ours, 65_536)
        link.write(b"")
    assert got == (b"<" + b"x" * 278 + b">") * sent
    assert link.write(b"<new>")
    assert os.read(ours, 10) == b"<new>"
    while link.write(b"x" * 280):
        pass
    link.close()
    assert time.monotonic() - start < 5.0
    os.close(ours)
    os.close(theirs)


def test_tcp_is_resolved_once_and_opened_again_in_half_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody ticks while the reader opens the link, and 1.2 s without ticks count as a vehicle without a listener."""
    server, closed = (socket.create_server((LOCAL, 0)) for _ in range(2))
    port, waits = server.getsockname()[1], list[float]()
    other = closed.getsockname()  # of the same host, where nobody is
    closed.close()
    both = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", at) for at in (other, (LOCAL, port))]
    real = socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", lambda h, *a, **k: both if h == "host" else real(h, *a, **k))
    link = open_link(f"tcp:host:{port}", retry=0.0)
    peer, _ = server.accept()

    def silent(address: Any, timeout: float) -> socket.socket:
        waits.append(timeout)
        assert address == (LOCAL, port)  # the one that answered
        raise TimeoutError("timed out")

    def asked(*_: Any, **__: Any) -> Any:
        raise AssertionError("the name is resolved again")

    monkeypatch.setattr(socket, "create_connection", silent)
    monkeypatch.setattr(socket, "getaddrinfo", asked)
    peer.close()
    for _ in range(3):
        assert link.read(0.01) == []
    assert waits
    assert max(waits) <= 0.5
    link.close()
    server.close()


@pytest.mark.parametrize(
    "name", ["", "udp", "udp:14550", "tcp:host:port", "tcp:h:70000", "serial:/dev/x", "can:1:2", "x"]
)
def test_a_name_that_means_nothing_is_refused_with_those_that_do(name: str) -> None:
    with pytest.raises(InputError, match="tcp:HOST:PORT"):
        open_link(name)


def test_what_a_user_can_mend_is_said() -> None:
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    taken.bind((LOCAL, 0))
    with pytest.raises(OutputError, match="taken"):
        open_link(f"udp:{LOCAL}:{taken.getsockname()[1]}")
    taken.close()
    closed = socket.create_server((LOCAL, 0))
    port = closed.getsockname()[1]
    closed.close()
    with pytest.raises(InputError, match="nobody answers"):
        open_link(f"tcp:{LOCAL}:{port}")
    with pytest.raises(InputError, match="no such host or device"):
        open_link("serial:/dev/there-is-none:57600")


@pytest.mark.parametrize(("package", "use"), [("serial", "serial:/dev/x:9600"), ("pymavlink", "")])
def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch, package: str, use: str) -> None:
    real = builtins.__import__

    def without(name: str, *more: Any, **named: Any) -> Any:
        if name.split(".")[0] == package:
            raise ImportError(name)
        return real(name, *more, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r"alight\[fly\]"):
        open_link(use) if use else importlib.reload(sys.modules["alight.flight.autopilot.dialect"])


def test_reading_waits_no_longer_than_told(monkeypatch: pytest.MonkeyPatch) -> None:
    link, waits, wait = open_link(f"udp:{LOCAL}:0"), list[float](), select.select
    monkeypatch.setattr(select, "select", lambda r, w, x, timeout: (waits.append(timeout), wait(r, w, x, timeout))[1])
    assert link.read(0.05) == []
    assert waits == [0.05]
    assert link.write(b"to nobody")
    link.close()


class Port:
    """A port over a real socket that fails on demand."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.fileno, self.close = self.socket.fileno, self.socket.close
        self.error: Exception | None = None

    def receive(self) -> list[bytes]:
        return [self.socket.recv(100)]

    def send(self, data: bytes) -> None:
        if self.error is not None:
            raise self.error


def fragile(retry: float = 0.02) -> tuple[Link, list[Port]]:
    """Return a link, and the list of its ports, the newest last."""
    ports: list[Port] = []

    def connect() -> Port:
        ports.append(Port())
        return ports[-1]

    return Link("fragile", connect, retry=retry), ports


@pytest.mark.parametrize("error", [OSError("the device is gone"), TypeError("an integer is required (got NoneType)")])
def test_only_the_reader_closes_and_opens(error: Exception) -> None:
    """A failed write leaves the socket open for the thread that may be waiting on it."""
    link, ports = fragile()
    ports[0].error = error
    assert not link.write(b"lost")
    assert link.broken == str(error)
    assert ports[0].fileno() >= 0
    time.sleep(0.03)
    assert not link.write(b"lost")
    assert len(ports) == 1
    link.read(0.01)
    assert ports[0].fileno() < 0
    assert link.write(b"again")
    assert not link.broken
    link.close()


def test_a_link_that_is_closed_under_its_reader_is_opened_again() -> None:
    """`select` raises ValueError for a socket that another thread has closed."""
    link, ports = fragile()
    ports[0].close()
    assert link.read(0.01) == []
    assert link.broken
    time.sleep(0.03)
    assert link.read(0.01) == []
    assert not link.broken
    assert len(ports) == 2
    link.close()


def test_a_link_that_is_closed_and_written_by_others_never_raises() -> None:
    """One thread reads; the other breaks the link again and again, and closes it at the end: nothing is raised."""
    link, ports = fragile(retry=0.0)
    raised: list[BaseException] = []
    over = threading.Event()

    def listen() -> None:
        try:
            while not over.is_set():
                link.read(0.005)
        except BaseException as e:
            raised.append(e)

    reader = threading.Thread(target=listen)
    reader.start()
    end = time.monotonic() + 60.0
    while len(ports) <= 20 and time.monotonic() < end:
        ports[-1].error = TypeError("closed")
        link.write(b"x")
    link.close()
    time.sleep(0.05)
    over.set()
    reader.join()
    assert not raised
    assert len(ports) > 20


PARAMETERS = Path(__file__).parents[3] / "docs/sitl-parameters"


def test_the_parameters_of_a_sitl_let_it_be_armed_and_land_on_a_target() -> None:
    """A fresh one without them says that nothing is calibrated, and is never ready."""
    rows = [line.split() for line in PARAMETERS.read_text().splitlines() if not line.startswith("#")]
    found = {name: float(value) for name, value in rows}
    assert len(found) == len(rows)
    assert all(len(name) <= 16 for name in found)  # as MAVLink's
    assert all(found[f"INS_ACC{k}OFFS_{axis}"] for k in ("", "2") for axis in "XYZ")
    assert (found["PLND_ENABLED"], found["PLND_TYPE"], found["PLND_STRICT"]) == (1, 1, 0)
    assert found["FRAME_CLASS"] == 1
    said = (PARAMETERS.parent / "autopilot.md").read_text()
    assert f"--defaults docs/{PARAMETERS.name}" in said


def test_a_real_ardupilot_takes_off_and_lands(sitl: str) -> None:
    link, ours, vehicle = ready_vehicle(sitl, TelemetryEvents())
    vehicle.set_mode(FlightMode.GUIDED)
    assert drive(link, ours, 10, lambda: bool(ours.telemetry and ours.telemetry.mode is FlightMode.GUIDED))
    vehicle.arm()
    assert drive(link, ours, 20, lambda: bool(ours.telemetry and ours.telemetry.armed)), ours.notices()
    vehicle.take_off(5.0)
    assert drive(link, ours, 30, lambda: bool(ours.telemetry and ours.telemetry.place
                                              and ours.telemetry.place.above_home > 4.5))  # fmt: skip
    vehicle.set_mode(FlightMode.LAND)
    assert drive(link, ours, 60, lambda: bool(ours.telemetry and ours.telemetry.is_down)), ours.notices()
    assert any(isinstance(s, NavSample) and s.position_world is not None for s in ours.samples())
    link.close()


def test_a_flood_of_senders_is_not_answered_one_and_all() -> None:
    port = free_port()
    link = open_link(f"udp:127.0.0.1:{port}")
    senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(12)]
    try:
        for s in senders:
            s.setblocking(False)
            s.sendto(b"x", ("127.0.0.1", port))
        assert len(link.read(1.0)) == 12
        link.write(b"y")
        assert len(select.select(senders, [], [], 0.2)[0]) == 8
    finally:
        for s in senders:
            s.close()
        link.close()
