"""What every rung returns: a bending whisker, and what became of the contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import domain
from ..whisker import Whisker


class Outcome(IntEnum):
    """What became of a contact; `message` says it in words."""

    HELD = 0
    PAST_FOLD = 1
    FLICKED_PAST = 2
    SLIPPED_OFF_TIP = 3
    OUT_OF_REACH = 4
    STUCK = 5
    TOUCHES_TWICE = 6
    UNRESOLVED = 7
    NO_TOUCH = 8
    TIP_NOT_TOUCHED = 9
    PARALLEL = 10
    END_OF_WHISKING = 11
    CONTRADICTORY = 12
    ONE_SIDED = 13
    AT_LIMIT = 14
    NOT_A_READING = 15

    @property
    def message(self) -> str:
        """The outcome in one sentence."""
        return _MESSAGES[self]


_MESSAGES = {
    Outcome.HELD: "held: a stable contact",
    Outcome.PAST_FOLD: "past the fold: in balance at this force, "
    "but an object fixed here would already have been flicked past",
    Outcome.FLICKED_PAST: "flicked past: no equilibrium on the first branch reaches this load",
    Outcome.SLIPPED_OFF_TIP: "slipped off the tip: the contact would lie beyond the tip",
    Outcome.OUT_OF_REACH: "out of reach: the contact lies beyond the whisker",
    Outcome.STUCK: "stuck: at this friction the contact does not slide so far",
    Outcome.TOUCHES_TWICE: "touches twice: the whisker meets the object at a second point",
    Outcome.UNRESOLVED: "unresolved: damping merges the peaks of neighbouring modes",
    Outcome.NO_TOUCH: "no touch: nothing was felt, so that only what lies in reach is ruled out",
    Outcome.TIP_NOT_TOUCHED: "tip not touched: the shaft was, so that only what lies beyond "
    "the tip is ruled out",
    Outcome.PARALLEL: "parallel: the two lines of sight do not meet ahead of the whisker",
    Outcome.CONTRADICTORY: "contradictory: no distance lets just these whiskers touch",
    Outcome.ONE_SIDED: "one-sided: at some bearing that is possible, the contact is out of reach "
    "from one end of the side",
    Outcome.AT_LIMIT: "at the limit: an object that the tip met bends the whisker almost as far as "
    "it can be held, where slips are not known well enough",
    Outcome.NOT_A_READING: "not a reading: a number of it is missing or infinite",
    Outcome.END_OF_WHISKING: "end of whisking: the range of whisking ends before the balance",
}


class Rung(IntEnum):
    """The rungs of the model ladder, from the cheapest up."""

    CLOSED_FORM = 0
    ELASTICA = 1
    PROFILE = 2
    ROD = 3

    @property
    def title(self) -> str:
        """The rung's name in words."""
        return _TITLES[self]


#: The unit of a bias that is not judged against any noise.
SIGNAL_UNIT = "of a signal"

_TITLES = {
    Rung.CLOSED_FORM: "the closed form",
    Rung.ELASTICA: "the straight elastica",
    Rung.PROFILE: "the curved planar beam",
    Rung.ROD: "the rod in space",
}


@dataclass(frozen=True, eq=False)
class Choice:
    """The rung that each scene needs, and why: what `choose_rung` returns and `press` went by.

    Attributes
    ----------
    rung : Rung or array of int
        The cheapest rung whose bias is within the tolerance.
    error : array (..., 4)
        Largest relative error of the moment and the two forces, estimated, by rung. Infinite where
        the estimate does not vouch for a rung, 0 from the first rung on that models all there is,
        NaN where a rung was not tried.
    bias : array (..., 4)
        What is judged, by rung: the shift of the inferred radial distance by that error, in JNDs,
        or where no noise was named the error itself.
    tolerance : float or array
        The largest bias allowed.
    unit : str
        What bias and tolerance are in, in words.
    """

    rung: Any
    error: NDArray[np.float64]
    bias: NDArray[np.float64]
    tolerance: Any
    unit: str = "JND"

    @classmethod
    def complete(cls, rung: Rung, tolerance: ArrayLike) -> Choice:
        """The lowest rung that models all there is, those below it not tried."""
        off = np.where(np.arange(len(Rung)) < rung, np.nan, 0.0)
        return cls(rung, off, off, tolerance, SIGNAL_UNIT)

    @property
    def why(self) -> Any:
        """The reason in words: one sentence, or an array of them."""
        tolerance = np.broadcast_to(self.tolerance, np.shape(self.rung))
        why = np.empty(np.shape(self.rung), dtype=object)
        for at in np.ndindex(why.shape):
            rung = Rung(int(np.asarray(self.rung)[at]))
            why[at] = _reason(rung, self.bias[at], f"{tolerance[at]:g} allowed", self.unit)
        return why[()]


def _reason(rung: Rung, bias: NDArray[np.float64], allowed: str, unit: str) -> str:
    here = f"{rung.title} is off by {bias[rung]:.2g} {unit}"
    if bias[rung] == 0:
        here = f"{rung.title} models all there is in this scene"
    if rung == Rung.CLOSED_FORM:
        return f"{here}, {allowed}, and nothing is cheaper"
    below = Rung(rung - 1)
    if np.isnan(bias[below]):
        return f"{here}; nothing cheaper was tried"
    if np.isinf(bias[below]):
        return f"{here}; {below.title} finds no contact here, or one too far off to judge"
    return f"{here}; {below.title} is off by {bias[below]:.2g} {unit}, {allowed}"


@dataclass(frozen=True, eq=False)
class Bending:
    """A whisker bent against a point: signals at the base, the contact and its outcome.

    All values have the broadcast shape of the inputs (scalars for scalars), in SI units. Where
    there is no equilibrium the numbers are NaN and `outcome` says why. Angles and the
    transverse signals carry the sign of the deflection.

    Attributes
    ----------
    moment, axial_force, transverse_force : float or array
        Signals at the base: N m; N, positive in compression; N.
    radial_distance, deflection_angle : float or array
        Straight line from base to contact, m, and its angle to the base tangent, rad.
    contact_angle, arc_length, force : float or array
        Tangent angle at the contact, rad; arc length of the contact, m; contact force, N.
    outcome : Outcome or array of int
        What became of the contact.
    model : Rung or array of int
        The rung that was used.
    error : float or array
        Estimated relative error of the signals.
    whisker : Whisker
    choice : Choice, optional
        How the ladder came to the rung; none where the rung was asked for by name.
    """

    moment: Any
    axial_force: Any
    transverse_force: Any
    radial_distance: Any
    deflection_angle: Any
    contact_angle: Any
    arc_length: Any
    force: Any
    outcome: Any
    model: Any
    error: Any
    whisker: Whisker
    choice: Choice | None = None

    @property
    def why(self) -> Any:
        """Why this rung, in words: one sentence, or an array of them."""
        return "it was asked for by name" if self.choice is None else self.choice.why

    @property
    def outside_domain(self) -> str:
        """What of whisker and contacts lies outside `weberwhisk.domain`, in words; empty if none.

        Examples
        --------
        >>> from weberwhisk import press
        >>> press(Whisker(0.5, 100e-6, 5e-6), 0.1, 0.1).outside_domain
        'Outside the domain: a length of 500 mm, where whiskers are 2 to 200 mm long.'
        """
        held = np.asarray(self.held)
        share = np.asarray(self.radial_distance / self.whisker.length)[held]
        return domain.sentence(domain.of_whisker(self.whisker) + domain.of_contact(share, 1.0))

    @property
    def held(self) -> Any:
        """True where the contact is stable."""
        return np.equal(self.outcome, Outcome.HELD)

    @property
    def normalised_moment(self) -> Any:
        """M·L/EI₀, as in the paper's figures."""
        return self.moment / self.whisker.moment_scale

    @property
    def normalised_axial_force(self) -> Any:
        """Fx·L²/EI₀."""
        return self.axial_force / self.whisker.force_scale

    @property
    def normalised_radial_distance(self) -> Any:
        """r/L."""
        return self.radial_distance / self.whisker.length


#: Rows solved at a time: pieces that fit the cache halve the time of large calls.
ROWS = 8192
#: The numbers of a `Bending`, in order.
NUMBERS = tuple(f.name for f in fields(Bending))[:8]


#: A contact this close beyond the tip (relative) is rounding, not a contact beyond the tip.
TIP_ROUNDING = 1e-12


def beyond_tip(
    distance: NDArray[np.float64],
    length: NDArray[np.float64] | float,
    fraction: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Beyond the tip, or at the tip of a perfect cone, which has no stiffness to push back.

    `fraction` is the distance over the apex distance.
    """
    return (distance > length * (1 + TIP_ROUNDING)) | (fraction >= 1)


def by_rows(
    solve: Callable[..., tuple[NDArray[np.float64], NDArray[np.int8], NDArray[np.float64]]],
    rung: Rung,
    whisker: Whisker,
    *arguments: ArrayLike,
) -> Bending:
    """Broadcast a whisker and its contacts, solve them row by row, and shape the result.

    `solve` takes flat arrays ``(length, taper, stiffness, *arguments)`` and returns the eight
    numbers (8, n), the outcomes (n,) and the errors (n,).
    """
    given = np.broadcast_arrays(whisker.length, whisker.taper, whisker.stiffness, *arguments)
    shape = given[0].shape
    flat = [np.ascontiguousarray(a, dtype=float).reshape(-1) for a in given]
    n = flat[0].size
    numbers = np.empty((len(NUMBERS), n))
    outcome = np.empty(n, dtype=np.int8)
    error = np.empty(n)
    for start in range(0, n, ROWS):
        part = slice(start, start + ROWS)
        numbers[:, part], outcome[part], error[part] = solve(*(a[part] for a in flat))
    values: dict[str, Any] = {
        name: row.reshape(shape)[()] for name, row in zip(NUMBERS, numbers, strict=True)
    }
    return Bending(
        **values,
        outcome=outcome.reshape(shape) if shape else Outcome(int(outcome[0])),
        model=np.full(shape, rung, dtype=np.int8) if shape else rung,
        error=error.reshape(shape)[()],
        whisker=whisker,
    )


@dataclass(frozen=True, eq=False)
class FlickPast:
    """How far a whisker can be pressed against an object at a given radial distance.

    Attributes
    ----------
    deflection_angle : float or array
        Largest deflection angle, rad.
    ended_by : Outcome or array of int
        `FLICKED_PAST` where a fold ends it, `SLIPPED_OFF_TIP` where the tip does,
        `OUT_OF_REACH` where there is no contact at all.
    at_end, at_moment_peak : Bending
        The whisker at that angle, and where its moment is largest on the way there: the end under
        an imposed base angle, and under a muscle of limited moment.
    """

    deflection_angle: Any
    ended_by: Any
    at_end: Bending
    at_moment_peak: Bending
