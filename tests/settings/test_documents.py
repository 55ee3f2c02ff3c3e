"""Hostile and damaged documents and models through the commands: one line, exit 2, soon and in little memory."""

from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from length import first
from refusal import Refused

from alight.cli import call
from alight.documents import DocumentError, parse_json, parse_yaml
from alight.learned import arrays_of
from alight.sources.appearance import DEFAULT_MODEL

LAUGHS = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(12)
)
HOSTILE = {
    "deep": "[" * 600 + "]" * 600,
    "deep mappings": "".join(f"{' ' * k}a:\n" for k in range(1000)),
    "exploding aliases": LAUGHS,
    "an alias to itself": "a: &a [*a]",
    "a date that is none": "lander: {radius: 2026-13-45}",
    "a long integer": "lander: {radius: " + "9" * 5000 + "}",
    "a tag": "!!python/object/apply:os.system ['true']",
    "an unhashable key": "{[1, 2]: 3}",
    "a key that is no word": "3: 4",
    "binary": "lander: {radius: !!binary aGVsbG8=}",
    "a set": "lander: !!set {a, b}",
    "two documents": "a: 1\n---\nb: 2\n",
    "too long": "a: " + "x" * 2_000_000,
    "control characters": "a: \x00\x01",
    "a list": "[1, 2]",
    "an open bracket": "lander: {radius: [",
    "text for a number": "lander: {radius: {a: b}}",
}


def test_merge_keys_that_explode_are_refused_before_they_do() -> None:
    """Each mapping merges the one before and adds a key: 40,000 of them, a megabyte, hold nearly a billion values."""
    levels = [f"l{k}: &l{k} {{<<: *l{k - 1}, k{k}: 1}}" for k in range(1, 500)]
    with pytest.raises(DocumentError, match="merged ones written out"):
        parse_yaml("\n".join(["l0: &l0 {x: 1}", *levels]))
    assert parse_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}") == {"a": {"x": 1}, "b": {"x": 1, "y": 2}}
    with pytest.raises(DocumentError, match="nested more than"):
        parse_yaml("a: &a {<<: *a}")


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_settings(text: str, tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(text)
    refused(["settings", "--settings", path], "s.yaml")


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_a_lander_a_scene_and_a_calibration(text: str, flight: Path, tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(text)
    refused(["hazards", "none.tif", "--lander", path, "--out", tmp_path / "out"])
    refused(["simulate", path, "--out", tmp_path / "flight2"], "s.yaml")
    (flight / "mav0" / "cam0" / "sensor.yaml").write_text(text)
    refused(["run", flight, "--out", tmp_path / "out"], "cam0/sensor.yaml")


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 600, "2026-13-45", "&a [*a]", "!!python/name:os.system"])
def test_an_assignment(value: str, refused: Refused) -> None:
    refused(["settings", "--set", f"lander.radius={value}"])


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_a_pipe_is_not_waited_for(flight: Path, tmp_path: Path, refused: Refused) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    out = ["--out", str(tmp_path / "out")]
    for command in (
        ["settings", "--settings", str(pipe)],
        ["hazards", str(pipe), *out],
        ["hazards", "none.tif", "--lander", str(pipe), *out],
        ["simulate", str(pipe), *out],
        ["run", str(flight), "--poses", str(pipe), *out],
        ["run", str(flight), "--set", f"sources.calibration={pipe}", *out],
        ["run", str(flight), "--set", f"terrain.model={pipe}", *out, "--force"],
        ["run", str(pipe), *out],
        ["terrain", "test", "--model", str(pipe)],
    ):
        refused(command)


def test_json_that_is_too_deep_or_too_long() -> None:
    for text in ("[" * 100_000, "[" * 100 + "]" * 100, '{"a": ' + "9" * 5000 + "}", "{", b"\xff\xfe"):
        with pytest.raises(DocumentError):
            parse_json(text)


def test_what_is_healthy_is_read() -> None:
    assert parse_yaml("a: &x [1, 2.5, null, true, word, 2026-01-01]\nb: *x\n") == {
        "a": [1, 2.5, None, True, "word", "2026-01-01"],
        "b": [1, 2.5, None, True, "word", "2026-01-01"],
    }
    assert parse_yaml("") is None


# -- models


def bytes_of(arrays: dict[str, np.ndarray]) -> bytes:
    """Return an archive of arrays."""
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)  # type: ignore[arg-type]
    return out.getvalue()


DAMAGES = (
    "NaN", "a wrong shape", "words for numbers", "objects", "no classes", "classes of 200", "the same class twice",
    "no spread", "temperature below 0", "cut off", "bent", "empty", "text", "one array", "bomb",
)  # fmt: skip


def damaged_model(kind: str) -> bytes:
    """A copy of the package's model that must not be used."""
    good = DEFAULT_MODEL.read_bytes()
    arrays = arrays_of(good)
    weights = next(k for k in arrays if k.endswith(".weights"))
    level = weights.partition(".")[0]
    nan = np.where(np.arange(arrays[weights].size).reshape(arrays[weights].shape) == 3, np.nan, arrays[weights])
    rng = np.random.default_rng(0)
    bent = np.frombuffer(good, np.uint8).copy()
    bent[rng.integers(200, len(bent), 300)] ^= 0x55
    changes: dict[str, dict[str, np.ndarray]] = {
        "NaN": {weights: nan},
        "a wrong shape": {weights: arrays[weights][:, :-1]},
        "words for numbers": {weights: arrays[weights].astype(str)},
        "objects": {weights: np.array([{"a": 1}], object)},
        "no classes": {"classes": np.zeros(0, np.uint8)},
        "classes of 200": {"classes": arrays["classes"] + 200},
        "the same class twice": {"classes": np.ones_like(arrays["classes"])},
        "no spread": {f"{level}.spread": np.zeros_like(arrays[f"{level}.spread"])},
        "temperature below 0": {f"{level}.temperature": np.float32(-1)},
    }
    if kind in changes:
        return bytes_of(arrays | changes[kind])
    other = {"cut off": good[: len(good) // 2], "bent": bent.tobytes(), "empty": b"", "text": b"a model\n"}
    return other[kind] if kind in other else {"one array": one_array, "bomb": bomb}[kind]()


def one_array() -> bytes:
    out = io.BytesIO()
    np.save(out, np.ones(3))
    return out.getvalue()


def bomb() -> bytes:
    """An archive that is 400 MB large when it is unpacked."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as z:
        z.writestr("classes.npy", bytes(400_000_000))
    return out.getvalue()


@pytest.mark.parametrize("kind", first(5, DAMAGES))
def test_a_damaged_model_is_refused(kind: str, flight: Path, tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "terrain.npz"
    path.write_bytes(damaged_model(kind))
    refused(
        ["run", flight, "--set", f"terrain.model={path}", "--out", tmp_path / "out"],
        "terrain.npz: no model of this version",
        "make one with 'alight terrain train'",
    )


def test_the_packages_own_model_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(["terrain", "test", "--model", str(DEFAULT_MODEL)]) == 0
