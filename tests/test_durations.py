"""The list of dear tests is true to the tests that there are."""

from __future__ import annotations

import durations


def test_the_list_names_tests_that_there_are() -> None:
    names = list(durations.dear())
    assert names == sorted(names)
    assert not durations.QUICK & set(names)
    gone = [name for name in (*names, *durations.QUICK) if not durations.exists(name)]
    assert not gone, "rename them in tests/durations.txt, or measure: python -m pytest --measure"
