"""The command line: exit codes, one line for every mistake, and the use of stdout and stderr."""

from __future__ import annotations

import builtins
import errno
import io
import logging
import os
import runpy
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from refusal import Refused
from some_run import candidate, site, some_run

from alight import __version__, cli
from alight.cli.options import SettingsOptions
from alight.cli.terminal import ProgressLines, progress_bar
from alight.outputs import write_run
from alight.pipeline.timing import with_whole
from alight.records import InputError, Sites
from alight.runner import replay
from alight.settings import Settings
from alight.settings.page import settings_page

ALIGHT = [sys.executable, "-c", "from alight.cli import main; main()"]


def alight(*arguments: str | Path, **more: object) -> subprocess.CompletedProcess[str]:
    """Run the command as a process of its own, as a user does."""
    command = [*ALIGHT, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, **more)  # type: ignore[call-overload]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run"], "Missing argument 'INPUT'; see 'alight run --help'"),
        (["run", "nowhere"], "Missing option '--out'"),
        (["run", "nowhere", "--out", "out", "--speed", "9"], "No such option: --speed"),
        (["run", "nowhere", "--out", "out"], "nowhere: no such folder or file; give a flight log"),
        (["land"], "No such command 'land'"),
        (["--nope"], "No such option: --nope"),
        (["demo", "--seed", "one"], "a whole number"),
        (["demo", "--seed", "-1"], "--seed"),
        (["evaluate", "nowhere"], "Missing option '--truth'"),
        (["evaluate", "nowhere", "--truth", "nowhere"], "nowhere: no finished run here"),
        (["terrain"], "Missing command; see 'alight terrain --help'"),
        (["terrain", "test", "--leave-out"], "--leave-out needs FOLDER"),
        (["terrain", "test", "f", "--leave-out", "--model", "m.npz"], "--leave-out trains models of its own"),
        (["live", "camera:0", "--rig", "rig", "--speed", "2", "--out", "out"], "--speed: is of a flight log"),
        (["live", "folder", "--follow", "--speed", "2", "--out", "out"], "--speed: is of a flight log"),
        (["live", "camera:0", "--rig", "rig", "--follow", "--out", "out"], "--follow: is for a folder"),
        (["live", "folder", "--rig", "rig", "--out", "out"], "--rig: is for cameras"),
        (["live", "folder", "--signing-key", "key", "--out", "out"], "--signing-key: signs the link of --telemetry"),
        (["fly", "--link", "udp::1", "--camera", "folder", "--rig", "rig", "--out", "out"], "--rig: is for cameras"),
        (["settings", "--set", "lander"], "--set takes key=value"),
        (["settings", "--set", "lander.wings=2"], "lander.wings: unknown key"),
        (["settings", "--set", "lander.radius=-2"], "lander.radius: "),
        (["settings", "--settings", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
    ],
)
def test_a_mistake_is_told_in_one_line(
    arguments: list[str],
    words: str,
    refused: Refused,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(arguments, words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text", ["lander: [1, 2", "- a\n- b\n", "lander: {radius: wide}", "\x00", "lander:\n\tradius: 1"]
)
def test_bad_settings_files_are_refused(text: str, refused: Refused, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    refused(["settings", "--settings", file], "mine.yaml")


def test_a_mistake_is_one_whole_line_without_a_traceback_in_a_process(tmp_path: Path) -> None:
    deep = tmp_path / ("a-rather-long-name" * 8)
    done = alight("run", deep, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == (
        f"error: {deep}: no such folder or file; give a flight log (a folder with mav0/), a recording (.mcap), a "
        "ROS bag (.bag, .db3, .mcap), a folder of photos, frames with an autopilot's log (.ulg, .bin, .tlog), or a "
        "video (.mp4) with a .srt or .gpx\n"
    )


def test_shells_complete_commands(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("_ALIGHT_COMPLETE", "complete_bash"), ("COMP_WORDS", "alight haz"), ("COMP_CWORD", "1")):
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        cli.call([])
    assert capsys.readouterr().out.split() == ["hazards"]


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.call(["--version"]) == 0
    assert capsys.readouterr().out == f"{__version__}\n"
    for arguments in ([], ["--help"], ["run", "--help"]):
        assert cli.call(arguments) == 0
        told = capsys.readouterr()
        assert "Usage: alight" in told.out
        assert told.err == ""


def test_the_file_is_named_where_it_is_at_fault(
    capsys: pytest.CaptureFixture[str], refused: Refused, tmp_path: Path
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("lander: {radius: -2}")
    for option, said in (("lander.max_slope=0.1", f"{file}: lander.radius"), ("lander.wings=1", f"{file}: lander")):
        assert cli.call(["settings", "--settings", str(file), "--set", option]) == 2
        assert said in capsys.readouterr().err.replace("\n", "")
    assert cli.call(["settings", "--settings", str(file), "--set", "lander.radius=2"]) == 0
    file.write_text("lander: {radius: 2}")
    assert str(file) not in refused(["settings", "--settings", file, "--set", "lander.wings=1"])


def test_settings_are_taken_back(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.call(["settings", "--set", "lander.radius=2.5"]) == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text)["lander"]["radius"] == 2.5
    (tmp_path / "mine.yaml").write_text(text)
    assert cli.call(["settings", "--settings", str(tmp_path / "mine.yaml")]) == 0
    assert capsys.readouterr().out == text


def test_tuned_constants_are_shown_when_asked_for(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.call(["settings", "--all", "--set", "tuning.filter.gate=0.9"]) == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text)["tuning"]["filter"]["gate"] == 0.9
    (tmp_path / "mine.yaml").write_text(text)
    assert cli.call(["settings", "--all", "--settings", str(tmp_path / "mine.yaml")]) == 0
    assert capsys.readouterr().out == text
    assert cli.call(["settings", "--markdown"]) == 0
    assert capsys.readouterr().out == settings_page()


def test_set_wins_over_the_file(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("lander: {radius: 2.0, max_roughness: 0.1}")
    lander = SettingsOptions(settings=tmp_path / "mine.yaml", assign=["lander.radius=3"]).read_settings().lander
    assert (lander.radius, lander.max_roughness) == (3.0, 0.1)


def found(monkeypatch: pytest.MonkeyPatch, **changes: object) -> None:
    """Replace the work of a run by a made-up result."""
    monkeypatch.setattr(replay, "find", lambda *_: some_run(**changes))


def test_the_answer_is_on_stdout_and_warnings_on_stderr(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    long = "photos: " + "one of them cannot be read, " * 12
    found(monkeypatch, warnings=[long])
    assert cli.call(["run", "any", "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert told.out.splitlines()[0].startswith("SITE  48.102")
    assert told.out.splitlines()[1:] == [f"report: {tmp_path / 'out' / 'report.html'}"]
    assert told.err.splitlines()[0] == f"warning: {long.strip()}"  # one line, however long
    assert [line for line in told.err.splitlines()[1:] if "--home" not in line] == []


def test_no_site_is_an_answer(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found(monkeypatch, sites=Sites((), "everything is water"), route=None, warnings=[])
    assert cli.call(["run", "any", "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    assert told.out.startswith("NO SITE  everything is water\n")
    assert told.err == ""


def test_candidates_are_told_after_the_reason_with_the_view_that_settles_the_doubt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found(monkeypatch, sites=Sites((), "fog", candidates=(candidate(), candidate(2, 12.0, 6.0))), route=None)
    assert cli.call(["run", "any", "--out", str(tmp_path / "out")]) == 0
    reason, look, report = capsys.readouterr().out.splitlines()
    assert reason == "NO SITE  fog"
    assert look.startswith("LOOK CLOSER  48.1022")
    assert "P(safe) 0.620  doubt: unseen obstacles  look from: 12 m above it, at 48.10229" in look
    assert look.endswith("(2 candidates)")
    assert report.startswith("report: ")
    found(monkeypatch, sites=Sites((site(),), candidates=(replace(candidate(2), look=None),)))
    assert cli.call(["run", "any", "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.splitlines()[0].endswith("(1 site, 1 candidate)")


def test_what_was_found_is_told_though_it_cannot_be_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found(monkeypatch)
    (tmp_path / "out").write_text("a file")
    assert cli.call(["run", "any", "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr()
    assert told.out.startswith("SITE  ")
    assert "report" not in told.out
    assert told.err.splitlines()[-1].startswith(f"error: {tmp_path / 'out'}: is a file")


def test_the_folder_for_the_results_is_looked_at_before_the_work(flight: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("precious")
    with pytest.MonkeyPatch.context() as m:
        m.setattr(replay, "replay", lambda *_: pytest.fail("the work was begun"))
        assert cli.call(["run", str(flight), "--out", str(tmp_path / "out")]) == 2
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["thesis.tex"]


def test_an_input_in_the_folder_for_the_results_is_refused_before_the_work(
    flight: Path, tmp_path: Path, refused: Refused
) -> None:
    out = tmp_path / "out"
    write_run(some_run(), out)
    path = (out / "trajectory.tum").read_bytes()
    refused(
        ["run", flight, "--poses", out / "trajectory.tum", "--out", out], f"{out / 'trajectory.tum'}: lies in {out}"
    )
    assert (out / "trajectory.tum").read_bytes() == path


class _Broken(io.StringIO):
    """A stream that cannot be written."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self._number = number

    def flush(self) -> None:
        raise OSError(self._number, os.strerror(self._number))  # a BrokenPipeError for EPIPE


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EPIPE])
def test_lines_that_stderr_does_not_take_cost_no_results(
    number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found(monkeypatch, warnings=["one photo cannot be read"])
    monkeypatch.setattr(sys, "stderr", _Broken(number))
    assert cli.call(["run", "any", "--out", str(tmp_path / "out")]) == 0
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith("SITE  ")
    assert last == f"report: {tmp_path / 'out' / 'report.html'}"
    assert (tmp_path / "out" / "run.json").exists()


def test_a_site_is_never_certain(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found(monkeypatch, sites=Sites((replace(site(), p_safe=0.99999),)))
    assert cli.call(["run", "any", "--out", str(tmp_path / "out")]) == 0
    assert "P(safe) > 0.999  (1 site)" in capsys.readouterr().out


def test_ctrl_c_while_the_program_is_imported_is_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(name: str, *more: object) -> object:
        if name.startswith("alight.cli"):
            raise KeyboardInterrupt
        return imported(name, *more)

    imported = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", interrupted)
    with pytest.raises((SystemExit, KeyboardInterrupt)) as ended:
        runpy.run_path(str(cli.__file__))
    assert ended.value.args == (130,)


def test_a_defect_of_ours_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "find", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cli.call(["run", "any", "--out", "out"])


def test_too_little_memory_is_mendable(monkeypatch: pytest.MonkeyPatch, refused: Refused) -> None:
    def greedy(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(replay, "find", greedy)
    refused(["run", "any", "--out", "out"], "parallax.cell")


def test_ctrl_c_is_130(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(replay, "find", interrupted)
    assert cli.call(["run", "any", "--out", "out"]) == 130
    assert capsys.readouterr().err.startswith("interrupted: ")


SLOW = """
import signal, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background start with it ignored
from alight import cli
from alight.outputs import write_run
from alight.runner import replay
from some_run import some_run
def find(source, out, *_):
    write_run(some_run(), out)
    (out / "run.json").unlink()
    print("working", flush=True)
    time.sleep(60)
replay.find = find
cli.main()
"""


def test_ctrl_c_in_a_process_leaves_whole_files_and_no_traceback(tmp_path: Path) -> None:
    paths = [str(Path(__file__).parents[1] / "helpers"), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = [sys.executable, "-c", SLOW, "run", "any", "--out", str(tmp_path / "out")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "working\n"
        process.send_signal(signal.SIGINT)
        start = time.monotonic()
        _, err = process.communicate(timeout=60)
    assert time.monotonic() - start < 30
    assert process.returncode == 130
    assert err == "interrupted: files that were finished are whole, the rest was not written\n"
    assert not [p for p in (tmp_path / "out").iterdir() if p.name.endswith(".tmp")]


def test_nobody_reads_the_answer(tmp_path: Path) -> None:
    """`alight settings | true` ends without an error."""
    with subprocess.Popen([*ALIGHT, "settings"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_an_answer_that_cannot_be_written_is_an_error() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([*ALIGHT, "settings"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("error: standard output: cannot be written")


@pytest.mark.parametrize("place", [["-v", "run"], ["run", "-v"]])
def test_verbose_speaks_up(
    place: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def find(*_: object) -> None:
        logging.getLogger("alight.runner.replay").info("a detail")
        logging.getLogger("another.package").info("noise")
        raise InputError("enough")

    monkeypatch.setattr(replay, "find", find)
    assert cli.call([*place, "any", "--out", "out"]) == 2
    assert capsys.readouterr().err == "INFO: a detail\nerror: enough\n"
    assert cli.call(["run", "any", "--out", "out"]) == 2
    assert capsys.readouterr().err == "error: enough\n"


def test_progress_is_only_for_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar() as report:
        report("heights", 0.5)
        report("heights", 1.0)
    assert capsys.readouterr() == ("", "")


def test_output_that_is_redirected_is_not_silent_for_minutes(capsys: pytest.CaptureFixture[str]) -> None:
    now = [100.0]
    report = with_whole(ProgressLines(15.0, lambda: now[0]), {"motion": 1.0, "heights": 3.0})
    for seconds, stage, share in (
        (5, "motion", 0.5), (16, "motion", 0.9), (17, "motion", 1.0), (18, "heights", 0.0), (20, "heights", 0.1),
        (40, "heights", 0.5), (80, "heights", 1.0),
    ):  # fmt: skip
        now[0] = 100.0 + seconds
        report(stage, share)
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.splitlines() == [
        "motion: 90% after 16 s; about 55 s left",
        "heights: 0% after 18 s; about 54 s left",
        "heights: 50% after 40 s; about 24 s left",
        "heights: 100% after 80 s; about 0 s left",
    ]


def test_the_time_left_counts_neither_the_compiler_nor_the_first_moments(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    report = ProgressLines(15.0, lambda: now[0])
    run = with_whole(report, {"reading": 1.0, "heights": 99.0})
    for seconds, told, stage, share in (
        (0, report, "compile", 0.0), (100, report, "compile", 1.0),
        (101, run, "reading", 1.0), (120, run, "heights", 0.2),
    ):  # fmt: skip
        now[0] = float(seconds)
        told(stage, share)
    assert capsys.readouterr().err.splitlines() == [
        "compile: 100% after 100 s",
        "reading: 100% after 101 s",
        "heights: 20% after 120 s; about 76 s left",
    ]


def test_poses_are_looked_at_before_the_work(flight: Path, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "bad.tum").write_text("0.0 1 2 3\n")
    for name, words in (("nowhere.tum", "cannot be read"), ("bad.tum", "line 1: no pose; each line needs")):
        command = ["run", str(flight), "--out", str(tmp_path / "out"), "--poses", str(tmp_path / name)]
        refused(command, words)


def test_truth_as_poses_needs_truth(flight: Path, tmp_path: Path, refused: Refused) -> None:
    (flight / "mav0" / "state_groundtruth_estimate0" / "data.csv").unlink()
    refused(["run", flight, "--out", tmp_path / "out", "--poses", "truth"], "has no state_groundtruth_estimate0")


def test_evaluate_needs_truth(tmp_path: Path, refused: Refused) -> None:
    write_run(some_run(settings=Settings()), tmp_path / "out")
    (tmp_path / "empty").mkdir()
    refused(["evaluate", tmp_path / "out", "--truth", tmp_path / "empty"], "no truth in it")
