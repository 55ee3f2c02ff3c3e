"""Picture of the true ground around a contact, with all objects at that time."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from alight.records import Terrain
from alight.records.campaign import StrikeLine, TouchdownLine
from alight.report.canvas import webp
from alight.report.paint import TERRAIN_COLOURS, hillshade, rgb
from alight_sim.movers import Moving
from alight_sim.oracle import TrueSurface
from alight_sim.world import World

AROUND = 4.0  # footprint radii that are shown each way
PIXELS = 480
RING = ((20, 20, 20), 5), ((255, 255, 255), 2)  # colour and width, one over the other


def ground_picture(
    world: World, contact: TouchdownLine | StrikeLine, radius: float, bodies: Sequence[Moving] = ()
) -> bytes:
    """WebP, north up: classes by colour, shaded relief, the footprint as a ring.

    Args:
        world: the ground, and what moves on it.
        contact: its place and time.
        radius: metres, of the footprint.
        bodies: that have come on command.
    """
    half, e, n = AROUND * radius, contact.east, contact.north
    surface = TrueSurface.of(world, (e - half, n - half, e + half, n + half), contact.t, bodies)
    height, label = surface.height[::-1].astype(np.float32), surface.label[::-1]
    colours = np.zeros((*label.shape, 3), np.float32)
    for terrain, text in TERRAIN_COLOURS.items():
        colours[label == terrain] = rgb(text)
    colours[label == Terrain.UNKNOWN] = 128.0
    shaded = colours * hillshade(height, np.ones(height.shape, bool), surface.cell)[..., None]
    image = cv2.resize(shaded.clip(0, 255).astype(np.uint8), (PIXELS, PIXELS), interpolation=cv2.INTER_LINEAR)
    middle, ring = (PIXELS // 2, PIXELS // 2), round(PIXELS * radius / (2 * half))
    for colour, width in RING:
        cv2.circle(image, middle, ring, colour, width, cv2.LINE_AA)
        cv2.drawMarker(image, middle, colour, cv2.MARKER_CROSS, 14, width, cv2.LINE_AA)
    return webp(image)
