"""A real ArduPilot, where there is one."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

PARAMETERS = Path(__file__).parents[2] / "docs/sitl-parameters"


@pytest.fixture
def sitl(tmp_path: Path) -> Any:
    """Start an ArduPilot Copter in a folder of its own."""
    binary = os.environ.get("ALIGHT_SITL")
    if not binary:
        pytest.skip("no ArduPilot SITL: set ALIGHT_SITL to its arducopter binary")
    command = [binary, "--model", "quad", "--speedup", "1", "--home", "47.6,13.4,500,0", "--wipe", "-I0"]
    command += ["--defaults", str(PARAMETERS)]
    with (
        (tmp_path / "sitl.log").open("wb") as log,
        subprocess.Popen(command, cwd=tmp_path, stdout=log, stderr=log) as run,
    ):
        yield "tcp:127.0.0.1:5760"
        run.terminate()
