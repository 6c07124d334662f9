"""Imports go one way, up the table; heavy packages stay where they belong; `import` stays light."""

from __future__ import annotations

import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
import shape

PACKAGE = Path(__file__).parent.parent / "weberwhisk"

# Each place and what stands right below it. A place may import those, all that those may import,
# its own folder, `_util.checks`, `_util.refusals` and `_util.values`. A folder's modules share its
# entry, unless they have their own. "" is the package's __init__.
TABLE: dict[str, tuple[str, ...]] = {
    "_util": (),
    "_util.refusals": (),
    "_util.values": (),
    "_util.checks": (),
    "_util.output": (),
    "_util.campaign": ("_util.output",),
    "_util.importance": (),
    "_util.sampling": (),
    "_util.weights": (),
    "domain": (),
    "whisker": ("domain",),
    "mechanics.contact": ("whisker",),
    "mechanics.elastica": ("mechanics.contact",),
    "mechanics.closed_form": ("mechanics.contact",),
    "mechanics.shape": ("whisker",),
    "mechanics.beam": ("mechanics.shape",),
    "mechanics.branches": ("mechanics.beam", "mechanics.elastica"),
    "mechanics.equilibrium": ("mechanics.branches",),
    "mechanics.profile": ("mechanics.equilibrium",),
    "mechanics.rod": ("mechanics.profile",),
    "mechanics.modes": ("mechanics.shape",),
    "mechanics.ladder": ("mechanics.rod", "mechanics.closed_form"),
    "mechanics.model_choice": ("mechanics.ladder",),
    "mechanics.curved_surface": ("mechanics.rod",),
    "mechanics.forward": ("mechanics.ladder", "mechanics.curved_surface"),
    "mechanics": ("mechanics.forward", "mechanics.model_choice", "mechanics.modes"),
    "receptors": (),
    "cues": ("mechanics", "receptors"),
    "inference": ("cues", "_util.sampling", "_util.campaign"),
    "sweeping": ("cues",),
    "array": ("inference",),
    "sensitivity": ("inference",),
    "recordings": ("inference", "_util.importance"),
    "behaviour": ("sensitivity", "recordings", "array"),
    "design": ("behaviour", "array"),
    "plots": ("design",),
    "": ("plots", "sweeping"),
    "commands": ("",),
    "cli": ("commands",),
    "__main__": ("cli",),
}
ONLY_IN = {
    "emcee": "_util.sampling",
    "arviz": "_util.sampling",
    "arviz_base": "_util.sampling",
    "arviz_plots": "_util.sampling",
    "arviz_stats": "_util.sampling",
    "matplotlib": "plots",
}
HEAVY = ("arviz", "emcee", "matplotlib", "pandas", "rich", "scipy.stats", "typer")


def offences(package: Path) -> list[str]:
    """Everything under `package` that breaks a rule, a sentence each."""
    modules = shape.modules(package)
    found, graph = [], {}
    for module, path in modules.items():
        where = path.relative_to(package).as_posix()
        place = _place(module)
        if place is None:
            found.append(f"{where} is not in the table: give it a line there.")
            continue
        allowed = _allowed(place)
        imported = list(shape.imports(path, package, modules))
        # A name imported for annotations alone runs in no circle; behaviour and design have none.
        whole = module.startswith(("behaviour", "design"))
        graph[module] = {m for m, runs in imported if (runs or whole) and m in modules}
        for target in sorted({target for target, _ in imported}):
            if target.startswith("/"):  # from outside the package
                only = ONLY_IN.get(target[1:])
                if only not in (None, place) and (target, True) in imported:
                    found.append(f"{where} imports {target[1:]}, which belongs in {only} alone.")
            elif _place(target) not in allowed:
                found.append(f"{where} imports {package.name}.{target}, which is not above it.")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as cycle:
        found.append(f"Imports go round: {' → '.join(cycle.args[1])}.")
    return found


def _place(module: str) -> str | None:
    """The entry of the table that a module falls under."""
    if module in TABLE:
        return module
    folder = module.split(".")[0]
    divided = any(place.startswith(f"{folder}.") for place in TABLE)
    return folder if folder in TABLE and "." in module and not divided else None


def _allowed(place: str) -> set[str]:
    own = {place, "_util.checks", "_util.refusals", "_util.values", "_util.weights"}
    return own.union(*(_allowed(below) for below in TABLE[place]))


def heavy_after_import(package: Path) -> list[str]:
    """Which heavy packages a fresh interpreter has loaded after importing `package`."""
    code = (
        f"import sys, {package.name}\n"
        f"print(*sorted(name for name in {HEAVY!r} if name in sys.modules), sep='\\n')"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        cwd=package.parent,  # what `python -c` looks in first
        capture_output=True,
        text=True,
        check=True,
    )
    return ended.stdout.split()


def test_imports_go_up_the_table() -> None:
    assert offences(PACKAGE) == []


def test_import_is_light() -> None:
    assert heavy_after_import(PACKAGE) == []


def test_the_table_goes_one_way() -> None:
    TopologicalSorter(TABLE).prepare()
    assert {below for places in TABLE.values() for below in places} <= set(TABLE)


@pytest.mark.parametrize(
    ("path", "source", "sentence"),
    [
        ("whisker.py", "from . import cues", "whisker.py imports weberwhisk.cues"),
        ("whisker.py", "import weberwhisk as ww", "whisker.py imports weberwhisk."),
        ("whisker.py", "def f():\n    from . import cues", "whisker.py imports weberwhisk.cues"),
        ("whisker.py", "if TYPE_CHECKING:\n    from . import cues", "imports weberwhisk.cues"),
        ("whisker.py", "importlib.import_module('.cues', 'weberwhisk')", "weberwhisk.cues"),
        ("inference/nested/deep.py", "from ... import sensitivity", "weberwhisk.sensitivity"),
        ("sensitivity/jnd.py", "def f():\n    from arviz.stats import ess", "jnd.py imports arviz"),
        ("novelties/one.py", "", "novelties/one.py is not in the table"),
    ],
)
def test_offence_is_found(tmp_path: Path, path: str, source: str, sentence: str) -> None:
    found = offences(_fake(tmp_path, {path: source}))
    assert len(found) == 1
    assert sentence in found[0]


def test_imports_that_go_round_are_found(tmp_path: Path) -> None:
    files = {"cues/one.py": "from . import two", "cues/two.py": "def f():\n    from .one import x"}
    assert "Imports go round" in offences(_fake(tmp_path, files))[0]


def _fake(folder: Path, files: dict[str, str]) -> Path:
    """A package tree with an empty module for every place that the sources may name."""
    package = folder / "weberwhisk"
    empty = [f"{place.replace('.', '/')}.py" for place in TABLE if place]
    folders = (
        "_util", "mechanics", "cues", "inference", "sensitivity", "recordings", "array",
        "behaviour", "design", "commands",
    )  # fmt: skip
    for path in [p for p in empty if p.removesuffix(".py") not in folders]:
        files = {path: "", **files}
    for name in ("", *(f"{f}/" for f in folders)):
        files = {f"{name}__init__.py": "", **files}
    for path, source in files.items():
        (package / path).parent.mkdir(parents=True, exist_ok=True)
        (package / path).write_text(source)
    return package
