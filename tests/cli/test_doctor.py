"""`alight doctor`: one screen about the machine and the installation."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path

import pytest

from alight import __version__
from alight.cli import call


def test_it_is_one_screen_with_all_that_a_report_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(["doctor"]) == 0
    told = capsys.readouterr()
    lines = told.out.splitlines()
    names = [line.partition("  ")[0] for line in lines]
    assert told.err == ""
    assert len(lines) <= 24
    for name in ("alight", "system", "packages", "processor", "threads", "memory", "compiled loops", "cameras"):
        assert name in names
    assert f" {__version__}, in " in lines[0]
    assert platform.python_version() in told.out
    assert f"numpy {metadata.version('numpy')}" in told.out


def test_missing_extras_are_named_with_what_they_are_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def version(name: str) -> str:
        if name == "laspy":
            raise metadata.PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr("alight.runner.doctor.version", version)
    assert call(["doctor"]) == 0
    missing = [line for line in capsys.readouterr().out.splitlines() if line.startswith("no extra")]
    assert [" ".join(line.split()) for line in missing] == [
        "no extra las point clouds (alight export --las): pip install 'alight[las]' (laspy)"
    ]


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "HOME"])
def test_a_bare_machine_is_no_obstacle(
    variable: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(path: Path, **_: object) -> str:
        raise OSError(2, "no such file")

    monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(Path, "read_text", unreadable)  # neither /proc nor /sys
    monkeypatch.setattr("alight.runner.doctor.compiled.CACHE", None)
    monkeypatch.setattr("alight.runner.doctor.requires", lambda _: None)
    assert call(["doctor"]) == 0
    assert "kept in memory only" in capsys.readouterr().out
