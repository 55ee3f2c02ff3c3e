"""Repeated photos of a set: copies of a file, and pictures saved again with the tags of the same exposure."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from hashlib import file_digest

import cv2
import numpy as np

from alight.arrays import F64, U8
from alight.photos.reading.photo_selection import LeftOut
from alight.photos.reading.photo_tags import PhotoTags
from alight.raster import grey_levels

ALIKE = 0.98  # least correlation of two pictures of one exposure, made small; neighbours with 90 % overlap have less


def repeated_photos(photos: Sequence[PhotoTags], read: Callable[[PhotoTags], U8]) -> LeftOut:
    """Return the photos to leave out because the set holds a better copy: larger, or equally large with a shorter name.

    Copies have equal bytes, or they have equal cameras, times and positions and their pictures look alike.

    Args:
        photos: all photos of the set.
        read: decodes a photo, (H, W) or (H, W, 3); may raise ValueError.
    """
    best_first = sorted(photos, key=lambda p: (-p.size[0] * p.size[1], len(p.path.name), p.path))
    out = list[PhotoTags]()
    for group in _groups(best_first, lambda p: p.path.stat().st_size):
        out += [p for same in _groups(group, _bytes_of) for p in same[1:]]
    left = {p.path for p in photos} - {p.path for p in out}
    for group in _groups([p for p in best_first if p.path in left], _exposure_of):
        small = [_small(p, read) for p in group]
        out += [p for k, p in enumerate(group) if any(_alike(small[k], s) for s in small[:k])]
    warning = f"{len(out)} photo(s) are in the set twice and count once (first: {out[0].path.name})" if out else ""
    return LeftOut({p.path: "the set holds it twice" for p in out}, "repeated photos", warning)


def _groups(photos: Iterable[PhotoTags], key: Callable[[PhotoTags], Hashable]) -> list[list[PhotoTags]]:
    """Return the groups of two or more photos with equal keys; a photo whose key is None is in no group."""
    found = defaultdict[Hashable, list[PhotoTags]](list)
    for photo in photos:
        found[key(photo)].append(photo)
    return [group for value, group in found.items() if value is not None and len(group) > 1]


def _bytes_of(photo: PhotoTags) -> str:
    with photo.path.open("rb") as file:
        return file_digest(file, "blake2b").hexdigest()


def _exposure_of(photo: PhotoTags) -> Hashable:
    """Return a key that identifies an exposure by its tags; None if time or position is missing."""
    if photo.time_ns is None or photo.place is None:
        return None
    camera = photo.camera._replace(size=(0, 0))
    return (camera, photo.time_ns, *(round(angle, 7) for angle in photo.place))


def _small(photo: PhotoTags, read: Callable[[PhotoTags], U8]) -> F64 | None:
    with suppress(ValueError):
        return np.asarray(cv2.resize(grey_levels(read(photo)), (32, 32), interpolation=cv2.INTER_AREA), np.float64)
    return None


def _alike(a: F64 | None, b: F64 | None) -> bool:
    if a is None or b is None or not min(np.ptp(a), np.ptp(b)):
        return False
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1]) > ALIKE
