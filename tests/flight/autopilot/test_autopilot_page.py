"""Agreement of docs/autopilot.md with the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from over_a_link import free_port

from alight.flight.autopilot.firmware import ArduPilotFirmware, Px4Firmware
from alight.flight.autopilot.parameters import PARAMETERS, parameters_table
from alight_sim.autopilot import SimulatedAutopilot, UdpServer

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "autopilot.md").read_text(encoding="utf-8")
MESSAGES = PAGE.split("## Messages that it requests")[1].split("\n## ")[0]
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, flags=re.S)


def test_the_page_has_the_rates_that_are_asked_for() -> None:
    rates: dict[str, float] = {}
    for names, rate in re.findall(r"^\| (`[^|]*) \| ([\d.]+) \|", MESSAGES, flags=re.M):
        rates |= {name: float(rate) for name in re.findall(r"`([A-Z_]+)`", names)}
    assert rates == {**ArduPilotFirmware.rates, **Px4Firmware.rates}


@pytest.mark.parametrize("firmware", sorted(PARAMETERS))
def test_the_page_has_the_table_of_parameters(firmware: str) -> None:
    assert parameters_table(firmware) in PAGE


def test_the_example_reads_telemetry(capsys: pytest.CaptureFixture[str]) -> None:
    port = free_port()
    code = EXAMPLES[0].replace("14550", str(port)).replace("+ 5.0", "+ 2.0")
    assert "14550" in EXAMPLES[0]
    with UdpServer(SimulatedAutopilot(), ("127.0.0.1", port), speed=10.0, step=0.05):
        exec(compile(code, "docs/autopilot.md", "exec"), {})
    assert "Telemetry(firmware='ArduPilot'" in capsys.readouterr().out


def test_the_example_of_the_simulated_autopilot_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(EXAMPLES[1].replace("14550", str(free_port())), "docs/autopilot.md", "exec"), {})
    assert int(capsys.readouterr().out) > 0


def test_the_page_claims_nothing_of_an_autopilot_that_no_test_runs() -> None:
    """What real autopilots did stands in the lab, with their versions and the date."""
    assert "[flew](lab/flight.md#real-autopilots)" in PAGE.split("## What was checked")[1]
    lab = (ROOT / "docs" / "lab" / "flight.md").read_text(encoding="utf-8").split("## Real autopilots")[1]
    assert re.match(r"\s+2026-\d\d-\d\d, in SITL .* ArduPilot at \w+ .* PX4 at \w+", lab, re.S)
