"""Trajectories in TUM format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from alight.geometry import LocalFrame
from alight.records import InputError
from alight.sources.tum import read_tum

LOCAL = LocalFrame(0.0, 0.0, 0.0)


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_times_are_exact_to_the_nanosecond(tmp_path: Path) -> None:
    """Read as a float64, the first time would end in ...512."""
    rows = [
        "1403715273.262142976 1 2 3 0 0 0 1",
        "",
        "1403715273.262142977 4 5 6 1 0 0 0",
        "1.403715274e9 0 0 0 0 0 0 -2",
    ]
    text = "\n".join(["# t x y z q", *rows])
    times, poses = read_tum(written(tmp_path / "p.tum", text), LOCAL)
    assert times.tolist() == [1403715273262142976, 1403715273262142977, 1403715274000000000]
    np.testing.assert_allclose(poses[0].matrix[:3], [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]])
    np.testing.assert_allclose(poses[1].rotation, np.diag([1.0, -1, -1]))  # x comes first, w last
    np.testing.assert_allclose(poses[2].rotation, np.eye(3))


@pytest.mark.parametrize(
    "line",
    [
        "2 1 2 3 0 0 0",
        "2 1 2 3 0 0 0 1 9",
        "2 1 2 x 0 0 0 1",
        "two 1 2 3 0 0 0 1",
        "2 1 2 nan 0 0 0 1",
        "2 1 2 3 0 0 0 0",
        "nan 1 2 3 0 0 0 1",
        "inf 1 2 3 0 0 0 1",
        "1e30 1 2 3 0 0 0 1",
        "1 1 2 3 0 0 0 1",
        "0.5 1 2 3 0 0 0 1",
        "2 500000 4980000 300 0 0 0 1",
    ],
)
def test_malformed_line_is_named(tmp_path: Path, line: str) -> None:
    path = written(tmp_path / "p.tum", f"1 1 2 3 0 0 0 1\n{line}\n")
    with pytest.raises(InputError, match=r"p\.tum, line 2: "):
        read_tum(path, LOCAL)


def test_no_poses(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no pose in it; each line needs"):
        read_tum(written(tmp_path / "p.tum", "# nothing\n"), LOCAL)
    with pytest.raises(InputError, match="cannot be read"):
        read_tum(tmp_path / "nowhere.tum", LOCAL)
