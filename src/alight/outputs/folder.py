"""The folder of a run: its files, the reasons for missing files, and the order of writing."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from alight import __version__, report
from alight.documents import LARGEST_JSON, DocumentError, parse_json, read_text
from alight.outputs import plan, rasters, vectors
from alight.outputs.atomic_write import ANOTHER, output_error, partial_path, write_whole
from alight.outputs.evidence import EVIDENCE, encode_evidence
from alight.outputs.folder_lock import LOCK, holds_folder, lock_folder, release_folder
from alight.records import ElevationMap, OutputError, RunResult

log = logging.getLogger(__name__)

RUN_JSON = "run.json"
FILES = (
    *("dem.tif", "flags.tif", "ortho.tif", "terrain.tif", "safe.tif", "reasons.tif", "sites.geojson", "route.plan"),
    *("route.geojson", "wires.geojson", "trajectory.tum", "trajectory.csv", "report.html"),
    EVIDENCE,
)
KNOWN = (RUN_JSON, *FILES, "hazards.tif", "heights.tif")  # the last two are written by `alight hazards`
BY_OTHERS = (
    ".DS_Store",
    "Thumbs.db",
    "desktop.ini",
    ".nfs*",
    "*.aux.xml",
    "*.qml",
)  # file managers, NFS, GDAL and QGIS
WORK = "unfinished-work"  # folder of an interrupted run
NO_PLACE = "the input has no place on Earth; run.json has the sites in metres"

# file name -> the function that returns the content or a file to be moved, or the reason why there is none
Contents = dict[str, Callable[[], bytes | Path] | str]


def _rasters(r: RunResult) -> Contents:
    crs = rasters.raster_crs(r.local, r.georeferenced)
    files: Contents = {}

    def tif(make: Callable[[Any], rasters.RasterFile], part: Any) -> bytes:
        return rasters.encode(make(part), crs)

    def add(part: Any, why: str, **makers: Callable[[Any], rasters.RasterFile]) -> None:
        for name, make in makers.items():
            files[f"{name}.tif"] = why if part is None else partial(tif, make, part)

    dem = partial(rasters.dem_raster, local=r.local, georeferenced=r.georeferenced)
    add(r.elevation, "no heights were found", dem=dem, flags=rasters.flags_raster, ortho=rasters.ortho_raster)
    add(r.hazards_as_mapped, "the ground was not judged", safe=rasters.safe_raster, reasons=rasters.reasons_raster)
    add(r.terrain_as_mapped, "the kind of ground was not judged", terrain=rasters.terrain_raster)
    return files


def _sites(r: RunResult) -> Contents:
    if r.sites.listed and not r.georeferenced:  # an answer without a site or candidate needs no place on Earth
        return {"sites.geojson": NO_PLACE}
    covariance = r.elevation.place_covariance if r.elevation is not None else None
    return {"sites.geojson": lambda: vectors.json_bytes(vectors.sites_geojson(r.sites, r.local, covariance))}


def _route(r: RunResult) -> Contents:
    route = r.route
    if route is None or not route.waypoints:
        why = "no route was planned" if r.sites.sites else "there is no site to fly to"
    elif not r.georeferenced:
        why = NO_PLACE
    else:
        return {
            "route.plan": lambda: vectors.json_bytes(plan.route_plan(route, r.local, r.settings, r.home)),
            "route.geojson": lambda: vectors.json_bytes(vectors.route_geojson(route, r.local)),
        }
    return dict.fromkeys(("route.plan", "route.geojson"), why)


def _wires(r: RunResult) -> Contents:
    if r.hazards is None:
        return {"wires.geojson": "the ground was not judged"}
    wires = r.hazards.wires
    if wires and not r.georeferenced:  # that there is none needs no place on Earth
        return {"wires.geojson": NO_PLACE}
    return {"wires.geojson": lambda: vectors.json_bytes(vectors.wires_geojson(wires, r.local))}


def report_file(result: RunResult, others: Contents) -> Contents:
    """Return the report as an entry for `write_folder`; it lists the `others`, or why they are not written."""
    files = {name: made if isinstance(made, str) else "" for name, made in (others | {RUN_JSON: bytes}).items()}
    return {"report.html": lambda: report.render(result, files).encode("utf-8", vectors.UNENCODABLE)}


def contents(r: RunResult) -> Contents:
    """Return all files but run.json, in the order of writing; for a file in `r.not_written`, its reason."""
    makers = {"trajectory.tum": vectors.tum, "trajectory.csv": vectors.csv}
    motion: Contents = {
        name: partial(make, r.motions) if r.motions else "the motion was not estimated" for name, make in makers.items()
    }
    judged = r.evidence is not None and r.hazards is not None
    kept: Contents = {EVIDENCE: partial(encode_evidence, r) if judged else "the ground was not judged"}
    # the answer first: on a full disk, the small and most important files still fit
    files = _sites(r) | _route(r) | _wires(r) | motion | _rasters(r) | kept
    return files | report_file(r, files | dict(r.not_written)) | dict(r.not_written)


def timing_summary(timings: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return number, median, 95th percentile and sum of the seconds per step for each stage that has steps."""
    found = {}
    for stage, steps in timings.items():
        if len(steps):
            s = np.asarray(steps, dtype=np.float64)
            values = {"median_s": np.median(s), "p95_s": np.percentile(s, 95), "total_s": s.sum()}
            found[stage] = {"steps": s.size} | {k: round(float(v), 6) for k, v in values.items()}
    return found


def run_json(result: RunResult, missing: Mapping[str, str]) -> dict[str, Any]:
    """Return the content of run.json; `missing` gives the reason for each file that was not written."""
    local = result.local
    origin = {"latitude": local.latitude, "longitude": local.longitude, "height": local.height}
    height = result.height_above_ground
    return {
        "alight": __version__,
        "input": {"name": result.source_name, "kind": result.source_kind},
        "georeferenced": result.georeferenced,
        "origin": origin if result.georeferenced else None,
        "answer": vectors.answer_json(result.sites),
        "height_above_ground_m": None if height is None else vectors.number(height, 3),
        "counts": vectors.plain(result.counts),
        "common_error": common_error(result.elevation),
        "notes": vectors.plain(result.notes),
        "photos": [vectors.plain(row.as_json()) for row in result.photos],
        "diary": None if result.diary is None else [vectors.plain(e.as_tree()) for e in result.diary.entries],
        "warnings": report.warnings(result),
        "time": timing_summary(result.timings),
        "not_written": dict(missing),
        "settings": result.settings.model_dump(mode="json"),
    }


def common_error(elevation: ElevationMap | None) -> dict[str, Any] | None:
    """Return the common error of all heights, as in dem.tif's tags; None: the poses have no covariance."""
    if elevation is None or elevation.datum is None:
        return None
    g = elevation.datum
    offset, east, north = np.sqrt(np.diag(g.covariance))
    return {
        "offset_sigma_m": vectors.number(float(offset), 4),
        "tilt_sigma_rad": [vectors.number(float(v), 6) for v in (east, north)],
        "centre_m": [vectors.number(v, 3) for v in (g.east, g.north)],
        "covariance": [[float(f"{v:.6g}") for v in row] for row in g.covariance],
    }


def is_run(folder: Path) -> bool:
    """Whether the folder holds a finished run of Alight."""
    try:
        tree = parse_json(read_text(folder / RUN_JSON, LARGEST_JSON))
    except (OSError, DocumentError):
        return False
    return isinstance(tree, dict) and "alight" in tree


def is_work(path: Path) -> bool:
    """Whether a path is the folder with the saved work of an interrupted run."""
    return path.name == WORK and path.is_dir() and not path.is_symlink()


def remove_work(out: Path) -> None:
    """Remove the saved work of an interrupted run from the output folder."""
    if is_work(out / WORK):
        shutil.rmtree(out / WORK, ignore_errors=True)


def new_work(out: Path) -> Path:
    """Return an empty folder within the output folder, for files that are moved there at the end."""
    remove_work(out)
    (out / WORK).mkdir()
    return out / WORK


def is_finished(folder: Path) -> bool:
    """Whether the folder holds a finished run and no saved work of a later, unfinished run."""
    return is_run(folder) and not is_work(folder / WORK)


def _is_ours(folder: Path) -> bool:
    """Whether the folder is empty, holds a finished run, or holds only the files of an interrupted run."""
    names = {LOCK, *KNOWN, "recording.rrd"}
    names |= {partial_path(Path(name)).name for name in names} | {"recording.mcap"}

    def is_by_others(path: Path) -> bool:  # files that a system or another program puts into any folder
        return path.is_file() and any(fnmatchcase(path.name, pattern) for pattern in BY_OTHERS)

    def is_known(path: Path) -> bool:  # includes recordings that a later run has kept (`recorder.make_room`)
        return path.is_file() and (path.name in names or fnmatchcase(path.name, "recording-*.mcap"))

    there = [p for p in folder.iterdir() if not is_by_others(p)]
    began = not there or any(p.name == LOCK or p.name.endswith(".tmp") for p in there)
    return is_run(folder) or (began and all(is_work(p) or is_known(p) for p in there))


def _check_folder(out: Path, overwrite: bool) -> None:
    """Raise OutputError for files that are not a run's (unless `overwrite`), or a folder in an output file's place."""
    if not overwrite and not _is_ours(out):
        raise OutputError(f"{out}: holds files that are not a run's; {ANOTHER} or add --force")
    for path in (out / name for name in KNOWN):
        if path.is_dir() and not path.is_symlink():
            raise OutputError(f"{path}: is a folder, and a file of this name is to be written; remove it or {ANOTHER}")


def prepare_folder(out: Path, overwrite: bool = False, inputs: Sequence[Path] = ()) -> None:
    """Create the folder, test that it can be written, and lock it, before the work whose results it will hold.

    An earlier run is replaced; a folder with other files is refused. Once this process has locked the folder, other
    files that appear in it do not matter.

    Args:
        out: output folder.
        overwrite: whether a folder with other files is accepted.
        inputs: files that the work reads; they must not lie in the folder.

    Raises:
        OutputError: the folder is a file, cannot be written, or is locked by another process; or it holds an input, a
            folder with the name of an output file, or other files while `overwrite` is false.
    """
    probe = out / ".alight.tmp"
    try:
        if out.exists() and not out.is_dir():
            raise OutputError(f"{out}: is a file, not a folder; {ANOTHER}")
        if within := [path for path in inputs if out.resolve() in path.resolve().parents]:
            raise OutputError(
                f"{within[0]}: lies in {out}, whose files are replaced; {ANOTHER}, or copy the input elsewhere"
            )
        out.mkdir(parents=True, exist_ok=True)
        if not holds_folder(out):
            _check_folder(out, overwrite)
        probe.write_bytes(b"")
        probe.unlink()
        lock_folder(out)
    except OSError as e:
        raise output_error(out, e) from e


def _is_note(path: Path) -> bool:
    """Whether a file is GDAL's or QGIS' notes on a raster (statistics, colours), which are wrong for a new raster."""
    with suppress(OSError):
        return path.is_file() and b"<PAMDataset" in path.read_bytes()[:200]
    return False


def write_folder(
    files: Contents, info: Callable[[Mapping[str, str]], dict[str, Any]], out: Path, overwrite: bool = False,
    inputs: Sequence[Path] = (),
) -> list[Path]:  # fmt: skip
    """Write a folder, each file atomically and run.json last; return the paths of the files written.

    The run.json of an earlier run is removed first, then its other files. So all files beside a run.json are of one
    run, and no old file stays beside a new answer. If a file cannot be written or removed, the others are still
    written, run.json lists the missing files, and then the error is raised.

    Args:
        files: all files but run.json, in the order of writing; for a file that is not written, the reason.
        info: returns the content of run.json, from the missing files and their reasons.
        out: output folder.
        overwrite: whether a folder with other files is accepted.
        inputs: files that were read; they must not lie in the folder.

    Raises:
        OutputError: see `prepare_folder`; or the disk is full: the message names the missing files.
    """
    prepare_folder(out, overwrite, inputs)
    written, missing, failed = list[Path](), dict[str, str](), dict[str, Exception]()
    old = dict.fromkeys((RUN_JSON, *KNOWN, *files))
    for name in [*old, *(note for name in old if _is_note(out / (note := f"{name}.aux.xml")))]:
        try:
            (out / name).unlink(missing_ok=True)
        except OSError as e:
            failed[name] = output_error(out / name, e)
            if name == RUN_JSON:
                raise failed[name] from e
    for name, made in (*files.items(), (RUN_JSON, lambda: vectors.json_bytes(info(missing)))):
        if isinstance(made, str):
            missing[name] = str(failed.get(name, made))
            log.info("%s is not written: %s", name, made)
            continue
        try:
            write_whole(out / name, made())
            written.append(out / name)
            failed.pop(name, None)
        except OutputError as e:
            failed[name], missing[name] = e, str(e)
        except Exception as e:
            log.error("%s: could not be made: %s", name, e)
            failed[name], missing[name] = e, "it could not be made: a defect of Alight"
    if is_run(out) or not written:
        release_folder(out)
    if refused := [name for name, e in failed.items() if isinstance(e, OutputError)]:
        also = f"; nor could {', '.join(refused[1:])}" if refused[1:] else ""
        raise OutputError(f"{failed[refused[0]]}{also}; {len(written)} other files are whole")
    if failed:
        raise next(iter(failed.values()))
    remove_work(out)
    return written


def unchanged(result: RunResult) -> tuple[str, ...]:
    """Return the files that are the same for every judgement of a run on cells of the same size."""
    evidence, hazards = result.evidence, result.hazards
    if evidence is None or hazards is None or hazards.grid.cell != evidence.grid.cell:
        return (EVIDENCE,)
    return "dem.tif", "flags.tif", "ortho.tif", "terrain.tif", EVIDENCE


def write_run(result: RunResult, out: Path, overwrite: bool = False, same_as: Path | None = None) -> list[Path]:
    """Write the folder of one run and return the paths of the files written; see `write_folder`.

    `same_as`: folder of the run that was judged again; the files that another judgement does not change are copied.
    """
    files = contents(result)
    for path in () if same_as is None else (same_as / name for name in unchanged(result)):
        if callable(files[path.name]) and path.is_file():
            files[path.name] = path.read_bytes
    return write_folder(files, partial(run_json, result), out, overwrite)
