"""Views of a simulated flight with their true poses."""

from __future__ import annotations

from collections.abc import Iterator

import alight_sim as simulate
from alight.records import Frame, View


def exposures(flight: simulate.SimulatedFlight) -> Iterator[list[View]]:
    """The views of each exposure with their true poses."""
    for event in flight.events():
        if isinstance(event, Frame):
            body = flight.pose(event.t_ns)
            yield [
                View(event.t_ns, i, image, cam.camera, body @ cam.body_from_cam)
                for i, (cam, image) in enumerate(zip(flight.true_rig.cameras, event.images, strict=True))
                if image is not None
            ]
