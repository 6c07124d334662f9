"""What is to be run: standards, offsets, trials and animals, and what limits them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal, named
from .._util.values import Array, Fields
from ..behaviour.encodings import (
    Encoding,
    checked_encoding,
    gives_signal,
    refuse_out_of_reach,
)
from ..behaviour.psychometric import difference_sd
from ..behaviour.trials import Cells
from .magnitude import DISTANCE, Magnitude, magnitude_of

__all__ = ["Constraints", "Scheme", "lattice", "sized"]

#: Trials of one experiment at most: what is listed must fit the memory.
MOST_TRIALS = 10_000_000
#: Levels of a default design, in sds of the expected difference between the two signals. The widest
#: tell of lapses, which else are taken for a large k: 162 trials do what 288 do at ±0.6, 1.2 and 2.
LEVELS = (-3.5, -1.5, -0.75, 0.75, 1.5, 3.5)


@dataclass(frozen=True, init=False, repr=False)
class Scheme(Fields):
    """An experiment of constant stimuli: what each animal is shown, and how often.

    Parameters
    ----------
    standards : sequence of float, length S
        Stimulus 1: radial distances in m, or stimuli in the unit of another `magnitude`.
    offsets : sequence of float, or of S sequences
        Comparison − standard, signed, in the same unit; one row for all standards or one each.
    trials : int, or sequences of int like `offsets`
        Trials of each comparison, for each animal.
    animals : int
        Or people.
    magnitude : Magnitude
        What the stimuli are.
    conditions : sequence of str
        Two conditions that are compared: all of this in each of them.

    Raises
    ------
    ValueError
        For no standards, offsets or animals, a standard given twice, a level without trials.

    Examples
    --------
    >>> scheme = Scheme([15e-3, 30e-3], [-2e-3, 2e-3], trials=20, animals=3)
    >>> scheme.n_trials, scheme.total_trials
    (80, 240)
    """

    standards: tuple[float, ...]
    offsets: tuple[tuple[float, ...], ...]
    trials: tuple[tuple[int, ...], ...]
    animals: int = 1
    magnitude: Magnitude = DISTANCE
    conditions: tuple[str, ...] = ()

    def __init__(
        self,
        standards: ArrayLike,
        offsets: Sequence[Any],
        trials: int | Sequence[Any] = 20,
        animals: int = 1,
        magnitude: Magnitude = DISTANCE,
        conditions: Sequence[str] = (),
    ) -> None:
        named_apart = tuple(checks.several("conditions", conditions, "write ['control', 'drug']"))
        if len(named_apart) not in (0, 2) or len({*named_apart}) < len(named_apart):
            raise Refusal(
                "two conditions are compared, by names of their own",
                checks.listed(named_apart),
                "write ['control', 'drug'], say",
            )
        hint = 'write ww.design.Magnitude("weight", "g"), say'
        checks.kind("magnitude", magnitude, "a Magnitude", "per_unit", hint)
        at = _standards(standards)
        if np.unique(at).size < at.size:
            raise Refusal(f"a standard was given twice, in {at.tolist()}", remedy="give each once")
        checks.whole("animals", animals, "write 20")
        offset_lists = _for_each_standard("offsets", offsets, at.size)
        one = np.isscalar(trials) or not isinstance(trials, Iterable)
        counts = [[trials] * len(row) for row in offset_lists] if one else None
        counts = counts or _for_each_standard("trials", trials, at.size)  # type: ignore[arg-type]
        for i, (row, n) in enumerate(zip(offset_lists, counts, strict=True)):
            if not row:
                raise Refusal(f"standard {at[i]:g} has no offsets", remedy="give one or more")
            if len(row) != len(n):
                raise Refusal(
                    f"standard {at[i]:g} has {len(row)} offsets and {len(n)} numbers of trials",
                    remedy="give one number for each",
                )
            if len(set(row)) < len(row):
                raise Refusal(
                    f"standard {at[i]:g} has an offset twice, in {row}", remedy="give it once"
                )
            checks.finite("offsets", row, "write for example [-2e-3, 2e-3]")
            for count in n:
                checks.whole(named("trials") + " of a level", count, "write 20")
        order = np.argsort(at)
        set_ = object.__setattr__
        set_(self, "standards", tuple(float(s) for s in at[order]))
        set_(self, "offsets", tuple(tuple(float(o) for o in offset_lists[i]) for i in order))
        set_(self, "trials", tuple(tuple(int(n) for n in counts[i]) for i in order))
        set_(self, "animals", int(animals))
        set_(self, "magnitude", magnitude)
        set_(self, "conditions", tuple(str(name) for name in named_apart))
        if self.total_trials > MOST_TRIALS:
            raise Refusal(
                f"an experiment may have up to {MOST_TRIALS} trials",
                f"{self.total_trials} with all animals",
                "write fewer trials or animals",
            )

    @classmethod
    def spaced(
        cls,
        encoding: Encoding,
        standards: ArrayLike,
        *,
        weber_fraction: float = 0.1,
        levels: ArrayLike = LEVELS,
        trials: int = 20,
        animals: int = 1,
        step: float = 0.0,
        magnitude: Magnitude | None = None,
    ) -> Scheme:
        """A scheme whose offsets are in sds of the expected animal at each standard.

        Parameters
        ----------
        encoding : Encoding
            How a stimulus is expected to be encoded.
        standards : array_like, shape (S,)
        weber_fraction : float
            Of the expected animal.
        levels : array_like
            In sds of the difference between the two signals: at ±1 the animal is right in 84 %.
        trials, animals
            As for `Scheme`.
        step : float
            Standards and comparisons are rounded to its multiples; 0 leaves them.
        magnitude : Magnitude, optional
            What the stimuli are, by default what the encoding is of.

        Examples
        --------
        >>> from weberwhisk import Observer, Whisker, cues
        >>> from weberwhisk.behaviour import CueEncoding
        >>> encoding = CueEncoding(Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance()))
        >>> scheme = Scheme.spaced(encoding, [30e-3], levels=[-1, 1], step=0.5e-3)
        >>> scheme.offsets
        ((-0.002, 0.002),)
        """
        checked_encoding(encoding)
        at = _standards(standards)
        checks.non_negative("step", checks.number("step", step, "write 0"), "write 0, or 1e-5")
        checks.positive("weber_fraction", weber_fraction, "write for example 0.1")
        at = np.unique(_snapped(at, step))
        refuse_out_of_reach(encoding, at, "standard")
        sd = weber_fraction * difference_sd(encoding, at)
        z = np.ravel(checks.finite("levels", levels, "write for example [-2, -1, 1, 2]"))
        offsets = [_snapped(s + u * z, step) - s for s, u in zip(at, sd, strict=True)]
        offsets = [np.unique([float(f"{o:.12g}") for o in row]) for row in offsets]
        for s, one, row in zip(at, sd, offsets, strict=True):
            if row.size < np.size(z):
                said = (magnitude or magnitude_of(encoding)).said
                raise Refusal(
                    f"steps of {said(step)} are too coarse at standard {said(s)}: {np.size(z)} "
                    f"levels fall on {row.size}, as one sd is {said(one)}",
                    remedy="take finer steps, fewer levels or another standard",
                )
        return cls(at, offsets, trials, animals, magnitude or magnitude_of(encoding))

    @property
    def n_trials(self) -> int:
        """Trials of one animal, in all conditions."""
        return sum(map(sum, self.trials)) * max(len(self.conditions), 1)

    @property
    def total_trials(self) -> int:
        """Trials of all animals together."""
        return self.n_trials * self.animals

    @property
    def comparisons(self) -> tuple[tuple[float, ...], ...]:
        """Stimulus 2 of every level."""
        return tuple(
            tuple(float(f"{s + o:.12g}") for o in row)
            for s, row in zip(self.standards, self.offsets, strict=True)
        )

    def cells(self) -> Cells:
        """Every level as a cell of one animal's table, without answers yet; arrays (C,)."""
        sizes = [len(row) for row in self.offsets]
        standard = np.repeat(self.standards, sizes)
        n = np.concatenate([np.asarray(row, dtype=float) for row in self.trials])
        comparison = np.concatenate([np.asarray(row) for row in self.comparisons])
        return Cells(standard, comparison, standard, n, np.zeros(n.size))

    def table(self) -> pd.DataFrame:
        """One row a level: `standard`, `offset` and `comparison`, with their unit, and `trials`."""
        cells, of = self.cells(), self.magnitude
        shown = cells.standard, np.concatenate(self.offsets), cells.stimulus_2
        names = map(of.column, ("standard", "offset", "comparison"))
        table = pd.DataFrame(dict(zip(names, map(of.written, shown), strict=True)))
        return table.assign(trials=cells.n.astype(int))

    def with_trials(self, trials: int) -> Scheme:
        """The same levels with so many trials each."""
        return Scheme(
            self.standards, self.offsets, trials, self.animals, self.magnitude, self.conditions
        )

    def with_animals(self, animals: int) -> Scheme:
        """The same for so many animals."""
        return replace(self, animals=animals)


def sized(scheme: Scheme, vary: str, size: int) -> Scheme:
    """The scheme with so many animals, or trials of the comparison shown most."""
    if vary == "animals":
        return scheme.with_animals(size)
    most = max(map(max, scheme.trials))
    checks.whole("trials", size, "write 20")
    counts = [[max(1, round(n * size / most)) for n in row] for row in scheme.trials]
    return Scheme(
        scheme.standards, scheme.offsets, counts, scheme.animals, scheme.magnitude,
        scheme.conditions,
    )  # fmt: skip


@dataclass(frozen=True, repr=False)
class Constraints(Fields):
    """What the rig and the animal allow.

    Parameters
    ----------
    nearest, farthest : float
        The least and the greatest stimulus: distances that the animal can reach, m.
    step : float
        Stimuli come in steps of this size, counted from 0: those of a pole, m; 0 for any.

    Examples
    --------
    >>> Constraints(nearest=5e-3, farthest=45e-3, step=0.1e-3).positions([20e-3])
    array([0.02])
    """

    nearest: float = 0.0
    farthest: float = float("inf")
    step: float = 0.0

    def __post_init__(self) -> None:
        checks.non_negative_number("step", self.step, "give m, such as 0.1e-3, or 0")
        for name in ("nearest", "farthest"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, float | int | np.number):
                raise Refusal(f"{name} must be a number", checks.shown(value), "give m, or inf")
        if not self.nearest < self.farthest:
            raise Refusal(
                "farthest must lie beyond nearest",
                f"{self.farthest:g} and {self.nearest:g}, {self.nearest - self.farthest:g} short",
                "exchange them, say",
            )

    def positions(self, distance: ArrayLike) -> Array:
        """Stimuli moved to the nearest that there is: distances, to a position of the pole."""
        return _snapped(distance, self.step)

    def check(self, scheme: Scheme, encoding: Encoding) -> None:
        """Refuse a scheme that breaks a constraint.

        Parameters
        ----------
        scheme : Scheme
        encoding : Encoding
            How the animal is expected to encode a stimulus; says which it can.

        Raises
        ------
        ValueError
            Naming the constraint, by how much it is missed and where.
        """
        cells, said = scheme.cells(), scheme.magnitude.said
        if scheme.magnitude.is_distance:
            checks.non_negative_number("nearest", self.nearest, "give m, such as 5e-3")
        ends = f"{said(self.nearest)} to {said(self.farthest)}"
        for name, at in (("standard", cells.standard), ("comparison", cells.stimulus_2)):
            low, high = float(at.min()), float(at.max())
            for value, beyond, side in (
                (low, self.nearest - low, scheme.magnitude.less),
                (high, high - self.farthest, scheme.magnitude.greater),
            ):
                if beyond > 0:
                    raise Refusal(
                        f"{name} {said(value)} is {side} than the range of {ends}, by "
                        f"{said(beyond)}",
                        remedy="move it or widen the range",
                    )
            off = np.abs(at - self.positions(at))
            if self.step and off.max() > 1e-6 * self.step:
                worst = int(np.argmax(off))
                raise Refusal(
                    f"{name} {said(at[worst])} lies between two steps of {said(self.step)}, "
                    f"off by {said(off[worst])}",
                    remedy=f"write {said(float(self.positions(at[worst])))}",
                )
            refuse_out_of_reach(encoding, at, name)


def lattice(
    encoding: Encoding,
    standards: ArrayLike,
    constraints: Constraints | None = None,
    *,
    each_side: int = 16,
    magnitude: Magnitude | None = None,
) -> Scheme:
    """Trials to choose from: comparisons in equal ratios of offset on either side of each standard.

    Parameters
    ----------
    encoding : Encoding
        Says how large an offset is: from 0.01 to 1.2 times the sd of the difference between two
        encodings at k = 1 (`difference_sd`): 2 sds for animals of k = 0.005 and 0.6, about the
        smallest and the greatest expected.
    standards : array_like
    constraints : Constraints, optional
        What falls outside the range is left out, the rest put on the nearest step.
    each_side : int
        Comparisons on either side, at most.
    magnitude : Magnitude, optional
        What the stimuli are, by default what the encoding is of.

    Raises
    ------
    ValueError
        Where a standard is left without comparisons on both sides.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> lattice(IdentityEncoding(), 2.0, each_side=2).comparisons
    ((1.97172, 2.02828, 5.39411),)
    """
    checked_encoding(encoding)
    low, high = encoding.domain
    # A range of distances begins at 0; other stimuli, such as logarithms, need not.
    limits = constraints or Constraints(farthest=high)
    nearest = limits.nearest if constraints else -np.inf
    given = np.atleast_1d(checks.finite("standards", standards, "give one, or several"))
    at = np.unique(limits.positions(given))
    refuse_out_of_reach(encoding, at, "standard")
    ratios = np.geomspace(0.01, 1.2, each_side)
    offsets = []
    for s in at:
        steps = ratios * float(difference_sd(encoding, s))
        levels = limits.positions(np.concatenate([s - steps[::-1], s + steps]))
        levels = np.array([float(f"{v:.6g}") for v in levels])
        inside = (levels >= nearest) & (levels <= limits.farthest)
        levels = levels[inside & (levels > low) & (levels < high)]
        levels = np.unique(
            levels[gives_signal(encoding, levels) & (np.abs(levels - s) > 1e-9 * abs(s))]
        )
        if not (np.any(levels < s) and np.any(levels > s)):
            raise Refusal(
                f"standard {s:g} is left without comparisons on both sides, between "
                f"{max(low, nearest):g} and {min(high, limits.farthest):g}",
                remedy="choose another, or widen the range",
            )
        offsets.append([float(f"{level - s:.12g}") for level in levels])
    return Scheme(at, offsets, magnitude=magnitude or magnitude_of(encoding))


def _standards(standards: ArrayLike) -> Array:
    at = np.ravel(checks.finite("standards", standards, "give one, or several"))
    if not at.size:
        raise Refusal("a design needs standards", "none", "write standards=[15e-3, 30e-3]")
    return at


def _snapped(distance: ArrayLike, step: float) -> Array:
    at = np.asarray(distance, dtype=float)
    return np.asarray(np.round(at / step) * step) if step else at


def _for_each_standard(name: str, values: Sequence[Any], count: int) -> list[list[Any]]:
    """One row a standard: as given, or the same for all."""
    given = checks.several(name, values, "write for example [-2e-3, 2e-3]")
    if given and all(np.ndim(v) == 0 for v in given):
        return [list(given) for _ in range(count)]
    if len(given) != count or any(np.ndim(v) != 1 for v in given):
        raise Refusal(
            f"{name} has {len(given)} rows for {count} standards",
            remedy="give one row for all, or one each",
        )
    return [list(row) for row in given]
