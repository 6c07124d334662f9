"""Refusals: what is wrong, the value got and what to write instead, as data."""

from __future__ import annotations

__all__ = ["Refusal"]


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
        return start if self.got is None else f"{start}."
