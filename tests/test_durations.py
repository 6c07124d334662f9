"""The list of dear tests is true to the tests that there are, and they take no longer than said."""

from __future__ import annotations

import durations
import pytest

#: CPU seconds of the tests in the lists.
MOST = {"dear": 570.0, "quick": 90.0}


def test_the_lists_name_tests_that_there_are() -> None:
    names, quick = list(durations.measured()), durations.quick()
    assert names == sorted(names)
    assert quick == sorted(quick)
    gone = [name for name in {*names, *quick} if not durations.exists(name)]
    assert not gone, "rename them in tests/durations.txt, or measure: python -m pytest --measure"


@pytest.mark.parametrize("tier", MOST)
def test_a_tier_takes_no_longer_than_it_may(tier: str) -> None:
    """A test that is added may want a shorter form, and a full length that is marked slow."""
    dear = durations.dear()
    seconds = {
        n: s for n, (_, s) in durations.measured().items() if (n in dear) == (tier == "dear")
    }
    assert sum(seconds.values()) <= MOST[tier]
