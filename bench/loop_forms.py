"""The forms of the compiled loops that each kind of run uses: runs one of each kind with an empty cache.

python bench/loop_forms.py            # the CPU time of each kind
python bench/loop_forms.py --write photos   # of one, and write it to src/alight/loop_forms.json
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import alight_sim
from alight.loop_forms import USES, Use, loop_forms

FILE = Path(__file__).parents[1] / "src" / "alight" / "loop_forms.json"


def fly(folder: Path) -> None:
    """Replay a flight in both ways."""
    from alight.runner import replay
    from alight.runner.opening import open_source
    from alight.settings import Settings

    for method in ("batch", "recursive"):
        settings = Settings.model_validate({"parallax": {"method": method}})
        replay.replay(open_source(folder / "flight", settings), settings)


def judge(folder: Path) -> None:
    """Judge heights with a finer picture that sunlight explains."""
    import cv2
    import numpy as np
    from bench_ground import as_map, rolling

    from alight.hazards import assess
    from alight.hazards.sharpen import sharpen
    from alight.pipeline.judging import find_land_cover
    from alight.runs import appearance_of
    from alight.settings import Settings

    fine, settings = rolling(400), Settings()
    stages = settings.stages()
    up = 1 / np.sqrt(1 + sum(g**2 for g in np.gradient(fine.height, fine.grid.cell)))
    picture = np.repeat((200 * up).astype(np.uint8)[..., None], 3, axis=2)
    small = cv2.resize(fine.height, (200, 200), interpolation=cv2.INTER_AREA)
    found = sharpen(as_map(small, 0.2, np.full_like(small, 0.02)), picture, stages.hazards.sharpen) or fine
    assess(found, find_land_cover(found, stages.terrain, appearance_of(settings)), stages.lander, stages.hazards)


def map_photos(folder: Path) -> None:
    """Map a small card of photos."""
    from photo_sets import Drawn, draw

    import alight

    draw(Drawn("village", (580, 387), 3, 5, 40.0, 0.75, 0.65), folder / "set")
    alight.run(folder / "set" / "images")


def simulate(folder: Path) -> None:
    """Draw every built-in scene, and write a flight."""
    from alight_sim.scene import built_in

    for scene in built_in():
        alight_sim.fly(scene, 0, 1.0, height=18.0).image(0, 0)
    alight_sim.write(alight_sim.fly("demo", 0, 1.0), folder / "written")


RUNS: dict[Use, Callable[[Path], None]] = {
    "flight": fly, "hazards": judge, "photos": map_photos, "simulator": simulate,
}  # fmt: skip


def used(package: str) -> dict[str, list[str]]:
    """The forms in the cache by loop of a package, the largest first, without those whose types have no text."""
    import importlib

    from numba.core import sigutils
    from numba.core.registry import CPUDispatcher

    from alight import compiled

    root, found = FILE.parents[1], dict[str, tuple[int, list[str]]]()
    for source in compiled.kernel_sources():
        module = ".".join(source.relative_to(root).with_suffix("").parts)
        if not module.startswith(package):
            continue
        for name, loop in vars(importlib.import_module(module)).items():
            own = isinstance(loop, CPUDispatcher) and loop.py_func.__module__ == module
            if not own or name.startswith("_"):  # a helper: its caller compiles it
                continue
            file: Any = loop._cache._cache_file  # type: ignore[attr-defined]
            for key, data in file._load_index().items():
                form = repr(key[0])
                try:
                    assert sigutils.normalize_signature(form)[0] == key[0]
                except Exception:  # with a literal or an enumeration
                    continue
                size, forms = found.get(f"{module}.{name}", (0, []))
                found[f"{module}.{name}"] = size + Path(file._data_path(data)).stat().st_size, [*forms, form]
    return {name: sorted(forms) for name, (_, forms) in sorted(found.items(), key=lambda f: (-f[1][0], f[0]))}


def main() -> None:
    """Run each kind, or those that are named, in a process of its own."""
    if sys.argv[1:2] == ["--in"]:
        folder, use = Path(sys.argv[2]), cast(Use, sys.argv[3])
        RUNS[use](folder)
        (folder / "forms.json").write_text(json.dumps(used("alight" if use == "simulator" else "alight.")))
        return
    for use in [u for u in USES if u in sys.argv] or USES:
        with tempfile.TemporaryDirectory() as folder:
            alight_sim.write(alight_sim.fly("demo", 0, 1.0), Path(folder) / "flight")
            begin = os.times().children_user
            command = [sys.executable, __file__, "--in", folder, use]
            subprocess.run(command, check=True, env=os.environ | {"NUMBA_CACHE_DIR": f"{folder}/cache"})
            found = json.loads((Path(folder) / "forms.json").read_text())
        number = sum(map(len, found.values()))
        print(f"{use}: {len(found)} loops, {number} forms, {os.times().children_user - begin:.0f} s of CPU", flush=True)
        if "--write" in sys.argv:
            FILE.write_text(json.dumps((loop_forms() if FILE.exists() else {}) | {use: found}, indent=1) + "\n")
            loop_forms.cache_clear()


if __name__ == "__main__":
    main()
