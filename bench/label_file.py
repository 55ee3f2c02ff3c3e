"""Labels drawn by eye: polygons in the pixels of photos, their file, and the checks of it.

A label is a ring in one photo, in pixels of the file as delivered; the centre of the top-left pixel is (0, 0). A pixel
of a photo never moves, whereas a place on Earth moves with every run's poses: `label_projection` takes the rings to a
run's map by the run's own poses, lens and heights.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from alight.arrays import F64, Mask

HAZARDS = (
    "water",
    "tree",
    "bush_or_tall_plants",
    "rubble_or_rocks",
    "vehicle",
    "building_or_structure",
    "pipe_or_pile",
    "pole_or_post",
    "person",
)
OPEN = ("lawn", "paved", "slab", "bare_smooth", "gravel_road")  # a person would land here
ROUGH, UNSURE = "rough_or_uneven", "unsure"
KINDS = (*HAZARDS, *OPEN, ROUGH, UNSURE)
EDGE_SHARE = 0.03  # of a ring's area that may cross the edge of a contradictory one: the accuracy of drawing


@dataclass(frozen=True, eq=False)
class Label:
    """One polygon of one kind of ground in one photo."""

    photo: str
    kind: str
    ring: F64  # (N, 2) pixels (u, v); the last vertex joins the first
    note: str = ""


@dataclass(frozen=True, eq=False)
class Labels:
    """All polygons of one folder of photos."""

    name: str
    width: int  # px, of every photo
    height: int  # px
    times: dict[str, int]  # ns, capture time of each photo by its file name, as in a run's trajectory
    polygons: tuple[Label, ...]

    def of_photo(self, photo: str) -> tuple[Label, ...]:
        """The polygons of one photo."""
        return tuple(p for p in self.polygons if p.photo == photo)

    def mask(self, label: Label) -> Mask:
        """The pixels of a photo that a polygon covers, (height, width)."""
        canvas = np.zeros((self.height, self.width), np.uint8)
        cv2.fillPoly(canvas, [np.rint(label.ring).astype(np.int32)], 1)
        return np.asarray(canvas > 0)


def read_labels(path: Path) -> Labels:
    """Read a file of labels.

    Raises:
        ValueError: the file is no file of labels, with the name of the missing key.
    """
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        polygons = tuple(
            Label(p["photo"], p["kind"], np.array(p["ring"], np.float64).reshape(-1, 2), p.get("note", ""))
            for p in tree["polygons"]
        )
        times = {name: int(t) for name, t in tree["photos"].items()}
        return Labels(tree["set"], int(tree["width"]), int(tree["height"]), times, polygons)
    except (KeyError, TypeError, ValueError) as e:
        raise ValueError(f"{path}: no file of labels ({type(e).__name__}: {e})") from e


def labels_json(labels: Labels) -> str:
    """The text of a file of labels, one polygon a line; times are text, since a browser rounds numbers as large."""
    head: dict[str, Any] = {"set": labels.name, "width": labels.width, "height": labels.height}
    lines = [f" {json.dumps(k)}: {json.dumps(v)}," for k, v in head.items()]
    photos = ",\n".join(f'  {json.dumps(n)}: "{t}"' for n, t in sorted(labels.times.items()))
    polygons = ",\n".join("  " + json.dumps(_entry(p)) for p in labels.polygons)
    return "\n".join(["{", *lines, ' "photos": {', photos, " },", ' "polygons": [', polygons, " ]", "}"]) + "\n"


def _entry(p: Label) -> dict[str, Any]:
    ring = [[float(u) if u % 1 else int(u), float(v) if v % 1 else int(v)] for u, v in p.ring.round(1)]
    return {"photo": p.photo, "kind": p.kind, "ring": ring} | ({"note": p.note} if p.note else {})


def problems(labels: Labels) -> list[str]:
    """Faults of labels, one sentence each: kinds, photos, rings, and polygons that contradict one another."""
    found = [f"polygon {i}: {why}" for i, p in enumerate(labels.polygons) for why in _ring_problems(p, labels)]
    return found or list(_contradictions(labels))


def _ring_problems(p: Label, labels: Labels) -> Iterator[str]:
    if p.kind not in KINDS:
        yield f"kind {p.kind!r} is unknown"
    if p.photo not in labels.times:
        yield f"photo {p.photo!r} is not in the list of photos"
    if len(p.ring) < 3:
        yield f"{len(p.ring)} vertices are no polygon"
        return
    if not np.isfinite(p.ring).all():
        yield "a vertex is not finite"
        return
    if (p.ring < -0.5).any() or (p.ring > [labels.width - 0.5, labels.height - 0.5]).any():
        yield "a vertex lies outside the photo"
    if _crosses_itself(p.ring):
        yield "its ring crosses itself"


def _crosses_itself(ring: F64) -> bool:
    """Return whether two edges of a closed ring that are no neighbours cross."""
    edges = list(pairwise([*ring, ring[0]]))
    n = len(edges)
    return any(_meet(*edges[i], *edges[j]) for i, j in combinations(range(n), 2) if j - i > 1 and (i or j < n - 1))


def _meet(a: F64, b: F64, c: F64, d: F64) -> bool:
    """Return whether the segments a-b and c-d cross."""

    def side(p: F64, q: F64, r: F64) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def _contradictions(labels: Labels) -> Iterator[str]:
    """Sentences on open ground whose edge crosses a hazard or rough ground in the same photo.

    A hazard wholly inside open ground is no contradiction: it is a thing that stands there, and it wins.
    """
    for photo in labels.times:
        mine = [(i, p) for i, p in enumerate(labels.polygons) if p.photo == photo]
        masks = {i: labels.mask(p) for i, p in mine}
        for (i, p), (j, q) in combinations(mine, 2):
            if (p.kind in OPEN) == (q.kind in OPEN) or UNSURE in (p.kind, q.kind):
                continue
            share = _crossing_share(masks[i], masks[j]) if p.kind in OPEN else _crossing_share(masks[j], masks[i])
            if share > EDGE_SHARE:
                yield f"polygons {i} ({p.kind}) and {j} ({q.kind}) of {photo} contradict each other on {share:.0%}"


def _crossing_share(ground: Mask, thing: Mask) -> float:
    """Share of a thing that lies on open ground, if it lies partly beside it; 0 if it is inside or outside."""
    share = float((ground & thing).sum() / thing.sum())
    return 0.0 if share > 1 - EDGE_SHARE else share


def counts(polygons: Sequence[Label]) -> dict[str, int]:
    """Number of polygons of each kind that occurs, in the order of `KINDS`."""
    return {k: n for k in KINDS if (n := sum(p.kind == k for p in polygons))}
