"""A command that must fail, as the fixture `refused` runs it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from alight.cli import call

Refused = Callable[..., str]


def refused_by(capsys: pytest.CaptureFixture[str]) -> Refused:
    """Return a function that runs a command, and asserts exit code 2 and one line of an error with some words."""

    def run(arguments: Sequence[object], *words: str) -> str:
        capsys.readouterr()
        code, told = call([str(a) for a in arguments]), capsys.readouterr()
        assert (code, told.out) == (2, ""), arguments
        assert told.err.startswith("error: "), told.err
        assert told.err.count("\n") == 1
        assert len(told.err) < 1000
        for word in words:
            assert word in told.err
        return told.err

    return run
