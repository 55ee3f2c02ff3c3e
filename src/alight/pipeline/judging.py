"""Judging lane: a verdict on every newer map; sites found earlier stay in reserve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from alight import hazards, memory, terrain
from alight.elevation import on_cells_up_to
from alight.landing import sites
from alight.landing.reserve import Reserve
from alight.landing.third_party import third_parties
from alight.landing.zones import MapZones
from alight.parallax.orthophoto import orthophoto
from alight.parallax.wires.find import find_wires
from alight.pipeline.mapping import MapSnapshot
from alight.pipeline.remembered import NOWHERE, CoverMemory, Remembered, WireMemory, shown_at, traffic
from alight.pipeline.timing import Timings
from alight.raster import upsample
from alight.records import (
    NO_ZONES,
    NOTHING_MISSING,
    ElevationMap,
    Flag,
    GroundZone,
    HazardMap,
    MapEvidence,
    MapFrame,
    MissingVeto,
    NextView,
    Observer,
    Site,
    Sites,
    TerrainMap,
    p_safe_text,
)
from alight.records.map_frame import Tie
from alight.settings import Lander, StageSettings, TerrainSettings

WET = np.uint16(Flag.WATER)
LARGE_MAP = 1_000_000  # cells; judging a larger map leaves hundreds of megabytes free in the heap
MOST_LOST = 100  # largest number of lost sites that are remembered
GREY = (
    "the pictures are grey: no colour can refuse water, plants or buildings, so fewer are recognised and P(safe) is "
    "lower; give colour pictures"
)
MISSING = {
    MissingVeto.SECOND_CAMERA: (
        "one camera sees the ground: no two pictures of one moment show what moves (water, swaying plants), so P(safe) "
        "is lower; a second camera would"
    ),
    MissingVeto.ATTITUDE: (
        "attitude was measured neither by a gimbal nor by GPS/INS: how level the map is rests on positions and "
        "gravity, so P(safe) is lower; give attitudes"
    ),
}
NO_COVER = "the kind of ground is not judged (terrain.enabled=false): nothing refuses water, plants or buildings"


@dataclass(frozen=True, eq=False)
class Verdict:
    """Verdict on one map: land cover, hazards and sites, in the map frame."""

    elevation: ElevationMap  # heights on water are refused
    land_cover: TerrainMap | None
    hazards: HazardMap
    sites: Sites
    frame: MapFrame  # map frame, with its position in the world
    missing: MissingVeto = NOTHING_MISSING
    evidence: MapEvidence | None = None  # in the map frame; None: not kept
    others: tuple[GroundZone, ...] = ()  # roads, cars, people and buildings on the map, in the world

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings in sentences about evidence that was missing."""
        land_cover = self.land_cover
        about = (NO_COVER,) if land_cover is None else () if land_cover.coloured else (GREY,)
        return about + tuple(words for veto, words in MISSING.items() if veto in self.missing)

    @property
    def look(self) -> NextView | None:
        """Next view of the first candidate that has one, if there is no site; else None."""
        views = [c.look for c in self.sites.candidates if c.look is not None]
        return views[0] if views and not self.sites.sites else None

    def in_world(self) -> Verdict:
        """Return the verdict in the world frame, for results that leave the pipeline."""
        frame, land_cover, hazards = self.frame, self.land_cover, self.hazards
        return replace(
            self,
            elevation=frame.elevation(self.elevation),
            land_cover=land_cover and replace(land_cover, grid=frame.grid(land_cover.grid)),
            hazards=replace(
                hazards,
                grid=frame.grid(hazards.grid),
                wires=tuple(w.moved(frame.offset_world) for w in hazards.wires),
            ),
            sites=frame.sites(self.sites),
            frame=replace(frame, offset_world=np.zeros(3)),
        )


@dataclass(frozen=True, eq=False)
class JudgingMemory:
    """Memory of the judging lane, immutable; a lane that replaces another continues with its memory."""

    kept: Reserve = field(default_factory=Reserve)  # reserve, in the map frame
    frame: MapFrame | None = None  # frame of the newest map
    lost: tuple[str, ...] = ()  # sites that were given up, in words, newest last
    warnings: tuple[str, ...] = ()  # warnings on sites after the motion was reinitialised
    roofs: Remembered = NOWHERE  # flat roofs, in the map frame: maps from low heights do not show the ground around
    roads: Remembered = NOWHERE  # roads, in the map frame: maps from low heights do not show how far they go on
    cover: CoverMemory = field(default_factory=CoverMemory)  # land cover, in the map frame
    wires: WireMemory = field(default_factory=WireMemory)  # wires, in the map frame

    @property
    def reserve(self) -> Reserve:
        """Sites, in the world, of all maps judged so far that no newer map refuses.

        `lost` are the sites that the newest map refused, with the reasons.
        """
        return self.kept if self.frame is None else self.kept.moved(self.frame.offset_world)

    def tied(self, tie: Tie, frame: MapFrame) -> JudgingMemory:
        """Return the memory moved to another map frame, with a warning that counts the remaining sites."""
        before = len(self.kept.sites)
        moved = replace(
            self, roofs=self.roofs.moved(*tie), roads=self.roads.moved(*tie), cover=self.cover.moved(*tie),
            wires=self.wires.moved(tie.shift),
        )  # fmt: skip
        if not before:
            return moved
        moved = moved.with_reserve(self.kept.tied(*tie, frame.frame_id), frame)
        left = len(moved.kept.sites)
        warning = (
            f"sites: the motion began anew (frame {frame.frame_id}); of {before} sites found before, {left} are "
            f"moved into the new frame, where their place is known to {tie.sigma:.2f} m, and "
            f"{before - left} are dropped"
        )
        return replace(moved, warnings=(*moved.warnings, warning)[-MOST_LOST:])

    def with_reserve(self, kept: Reserve, frame: MapFrame) -> JudgingMemory:
        """Return the memory with another reserve; its lost sites are noted in words."""
        later = replace(self, kept=kept, frame=frame)
        lost = tuple(f"east {s.east:.1f} north {s.north:.1f} m: {why}" for s, why in later.reserve.lost)
        return replace(later, lost=(self.lost + lost)[-MOST_LOST:])


class JudgingLane:
    """Lane that judges one map after another, and keeps the sites of earlier maps until a newer map refuses them.

    Args:
        appearance: appearance model; None: land cover from the evidence of the map itself only.
        memory: memory of the lane that this one replaces.
        zones: the user's zones in the world; None: there are none.
    """

    def __init__(
        self,
        settings: StageSettings,
        appearance: terrain.Model | None,
        timings: Timings,
        memory: JudgingMemory = JudgingMemory(),
        zones: MapZones | None = None,
    ) -> None:
        self._settings, self._appearance, self._timings, self._zones = settings, appearance, timings, zones
        self.memory = memory

    def judge(self, seen: MapSnapshot) -> Verdict:
        """Return the verdict on a map: land cover, hazards, sites, and candidates with next views."""
        return replace(self.judge_at_end(seen), evidence=None)

    def judge_at_end(self, seen: MapSnapshot) -> Verdict:
        """Return the verdict on the last map of a run, with its evidence."""
        s, frame = self._settings, seen.frame
        self._follow(frame)
        evidence = self._evidence(seen)
        found = judge_evidence(evidence, s, self._timings, self._zones)
        apart = sites.separation(s.sites, s.lander)
        self.memory = self.memory.with_reserve(self.memory.kept.updated(found.sites, found.hazards, apart), frame)
        return replace(found, evidence=evidence)

    def _evidence(self, seen: MapSnapshot) -> MapEvidence:
        """Gather the evidence of a map: its wires, its picture and its land cover."""
        s, t_ns = self._settings, max((v.t_ns for v in seen.views), default=0)
        with_roads = seen.whole or self.memory.wires.is_search_due(seen.views)
        with self._timings.of("wires"):
            self._search_wires(seen)
        with self._timings.of("finer pixels"):
            elevation = as_judged(seen, s.lander)
        _tidy(elevation)
        land_cover = None
        if s.terrain.enabled:
            with self._timings.of("terrain"):
                land_cover = find_land_cover(elevation, s.terrain, self._appearance, with_roads=with_roads)
                land_cover = self._with_earlier(land_cover, t_ns)
            _tidy(elevation)
        assert elevation.fine is not None
        return MapEvidence(
            seen.elevation, elevation.grid, elevation.fine, elevation.picture_sampling, land_cover,
            self.memory.wires.wires, traffic(seen.passed, elevation.grid, land_cover), seen.came.on(elevation.grid),
            seen.missing, observer(seen), seen.position, seen.height_above_ground, seen.frame,
        )  # fmt: skip

    def _search_wires(self, seen: MapSnapshot) -> None:
        """Look for wires if enough views are new, and remember them."""
        known = self.memory.wires
        if known.is_search_due(seen.views):
            found = find_wires(seen.views, on_cells_up_to(seen.elevation, self._settings.lander.judging_cell))
            self.memory = replace(self.memory, wires=known.with_search(found, seen.views, seen.elevation.grid))

    def _with_earlier(self, land_cover: TerrainMap, t_ns: int) -> TerrainMap:
        """Remember the land cover; return it with roofs (G13c), roads (G20) and doubts (T8) of earlier maps."""
        self.memory = replace(self.memory, cover=self.memory.cover.with_seen(land_cover, t_ns))
        land_cover, grid = self.memory.cover.doubted(land_cover), land_cover.grid
        roofs = self.memory.roofs.with_seen(shown_at(grid, land_cover.raised > 0.5), t_ns)
        roads = self.memory.roads
        if land_cover.road is not None:
            roads = roads.with_seen(shown_at(grid, land_cover.road), t_ns)
        known = roads.on(grid)
        land_cover = replace(land_cover, road=known if land_cover.road is None else land_cover.road | known)
        self.memory = replace(self.memory, roofs=roofs, roads=roads)
        return land_cover.with_roofs(np.maximum(land_cover.raised, roofs.on(grid)))

    def _follow(self, frame: MapFrame) -> None:
        """Move the memory of earlier maps into a newer map frame.

        Sites whose clearance does not cover the error of the tie are given up.
        """
        m = self.memory
        if m.frame is not None and frame.frame_id != m.frame.frame_id:
            m = m.tied(m.frame.tie(frame), frame)
        self.memory = replace(m, kept=replace(m.kept, frame_id=frame.frame_id), frame=frame)

    def notes(self, found: Verdict) -> dict[str, object]:
        """Return the notes of a run on a verdict: evidence, quality, sites of earlier maps, and sites given up."""
        coloured = None if found.land_cover is None else found.land_cover.coloured
        out: dict[str, object] = {
            "terrain": terrain.describe(found.elevation, self._settings.terrain, self._appearance, coloured)
        }
        out |= quality_note(found.hazards, self._settings)
        out |= reserve_notes(self.memory.reserve.sites[len(found.sites.sites) :])
        if self.memory.lost:
            out["sites given up"] = list(self.memory.lost)
        return out


def quality_note(found: HazardMap, settings: StageSettings) -> dict[str, object]:
    """Return the note of a run on the obstacles that its judgement can find; empty if no cell could be judged."""
    resolved = found.resolved[np.isfinite(found.resolved)]
    if not resolved.size:
        return {}
    return {
        "quality": f"{settings.parallax.quality}: heights on cells of {found.grid.cell:g} m; on half of the "
        f"ground an obstacle of {float(np.median(resolved)):.2f} m would be found with a chance of 95 %"
    }


def reserve_notes(sites: Sequence[Site]) -> dict[str, object]:
    """Return the notes of a run on the sites in reserve, in the world."""
    lines = [f"east {s.east:.1f} north {s.north:.1f} m, P {p_safe_text(s.p_safe)}" for s in sites]
    return {"sites in reserve": lines} if lines else {}


def _tidy(elevation: ElevationMap) -> None:
    if elevation.height.size > LARGE_MAP:
        memory.give_back()


def judge_evidence(
    evidence: MapEvidence, settings: StageSettings, timings: Timings, zones: MapZones | None = None
) -> Verdict:
    """Return the verdict on the evidence of a map, for the lander and the limits of the settings, and for zones.

    If the lander is judged on cells of another size than the evidence has, the evidence is resampled.
    """
    lander, of = settings.lander, evidence.grid
    with timings.of("hazards"):
        elevation = on_judging_cells(evidence, lander)
        grid = elevation.grid
        land_cover = evidence.land_cover and evidence.land_cover.on(grid)
        passed, came = (v if grid == of else of.nearest_on(grid, v) for v in (evidence.passed, evidence.came))
        found = hazards.assess(
            elevation, land_cover, lander, settings.hazards, evidence.missing, passed, came, evidence.wires
        )
    _tidy(elevation)
    with timings.of("sites"):
        at, others = evidence.frame.offset_world[:2], tuple[GroundZone, ...]()
        if settings.sites.third_party:
            others = third_parties(land_cover, grid, came, settings.hazards.traffic_margin, at)
        limits = MapZones(NO_ZONES if zones is None else zones.plane, lander.reach, others)
        found = limits.judged(found, at)
        chosen = sites.choose_sites(found, land_cover, elevation, settings.sites, lander, evidence.observer)
        chosen = limits.named(chosen, at)
    mapped = without_water(evidence.elevation, land_cover)
    return Verdict(mapped, land_cover, found, chosen, evidence.frame, evidence.missing, others=others)


def on_judging_cells(evidence: MapEvidence, lander: Lander) -> ElevationMap:
    """Return the map on the cells on which a lander is judged, with the picture of the evidence.

    On finer cells than those of the evidence, its picture is used if it has a pixel or more for each of them.
    """
    judged, cell = evidence.grid, lander.judging_cell
    start = on_cells_up_to(evidence.elevation, min(cell, judged.cell))
    times, (rows, cols) = round(judged.cell / start.grid.cell), start.grid.shape
    if pixels := evidence.picture.shape[0] // judged.rows // times:
        picture = evidence.picture[: pixels * rows, : pixels * cols]
        start = replace(start, fine=picture, fine_sampling=upsample(evidence.picture_sampling, times)[:rows, :cols])
    return on_cells_up_to(start, cell)


def as_judged(seen: MapSnapshot, lander: Lander) -> ElevationMap:
    """Resample the map to cells that suit the lander, and add an orthophoto of the views as its finest picture."""
    elevation = on_cells_up_to(seen.elevation, lander.judging_cell)
    picture, sampling = orthophoto(seen.views, elevation)
    for view in seen.views:
        if not isinstance(view.image, np.ndarray):
            view.image.let_go()  # frees hundreds of megabytes before a large map is judged
    return replace(elevation, fine=picture, fine_sampling=sampling)


def find_land_cover(
    elevation: ElevationMap,
    settings: TerrainSettings,
    appearance: terrain.Model | None,
    tables: terrain.Tables | None = None,
    with_roads: bool = True,
) -> TerrainMap:
    """Estimate the land cover on cells of up to `settings.cell` metres, and return it on the map's grid."""
    coarse = on_cells_up_to(elevation, settings.cell)
    return terrain.classify(coarse, settings, appearance, tables, with_roads).on(elevation.grid)


def observer(seen: MapSnapshot) -> Observer | None:
    """Return the vehicle with the cameras that look down at the newest instant; None if no camera does."""
    t_ns = max((v.t_ns for v in seen.views), default=0)
    newest = [v for v in seen.views if v.t_ns == t_ns]
    if not newest:
        return None
    stereo = len({v.cam for v in newest}) > 1
    return Observer(seen.position, seen.height_above_ground, newest[-1].camera.fu, stereo)


def without_water(elevation: ElevationMap, land_cover: TerrainMap | None) -> ElevationMap:
    """Refuse the heights of water: they are flat and smooth with a small sigma, but show the bed.

    On the sample flight this reduces the wrong heights from 10 % of all heights to 1 %.
    """
    if land_cover is None:
        return elevation
    rows, cols = elevation.grid.shape
    water = upsample(terrain.open_water(land_cover), round(land_cover.grid.cell / elevation.grid.cell))[:rows, :cols]
    return replace(elevation, flags=elevation.flags | np.where(water, WET, np.uint16(0)))
