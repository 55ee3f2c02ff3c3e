"""Count the lines that run from `alight run FLIGHT` to a site.

python bench/path_lines.py            # the modules that the replay imports, without bundle, training and outputs
"""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1] / "src"
START = "alight.runner.replay"
LEFT_OUT = (
    "alight.photos.bundle", "alight.training", "alight.outputs", "alight.report", "alight.evaluation", "alight.cli",
    "alight.api", "alight.result", "alight.trials.demo", "alight.runner.judge", "alight.flight.live",
    "alight.photos.reading.photo", "alight.photos.work", "alight.sources.raster",
    "alight.hazards.sharpen", "alight.settings.page",
)  # fmt: skip


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for path in (ROOT / "alight").rglob("*.py"):
        parts = list(path.relative_to(ROOT).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path, known: dict[str, Path]) -> set[str]:
    """Modules that a file imports, with the packages that they are in; imports for type checking alone left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    checked = [n for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.dump(n.test)]
    idle = {id(c) for n in checked for c in ast.walk(n)}
    out = set()
    for n in ast.walk(tree):
        if id(n) in idle:
            continue
        if isinstance(n, ast.ImportFrom) and n.module:
            out |= {n.module, *(f"{n.module}.{a.name}" for a in n.names)}
        elif isinstance(n, ast.Import):
            out |= {a.name for a in n.names}
    packages = {".".join(m.split(".")[:k]) for m in out for k in range(1, m.count(".") + 2)}
    return {m for m in packages if m in known}


def main() -> None:
    """Print the sum, and the lines of each room."""
    known, seen, ahead = modules(), set[str](), [START]
    while ahead:
        name = ahead.pop()
        if name not in seen and not name.startswith(LEFT_OUT):
            seen.add(name)
            ahead += imports(known[name], known)
    rooms = Counter[str]()
    for m in seen:
        rooms[".".join(m.split(".")[:2])] += known[m].read_text(encoding="utf-8").count("\n")
    print(f"{len(seen)} modules, {rooms.total()} lines")
    for room, lines in rooms.most_common():
        print(f"  {room:20s}{lines:6d}")


if __name__ == "__main__":
    main()
