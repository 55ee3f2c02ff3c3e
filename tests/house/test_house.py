"""The rules of the house, which are checked and not only stated."""

from __future__ import annotations

import ast
import importlib.metadata
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import alight
from alight.compiled import kernel_sources

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "alight"
SOURCES = sorted((ROOT / "src").rglob("*.py"))
KERNELS = list(kernel_sources())
AT_TOP = {".gitignore", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "Makefile", "README.md", "pyproject.toml"}
KINDS = {
    "", ".py", ".md", ".jpg", ".yaml", ".svg", ".npz", ".json", ".jsonl", ".j2", ".typed", ".sh", ".html", ".css",
}  # fmt: skip
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])


def name_of(path: Path) -> str:
    """Name of a test case: the path of the file in the project."""
    return path.relative_to(ROOT).as_posix()


def imports(path: Path) -> Iterator[str]:
    """Yield every module that a file imports, at any place in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""


def test_nothing_lies_about() -> None:
    """No wheels, data or left-overs of tests are committed by mistake."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no git, or no repository here")
    files = [Path(name) for name in listed.stdout.splitlines()]
    assert {p.name for p in files if len(p.parts) == 1} == AT_TOP
    kinds = {p.suffix for p in files if len(p.parts) > 1}
    assert kinds <= KINDS


def test_import_contracts_hold() -> None:
    command = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    run = subprocess.run([sys.executable, "-c", command, "--no-cache"], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 broken" in run.stdout


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_only_the_kernels_doorway_imports_the_compiler(path: Path) -> None:
    found = [m for m in imports(path) if m.split(".")[0] == "numba"]
    assert not found or path == PACKAGE / "compiled.py"


@pytest.mark.parametrize("path", KERNELS, ids=name_of)
def test_kernels_stand_on_the_ground(path: Path) -> None:
    allowed = {"__future__", "functools", "math", "numpy", "numpy.typing", "alight.compiled", "alight.arrays"}
    own = {".".join(p.relative_to(ROOT / "src").with_suffix("").parts) for p in KERNELS}
    assert all(m in allowed | own for m in imports(path))


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_compiled_loops_stand_where_the_cache_looks_for_them(path: Path) -> None:
    uses = [m for m in imports(path) if m == "alight.compiled"]
    assert not uses or path in KERNELS or path == PACKAGE / "__init__.py"


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_no_print_and_no_promise(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    calls = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call)]
    assert not [c.lineno for c in calls if isinstance(c.func, ast.Name) and c.func.id == "print"]
    assert not re.search(r"\b(TODO|FIXME|XXX)\b", text)


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_every_file_says_what_it_is_for(path: Path) -> None:
    assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))


def test_the_version_is_the_same_everywhere() -> None:
    assert importlib.metadata.version("alight") == alight.__version__
    released = re.findall(r"^## \[(\d[^\]]*)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    assert released[0] == alight.__version__


def test_the_architecture_page_names_every_module() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    modules = {p.stem if p.is_file() else p.name for p in PACKAGE.iterdir() if p.suffix == ".py" or p.is_dir()}
    modules -= {"__init__", "__pycache__"}
    assert not [m for m in sorted(modules) if f"`{m}`" not in text]


def public_names() -> Iterator[tuple[str, Path]]:
    """Yield the public classes and module-level functions, outside the command line."""
    for path in SOURCES:
        if "cli" in path.parts or path.name == "__init__.py":
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                yield node.name, path


def test_no_public_name_stands_twice() -> None:
    where: dict[str, set[Path]] = {}
    for name, path in public_names():
        where.setdefault(name, set()).add(path)
    assert not {n: sorted(map(name_of, paths)) for n, paths in where.items() if len(paths) > 1}


def test_the_pipeline_reads_like_the_method() -> None:
    text = (PACKAGE / "pipeline" / "pipeline.py").read_text(encoding="utf-8")
    assert text.count("\n") <= 120
    assert "isinstance" not in text
