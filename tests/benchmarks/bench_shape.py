"""How much of a package a maintainer must hold in the head: files, lines, constants, chains.

    python tests/benchmarks/bench_shape.py [OTHER_PACKAGE …]

Prints a row for this checkout's package and one for every other package folder named. A tuning
constant is whatever a module keeps under a name in capitals with a number written in its value.
The chain is the deepest stack, in calls and in files of the package, of one posterior of two
unknowns, traced in a fresh interpreter that has imported the subpackage: modules that are only
loaded have no part in it.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

HERE = Path(__file__).parent.parent.parent / "weberwhisk"

TRACE = """
import json, sys, threading
import numpy as np, weberwhisk as ww, weberwhisk.inference
root = ww.__path__[0]
w = ww.Whisker(50e-3, 100e-6, 5e-6)
o = ww.Observer(w, ww.cues.ForceMap(), ww.receptors.Weber(0.1))
reading = np.stack([o.read([20e-3, 0.26], seed=i) for i in range(50)])
files, deepest, depth = set(), 0, 0
def trace(frame, event, arg):
    global deepest, depth
    inside = frame.f_code.co_filename.startswith(root)

    if inside and event == 'call':
        files.add(frame.f_code.co_filename); depth += 1; deepest = max(deepest, depth)
    elif inside and event == 'return':
        depth -= 1
sys.setprofile(trace)
p = ww.posterior(o, reading)
p.mean, p.sd
sys.setprofile(None)
print(json.dumps([deepest, len(files)]))
"""


def has_number(value: ast.expr) -> bool:
    """Whether a number is written anywhere in an expression."""
    return any(
        isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in ast.walk(value)
    )


def measure(package: Path) -> dict[str, object]:
    """The counts of one package."""
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
    chain = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", TRACE],
        cwd=package.parent, env={"PYTHONPATH": str(package.parent), "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    calls, through = json.loads(chain.stdout)
    return {
        "package": str(package.resolve()), "files": len(files), "lines": lines,
        "constants": constants, "chain, calls": calls, "chain, files": through,
        "classes twice": [name for name, n in classes.items() if n > 1],
    }  # fmt: skip


if __name__ == "__main__":
    for where in (HERE, *map(Path, sys.argv[1:])):
        for key, value in measure(where).items():
            print(f"{key:16} {value}")
        print()
