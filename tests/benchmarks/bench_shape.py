"""What a maintainer must hold in the head: files, constants, circles, deep stacks, words.

    python tests/benchmarks/bench_shape.py [OTHER_PACKAGE …]

Prints this checkout's package and every other package folder named. A tuning constant is whatever
a module keeps under a name in capitals with a number written in its value. A circle is a set of
files, or of rooms, that import each other in any way: imports in functions and for annotations
alone count. The deepest stack is of the package's own functions, in the first call in a fresh
interpreter that has imported all its modules. Identifiers are counted that `tests/shape.py` lists.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import shape

HERE = Path(__file__).parent.parent.parent / "weberwhisk"


def has_number(value: ast.expr) -> bool:
    """Whether a number is written anywhere in an expression."""
    return any(
        isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in ast.walk(value)
    )


def measure(package: Path) -> dict[str, object]:
    """What can be counted of one package without running it."""
    files = sorted(package.rglob("*.py"))
    lines = constants = 0
    classes: Counter[str] = Counter()
    for file in files:
        text = file.read_text()
        lines += len(text.splitlines())
        for node in ast.parse(text).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                classes[node.name] += 1
            target = node.targets[0] if isinstance(node, ast.Assign) else None
            target = node.target if isinstance(node, ast.AnnAssign) else target
            named = isinstance(target, ast.Name) and target.id.lstrip("_").isupper()
            value = getattr(node, "value", None)
            constants += bool(named and value is not None and has_number(value))
    measured: dict[str, object] = {
        "package": package.resolve(), "files": len(files), "lines": lines, "constants": constants,
        "classes twice": [name for name, n in classes.items() if n > 1],
        "circles of rooms": shape.circles(shape.graph_of_rooms(package)),
        "circles of files": shape.circles(shape.graph_of_files(package)),
    }  # fmt: skip
    rooms: Counter[str] = Counter()
    words: Counter[str] = Counter()
    for file in files:
        used = shape.identifiers(file)
        rooms[file.relative_to(package).parts[0]] += used.total()
        words += used
    measured["identifiers"] = words.total()
    measured["by room"] = ", ".join(f"{room} {n}" for room, n in rooms.most_common() if n)
    measured["by word"] = ", ".join(f"{word} {n}" for word, n in words.most_common())
    return measured


if __name__ == "__main__":
    for where in (HERE, *map(Path, sys.argv[1:])):
        for key, value in measure(where).items():
            print(f"{key:28}{value}")
        for call in shape.CALLS:
            print(f"{call:28}{shape.walk(where, call)}")
        print()
