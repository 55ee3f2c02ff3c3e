"""A hostile peer on the link: with a key it has no effect, without one it is noticed and costs little."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from autopilot_rig import Rig
from hostile_peer import attacked
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from alight.flight.autopilot import Autopilot
from alight.flight.autopilot.signing import SigningKey
from alight.flight.live.signing_key import read_signing_key
from alight.records import InputError, NoticeKind

KEY = b"k" * 32


def test_with_a_key_nothing_that_is_forged_or_replayed_has_an_effect() -> None:
    """What is sent to the vehicle is the same to the bit."""
    alone, under = attacked(KEY, 3, 0), attacked(KEY, 3, 60)
    assert under.sent == alone.sent
    assert np.array_equal(under.position, alone.position)
    assert under.notices_but(NoticeKind.INTERFERENCE) == alone.notices
    assert not alone.dropped
    assert {"unsigned", "wrongly signed", "replayed"} == set(under.dropped)
    assert len(under.of(NoticeKind.INTERFERENCE)) == 1


def test_without_a_key_a_flood_and_a_second_sender_are_survived_and_reported() -> None:
    found = attacked(None, 3, 160, 3.5)
    lines = " ".join(found.of(NoticeKind.INTERFERENCE))
    assert "a second sender has the vehicle's identity" in lines
    assert "beyond 1,000 a second" in lines
    assert len(found.notices) < 300  # of about 1,000 texts
    assert len(found.sent) < 5_000


def talks(secret: bytes, stamps: list[int]) -> list[bytes]:
    """Heartbeats of a vehicle, signed at these time stamps."""
    talker = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    talker.signing.secret_key, talker.signing.sign_outgoing = secret, True
    out = []
    for talker.signing.timestamp in stamps:
        out.append(bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(talker)))
        talker.seq += 1
    return out


def heard(key: SigningKey | None, data: list[bytes]) -> Autopilot:
    ours = Autopilot(key=key)
    for one in data:
        ours.receive(one, 0)
    return ours


def test_a_forged_time_stamp_does_not_shut_the_vehicle_out() -> None:
    (forged,), (true,) = talks(b"x" * 32, [2**47]), talks(KEY, [1000])
    ours = heard(SigningKey(KEY, 0), [forged, true])
    assert ours.vehicle is not None
    assert dict(ours.dropped) == {"wrongly signed": 1}


def test_after_a_restart_nothing_is_accepted_again(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("open sesame\n", encoding="utf-8")
    file.chmod(0o600)
    key = read_signing_key(file)
    now = key.stamp
    said = talks(key.secret, [now, now + 1])
    assert heard(key, said).messages == 2
    again = heard(read_signing_key(file), said)  # nothing was told that the program would end
    assert again.vehicle is None
    assert dict(again.dropped) == {"replayed": 2}
    assert heard(read_signing_key(file), talks(key.secret, [now + 1_000_000])).vehicle is not None


@pytest.mark.parametrize(
    ("mode", "text", "stamps", "why"),
    [
        (0o640, "secret", "", "chmod 600"),
        (0o600, " \n", "", "is empty"),
        (0o600, "secret", "[1]", "are damaged"),
        (0o600, "secret", '{"1 1": 5}', "are damaged"),
        (0, None, "", "cannot be read"),
    ],
)
def test_a_key_that_cannot_be_used_is_refused_by_name(
    tmp_path: Path, mode: int, text: str | None, stamps: str, why: str
) -> None:
    file = tmp_path / "key"
    if text is not None:
        file.write_text(text, encoding="utf-8")
        file.chmod(mode)
    if stamps:
        (tmp_path / "key.stamps").write_text(stamps, encoding="utf-8")
    with pytest.raises(InputError, match=why) as refused:
        read_signing_key(file)
    assert str(file) in str(refused.value)


@pytest.mark.parametrize(("autopilot", "kind"), [(8, 6), (12, 2), (3, 4)])
def test_a_heartbeat_of_another_kind_with_the_identity_of_the_vehicle_changes_nothing(
    autopilot: int, kind: int
) -> None:
    """Such as that of a ground station whose system number was set to that of the vehicle."""
    rig = Rig()
    rig.run(3.0)
    before, talker = rig.telemetry.mode_name, mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    talker.seq = 77
    rig.ours.receive(bytes(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 9, 4, 3).pack(talker)), rig.now_ns)
    assert rig.telemetry.mode_name == before
    rig.run(0.1)
    assert next(n.text for n in rig.of(NoticeKind.INTERFERENCE)).startswith("a second sender")


@pytest.mark.parametrize("link", [{"loss": 0.5}, {"jitter": 0.3, "double": 0.5}, {"delay": 0.4}])
def test_a_bad_link_is_no_second_sender(link: dict[str, float]) -> None:
    rig = Rig(link=link, rates={"HIGHRES_IMU": 100.0})
    rig.run(15.0)
    assert not rig.of(NoticeKind.INTERFERENCE)
