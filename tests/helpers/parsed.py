"""The project's Python files, each parsed once a session, for the tests that read the source."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "alight"
SOURCES = sorted((ROOT / "src").rglob("*.py"))


def name_of(path: Path) -> str:
    """Path of a file in the project."""
    return path.relative_to(ROOT).as_posix()


@cache
def text_of(path: Path) -> str:
    """Text of a file."""
    return path.read_text(encoding="utf-8")


@cache
def tree_of(path: Path) -> ast.Module:
    """Syntax tree of a file."""
    return ast.parse(text_of(path))


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of the tree of a file."""
    return tuple(ast.walk(tree_of(path)))


@cache
def imports_of(path: Path) -> set[str]:
    """Every module that a file imports, at any place in it; a relative import begins with a dot."""
    found = {alias.name for node in nodes_of(path) if isinstance(node, ast.Import) for alias in node.names}
    return found | {"." * n.level + (n.module or "") for n in nodes_of(path) if isinstance(n, ast.ImportFrom)}
