"""The scripts of analyses/, which are no package, as modules for the tests that hold them."""

from __future__ import annotations

import importlib.util
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

FOLDER = Path(__file__).parent.parent / "analyses"


def load(name: str) -> ModuleType:
    """The script of that name, run anew, or the module ``folder.name``, once.

    It finds its neighbours as when it is run by itself.
    """
    if str(FOLDER) not in sys.path:
        sys.path.insert(0, str(FOLDER))
    if "." in name:
        return import_module(name)
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where its dataclasses look themselves up
    sys.path.insert(0, str(FOLDER))  # as when it is run: scripts share code with one another
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(FOLDER))
    return module
