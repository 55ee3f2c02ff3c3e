"""Turn the structure-from-motion reference of the `mirafiori` photos into inputs of `alight run`.

    python bench/mirafiori_reference.py ../shared/data/mirafiori out/reference.tum
    alight run ../shared/data/mirafiori/images --out out/mirafiori-reference --poses out/reference.tum \
        --set sources.calibration=out/reference.camchain.yaml

The reference has its own lens: its principal point is 24 px from the maker's, which its poses compensate by 0.7 degrees
of tilt. So poses and lens belong together, and both are written.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from alight.geometry import LocalFrame, Pose
from alight.records import Frame
from alight.runner.opening import open_source
from alight.settings import Settings
from alight.sources import Source


def moved(local: LocalFrame, reference: LocalFrame, pose: Pose) -> Pose:
    """A pose of the reference's ENU in that of the source, through geodetic coordinates."""
    ends = pose.translation + np.concatenate(
        [np.zeros((1, 3)), 1000 * pose.rotation.T]
    )  # its axes as points in the world
    origin, *axes = local.to_enu(*reference.to_geodetic(ends))
    U, _, Vt = np.linalg.svd((np.array(axes) - origin) / 1000)
    return Pose((U @ Vt).T, origin)


def body_poses(source: Source, folder: Path) -> dict[int, Pose]:
    """`world_from_body` by time, ns, for every photo of the reference."""
    z = np.load(folder / "sfm_reference.npz")
    reference = LocalFrame(*z["origin_llh"])
    index = {str(name): i for i, name in enumerate(z["names"])}
    body_from_cam = source.rig.cameras[0].body_from_cam
    poses = {}
    for frame in (e for e in source.events() if isinstance(e, Frame)):
        i = index[frame.name]
        world_from_cam = Pose(z["R_cam_from_enu"][i].T, z["centers_enu"][i])
        poses[frame.t_ns] = moved(source.local, reference, world_from_cam) @ body_from_cam.inverse
    return poses


def tum_line(t_ns: int, pose: Pose) -> str:
    """One line of TUM, its time exact to the nanosecond."""
    w, x, y, z = pose.quaternion
    numbers = " ".join(f"{v:.9f}" for v in (*pose.translation, x, y, z, w))
    return f"{t_ns // 10**9}.{t_ns % 10**9:09d} {numbers}"


def camchain(size: NDArray[np.int64], params: NDArray[np.float64]) -> str:
    """The reference's lens in Kalibr's form; COLMAP counts pixels from the corner: half a pixel less."""
    fx, fy, cx, cy, *distortion = (float(v) for v in params)
    entry = {
        "camera_model": "pinhole",
        "intrinsics": [fx, fy, cx - 0.5, cy - 0.5],
        "distortion_model": "radtan",
        "distortion_coeffs": distortion,
        "resolution": [int(v) for v in size],
    }
    return str(yaml.safe_dump({"cam0": entry}, sort_keys=False))


def main() -> None:
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    poses = body_poses(open_source(folder / "images", Settings()), folder)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join(tum_line(t, p) for t, p in sorted(poses.items())) + "\n")
    z = np.load(folder / "sfm_reference.npz")
    lens = out.with_suffix(".camchain.yaml")
    lens.write_text(camchain(z["image_wh"], z["camera_params"]))
    print(f"{len(poses)} poses in {out}, their lens in {lens}")


if __name__ == "__main__":
    main()
