"""The cache of compiled loops: it is never another user's, and it never ends a command."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from length import first

from alight import compiled, loop_cache
from alight.loop_cache import cache_folder

ROOT = Path(__file__).parents[1]
NOBODY = 65534
SCRIPT = """
from alight import compiled
@compiled.kernel
def twice(x):
    return 2 * x
assert twice(21) == 42
loaded = bool(getattr(twice.stats, "cache_hits", {}))
print(compiled.CACHE, "loaded" if loaded else "compiled")
"""


@pytest.fixture
def loop(tmp_path: Path) -> Path:
    """Write a file with one loop; its cache lies beside it."""
    path = tmp_path / "loop.py"
    path.write_text(SCRIPT)
    return path


def caching_in(folder: Path) -> dict[str, str]:
    """Return the environment of a process whose cache lies in a folder of its own."""
    env = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    return env | {"PYTHONPATH": str(ROOT / "src"), "XDG_CACHE_HOME": str(folder / "cache")}


def run(loop: Path, user: int | None = None, **environment: str) -> tuple[str, str]:
    """Compile or load the loop in a process; return the place of the cache with `compiled` or `loaded`, and stderr."""
    env = caching_in(loop.parent) | environment
    done = subprocess.run(
        [sys.executable, loop], env=env, cwd=loop.parent, capture_output=True, text=True, user=user, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr


def folder_of(answer: str) -> Path:
    """Return the folder of the cache."""
    return Path(answer.rsplit(" ", 1)[0])


def test_the_second_process_loads_what_the_first_compiled(loop: Path) -> None:
    first, said = run(loop)
    assert first.endswith(" compiled")
    assert said == ""
    assert folder_of(first).stat().st_mode & 0o777 == 0o700
    assert run(loop) == (first.replace(" compiled", " loaded"), "")


SLOW = """
import sys, time
from pathlib import Path
from alight import compiled
compiled.LONGEST_TURN = 1e4  # s: longer than the test waits
from numba.extending import overload
def wait(x): pass
@overload(wait)
def _wait(x):
    with open("compiled", "a") as f:
        f.write("once ")
    if Path("dies").exists():
        Path("dies").unlink()
        sys.stdout.flush()
        import os, signal; os.kill(os.getpid(), signal.SIGKILL)
    if Path("fails").exists():
        return None
    time.sleep(1.0)
    return lambda x: x
@compiled.kernel
def inner(x):
    return wait(x)
@compiled.kernel
def outer(x):
    return inner(x)
try:
    assert (inner if sys.argv[1] == "inner" else outer)(21) == 21
    print("right", flush=True)
except Exception as e:
    print(type(e).__name__, flush=True)
if sys.argv[1] == "stay":
    sys.stdin.read()
"""


@pytest.fixture
def slow(tmp_path: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Return a function that starts processes that use a loop which takes a second to compile."""
    path, begun = tmp_path / "slow.py", []
    path.write_text(SLOW)
    env = caching_in(tmp_path)

    def start(how: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, path, how], env=env, cwd=tmp_path, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        begun.append(process)
        return process

    yield start
    for process in begun:
        process.communicate(timeout=120)


Start = Callable[[str], subprocess.Popen[str]]


def test_a_loop_that_another_process_compiles_is_waited_for(slow: Start, tmp_path: Path) -> None:
    both = [slow("outer"), slow("inner")]
    assert [p.communicate(timeout=120)[0] for p in both] == ["right\n"] * 2
    together = len((tmp_path / "compiled").read_text().split())
    (tmp_path / "compiled").unlink()
    for cache in (tmp_path / "cache").rglob("*.nb*"):
        cache.unlink()
    assert slow("outer").communicate(timeout=120)[0] == "right\n"
    assert len((tmp_path / "compiled").read_text().split()) == together


def test_a_process_that_dies_while_it_compiles_lets_others_go_on(slow: Start, tmp_path: Path) -> None:
    (tmp_path / "dies").touch()
    assert slow("outer").wait(timeout=120) == -signal.SIGKILL
    assert slow("outer").communicate(timeout=120)[0] == "right\n"


def test_a_loop_that_cannot_be_compiled_keeps_nobody_waiting(slow: Start, tmp_path: Path) -> None:
    (tmp_path / "fails").touch()
    stays = slow("stay")
    assert stays.stdout is not None
    assert stays.stdout.readline() == "TypingError\n"
    (tmp_path / "fails").unlink()
    assert slow("outer").communicate(timeout=120)[0] == "right\n"


def test_a_folder_that_others_can_write_is_never_read(loop: Path) -> None:
    folder = folder_of(run(loop)[0])
    folder.chmod(0o777)
    answer, said = run(loop)
    assert answer.endswith(" compiled")
    assert folder_of(answer) != folder
    assert "is not yours alone; loops are compiled anew by this command, about 4 minutes" in said
    assert not folder_of(answer).exists()  # private, and removed with the process


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The usual folder of the cache, with a loop in it."""
    monkeypatch.delenv(loop_cache.NAMED, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = tmp_path / "cache" / "alight" / "loops"
    assert cache_folder("loops") == found
    (found / "loop.nbc").write_bytes(b"compiled")
    return found


def replaced(folder: Path) -> Path:
    """The private folder that is used instead of one that may not be."""
    found = cache_folder("loops")
    assert found is not None
    assert found != folder
    assert found.stat().st_mode & 0o777 == 0o700
    return found


def test_a_folder_named_in_the_environment_is_held_to_the_same(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = tmp_path / "named"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(named))
    assert cache_folder("loops") == named
    named.chmod(0o777)
    assert not list(replaced(named).iterdir())


def test_a_new_folder_begins_with_the_loops_of_the_package(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    brought = tmp_path / "package" / "loops"
    (brought / "alight").mkdir(parents=True)
    (brought / "alight" / "loop.nbc").write_bytes(b"brought")
    monkeypatch.setattr(loop_cache, "BROUGHT", brought)
    assert cache_folder("loops") == folder
    assert not (folder / "alight").exists()  # it was there before
    new = cache_folder("newer")
    assert new == folder.parent / "newer"
    assert (new / "alight" / "loop.nbc").read_bytes() == b"brought"
    assert new.stat().st_mode & 0o777 == 0o700


def test_a_link_is_never_followed(folder: Path, tmp_path: Path) -> None:
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    assert not list(replaced(folder).iterdir())


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="needs root")
def test_a_folder_of_another_user_is_never_read(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    os.chown(folder, NOBODY, NOBODY)
    assert not list(replaced(folder).iterdir())
    assert "is not yours alone" in caplog.text


@pytest.mark.parametrize(
    "damage", first(1, [b"cos\nsystem\n(S'touch planted'\ntR.", b"\x80\x04garbage", b"", bytes(5000)])
)
def test_damaged_files_are_compiled_anew(loop: Path, damage: bytes) -> None:
    folder = folder_of(run(loop)[0])
    for path in folder.rglob("*.nbi"):
        path.write_bytes(damage)
    assert run(loop)[0].endswith(" compiled")
    assert run(loop)[0].endswith(" loaded")  # the file is repaired
    compiled = list(folder.rglob("*.nbc"))
    assert compiled
    for path in compiled:
        data = path.read_bytes()
        path.write_bytes(damage + data[len(damage) : -100])
    assert run(loop)[0].endswith(" compiled")
    assert run(loop)[0].endswith(" loaded")


def test_no_home_to_write_to(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.delenv(loop_cache.NAMED, raising=False)
    monkeypatch.setenv("HOME", "/dev/null")
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    assert not list(replaced(Path("/dev/null/.cache/alight/loops")).iterdir())
    assert "cannot be made; loops are compiled anew" in caplog.text


def test_a_cache_that_is_read_only_is_copied(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(loop_cache, "is_writable", lambda folder: False)
    assert (replaced(folder) / "loop.nbc").read_bytes() == b"compiled"
    assert "cannot be written; it is copied for this command" in caplog.text


def test_nowhere_to_write_at_all(loop: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Loops then live in memory alone."""
    loop.write_text("import tempfile\ntempfile.mkdtemp = lambda **k: (_ for _ in ()).throw(OSError())\n" + SCRIPT)
    answer, said = run(loop, XDG_CACHE_HOME="/dev/null/cache")
    assert answer == "None compiled"
    assert "loops are compiled anew" in said


NAMES = ["NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("count", ["many", "99999999", "0", "-1", ""])
def test_a_number_of_threads_that_no_machine_has(
    name: str, count: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(name, count)
    loop_cache.mend_threads()
    assert name not in os.environ
    assert f"{name}={count}: not a number from 1 to" in caplog.text


def test_numbers_of_threads_are_mended_before_a_loop_is_compiled(loop: Path) -> None:
    _, said = run(loop, **dict.fromkeys(NAMES, "many"))
    assert said.count("=many: not a number from 1 to") == 2


def test_loops_of_other_sources_do_not_count_as_warm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "CACHE", tmp_path)
    compiled.mark_warm()
    assert compiled.is_warm()
    monkeypatch.setattr(compiled, "SOURCES", "others")
    assert not compiled.is_warm()


ONE_LOOP = """
import numpy as np
from alight.parallax.view_kernels import normalise
normalise(np.ones((8, 8), np.float32), 1, 1.0, np.ones((8, 8), np.float32))
print("loaded" if normalise.stats.cache_hits else "compiled")
"""


def test_loops_are_found_by_the_package_and_the_cache_in_other_places(tmp_path: Path) -> None:
    """A wheel that brings compiled loops relies on it."""

    def used(place: Path) -> str:
        env = caching_in(place) | {"PYTHONPATH": str(place)}
        done = subprocess.run([sys.executable, "-c", ONE_LOOP], env=env, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    here, there = tmp_path / "here", tmp_path / "there"
    for package in ("alight", "alight_sim"):
        shutil.copytree(ROOT / "src" / package, here / package)
    assert used(here) == "compiled"
    here.rename(there)
    for file in there.rglob("*.py"):
        os.utime(file, (1e9, 1e9))
    assert used(there) == "loaded"
