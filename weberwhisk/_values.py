"""Frozen dataclasses that compare, hash and print by value, arrays among their fields included."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any

import numpy as np


class Value:
    """Base of frozen dataclasses (``eq=False, repr=False``) whose fields may be arrays.

    Two of one type with equal fields are equal and have one hash, so that what is worked out for
    one is found again by the other; fields cannot be changed, nor can arrays among them.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, eq=False, repr=False)
    ... class Place(Value):
    ...     at: Any
    ...     size: float = 1.0
    ...     def __post_init__(self):
    ...         self._set(at=np.asarray(self.at, dtype=float))
    >>> Place([1, 2]), Place([1, 2]) == Place([1.0, 2.0]), Place(1) == Place(2)
    (Place([1.0, 2.0]), True, False)
    """

    _known_key: tuple[Any, ...]
    __slots__ = ("__dict__", "__weakref__", "_known_key")

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__  # in a copy the key is made again

    def _set(self, **values: Any) -> None:
        """Give fields their final values, in `__post_init__`; arrays become read-only copies."""
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value = value.copy()
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def _key(self) -> tuple[Any, ...]:
        try:
            return self._known_key
        except AttributeError:
            key = tuple(_plain(getattr(self, f.name)) for f in fields(self))  # type: ignore[arg-type]
            object.__setattr__(self, "_known_key", key)
            return key

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return self._key == other._key

    def __hash__(self) -> int:
        return hash((type(self), self._key))

    def __repr__(self) -> str:
        parts = []
        in_order = True
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if f.default is not MISSING and _plain(value) == _plain(f.default):
                in_order = False
                continue
            in_order = in_order and not f.kw_only
            parts.append(_text(value) if in_order else f"{f.name}={_text(value)}")
        return f"{type(self).__name__}({', '.join(parts)})"


def _plain(value: Any) -> Any:
    """What a field's value is compared by."""
    if isinstance(value, np.ndarray | list):
        array = np.asarray(value)
        if array.ndim == 0 or array.dtype.kind not in "fiu":
            return array.tolist() if array.ndim == 0 else (array.shape, tuple(array.ravel()))
        return array.shape, (array.astype(float) + 0.0).tobytes()
    return value


def _text(value: Any) -> str:
    """A field's value in a sentence."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return f"{value:.6g}"
    return repr(value)
