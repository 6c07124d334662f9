"""What objects are to their user: values that compare, hash and print, and results that show
themselves in a line, as HTML in a notebook and as a figure."""

from __future__ import annotations

import math
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import IntEnum
from html import escape
from importlib import import_module
from importlib.metadata import version
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import __version__
from .refusals import Advice

__all__ = [
    "Array", "Codes", "Fields", "Flags", "Index", "Line", "Shown", "Value", "Worded",
    "counted", "density_quantiles", "distinct", "in_short", "interval_text", "member",
    "methods_text", "paragraphs", "pd", "plain_number", "weighted_quantiles", "with_units",
]  # fmt: skip

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Codes = NDArray[np.int8]  # members of an enumeration: outcomes, statuses, models
Index = NDArray[np.intp]  # what NumPy counts with: 32 bits in a browser
Seed = int | np.random.SeedSequence | np.random.Generator | None


#: Characters of the longest text that an object prints as.
LONGEST = 300


class _WhenUsed:
    """A module that takes long to import: it is imported where it is first asked for something."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self._name), name)


if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    pd = _WhenUsed("pandas")


class Fields:
    """Base of dataclasses (``repr=False``) that print as the call that makes them, in short.

    Fields at their defaults are left out but those of `_always_printed`; numbers have six digits.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(repr=False)
    ... class Place(Fields):
    ...     at: Any
    ...     size: float = 1.0
    >>> Place(0.1 + 0.2), Place(np.arange(9.0), size=2)
    (Place(0.3), Place([0, 1, 2, 3, 4, 5, …], 2))
    """

    _always_printed: ClassVar[tuple[str, ...]] = ()
    __slots__ = ()

    def __repr__(self) -> str:
        text = _as_call(self, self._always_printed)
        return text if len(text) <= LONGEST else f"{text[: LONGEST - 2]}…)"


def _as_call(made: Any, always: tuple[str, ...] = ()) -> str:
    """The call that makes a dataclass."""
    arguments, in_order = [], True
    taken = signature(type(made)).parameters
    for f in fields(made):
        value, how = getattr(made, f.name), taken.get(f.name, f)
        if not f.repr or (f.name not in always and _same(value, how.default)):
            in_order = False
            continue
        in_order = in_order and getattr(how, "kind", None) != Parameter.KEYWORD_ONLY
        arguments.append(in_short(value) if in_order else f"{f.name}={in_short(value)}")
    return f"{type(made).__name__}({', '.join(arguments)})"


def _same(value: Any, default: Any) -> bool:
    """Whether a field has its default."""
    if hasattr(value, "dist") and hasattr(default, "dist"):  # frozen, perhaps from a pickle
        return bool(
            type(value.dist) is type(default.dist)
            and (value.args, value.kwds) == (default.args, default.kwds)
        )
    plain = isinstance(default, int | float | str | tuple | list)
    return value is default or (plain and bool(_plain(value) == _plain(default)))


def in_short(value: Any) -> str:
    """A value in a line: numbers with six digits, the first of many, laws by their names."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{k!r}: {in_short(v)}' for k, v in value.items())}}}"
    if is_dataclass(value) and not isinstance(value, type | Fields | Line):
        return _as_call(value)
    if hasattr(value, "_asdict"):
        items = ", ".join(f"{k}={in_short(v)}" for k, v in value._asdict().items())
        return f"{type(value).__name__}({items})"
    if type(value) in (list, tuple):
        first = [*map(in_short, value[:6]), *["…"] * (len(value) > 6)]
        text = ", ".join(first) + "," * (len(value) == 1 and isinstance(value, tuple))
        return f"[{text}]" if isinstance(value, list) else f"({text})"
    if hasattr(value, "dist") and hasattr(value, "kwds"):  # SciPy's
        given = [*map(in_short, value.args), *(f"{k}={in_short(v)}" for k, v in value.kwds.items())]
        return f"{value.dist.name}({', '.join(given)})"
    if hasattr(value, "iloc"):
        return f"<table of {counted(len(value), 'row')}>"
    return getattr(value, "__qualname__", None) or repr(value)


class Value(Fields):
    """Base of frozen dataclasses (``eq=False, repr=False``) whose fields may be arrays.

    Two of one type with equal fields are equal and have one hash, so that what is worked out for
    one is found again by the other; fields cannot be changed, nor can arrays among them.
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
            compared = (f.name for f in fields(self) if f.compare)  # type: ignore[arg-type]
            key = tuple(_plain(getattr(self, name)) for name in compared)
            object.__setattr__(self, "_known_key", key)
            return key

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return self._key == other._key

    def __hash__(self) -> int:
        return hash((type(self), self._key))


def _plain(value: Any) -> Any:
    """What a field's value is compared by."""
    if isinstance(value, np.ndarray | list):
        array = np.asarray(value)
        if array.ndim == 0 or array.dtype.kind not in "fiu":
            return array.tolist() if array.ndim == 0 else (array.shape, tuple(array.ravel()))
        return array.shape, (array.astype(float) + 0.0).tobytes()
    return value


# -- results --------------------------------------------------------------------------------------


class Line:
    """Base of results that say what they found, in `_line`, and have their numbers in `_table`."""

    def _line(self) -> str:
        """The estimate, its interval and its status."""
        raise NotImplementedError

    def _table(self) -> pd.DataFrame | None:
        """What a notebook shows below the line."""
        table = self.summary() if hasattr(self, "summary") else getattr(self, "table", None)
        return cast("pd.DataFrame | None", table)

    def __repr__(self) -> str:
        text = f"<{type(self).__name__}: {self._line()}>"
        return text if len(text) <= LONGEST else f"{text[: LONGEST - 2]}…>"

    def _repr_html_(self) -> str:
        table = self._table()
        line = f"<p><b>{type(self).__name__}</b>: {escape(self._line())}</p>"
        if table is None:
            return line
        return line + table.to_html(max_rows=12, float_format="{:.4g}".format, na_rep="–")


class Shown(Line):
    """Base of results that also draw themselves.

    `_figure` names the function of `weberwhisk.plots` that does. Those stand above all results, so
    that the package is asked for them, and no result imports a figure.
    """

    _figure: ClassVar[str]

    def plot(self, ax: Axes | None = None, **options: object) -> Figure:
        """Draw it with its function of `weberwhisk.plots`; see there for further options.

        Without `ax` on a figure of its own, which `pyplot` knows: a notebook shows it, and
        `plt.show()` does in a script.
        """
        plots = sys.modules[__name__.partition(".")[0]].plots
        drawn: Figure = plots.shown(getattr(plots, self._figure), self, ax, options)
        return drawn


def with_units(
    table: pd.DataFrame,
    lengths: Iterable[str] = (),
    angles: Iterable[str] = (),
    units: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """A table in SI units in mm and degrees, which the names of its columns then say.

    `units` has SI units by name, of such columns as are there; what is named nowhere has none.

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"at": [20e-3], "push": [0.1], "bow": [2.0], "outcome": ["held"]})
    >>> with_units(table, ["at"], ["push"], {"bow": "1/m"}).round(3).to_dict("records")
    [{'at_mm': 20.0, 'push_deg': 5.73, 'bow_per_m': 2.0, 'outcome': 'held'}]
    """
    of = {n: unit for n, unit in (units or {}).items() if n in table}
    of |= dict.fromkeys(lengths, "m") | dict.fromkeys(angles, "rad")
    said = {
        "m": ("mm", 1e3), "rad": ("deg", 180 / math.pi), "rad/s": ("deg_per_s", 180 / math.pi),
        "1/m": ("per_m", 1.0), "N m/rad": ("Nm_per_rad", 1.0),
    }  # fmt: skip
    out = table.copy()
    for name, unit in of.items():
        out[name] = table[name] * said[unit][1]
    return out.rename(columns={name: f"{name}_{said[unit][0]}" for name, unit in of.items()})


class Worded(IntEnum):
    """Codes, each with what it says: members are ``NAME = code, "words"``."""

    _words: str

    def __new__(cls, code: int, words: str = "") -> Self:
        made = int.__new__(cls, code)
        made._value_, made._words = code, words
        return made

    @property
    def message(self) -> str:
        """The same in one sentence."""
        return self._words


Member = TypeVar("Member", bound=IntEnum)


def member(kind: type[Member], codes: Any) -> Member:
    """The member that a code stands for; an array of codes stays one, and is typed as a member.

    So that `result.status.message` is text to a type checker, for one result as most are.
    """
    return kind(int(codes)) if codes.ndim == 0 else codes


def interval_text(middle: float, low: float, high: float, unit: str = "") -> str:
    """An estimate with its 95 % interval, rounded to where they differ.

    Examples
    --------
    >>> interval_text(0.09982, 0.0851, 0.1177), interval_text(30.12, 27.83, 32.41, " mm")
    ('0.100 (95 %: 0.085 to 0.118)', '30.1 mm (95 %: 27.8 to 32.4)')
    """
    width = abs(high - low)
    if not (math.isfinite(middle) and math.isfinite(width) and width > 0):
        return f"{middle:.3g}{unit} (95 %: {low:.3g} to {high:.3g})"
    digits = max(1 - math.floor(math.log10(width)), 0)
    if abs(middle) >= 1e4 or digits > 6:
        return f"{middle:.4g}{unit} (95 %: {low:.4g} to {high:.4g})"
    return f"{middle:.{digits}f}{unit} (95 %: {low:.{digits}f} to {high:.{digits}f})"


def plain_number(value: float, digits: int = 4) -> str:
    """A number as people write it, to so many digits: without an exponent from 1e-5 to 1e9.

    Examples
    --------
    >>> plain_number(1200.0, 3), plain_number(0.25), plain_number(123456.7), plain_number(2e12)
    ('1200', '0.25', '123457', '2e+12')
    """
    if value == 0 or not math.isfinite(value) or not 1e-5 <= abs(value) < 1e9:
        return f"{value:.{digits}g}"
    places = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def counted(number: int, thing: str) -> str:
    """A number of things.

    Examples
    --------
    >>> counted(1, "trial"), counted(2, "trial"), counted(2, "touch")
    ('1 trial', '2 trials', '2 touches')
    """
    plural = "es" if thing.endswith("ch") else "s"
    return f"{number} {thing}{plural if number != 1 else ''}"


def distinct(*given: Array) -> tuple[list[Array], Index]:
    """The distinct combinations (m,) of values (n,) or (1,), and which each of n is."""
    values, codes = zip(*(np.unique(a, return_inverse=True) for a in given), strict=True)
    shape = tuple(v.size for v in values)
    kinds, which = np.unique(
        np.ravel_multi_index(np.broadcast_arrays(*codes), shape), return_inverse=True
    )
    return [v[i] for v, i in zip(values, np.unravel_index(kinds, shape), strict=True)], which


def weighted_quantiles(values: Array, weight: Array, p: ArrayLike) -> Array:
    """Quantiles at `p` of values (n,) of which each has a weight: it lies in the middle of it."""
    order = np.argsort(values)
    share = (np.cumsum(weight[order]) - weight[order] / 2) / weight.sum()
    return np.interp(np.asarray(p, dtype=float), share, values[order])


def density_quantiles(x: Array, density: Array, p: ArrayLike) -> Array:
    """Quantiles (..., Q) at p (Q,) of densities (..., X), straight between x, (X,) or (..., X)."""
    mass = np.cumsum((density[..., 1:] + density[..., :-1]) / 2 * np.diff(x), axis=-1)
    below = np.insert(mass / mass[..., -1:], 0, 0.0, axis=-1).reshape(-1, np.shape(x)[-1])
    each = zip(below, np.broadcast_to(x, density.shape).reshape(below.shape), strict=True)
    out = [np.interp(np.asarray(p, dtype=float), rise, at) for rise, at in each]
    return np.reshape(out, density.shape[:-1] + np.shape(p))


def methods_text(sentences: Sequence[str]) -> str:
    """Sentences of a methods section as one paragraph, which ends in what they were done with."""
    made = f"weberwhisk {__version__} (NumPy {version('numpy')}, SciPy {version('scipy')})"
    return " ".join([*sentences, f"This was done with {made}."])


def paragraphs(sections: Mapping[str, Sequence[str]], width: int | None = None) -> str:
    """A report: a paragraph for each heading, its sentences one a line, or wrapped to a width."""
    out: list[str] = []
    for heading, sentences in sections.items():
        if width is None:
            out.append(
                Advice.joined("\n" if len(sentences) > 1 else " ", [f"{heading}.", *sentences])
            )
        else:
            out.append(textwrap.fill(" ".join([f"{heading}.", *sentences]), width))
    return Advice.joined("\n\n", out) + "\n"
