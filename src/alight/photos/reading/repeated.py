"""Repeated photos of a set: copies of a file, and pictures saved again with the tags of the same exposure."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from hashlib import blake2b

import cv2
import numpy as np

from alight.arrays import F64, U8
from alight.photos.reading.photo_selection import LeftOut
from alight.photos.reading.photo_tags import PhotoTags
from alight.raster import grey_levels

ALIKE = 0.98  # least correlation of two pictures of one exposure, made small; neighbours with 90 % overlap have less


def repeated_photos(photos: Sequence[PhotoTags], read: Callable[[PhotoTags], U8]) -> LeftOut:
    """Return the photos to leave out because the set holds a better copy: larger, else with more tags.

    Copies have equal bytes, or their tags may be of one exposure (`_may_be_one`) and their pictures look alike.

    Args:
        photos: all photos of the set.
        read: decodes a photo, (H, W) or (H, W, 3); may raise ValueError.
    """
    best_first = sorted(
        photos, key=lambda p: (-p.size[0] * p.size[1], -len(p.exif) - len(p.gps) - len(p.xmp), len(p.path.name), p.path)
    )
    out = list[PhotoTags]()
    for group in _groups(best_first, lambda p: p.path.stat().st_size):
        out += [p for same in _groups(group, lambda p: blake2b(p.path.read_bytes()).digest()) for p in same[1:]]
    copies = {p.path for p in out}
    left = [p for p in best_first if p.path not in copies]

    @cache
    def small(number: int) -> F64:
        """Return a small picture (1024,) without its mean, of length 1; zeros if it is flat or cannot be read."""
        with suppress(ValueError):
            grey = cv2.resize(grey_levels(read(left[number])), (32, 32), interpolation=cv2.INTER_AREA)
            off = grey.ravel() - np.mean(grey, dtype=np.float64)
            return np.asarray(off / (np.linalg.norm(off) or 1.0))
        return np.zeros(32 * 32)

    out += [left[k] for k, better in _may_be_one(left) if any(small(k) @ small(j) > ALIKE for j in better)]
    warning = f"{len(out)} photo(s) are in the set twice and count once (first: {out[0].path.name})" if out else ""
    return LeftOut({p.path: "the set holds it twice" for p in out}, "repeated photos", warning)


def _groups(photos: Iterable[PhotoTags], key: Callable[[PhotoTags], Hashable]) -> list[list[PhotoTags]]:
    """Return the groups of two or more photos with equal keys; a photo whose key is None is in no group."""
    found = defaultdict[Hashable, list[PhotoTags]](list)
    for photo in photos:
        found[key(photo)].append(photo)
    return [group for value, group in found.items() if value is not None and len(group) > 1]


def _may_be_one(photos: Sequence[PhotoTags]) -> Iterator[tuple[int, list[int]]]:
    """Yield the index of each photo that may show the exposure of earlier photos, and the indices of those photos.

    The photos have equal cameras, times and positions; time or position, but not both, may be missing in one of them.
    Programs that save a photo again may drop the fraction of a second, and round the position by up to 1e-5 degrees.
    """
    cameras = np.unique([f"{c.make}|{c.model}|{c.band}" for c in (p.camera for p in photos)], return_inverse=True)[1]
    times = [p.time_ns for p in photos]
    whole, part = np.array([(np.nan, 0) if t is None else divmod(t, 10**9) for t in times]).reshape(-1, 2).T
    places = np.array([p.place or (np.nan, np.nan) for p in photos]).reshape(-1, 2)
    for k in range(1, len(photos)):
        later = np.abs(whole[:k] - whole[k])
        same_time = (later == 0) & ((part[:k] == part[k]) | (part[:k] == 0) | (part[k] == 0))
        away = np.abs(places[:k] - places[k]).max(axis=1)
        fits = (same_time | np.isnan(later)) & ((away <= 1e-5) | np.isnan(away)) & ~(np.isnan(later) & np.isnan(away))
        if len(better := np.flatnonzero(fits & (cameras[:k] == cameras[k]))):
            yield k, better.tolist()
