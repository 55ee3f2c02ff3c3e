"""Compare what a reader of this project has to carry with totals.json; a total that rose needs a change of that file.

python .ci/totals.py            # fail if a total is above its number in totals.json
python .ci/totals.py --write    # write today's totals
"""

import ast
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "totals.json"
MOST_PARAMETERS, MOST_ATTRIBUTES = 7, 20
PRIVATE = re.compile(r"(?<!self)(?<!cls)\._[a-z]\w+")


def tracked() -> list[Path]:
    """The files that Git knows, those not committed yet among them."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    out = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [path for name in out.splitlines() if (path := ROOT / name).is_file()]


def constants(tree: ast.Module) -> int:
    """Number of upper-case names that a module binds to a value with a number in it."""
    bound = [n for n in tree.body if isinstance(n, ast.Assign | ast.AnnAssign) and n.value and has_number(n.value)]
    targets = [t for n in bound for t in (n.targets if isinstance(n, ast.Assign) else [n.target])]
    return sum(n.id.isupper() for t in targets for n in ast.walk(t) if isinstance(n, ast.Name))


def has_number(value: ast.expr) -> bool:
    """Whether an expression contains a number."""
    numbers = (v.value for v in ast.walk(value) if isinstance(v, ast.Constant))
    return any(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers)


def parameters(function: ast.FunctionDef) -> int:
    """Number of parameters, `self` and `cls` not counted."""
    a = function.args
    named = [*a.posonlyargs, *a.args, *a.kwonlyargs]
    return len(named) - bool(named and named[0].arg in ("self", "cls"))


def attributes(cls: ast.ClassDef) -> int:
    """Number of attributes that the methods of a class assign."""
    names = (n for m in cls.body if isinstance(m, ast.FunctionDef) for n in ast.walk(m) if isinstance(n, ast.Attribute))
    return len({
        n.attr for n in names
        if isinstance(n.ctx, ast.Store) and isinstance(n.value, ast.Name) and n.value.id == "self"
    })  # fmt: skip


def totals() -> dict[str, int]:
    """Lines, constants, words and state, by what they are called in the file."""
    found: Counter[str] = Counter()
    for path in tracked():
        parts = path.relative_to(ROOT).parts
        if path.suffix == ".md":
            found["words of pages"] += len(path.read_text().split())
        if path.suffix != ".py":
            continue
        text = path.read_text()
        found[f"lines of {'/'.join(parts[:2]) if parts[0] == 'src' else parts[0]}"] += text.count("\n")
        if parts[0] == "tests":
            found["private members touched by tests"] += len(PRIVATE.findall(text))
        if parts[0] != "src":
            continue
        tree = ast.parse(text)
        found["numeric constants of modules"] += constants(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                found[f"classes of more than {MOST_ATTRIBUTES} attributes"] += attributes(node) > MOST_ATTRIBUTES
                if "tuning" in parts:
                    found["tuned constants"] += sum(isinstance(n, ast.AnnAssign) for n in node.body)
            elif isinstance(node, ast.FunctionDef) and "kernel" not in path.as_posix():
                key = f"functions of more than {MOST_PARAMETERS} parameters"
                found[key] += parameters(node) > MOST_PARAMETERS
    return dict(sorted(found.items()))


def main() -> int:
    """Compare, or write."""
    if not (ROOT / ".git").exists():
        print("totals: not a clone, left out")
        return 0
    now = totals()
    if "--write" in sys.argv[1:]:
        FILE.write_text(json.dumps(now, indent=2) + "\n")
        return 0
    then = json.loads(FILE.read_text())
    risen = {k: (then.get(k, 0), v) for k, v in now.items() if v > then.get(k, 0)}
    for key, (old, new) in risen.items():
        print(f"{key}: {old:,} before, {new:,} now", file=sys.stderr)
    if risen:
        print(
            "take something away; or run `python .ci/totals.py --write` and say in the commit what it is worth",
            file=sys.stderr,
        )
    return bool(risen)


if __name__ == "__main__":
    sys.exit(main())
