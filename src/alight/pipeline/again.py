"""Judging again: another lander or other limits, from the evidence that a run has kept, without motion or mapping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from alight.elevation import doublings_up_to
from alight.landing.zones import MapZones
from alight.pipeline.judging import judge_evidence, quality_note
from alight.pipeline.lanes import with_verdict
from alight.pipeline.mapping.ground_map import QUALITY, nice_cell
from alight.pipeline.timing import Clock, Timings
from alight.records import InputError, RunResult, SettingsError
from alight.settings import Settings
from alight.settings.loading import all_keys, leaves, settings_of_keys
from alight.settings.units import with_degrees

JUDGED = tuple(f"{tuning}{group}." for tuning in ("", "tuning.") for group in ("lander", "hazards", "sites", "route"))
BEFORE = (  # keys of these groups that are used before the judgement, or by `alight hazards`
    "sites.every", "hazards.usual_sigma", "tuning.hazards.traffic_memory", "tuning.hazards.traffic_height",
    "tuning.hazards.came_memory", "tuning.hazards.sharpen.",
)  # fmt: skip
OF_EARLIER_MAPS = ("sites in reserve", "sites given up")  # notes on maps that are not judged again


def settings_to_judge(run: Settings, given: Mapping[str, Any]) -> Settings:
    """Return the settings of a run with other keys of its judgement.

    Args:
        run: settings of the run.
        given: the other keys, dotted or nested.

    Raises:
        SettingsError: a value is not valid, or the judgement does not use a key whose value differs from the run's.
    """
    try:
        stored = run.model_dump(mode="json")
        known = dict(leaves(stored))
        merged = settings_of_keys({**dict(leaves(with_degrees(stored, Settings))), **dict(leaves(given))})
    except ValueError as e:
        raise SettingsError(str(e)) from e
    now = dict(leaves(merged.model_dump(mode="json")))
    for key in (k for k in all_keys() if now[k] != known[k]):
        if not key.startswith(JUDGED) or key.startswith(BEFORE):
            raise SettingsError(f"{key}: the judgement does not use it; run again with it")
    return merged


def judge_again(result: RunResult, settings: Settings, clock: Clock = lambda: 0.0) -> RunResult:
    """Return the result of a run, judged with other settings (`settings_to_judge`).

    If a new run with these settings would use other cells, the result has a warning.

    Raises:
        InputError: the run has no map that could be judged.
    """
    evidence, stages, timings = result.evidence, settings.stages(), Timings(clock)
    if evidence is None:
        raise InputError(f"{result.source_name}: the run has no map to judge; {result.sites.reason or 'run again'}")
    zones = MapZones(result.zones, stages.lander.reach) if result.zones.zones else None
    verdict = judge_evidence(evidence, stages, timings, zones)
    notes = {k: v for k, v in result.notes.items() if k not in OF_EARLIER_MAPS}
    notes |= quality_note(verdict.hazards, stages)
    again = replace(result, settings=settings, notes=notes, timings=timings.stages, not_written={})
    again = with_verdict(again, verdict, evidence, stages.route, zones)
    why = _other_cells(result, settings)
    return replace(again, warnings=[*result.warnings, why]) if why else again


def _other_cells(result: RunResult, settings: Settings) -> str:
    """Return a warning if a new run with these settings may map or judge the ground on other cells; else empty."""
    assert result.evidence is not None
    cells = [s.lander.judging_cell for s in (result.settings, settings)]
    mapped, of = result.evidence.elevation.grid.cell, result.settings.parallax
    before, now = (doublings_up_to(mapped, cell) for cell in cells)
    # the least cells of the map, by the lander; on smaller cells than these the lander had no part in it
    least = [nice_cell(max(QUALITY[of.quality][1] * cell, 1e-9)) for cell in cells]
    same = of.cell is not None or of.method == "recursive" or least[0] == least[1] or max(least) < mapped
    if before == now and same:
        return ""
    return (
        f"judged on cells of {mapped * 2**now:g} m, from heights on cells of {mapped:g} m: for this lander a new run "
        "may choose others, and find more or less"
    )
