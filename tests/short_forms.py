"""Which cases of a parametrised test are short, and which full length and so slow."""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import Any

import pytest


def slow_but(values: Iterable[Any], quick: Container[int]) -> list[Any]:
    """Parameters of which all but those at the positions `quick` have the slow mark."""
    return [
        v if i in quick else pytest.param(*_each(v), marks=pytest.mark.slow)
        for i, v in enumerate(values)
    ]


def _each(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)
