"""Compilation of loops ahead of time: the list of forms is right and whole, and processes share the work."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core import sigutils
from numba.core.registry import CPUDispatcher

from alight import compiled
from alight.loop_forms import USES, compile_loop, compile_loops, loop_forms

RUN = """
import json, sys
from pathlib import Path
import alight_sim
from alight import compiled
from alight.runner import replay
from alight.runner.opening import open_source
from alight.settings import Settings

folder = Path(sys.argv[1])
alight_sim.write(alight_sim.fly("demo", 0, 1.0), folder)
listener = compiled.CompilationListener()
for method in ("batch", "recursive"):
    settings = Settings.model_validate({"parallax": {"method": method}})
    replay.replay(open_source(folder, settings), settings)
print(json.dumps(listener.names))
"""
CALL = """
import json
import numpy as np
from alight import compiled
from alight.motion.rotation_kernels import exponential

listener = compiled.CompilationListener()
exponential(0.1, 0.2, 0.3, np.zeros((3, 3)))
print(json.dumps(listener.names))
"""
SMALL = {"alight.motion.rotation_kernels.multiply", "alight.motion.rotation_kernels.exponential"}


def test_each_form_is_a_signature_of_a_loop() -> None:
    names = [(name, forms) for loops in loop_forms().values() for name, forms in loops.items()]
    assert len(names) > 150
    for name, forms in names:
        module, _, function = name.rpartition(".")
        assert isinstance(getattr(importlib.import_module(module), function), CPUDispatcher)
        assert forms, name
        assert all(sigutils.is_signature(f) and sigutils.normalize_signature(f)[0] for f in forms), name


def test_a_run_compiles_nothing_after_the_listed_forms(tmp_path: Path) -> None:
    compile_loops("flight", "simulator")
    run = subprocess.run([sys.executable, "-c", RUN, str(tmp_path / "f")], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == []


def test_processes_share_the_work_and_keep_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {name: forms for name, forms in loop_forms()["flight"].items() if name in SMALL}
    assert few
    monkeypatch.setattr(compiled, "CACHE", tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("alight.loop_forms.loop_forms", lambda: {use: few for use in USES})
    shares = list[float]()
    compile_loops("flight", progress=lambda stage, share: shares.append(share), cores=2)
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert compiled.is_warm("flight")
    assert not compiled.is_warm("photos")
    assert {p.name.split(".")[1].rsplit("-", 1)[0] for p in tmp_path.rglob("*.nbi")} >= {n.rsplit(".")[-1] for n in few}
    compile_loops("flight", progress=lambda stage, share: pytest.fail("nothing is left to compile"))
    called = subprocess.run([sys.executable, "-c", CALL], capture_output=True, text=True, check=True)
    assert json.loads(called.stdout) == []


def test_a_loop_that_does_not_exist_is_named() -> None:
    with pytest.raises(AttributeError, match="nothing"):
        compile_loop("alight.motion.rotation_kernels.nothing", [])
