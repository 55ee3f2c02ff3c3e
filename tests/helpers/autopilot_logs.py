"""Small logs of PX4 (.ulg), ArduPilot (.bin) and a ground station (.tlog), written from the events of a flight."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.spatial.transform import Rotation

from alight.geometry import LocalFrame
from alight.records import Event, ImuSample, NavSample

NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.array([1.0, -1.0, -1.0])
SEPARATION = 46.5  # m, ellipsoid minus sea level
Row = tuple[int, Sequence[float]]  # microseconds, fields


@dataclass(frozen=True)
class LoggedTopic:
    """One kind of message: its name, its fields, and its rows."""

    name: str
    fields: str  # as the format writes them
    rows: list[Row]
    instance: int = 0


@dataclass(frozen=True)
class Autopilot:
    """The numbers that an autopilot would have logged on a flight, NED and FRD, altitudes above the sea."""

    events: Sequence[Event]
    local: LocalFrame
    late_ns: int = 0  # what its clock is behind that of the events

    def of(self, kind: type[Any], row: Callable[[Any], Sequence[float]]) -> list[Row]:
        """The rows of a kind of sample."""
        return [((e.t_ns - self.late_ns) // 1000, row(e)) for e in self.events if isinstance(e, kind)]

    def place(self, s: NavSample) -> list[float]:
        """Latitude, longitude, altitude above the sea."""
        latitude, longitude, height = self.local.to_geodetic(s.position_world)
        return [float(latitude), float(longitude), float(height) - SEPARATION]

    def rotation(self, s: NavSample) -> Rotation:
        """ned_from_frd."""
        return Rotation.from_matrix(NED @ np.asarray(s.world_from_body) * FRD)

    def quaternion(self, s: NavSample) -> list[float]:
        """w, x, y, z."""
        return list(np.roll(self.rotation(s).as_quat(), 1))

    def angles(self, s: NavSample) -> list[float]:
        """Roll, pitch, yaw [rad]."""
        return list(self.rotation(s).as_euler("ZYX")[::-1])

    def velocity(self, s: NavSample) -> list[float]:
        """North, east, down."""
        return list(NED @ np.asarray(s.velocity_world))

    @staticmethod
    def inertial(s: ImuSample) -> list[float]:
        """Rates and forces."""
        return [*(s.angular_velocity_body * FRD), *(s.specific_force_body * FRD)]


def write_ulog(path: Path, a: Autopilot) -> None:
    """Write PX4's log (docs.px4.io, ULog file format), with a second IMU and receiver that are wrong."""

    def gps(s: NavSample) -> list[float]:
        msl = a.place(s)[2]
        return [round(msl * 1e3), round((msl + SEPARATION) * 1e3), 3]

    inertial = "float[3] gyro_rad;float[3] accelerometer_m_s2"
    topics = [
        LoggedTopic("vehicle_attitude", "float[4] q", a.of(NavSample, a.quaternion)),
        LoggedTopic("vehicle_global_position", "double lat;double lon;float alt;float eph;float epv",
                    a.of(NavSample, lambda s: [*a.place(s), s.sigma_position[0], s.sigma_position[2]])),
        LoggedTopic("vehicle_local_position", "float vx;float vy;float vz;float evh",
                    a.of(NavSample, lambda s: [*a.velocity(s), s.sigma_velocity[0]])),
        LoggedTopic("sensor_combined", inertial, a.of(ImuSample, a.inertial)),
        LoggedTopic("vehicle_gps_position", "int32_t alt;int32_t alt_ellipsoid;uint8_t fix_type", a.of(NavSample, gps)),
        LoggedTopic("sensor_combined", inertial, a.of(ImuSample, lambda s: [9.0] * 6)[:9], 1),
    ]  # fmt: skip
    codes = {"float": "f", "double": "d", "int32_t": "i", "uint8_t": "B"}
    with path.open("wb") as out:
        out.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))

        def put(kind: bytes, payload: bytes) -> None:
            out.write(struct.pack("<HB", len(payload), kind[0]) + payload)

        put(b"B", bytes(40))
        for name, fields in {t.name: t.fields for t in topics}.items():
            put(b"F", f"{name}:uint64_t timestamp;{fields};".encode())
        for number, topic in enumerate(topics):
            put(b"A", struct.pack("<BH", topic.instance, number) + topic.name.encode())
        for number, topic in enumerate(topics):
            kinds = [field.split(" ")[0].partition("[") for field in topic.fields.split(";")]
            packing = "<HQ" + "".join(codes[kind] * int(count.rstrip("]") or 1) for kind, _, count in kinds)
            for t_us, values in topic.rows:
                put(b"D", struct.pack(packing, number, t_us, *values))


def write_dataflash(path: Path, a: Autopilot, ellipsoid: str = "Und", driver: str = "u-blox") -> None:
    """Write ArduPilot's log (ArduPilot, AP_Logger), with a second IMU that is wrong.

    Args:
        path: the log.
        a: what was flown.
        ellipsoid: field of `GPA` from which ellipsoidal heights follow: `Und`, `AEl` of newer firmware, or none.
        driver: driver of the receiver, as logged at the start.
    """

    def degrees(s: NavSample) -> list[float]:
        roll, pitch, yaw = np.degrees(a.angles(s))
        return [round(100 * roll), round(100 * pitch), round(100 * (yaw % 360.0))]

    def place(s: NavSample) -> list[float]:
        latitude, longitude, msl = a.place(s)
        return [round(latitude * 1e7), round(longitude * 1e7), msl]

    def accuracy(s: NavSample) -> list[float]:
        return [round(100 * float(v[k])) for v, k in
                ((s.sigma_position, 0), (s.sigma_position, 2), (s.sigma_velocity, 0))]  # fmt: skip

    def more(s: NavSample) -> list[float]:
        undulation = a.place(s)[2] - float(a.local.to_geodetic(s.position_world)[2])  # as AP_GPS defines it
        return {"Und": [undulation], "AEl": [round(100 * (a.place(s)[2] - undulation))]}.get(ellipsoid, [])

    letter = {"Und": "f", "AEl": "e"}.get(ellipsoid, "")
    inertial = "GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    topics = [
        LoggedTopic("ATT", "ccC Roll,Pitch,Yaw", a.of(NavSample, degrees)),
        LoggedTopic("POS", "LLf Lat,Lng,Alt", a.of(NavSample, place)),
        LoggedTopic("XKF1", "Bfff C,VN,VE,VD", a.of(NavSample, lambda s: [0, *a.velocity(s)])),
        LoggedTopic("IMU", f"Bffffff I,{inertial}", a.of(ImuSample, lambda s: [0, *a.inertial(s)])),
        LoggedTopic("IMU", f"Bffffff I,{inertial}", a.of(ImuSample, lambda s: [1, *[9.0] * 6])[:9]),
        LoggedTopic(
            "GPS", "BBe I,Status,Alt",
            a.of(NavSample, lambda s: [0, 3, round(100 * a.place(s)[2])]) if ellipsoid == "AEl" else [],
        ),
        LoggedTopic(
            "GPA", f"BCCC{letter} I,HAcc,VAcc,SAcc{letter and ','}{ellipsoid}",
            a.of(NavSample, lambda s: [0, *accuracy(s), *more(s)]),
        ),
        LoggedTopic("MSG", "Z Message", [(0, [f"GPS 1: specified as {driver}".encode()])]),
    ]  # fmt: skip
    codes = {"c": "h", "C": "H", "L": "i", "e": "i", "f": "f", "B": "B", "Z": "64s"}
    numbers = {name: 130 + k for k, name in enumerate({t.name: None for t in topics})}
    with path.open("wb") as out:

        def format_row(number: int, name: str, letters: str, columns: str, size: int) -> None:
            row = struct.pack("<BB4s16s64s", number, size, name.encode(), letters.encode(), columns.encode())
            out.write(b"\xa3\x95\x80" + row)

        format_row(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)
        packings = {}
        for name, fields in {t.name: t.fields for t in topics}.items():
            letters, columns = fields.split(" ")
            packings[name] = "<Q" + "".join(codes[letter] for letter in letters)
            size = 3 + struct.calcsize(packings[name])
            format_row(numbers[name], name, f"Q{letters}", f"TimeUS,{columns}", size)
        rows = ((t_us, topic.name, values) for topic in topics for t_us, values in topic.rows)
        for t_us, name, values in sorted(rows, key=lambda row: row[0]):
            out.write(b"\xa3\x95" + bytes([numbers[name]]) + struct.pack(packings[name], t_us, *values))


def telemetry_of(a: Autopilot) -> Iterator[tuple[int, Any]]:
    """Messages with their times [us], of a vehicle whose IMU is sent as ArduPilot scales it."""
    for event in a.events:
        t_us = (event.t_ns - a.late_ns) // 1000
        t_ms = (t_us // 1000) % 2**32
        if isinstance(event, ImuSample):
            rates, forces = np.split(np.array(a.inertial(event)), 2)
            milli = [round(v) for v in (*(forces / 9.80665 * 1e3), *(rates * 1e3))]
            yield t_us, mavlink.MAVLink_raw_imu_message(t_us, *milli, 0, 0, 0)
        elif isinstance(event, NavSample):
            latitude, longitude, msl = a.place(event)
            speeds = [round(100 * v) for v in a.velocity(event)]
            rates = np.asarray(event.angular_velocity_body) * FRD
            yield t_us, mavlink.MAVLink_attitude_message(t_ms, *a.angles(event), *rates)
            yield t_us, mavlink.MAVLink_gps_raw_int_message(
                1_700_000_000_000_000, 3, 0, 0, round(msl * 1e3), 0, 0, 0, 0, 12,
                alt_ellipsoid=round((msl + SEPARATION) * 1e3), h_acc=900, v_acc=1400, vel_acc=100,
            )  # fmt: skip
            yield (
                t_us,
                mavlink.MAVLink_global_position_int_message(
                    t_ms, round(latitude * 1e7), round(longitude * 1e7), round(msl * 1e3), 0, *speeds, 0
                ),
            )


def write_telemetry(path: Path, messages: Iterable[tuple[int, Any]]) -> None:
    """Write a ground station's log: eight bytes of time before each message."""
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as out:
        for t_us, message in messages:
            out.write(struct.pack(">Q", 1_700_000_000_000_000 + t_us) + bytes(message.pack(link)))
            link.seq = (link.seq + 1) % 256
