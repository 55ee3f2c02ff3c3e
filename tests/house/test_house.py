"""The rules of the house, which are checked and not only stated. A rule that is broken lists every file that does."""

from __future__ import annotations

import ast
import importlib.metadata
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest
from parsed import PACKAGE, ROOT, SOURCES, imports_of, name_of, nodes_of, text_of, tree_of

import alight
from alight.compiled import kernel_sources

KERNELS = list(kernel_sources())
AT_TOP = {
    ".gitignore",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "LICENSE",
    "Makefile",
    "README.md",
    "totals.json",
    "pyproject.toml",
}
MAY_BE_AT_TOP = {"CITATION.cff", "CODE_OF_CONDUCT.md", "SECURITY.md", ".pre-commit-config.yaml", "mkdocs.yml"}
KINDS = {
    "", ".py", ".md", ".jpg", ".yaml", ".yml", ".svg", ".npz", ".json", ".jsonl", ".j2", ".typed", ".sh", ".html",
    ".css", ".js", ".ipynb", ".webp",
}  # fmt: skip


def test_no_leftovers_are_committed() -> None:
    """No wheels, data or left-overs of tests are committed by mistake."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no git, or no repository here")
    files = [Path(name) for name in listed.stdout.splitlines()]
    at_top = {p.name for p in files if len(p.parts) == 1}
    assert at_top >= AT_TOP
    assert at_top <= AT_TOP | MAY_BE_AT_TOP
    assert {p.suffix for p in files if len(p.parts) > 1} <= KINDS


def test_import_contracts_hold() -> None:
    command = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    run = subprocess.run([sys.executable, "-c", command, "--no-cache"], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 broken" in run.stdout


def offenders(rule: object) -> list[str]:
    """Files of the source that break a rule: a function of the file, true where it is kept."""
    assert callable(rule)
    return [name_of(path) for path in SOURCES if not rule(path)]


def test_imports_are_absolute() -> None:
    assert not offenders(lambda path: not any(m.startswith(".") for m in imports_of(path)))


def test_only_the_kernels_doorway_imports_the_compiler() -> None:
    found = offenders(lambda path: not any(m.split(".")[0] == "numba" for m in imports_of(path)))
    assert found == ["src/alight/compiled.py"]


def test_kernels_stand_on_the_ground() -> None:
    standard = {"__future__", "enum", "functools", "math", "typing"}
    allowed = standard | {"numpy", "numpy.typing", "alight.compiled", "alight.arrays"}
    own = {".".join(p.relative_to(ROOT / "src").with_suffix("").parts) for p in KERNELS}
    assert not [name_of(path) for path in KERNELS if not imports_of(path) <= allowed | own]


def test_compiled_loops_stand_where_the_cache_looks_for_them() -> None:
    found = offenders(lambda path: "alight.compiled" not in imports_of(path))
    assert not set(found) - {name_of(p) for p in KERNELS} - {"src/alight/__init__.py"}


def test_no_print_and_no_promise() -> None:
    def is_print(node: ast.AST) -> bool:
        return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"

    assert not offenders(lambda path: not any(map(is_print, nodes_of(path))))
    assert not offenders(lambda path: not re.search(r"\b(TODO|FIXME|XXX)\b", text_of(path)))


def test_every_file_states_its_purpose() -> None:
    assert not offenders(lambda path: ast.get_docstring(tree_of(path)))


def test_the_version_is_the_same_everywhere() -> None:
    assert importlib.metadata.version("alight") == alight.__version__
    released = re.findall(r"^## \[(\d[^\]]*)\]", text_of(ROOT / "CHANGELOG.md"), re.M)
    assert released[0] == alight.__version__


def test_the_architecture_page_names_every_module() -> None:
    text = text_of(ROOT / "docs" / "architecture.md")
    modules = {p.stem if p.is_file() else p.name for p in PACKAGE.iterdir() if p.suffix == ".py" or p.is_dir()}
    modules -= {"__init__", "__pycache__"}
    assert not [m for m in sorted(modules) if f"`{m}`" not in text]


def test_no_public_name_stands_twice() -> None:
    """Public classes and module-level functions, outside the command line."""
    where: dict[str, set[str]] = defaultdict(set)
    for path in SOURCES:
        if "cli" not in path.parts and path.name != "__init__.py":
            for node in tree_of(path).body:
                if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                    where[node.name].add(name_of(path))
    assert not {name: sorted(paths) for name, paths in where.items() if len(paths) > 1}


def test_the_pipeline_reads_like_the_method() -> None:
    text = text_of(PACKAGE / "pipeline" / "pipeline.py")
    assert text.count("\n") <= 120
    assert "isinstance" not in text
