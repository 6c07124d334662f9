"""Refusals, and advice on what to write: data, said in Python or as another interface types it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

__all__ = [
    "Advice", "Argument", "Call", "Named", "Refusal", "Remedy", "argument", "call", "in_code",
    "named", "remedy", "without_remedies",
]  # fmt: skip


@dataclass(frozen=True)
class Named:
    """A parameter of the package by its name."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Argument:
    """A parameter with the value to write; ... is a value that only the user knows.

    `of` is the function whose parameter it is, where others have one of the same name and another
    meaning.
    """

    name: str
    value: Any
    of: str = ""

    def __str__(self) -> str:
        return f"{self.name}={in_code(self.value)}"


@dataclass(frozen=True)
class Call:
    """A call with its arguments, some of them text.

    `also` is what Python needs besides, such as an import.
    """

    function: str
    arguments: tuple[str, ...]
    also: str = ""

    def __str__(self) -> str:
        return f"{self.function}({', '.join(self.arguments)}){self.also}"


Typed = Named | Argument | Call


@dataclass(frozen=True)
class Remedy:
    """What to write for another answer: text that a report of the answer leaves out."""

    text: Advice

    def __str__(self) -> str:
        return str(self.text)


class Advice(str):
    """Text of which pieces can be typed; as a str it says them in Python.

    Sums with text keep the pieces, formatted strings lose them.

    Examples
    --------
    >>> said = "write " + argument("bias", "none") + ", say"
    >>> said
    "write bias='none', say"
    >>> said.rendered(lambda piece: f"--{piece.name} {piece.value}")
    'write --bias none, say'
    """

    pieces: tuple[str | Typed | Remedy, ...]

    def __new__(cls, *pieces: str | Typed | Remedy) -> Advice:
        flat: list[str | Typed | Remedy] = []
        for piece in pieces:
            flat.extend(piece.pieces if isinstance(piece, Advice) else [piece])
        made = super().__new__(cls, "".join(map(str, flat)))
        made.pieces = tuple(flat)
        return made

    def __getnewargs__(self) -> tuple[str | Typed | Remedy, ...]:  # type: ignore[override]
        return self.pieces

    def __add__(self, text: str) -> Advice:
        return Advice(self, text)

    def __radd__(self, text: str) -> Advice:
        return Advice(text, self)

    @classmethod
    def joined(cls, separator: str, texts: Iterable[str]) -> Advice:
        """The texts with a separator between them; pieces that can be typed are kept."""
        return cls(*[piece for text in texts for piece in (separator, text)][1:])

    def rendered(self, write: Callable[[Typed], str]) -> str:
        """The text with each piece that can be typed as `write` has it."""
        return "".join(
            p.text.rendered(write) if isinstance(p, Remedy)
            else str(p) if isinstance(p, str) else write(p)
            for p in self.pieces
        )  # fmt: skip


def named(name: str) -> Advice:
    """A parameter by its name, as a text."""
    return Advice(Named(name))


def argument(name: str, value: Any, of: str = "") -> Advice:
    """A parameter with its value, as a text.

    Examples
    --------
    >>> argument("columns", {"moment": ...}), argument("states", 3)
    ("columns={'moment': …}", 'states=3')
    """
    return Advice(Argument(name, value, of))


def call(function: str, *arguments: str, also: str = "") -> Advice:
    """A call, as a text.

    Examples
    --------
    >>> call("fit_weber", "trials", argument("states", 3))
    'fit_weber(trials, states=3)'
    """
    return Advice(Call(function, arguments, also))


def remedy(text: str) -> Advice:
    """What to write for another answer, as a text.

    Examples
    --------
    >>> said = "A wire is straight" + remedy("; if bent, write " + argument("curvature", 5)) + "."
    >>> print(said)
    A wire is straight; if bent, write curvature=5.
    >>> print(without_remedies(said))
    A wire is straight.
    """
    return Advice(Remedy(Advice(text)))


def without_remedies(text: str) -> str:
    """A text without what to write for another answer."""
    pieces = text.pieces if isinstance(text, Advice) else (text,)
    return "".join(str(piece) for piece in pieces if not isinstance(piece, Remedy))


def rendered(text: str, write: Callable[[Typed], str]) -> str:
    """A text as `write` says its pieces; one without is as it is."""
    return text.rendered(write) if isinstance(text, Advice) else text


def in_code(value: Any) -> str:
    """A value as it is written in Python."""
    if value is ...:
        return "…"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {in_code(item)}' for key, item in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(in_code, value))}]"
    if isinstance(value, Real) and not isinstance(value, bool):  # NumPy's too
        short = f"{value:g}"
        return short if float(short) == value else str(value)
    if hasattr(value, "dist") and hasattr(value, "kwds"):  # a frozen distribution of SciPy
        given = [*map(in_code, value.args), *(str(Argument(*pair)) for pair in value.kwds.items())]
        return f"scipy.stats.{value.dist.name}({', '.join(given)})"
    return str(getattr(value, "typed", None) or repr(value))


class Refusal(ValueError):
    """Input that the package does not take; its text is one sentence.

    Parameters
    ----------
    what
        What is wrong: the sentence up to the value got. It may end in a question.
    got
        The value got, as it stands in the sentence; None where there is none to show.
    remedy
        What to write instead, without the full stop.

    Examples
    --------
    >>> str(Refusal("draws must be a whole number of 1 or more", 0.5, "write draws=200, say"))
    'draws must be a whole number of 1 or more, got 0.5; write draws=200, say.'
    >>> str(Refusal("A whisker of 50 m is none: did you pass mm?", remedy="write 50e-3"))
    'A whisker of 50 m is none: did you pass mm? Write 50e-3.'
    """

    def __init__(self, what: str, got: object = None, remedy: str = "") -> None:
        super().__init__(what, got, remedy)  # all of them, so that it comes back from a worker
        self.what, self.got, self.remedy = what, got, remedy

    def __str__(self) -> str:
        start = self.what if self.got is None else f"{self.what}, got {self.got}"
        if start.endswith("?") and self.remedy:
            return f"{start} {self.remedy[:1].upper()}{self.remedy[1:]}."
        if self.remedy:
            return f"{start}; {self.remedy}."
        return str(start) if self.got is None else f"{start}."

    def rendered(self, write: Callable[[Typed], str]) -> Refusal:
        """The same refusal in other words for what can be typed."""
        got = rendered(self.got, write) if isinstance(self.got, str) else self.got
        return Refusal(rendered(self.what, write), got, rendered(self.remedy, write))
