"""Colours of classes differ for people who see all colours, and for people who do not."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
import pytest

from alight.report import paint

SEEN = {  # linear RGB as seen without one kind of cones: Machado, Oliveira and Fernandes (2009), severity 1
    "all": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}
CLASSES = {
    "land cover": {terrain.name: colour for terrain, colour in paint.TERRAIN_COLOURS.items()},
    "reasons": {reason.text: reason.colour for reason in (paint.FIT, *paint.HAZARDS.values())},
    "flags": {reason.text: reason.colour for reason in paint.FLAGS.values()},
}


def lab(colour: str, seen: str) -> np.ndarray:
    """Return a colour in CIE L*a*b* as people with this vision see it."""
    share = np.array(paint.rgb(colour)) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    felt = np.clip(np.array(SEEN[seen]) @ linear, 0, 1).astype(np.float32)
    return cv2.cvtColor(felt[None, None], cv2.COLOR_LRGB2Lab)[0, 0]


@pytest.mark.parametrize("seen", SEEN)
@pytest.mark.parametrize("kind", CLASSES)
def test_classes_differ_in_colour(kind: str, seen: str) -> None:
    """A difference of 2.3 is just noticed; thrice a safe distance in a legend."""
    pairs = combinations(CLASSES[kind].items(), 2)
    apart = {(a, b): np.linalg.norm(lab(x, seen) - lab(y, seen)) for (a, x), (b, y) in pairs}
    assert not {pair: distance for pair, distance in apart.items() if distance < 10}
