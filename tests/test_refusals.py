"""Refusals: what, value and remedy as data; the sentences are held by test_misuse.py."""

from __future__ import annotations

import ast
import pickle
from pathlib import Path

import pytest
from test_misuse import MISUSES, RECEPTOR_AND_CUE_MISUSES

import weberwhisk as ww
from weberwhisk._util.refusals import Refusal

PACKAGE = Path(ww.__file__).parent


def test_all_that_the_package_refuses_is_a_refusal() -> None:
    """The command line takes any other ValueError for a bug, and shows its traceback."""
    bare = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "ValueError"
    ]
    assert not bare, f"write raise Refusal(what, got, remedy) at {', '.join(bare)}"


def test_misuse_carries_its_remedy_and_comes_back_from_a_worker() -> None:
    for work, _ in (*MISUSES, *RECEPTOR_AND_CUE_MISUSES):
        with pytest.raises(ValueError) as caught:  # noqa: PT011
            work()
        refusal = caught.value
        assert isinstance(refusal, Refusal), refusal
        assert str(refusal.what) in str(refusal)
        back = pickle.loads(pickle.dumps(refusal))
        assert (str(back), back.what, back.remedy) == (str(refusal), refusal.what, refusal.remedy)
