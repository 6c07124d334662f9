"""Old public names that keep working for one release, with a `DeprecationWarning`."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from operator import attrgetter
from typing import Any, TypeVar, cast

Called = TypeVar("Called", bound=Callable[..., Any])


def renamed_names(module: str, renamed: Mapping[str, str]) -> Callable[[str], Any]:
    """A module's ``__getattr__`` for old names; the new ones are ``"name"`` or ``"module:name"``.

    Examples
    --------
    >>> import warnings
    >>> old = renamed_names("weberwhisk.whisker", {"Vibrissa": "Whisker"})
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     old("Vibrissa").__name__
    'Whisker'
    >>> str(caught[0].message)
    'weberwhisk.whisker.Vibrissa is now weberwhisk.whisker.Whisker; the old name goes in 0.3.'
    """

    def __getattr__(name: str) -> Any:
        if name not in renamed:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        place, _, new = renamed[name].rpartition(":")
        place = place or module
        _warn(f"{module}.{name}", f"{place}.{new}")
        return getattr(import_module(place), new)

    return __getattr__


def renamed_arguments(**renamed: str) -> Callable[[Called], Called]:
    """A decorator: keyword arguments ``old="new"`` are still taken."""

    def decorate(function: Called) -> Called:
        @functools.wraps(function)
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            for old in renamed.keys() & kwargs.keys():
                _warn(f"{old}= of {function.__qualname__}", f"{renamed[old]}=")
                kwargs[renamed[old]] = kwargs.pop(old)
            return function(*args, **kwargs)

        return cast(Called, wrapper)

    return decorate


def renamed_attribute(owner: str, old: str, new: str) -> Any:
    """An old attribute or method of a class: ``old = renamed_attribute("Class", "old", "new")``.

    The new one may be an attribute's: ``"space.spread"``.
    """

    def read(self: Any) -> Any:
        _warn(f"{owner}.{old}", f"{owner}.{new}")
        return attrgetter(new)(self)

    return property(read)


def _warn(old: str, new: str) -> None:
    message = f"{old} is now {new}; the old name goes in 0.3."
    warnings.warn(message, DeprecationWarning, stacklevel=3)
