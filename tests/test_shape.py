"""What a maintainer must hold in the head stays small: no circles, no deep stacks."""

from __future__ import annotations

from pathlib import Path

import pytest
import shape
from short_forms import slow_but

PACKAGE = Path(__file__).parent.parent / "weberwhisk"

#: The deepest stack of package functions from a call: what is held today, and the aim.
DEEPEST = {
    "posterior": (15, 15),
    "fit_weber": (12, 12),
    "power": (20, 18),
    "locate": (20, 20),
    "jnd_curve": (16, 15),
}


def test_rooms_import_one_way() -> None:
    assert shape.circles(shape.graph_of_rooms(PACKAGE)) == []


def test_files_import_one_way() -> None:
    assert shape.circles(shape.graph_of_files(PACKAGE)) == []


@pytest.mark.parametrize("call", slow_but(DEEPEST, (3,)))
def test_calls_do_not_go_deeper(call: str) -> None:
    walk = shape.walk(PACKAGE, call)
    most, aim = DEEPEST[call]
    lines = [f"{file} {function}" for file, function in walk.stack]
    assert len(walk.stack) <= most, "\n".join([f"{walk}, where the aim is {aim}:", *lines])


def test_circles_are_seen(tmp_path: Path) -> None:
    sources = {
        "__init__": "", "a/__init__": "", "b": "from .a.one import x", "a/two": "from . import one",
        "a/one": "def f():\n    from . import two\n    from .. import b",
        "a/three": "from . import two",
    }  # fmt: skip
    package = tmp_path / "package"
    (package / "a").mkdir(parents=True)
    for name, source in sources.items():
        (package / f"{name}.py").write_text(source)
    assert shape.circles(shape.graph_of_files(package)) == [["a.one", "a.two", "b"]]
    assert shape.circles(shape.graph_of_rooms(package)) == [["a", "b"]]
