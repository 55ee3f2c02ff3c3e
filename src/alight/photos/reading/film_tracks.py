"""Find a film's telemetry, in a file next to it or in one of its tracks."""

from __future__ import annotations

import shutil
import subprocess
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from pathlib import Path

from alight.documents import LARGEST_JSON, DocumentError, read_bytes
from alight.photos.reading.film_telemetry import FilmTelemetry, TelemetryRow
from alight.photos.reading.gpmf import read_gpmf
from alight.photos.reading.subtitles import Subtitle, read_subtitles, subtitles_in, telemetry_of
from alight.records import InputError

SUBTITLES = (".srt", ".ass", ".vtt")


def telemetry_beside(film: Path) -> FilmTelemetry | None:
    """Read the telemetry from the subtitles or GPX track that share the film's name; None if there is no such file.

    Raises:
        InputError: no file holds a position, or a file cannot be used.
    """
    files = {p.suffix.lower(): p for p in sorted(film.parent.iterdir()) if p.stem == film.stem}
    found = [files[suffix] for suffix in (*SUBTITLES, ".gpx") if suffix in files]
    for path in found:
        try:
            text = read_bytes(path, LARGEST_JSON).decode("utf-8-sig", errors="replace")
        except DocumentError as e:
            raise InputError(f"{path}: {e}") from e
        telemetry = (read_gpx if path.suffix.lower() == ".gpx" else read_subtitles)(text, str(path))
        if telemetry.rows:
            return telemetry
    if found:
        raise InputError(
            f"{found[-1]}: no place in it; needs subtitles with [latitude: ...] [longitude: ...] [abs_alt: ...], or "
            "with GPS(...) and BAROMETER:..."
        )
    return None


def read_gpx(text: str, source: str) -> FilmTelemetry:
    """Parse the track of a GPX file; its clock begins at its first point.

    Raises:
        InputError: the text is not a GPX track, or no point has a time.
    """
    try:
        if "<!DOCTYPE" in text or "<!ENTITY" in text:  # no GPX track has a document type, which is a known attack
            raise InputError(f"{source}: has a document type; give a GPX track")
        points = ET.fromstring(text).iterfind(".//{*}trkpt")
        timed = [(datetime.fromisoformat(t.strip()), p) for p in points if (t := p.findtext("{*}time"))]
        timed = [(at if at.tzinfo else at.replace(tzinfo=UTC), p) for at, p in timed]
        rows = []
        for at, p in timed:
            written = {"latitude": p.attrib["lat"], "longitude": p.attrib["lon"], "abs_alt": p.findtext("{*}ele")}
            values = {name: float(text) for name, text in written.items() if text}
            rows.append(TelemetryRow((at - timed[0][0]).total_seconds(), values, at))
    except (ET.ParseError, KeyError, ValueError) as e:
        raise InputError(f"{source}: no GPX track: {e}") from e
    if not rows:
        raise InputError(f"{source}: no point of a track (trkpt) has a time; export the track with times")
    return FilmTelemetry.of(rows, source, of_film=False)


def telemetry_inside(film: Path, seconds: float) -> FilmTelemetry | None:
    """Read the telemetry from a track of a film; None if no track can be read.

    Args:
        film: the film's path.
        seconds: length of the film.

    Raises:
        InputError: neither `av` nor `ffmpeg` is installed.
    """
    try:
        import av  # noqa: F401
    except ImportError:
        if shutil.which("ffmpeg") is None:
            raise InputError(
                f"{film}: has no telemetry; put {film.stem}.srt or {film.stem}.gpx beside it, or, if a track of the "
                "film has it, pip install 'alight[films]', or install ffmpeg"
            ) from None
        payloads, subtitles = _by_ffmpeg(film, seconds)
    else:
        payloads, subtitles = _by_av(film)
    name = f"a track of {film}"
    found = (read_gpmf(payloads, name), telemetry_of(subtitles, name))
    return next((telemetry for telemetry in found if telemetry.rows), None)


def _by_av(film: Path) -> tuple[list[tuple[float, bytes]], list[Subtitle]]:
    """Return (seconds, GPMF payload) pairs and the subtitles, read by `av`."""
    import av

    payloads, subtitles = list[tuple[float, bytes]](), list[Subtitle]()
    try:
        with av.open(str(film)) as file:
            tracks = [s for s in file.streams if s.type in ("data", "subtitle")]
            for packet in file.demux(*tracks) if tracks else ():
                data, kind = bytes(packet), packet.stream.type
                if packet.pts is None or packet.time_base is None or not data:
                    continue
                seconds = float(packet.pts * packet.time_base)
                if kind == "subtitle":
                    skip = 2 if int.from_bytes(data[:2], "big") == len(data) - 2 else 0  # mov_text: the length is first
                    body = data[skip:].decode("utf-8", errors="replace").replace("\\N", "\n")
                    subtitles.append((seconds, body))
                elif data.startswith(b"DEVC"):
                    payloads.append((seconds, data))
    except av.error.FFmpegError:
        pass  # a damaged file: use what came before the damage
    return payloads, subtitles


def _by_ffmpeg(film: Path, seconds: float) -> tuple[list[tuple[float, bytes]], list[Subtitle]]:
    """Return what `_by_av` returns, read by `ffmpeg`; the payloads are assumed to be evenly spaced in time."""

    def track(*arguments: str) -> bytes:
        command = ["ffmpeg", "-v", "error", "-nostdin", "-i", str(film), *arguments, "-"]
        return subprocess.run(command, capture_output=True, check=False).stdout

    parts = track("-map", "0:d", "-c", "copy", "-f", "data").split(b"DEVC")[1:]
    payloads = [(k * seconds / len(parts), b"DEVC" + part) for k, part in enumerate(parts)]
    return payloads, subtitles_in(track("-map", "0:s:0", "-f", "srt").decode("utf-8", errors="replace"))
