"""What every model returns: a bending whisker, and what became of the contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from .. import domain
from .._util.checks import finite, refuse_hinge
from .._util.refusals import Refusal
from .._util.values import Array, Codes, Flags, Line, Shown, Worded, member, pd
from ..whisker import Whisker

__all__ = [
    "NUMBERS", "TIP_ROUNDING", "TOLERANCE", "Bending", "FlickPast", "Model", "Outcome",
    "bending", "beyond_tip", "by_rows", "flat_with", "friction", "in_pieces", "signals_of",
]  # fmt: skip


class Outcome(Worded):
    """What became of a contact; `message` says it in words."""

    HELD = 0, "held: a stable contact"
    PAST_FOLD = (
        1,
        "past the fold: in balance at this force, but an object fixed here would already have "
        "been flicked past",
    )
    FLICKED_PAST = 2, "flicked past: no equilibrium on the first branch reaches this load"
    SLIPPED_OFF_TIP = 3, "slipped off the tip: the contact would lie beyond the tip"
    OUT_OF_REACH = 4, "out of reach: the contact lies beyond the whisker"
    STUCK = 5, "stuck: at this friction the contact does not slide so far"
    TOUCHES_TWICE = 6, "touches twice: the whisker meets the object at a second point"
    UNRESOLVED = 7, "unresolved: damping merges the peaks of neighbouring modes"
    NO_TOUCH = 8, "no touch: no contact was sensed, so that only what lies in reach is ruled out"
    TIP_NOT_TOUCHED = (
        9,
        "tip not touched: the shaft was, so that only what lies beyond the tip is ruled out",
    )
    PARALLEL = 10, "parallel: the two lines of sight do not meet ahead of the whisker"
    END_OF_WHISKING = 11, "end of whisking: the range of whisking ends before the balance"
    CONTRADICTORY = 12, "contradictory: no distance lets just these whiskers touch"
    ONE_SIDED = (
        13,
        "one-sided: at some bearing that is possible, the contact is out of reach from one end of "
        "the side",
    )
    NOT_A_READING = 14, "not a reading: a number of it is missing or infinite"


class Model(Worded):
    """The models of the mechanics, from the simplest up: each leaves less out."""

    CLOSED_FORM = 0, "the closed form"
    ELASTICA = 1, "the straight elastica"
    PROFILE = 2, "the curved planar beam"
    ROD = 3, "the rod in space"


@dataclass(frozen=True, eq=False, repr=False)
class Bending(Shown):
    """A whisker bent against a point: signals at the base, the contact and its outcome.

    All values have the broadcast shape of the inputs and are in SI units; `outcome` and `model` are
    members for scalars and arrays of their integers otherwise. Where there is no equilibrium the
    numbers are NaN and `outcome` says why. Angles and transverse signals carry the sign of the
    deflection.

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
    model : Model or array of int
        The model that was used.
    error : float or array
        Estimated relative error of the signals.
    whisker : Whisker
    """

    _figure: ClassVar[str] = "bending"
    moment: Array
    axial_force: Array
    transverse_force: Array
    radial_distance: Array
    deflection_angle: Array
    contact_angle: Array
    arc_length: Array
    force: Array
    outcome: Outcome
    model: Model | Codes
    error: Array
    whisker: Whisker

    @property
    def outside_domain(self) -> str:
        """Which properties lie outside `weberwhisk.domain`, as a sentence; empty if none.

        Examples
        --------
        >>> from weberwhisk import press
        >>> press(Whisker(0.5, 100e-6, 5e-6), 0.1, 0.1).outside_domain
        'Outside the domain: a length of 500 mm, where whiskers are 2 to 200 mm long.'
        """
        in_contact = np.asarray(self.held)
        share = np.asarray(self.radial_distance / self.whisker.length)[in_contact]
        return domain.sentence(domain.of_whisker(self.whisker) + domain.of_contact(share, 1.0))

    @property
    def held(self) -> Flags:
        """True where the contact is stable."""
        return np.equal(self.outcome, Outcome.HELD)

    def _line(self) -> str:
        if np.ndim(self.moment):
            count, shape = int(np.sum(self.held)), "×".join(map(str, np.shape(self.moment)))
            models = ", ".join(Model(int(m)).message for m in np.unique(self.model))
            return f"{shape} contacts, {count} of {np.size(self.moment)} held; {models}"
        signals = (
            f"M = {self.moment * 1e6:.4g} µN m, Fx = {self.axial_force * 1e6:.4g} µN, "
            f"Fy = {self.transverse_force * 1e6:.4g} µN"
        )
        place = f"r = {self.radial_distance * 1e3:.4g} mm, "
        place += f"θ_d = {np.degrees(self.deflection_angle):.4g}°"
        numbers = f"{signals} at {place}; " if self.held else ""
        return f"{numbers}{Outcome(int(self.outcome)).message}; {Model(int(self.model)).message}"

    def _table(self) -> pd.DataFrame:
        units = {
            "radial_distance": ("mm", 1e-3), "deflection_angle": ("deg", np.pi / 180),
            "moment": ("micronewton_metre", 1e-6), "axial_force": ("micronewton", 1e-6),
            "transverse_force": ("micronewton", 1e-6),
        }  # fmt: skip
        table = pd.DataFrame(
            {f"{n}_{u}": np.ravel(getattr(self, n)) / scale for n, (u, scale) in units.items()}
        )
        names = [Outcome(int(o)).name.lower() for o in np.ravel(self.outcome)]
        return table.assign(outcome=names)

    @property
    def normalised_moment(self) -> Array:
        """M·L/EI₀, as in the paper's figures."""
        return self.moment / self.whisker.moment_scale

    @property
    def normalised_axial_force(self) -> Array:
        """Fx·L²/EI₀."""
        return self.axial_force / self.whisker.force_scale


#: Relative error of the signals to stay below, by default, where equations are integrated.
TOLERANCE = 1e-9
#: The numbers of a `Bending`, in order.
NUMBERS = (
    "moment", "axial_force", "transverse_force", "radial_distance", "deflection_angle",
    "contact_angle", "arc_length", "force",
)  # fmt: skip
#: A contact this close beyond the tip (relative) is rounding, not a contact beyond the tip.
TIP_ROUNDING = 1e-12


def bending(
    whisker: Whisker,
    model: Model,
    shape: tuple[int, ...],
    numbers: Array,
    outcome: Codes,
    error: Array,
) -> Bending:
    """A `Bending` of the given shape from flat numbers in SI units."""
    values: dict[str, Any] = {
        name: row.reshape(shape)[()] for name, row in zip(NUMBERS, numbers, strict=True)
    }
    return Bending(
        **values,
        outcome=member(Outcome, outcome.reshape(shape)),
        model=member(Model, np.full(shape, model, dtype=np.int8)),
        error=error.reshape(shape)[()],
        whisker=whisker,
    )


def signals_of(bent: Bending) -> Array:
    """Moment, axial and transverse force at the base, (..., 3)."""
    return np.stack([bent.moment, bent.axial_force, bent.transverse_force], axis=-1)


def beyond_tip(distance: Array, length: Array | float, fraction: Array) -> Flags:
    """Whether contacts lie beyond the tip, or at the tip of a perfect cone, which has no stiffness.

    `fraction` is the distance over the apex distance.
    """
    return (distance > length * (1 + TIP_ROUNDING)) | (fraction >= 1)


def in_pieces(solve: Callable[..., Any], *given: Array, axis: int = -1) -> Any:
    """Call `solve` on pieces of flat arrays, (n,) or (1,) for all, and join what it returns."""
    pieces, size = [], 8192  # pieces that fit the cache halve the time of large calls
    last = given[0].size - 1
    for start in range(0, max(last, 1), size):
        piece = slice(start, None if start + size >= last else start + size)  # never one alone
        pieces.append(solve(*[a[piece] if a.size > 1 else a for a in given]))
    if len(pieces) == 1:
        return pieces[0]
    if isinstance(pieces[0], tuple):
        return tuple(np.concatenate(parts, axis=axis) for parts in zip(*pieces, strict=True))
    return np.concatenate(pieces, axis=axis)


def flat_with(whisker: Whisker, *arguments: ArrayLike) -> tuple[tuple[int, ...], list[Array]]:
    """The broadcast shape; length, taper, stiffness and the arguments as flat arrays."""
    given = np.broadcast_arrays(whisker.length, whisker.taper, whisker.stiffness, *arguments)
    flat = [np.ascontiguousarray(a, dtype=float).reshape(-1) for a in given]
    return given[0].shape, flat


def by_rows(
    solve: Callable[..., Any], model: Model, whisker: Whisker, *arguments: ArrayLike
) -> Bending:
    """Broadcast a straight whisker and its contacts, solve them, and shape the result.

    `solve` takes flat arrays ``(length, taper, stiffness, *arguments)`` and returns the eight
    numbers (8, n), the outcomes (n,) and the errors (n,).
    """
    refuse_hinge(whisker, f"The {model.name.lower()} model")
    shape, flat = flat_with(whisker, *arguments)
    return bending(whisker, model, shape, *in_pieces(solve, *flat))


@dataclass(frozen=True, eq=False, repr=False)
class FlickPast(Line):
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

    deflection_angle: Array
    ended_by: Outcome | Codes
    at_end: Bending
    at_moment_peak: Bending

    def _line(self) -> str:
        degrees = np.degrees(np.ravel(self.deflection_angle))
        reasons = sorted({Outcome(o).message for o in np.ravel(self.ended_by)})
        if not degrees.size:
            return "no distances"
        there = degrees[np.isfinite(degrees)]
        if not there.size:
            return "; ".join(reasons)
        ends = dict.fromkeys(f"{a:.4g}°" for a in (there.min(), there.max()))
        return f"θ_d at most {' to '.join(ends)}; {'; '.join(reasons)}"


def friction(friction_angle: ArrayLike) -> Array:
    """Friction angles as an array; a right angle or more is misuse."""
    tilt = finite("friction_angle", friction_angle, "give radians, 0 for no friction")
    if np.any(np.abs(tilt) >= np.pi / 2):
        raise Refusal(
            "friction_angle must be between −π/2 and π/2",
            f"{np.ravel(tilt)[np.argmax(np.abs(tilt))]:g}",
            "give radians, such as np.arctan(0.48)",
        )
    return tilt
