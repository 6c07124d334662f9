"""Maps of moment and forces, in the plane (§2f) and in all directions (§2g)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .._util.checks import number, numbers, one_or_more, positive_number, refuse_hinge
from .._util.refusals import Refusal
from .._util.values import Array, Codes
from ..mechanics import closed_form
from ..mechanics.contact import Outcome
from ..mechanics.curved_surface import SIX
from ..mechanics.forward import ForwardModel, forward_of
from ..receptors import GeneralisedWeber, Joint, ReceptorNoise, Weber
from ..whisker import Whisker
from .protocol import Cue, Encoded, reach_at, readings

__all__ = ["IN_SPACE", "SIGNALS", "ForceMap", "SpaceMap"]

SIGNALS = ("moment", "axial_force", "transverse_force")


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ForceMap(Cue):
    """Radial distance, and deflection angle where unknown, from moment and forces at the base.

    Moment M and axial force Fx, the paper's pair, are one-to-one with the contact on a tapered
    whisker; on a cylinder M² = 2EI·Fx at every contact, so that the map collapses to a curve and
    the posterior to a ridge. The transverse force Fy (Scholz & Rahn 2004) with either of the others
    is one-to-one on a cylinder too. At a known angle the moment is enough.

    Parameters
    ----------
    signal_names : sequence of {"moment", "axial_force", "transverse_force"}
        Which are encoded.
    deflection_angle : float, optional
        θ_d, rad, where it is known; by default it is unknown. On a curved whisker counted from
        where it first touches: ``press(w, r, rest_angle(w, r) + deflection_angle)``.

    Raises
    ------
    ValueError
        For an unknown, a repeated or no signal, and an angle that is not positive.

    Notes
    -----
    The transverse force is that across the base tangent, and changes its sign where the contact
    angle passes 90°, the axial force of a whisker on its concave side at light contacts: where they
    do, their noise has a floor (`inference.default_noise`). For an unknown stiffness see
    `UnknownStiffness`, for correlated noise and a Weber fraction of each signal `Weber`.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> signals, outcome = ForceMap().signals(w, np.array([30e-3, 0.4]))
    >>> contact, outcome = ForceMap().contact(w, signals)
    >>> contact.round(9)
    array([0.03, 0.4 ])
    """

    takes_curved = True
    signal_names: tuple[str, ...] = SIGNALS[:2]
    _: KW_ONLY
    deflection_angle: float | None = None

    def __init__(
        self, signal_names: Sequence[str] = SIGNALS[:2], *, deflection_angle: float | None = None
    ) -> None:
        names = one_or_more("signals", signal_names, SIGNALS)
        if deflection_angle is not None:
            hint = "give radians, or None where it is unknown"
            deflection_angle = positive_number("deflection_angle", deflection_angle, hint)
        self._set(signal_names=names, deflection_angle=deflection_angle)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The distance, and the deflection angle where it is not known."""
        return ("radial_distance", "deflection_angle")[: 1 + (self.deflection_angle is None)]

    @cached_property
    def _columns(self) -> list[int]:
        """Columns of the signals among all three."""
        return [SIGNALS.index(name) for name in self.signal_names]

    def _place(self, contact: Array) -> tuple[Array, Array]:
        """Distance and angle of a contact."""
        contact = np.asarray(contact, dtype=float)
        r = contact[..., 0]
        if self.deflection_angle is None:
            return r, contact[..., 1]
        return r, np.full_like(r, self.deflection_angle)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Moment (N m) and forces (N), (..., S), and outcome of a contact (..., U)."""
        signals, outcome = forward_of(whisker, model).signals(*self._place(contact))
        if self._columns == [0, 1]:  # a view, where it will do: the bulk of all work
            return signals[..., :2], outcome
        return signals[..., self._columns], outcome

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        r, theta = self._place(contact)
        slope = forward_of(whisker, model).jacobian(r, theta)
        return slope[..., self._columns, : len(self.unknowns)]

    def farthest(self, whisker: Whisker) -> float:
        """The tip, or where the whisker flicks past at the known angle, m."""
        if self.deflection_angle is None:
            return forward_of(whisker).reach
        return reach_at(whisker, self.deflection_angle, "deflection_angle")

    # -- inverse -------------------------------------------------------------------------------

    def contact(self, whisker: Whisker, signals: ArrayLike) -> Encoded:
        """The contact that gives these signals: of two signals, or of the moment at a known angle.

        Newton's method from the closed-form inverse, or from the nearest contact of a coarse map;
        bisection at a known angle, where the moment falls with distance.

        Parameters
        ----------
        whisker : Whisker
        signals : array, shape (..., S)
            Moment (N m) and forces (N), as in `signal_names`; of the moment alone also (...).

        Returns
        -------
        contact : array, shape (..., U)
            r (m) and θ_d (rad); NaN where no held contact on this whisker gives the signals.
        outcome : array of int
            `HELD`, or `OUT_OF_REACH` where there is none: every reading of M and Fx on a cylinder,
            and readings too stiff or too slack for this taper.

        Raises
        ------
        ValueError
            For any other set of signals: more than the unknowns have no exact inverse, and a force
            alone at a known angle has several.
        """
        target = numbers("signals", signals, "give the base signals in SI units")
        if self.deflection_angle is not None and self.signal_names == ("moment",):
            alone = target.ndim == 0 or target.shape[-1] != 1
            target = readings("signals", target[..., None] if alone else target, 1)
            contact = self._bisect(whisker, target)
        elif self.deflection_angle is None and len(self.signal_names) == 2:
            target = readings("signals", target, 2)
            order = np.argsort(self._columns)  # as the closed form has them
            ordered = ForceMap([self.signal_names[i] for i in order])
            contact = ordered._solve(whisker, target[..., order])
        else:
            raise Refusal(
                f"There is no unique contact for the signals of {self!r}",
                remedy="write ww.posterior(observer, reading), which needs none",
            )
        lost = np.isnan(contact[..., 0])
        return contact, np.where(lost, Outcome.OUT_OF_REACH, Outcome.HELD).astype(np.int8)

    def reading_outcome(self, whisker: Whisker, reading: Array) -> Codes:
        """What `contact` says of readings (..., S); `HELD` where there is no unique inverse."""
        known = self.deflection_angle is not None
        if (self.signal_names != ("moment",)) if known else (len(self.signal_names) != 2):
            return np.zeros(reading.shape[:-1], dtype=np.int8)
        return self.contact(whisker, reading)[1]

    def _bisect(self, whisker: Whisker, target: Array) -> Array:
        low = np.full(target.shape, 1e-9 * forward_of(whisker).length)
        high = np.full(target.shape, self.farthest(whisker))
        ends = [self.signals(whisker, end)[0] for end in (high * (1 - 1e-12), low)]
        inside = (target >= ends[0]) & (target <= ends[1])
        for _ in range(80):
            middle = (low + high) / 2
            farther = self.signals(whisker, middle)[0] > target
            low, high = np.where(farther, middle, low), np.where(farther, high, middle)
        return np.where(inside, (low + high) / 2, np.nan)

    def _solve(self, whisker: Whisker, target: Array) -> Array:
        contact = np.full(target.shape, np.nan)
        if self.signal_names == SIGNALS[:2]:
            forward = forward_of(whisker)
            r, bent = closed_form.contact_from_signals(forward.base, target[..., 0], target[..., 1])
            solvable = np.isfinite(r)
            angle = bent + forward.hinge_compliance * target[..., 0]
            contact[solvable] = self._newton(
                whisker, target[solvable], r[solvable], angle[solvable]
            )
        # Large angles are far from the closed form: start again from the nearest of a coarse map.
        missed = np.isnan(contact[..., 0]) & (np.abs(target) > 0).all(axis=-1)
        one_to_one = not forward_of(whisker).is_plain or np.any(whisker.taper)
        if np.any(missed) and (one_to_one or self.signal_names != SIGNALS[:2]):
            contact[missed] = self._newton(
                whisker, target[missed], *self._nearest(whisker, target[missed])
            )
        return contact

    def _size(self, whisker: Whisker, target: Array) -> Array:
        """Of the signals; of the transverse force, which passes through zero, not much less."""
        size = np.abs(target)
        if 2 in self._columns[1:]:
            force_size = size[..., 0] / (
                forward_of(whisker).length if self._columns[0] == 0 else 1.0
            )
            size[..., 1] = np.maximum(size[..., 1], 0.1 * force_size)
        return size

    def _nearest(self, whisker: Whisker, target: Array) -> tuple[Array, Array]:
        """The contact of a coarse map whose signals are nearest in logarithms, (n,) each."""
        forward = forward_of(whisker)
        r = np.linspace(0.01, 0.99, 50)[:, None] * forward.reach
        share = np.sin(np.linspace(0.02, 0.98, 50) * np.pi / 2)
        theta = share * forward.limit(r)
        grid = np.stack(np.broadcast_arrays(r, theta), axis=-1).reshape(-1, 2)
        mapped = self.signals(whisker, grid)[0]
        sizes = self._size(whisker, target)
        best = [
            np.nansum(_miss(mapped, y, size)[0] ** 2, axis=1).argmin()
            for y, size in zip(target, sizes, strict=True)
        ]
        return grid[best, 0], grid[best, 1]

    def _newton(self, whisker: Whisker, target: Array, r: Array, theta: Array) -> Array:
        """Newton's method in ln r and ln θ_d. NaN where it fails."""
        forward = forward_of(whisker)
        length = forward.reach
        contact = np.stack([np.minimum(r, 0.98 * length), theta], axis=-1)
        solution, size = np.full(target.shape, np.nan), self._size(whisker, target)
        left = np.arange(len(target))
        least, since = np.full(len(target), np.inf), np.zeros(len(target), dtype=int)
        for _ in range(60):
            r, theta = contact[left].T
            point = np.stack([r, np.minimum(theta, 0.995 * forward.limit(r))], axis=-1)
            signals = self.signals(whisker, point)[0]
            miss, slope = _miss(signals, target[left], size[left])
            (a, b), (c, d) = np.moveaxis(
                self.jacobian(whisker, point) * slope[..., :, None] * point[..., None, :], 0, -1
            )
            with np.errstate(divide="ignore", invalid="ignore"):
                move = np.stack([d * miss[:, 0] - b * miss[:, 1], a * miss[:, 1] - c * miss[:, 0]])
                move = np.clip(move / (a * d - b * c), -0.3, 0.3).T
                after = point * np.exp(move)
            after[:, 0] = np.where(after[:, 0] < length, after[:, 0], (point[:, 0] + length) / 2)
            near = np.all(np.abs(miss) < 1e-9, axis=-1)
            solution[left] = np.where(near[:, None], after, np.nan)
            contact[left] = after
            # A point at which the signals depend on one unknown alone leads nowhere, nor do ten
            # steps that come no nearer.
            far = np.abs(miss).max(axis=-1)
            since[left] = np.where(far < 0.99 * least[left], 0, since[left] + 1)
            least[left] = np.fmin(far, least[left])
            going = ~near & np.isfinite(after).all(axis=-1) & (since[left] < 10)
            left = left[going]
            if not left.size:
                break
        return solution


def _miss(signals: Array, target: Array, size: Array) -> tuple[Array, Array]:
    """How far signals are from their target, and how fast that falls with each signal.

    On an axis that is logarithmic for signals that are far too large, as there the map is nearly
    linear, and that passes through zero smoothly.
    """
    miss = np.arcsinh(target / size) - np.arcsinh(signals / size)
    return miss, 1 / np.hypot(signals, size)


# -- in all directions -----------------------------------------------------------------------------

DIRECTIONS = ("moment_direction", "force_direction")
#: What `SpaceMap` may sense: sizes, components and angles.
IN_SPACE = tuple(dict.fromkeys((*SIGNALS, *SIX, *DIRECTIONS, "torsion_angle")))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SpaceMap(Cue):
    """Distance, deflection angle and azimuth from moment and forces in all directions.

    The paper's map in three dimensions, Scholz & Rahn's with a second plane. A straight whisker
    bends in the plane of its contact. Friction (`Friction`) acts in that plane, and a hinge at the
    base, which is as stiff in all directions, turns in it. The sizes of moment and forces are those
    of `ForceMap`, and the azimuth ω of the contact about the base tangent (from y towards z) is the
    direction of both: F = (−Fx, Fy cos ω, Fy sin ω), moment (0, −M sin ω, M cos ω).

    A curved whisker bends out of the plane of its curvature and twists, so that all signals inform
    of all three unknowns (`mechanics.rod`, with friction along the whisker). Its deflection is
    counted from where it first touches at that distance, and ω is the direction of the push there:
    at 0 to the side that it curves to, as `ForceMap` has it, at π against its curvature.

    Parameters
    ----------
    signal_names : sequence of str, optional
        Which are sensed, of ``"moment"`` and ``"transverse_force"``, the sizes of what is across
        the base tangent, and their directions ``"moment_direction"`` and ``"force_direction"``,
        rad; ``"axial_force"``, ``"force_y"``, ``"force_z"``, ``"torsion"``, ``"moment_y"`` and
        ``"moment_z"``, the components of force and moment; and ``"torsion_angle"``, by which the
        moment leans out of the plane across the base tangent, rad. By default the sizes of moment,
        axial and transverse force and the two directions: all that there is of a straight whisker.
        A curved one's torsion is one more.
    roll : float
        Angle of the plane of curvature about the base tangent, rad: the whisker curves towards
        ω = roll. `UnknownRoll` is for a roll that is not known.

    Raises
    ------
    ValueError
        For an unknown, a repeated or no signal, and a roll that is not finite. Where it is used,
        for a curved whisker on a hinge.

    Notes
    -----
    Directions that differ by whole turns are the same, and a posterior continues beyond an azimuth
    of π. A prior of your own has ends, unless it is uniform over a whole turn.

    A straight whisker's force that points away from the push, as it does beyond a contact angle of
    90°, or sooner with friction, has a negative size, and the direction of the push. A curved
    whisker's turns round out of the plane: its sizes are positive, and its directions may be any.

    Components change sign, and so may axial and transverse forces of curved whiskers and of those
    that rub: their noise has a floor (`inference.default_noise`).

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> signals, outcome = SpaceMap().signals(w, np.array([30e-3, 0.4, 1.0]))
    >>> flat, _ = ForceMap().signals(w, np.array([30e-3, 0.4]))
    >>> bool((signals[:2] == flat).all()), signals[3:]
    (True, array([1., 1.]))
    """

    takes_curved = True
    unknowns = ("radial_distance", "deflection_angle", "azimuth")
    signal_names: tuple[str, ...] = (*SIGNALS, *DIRECTIONS)
    roll: float = 0.0

    def __init__(
        self, signal_names: Sequence[str] = (*SIGNALS, *DIRECTIONS), *, roll: float = 0.0
    ) -> None:
        names = one_or_more("signals", signal_names, IN_SPACE)
        hint = "give radians, 0 where the whisker curves towards y; UnknownRoll has a prior of it"
        roll = number("roll", roll, hint)
        self._set(signal_names=names, roll=roll)

    @property
    def is_isotropic(self) -> bool:
        """False with components of a force or a moment across the base tangent."""
        return not any(name.endswith(("_y", "_z")) for name in self.signal_names)

    @property
    def circular(self) -> tuple[bool, ...]:
        """The two directions."""
        return tuple(name in DIRECTIONS for name in self.signal_names)

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        """The mechanics of contacts (..., 3): those of a curved whisker, at their azimuths."""
        forward = forward_of(whisker)
        if forward.is_flat:
            return forward
        refuse_hinge(forward.whisker, "SpaceMap of a curved whisker")
        return replace(forward, azimuth=np.asarray(contact, dtype=float)[..., 2] - self.roll)

    def farthest(self, whisker: Whisker) -> float:
        return self.forward(whisker, np.zeros(3)).reach

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        contact = np.asarray(contact, dtype=float)
        azimuth = contact[..., 2]
        place = contact.copy()
        place[..., 2] = 0.0 if _is_flat(forward_of(whisker), model) else azimuth - self.roll
        return self.from_plane(whisker, place, model=model)(azimuth)

    def from_plane(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> Callable[[Array], Encoded]:
        """The signals as a function of the azimuth (...) of contacts (..., 3).

        The third number of a contact is its azimuth from the plane of curvature. The azimuth that
        the function takes is that number plus the roll, by which the signals are turned.
        """
        forward = forward_of(whisker, model)
        self.forward(whisker, np.zeros(3))  # refuses what it does not know
        r, push, turn = np.moveaxis(contact, -1, 0)
        if _is_flat(forward, model):
            sizes, outcome = forward.signals(r, push)
            moment, axial, across = np.moveaxis(sizes, -1, 0)
            zero = np.zeros_like(moment)
            force, bending, twist = (across, zero), (moment, zero), zero
            signed = True
        else:
            six, outcome = replace(forward, azimuth=turn).in_space(r, push)
            axial, y, z, twist, m_y, m_z = np.moveaxis(six, -1, 0)
            # Along the push and across it.
            c, s = np.cos(turn), np.sin(turn)
            force = c * y + s * z, c * z - s * y
            bending = c * m_z - s * m_y, -c * m_y - s * m_z
            signed = False

        def turned(azimuth: Array) -> Encoded:
            out = _named(self.signal_names, axial, force, twist, bending, azimuth, signed)
            # A direction that is no number is none of a contact.
            off = (outcome == Outcome.HELD) & ~np.isfinite(azimuth)
            outcomes = np.where(off, np.int8(Outcome.OUT_OF_REACH), outcome)
            out[outcomes != Outcome.HELD] = np.nan
            return out, outcomes

        return turned

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        contact = np.asarray(contact, dtype=float)
        sizes = [name for name in self.signal_names if name in SIGNALS]
        separate = sizes and self.signal_names == (*sizes, *DIRECTIONS)
        if not (separate and forward_of(whisker).is_flat):
            return super().jacobian(whisker, contact, model=model)
        out = np.zeros((*contact.shape[:-1], len(self.signal_names), 3))
        out[..., :-2, :2] = ForceMap(sizes).jacobian(whisker, contact[..., :2], model=model)
        out[..., -2:, 2] = 1.0
        return out

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """Flat all around, of the azimuth."""
        return {"azimuth": scipy.stats.uniform(-np.pi, 2 * np.pi)}

    def default_noise(self) -> ReceptorNoise:
        """Weber's law, k = 0.1, for sizes and components; as much across them: 0.1 rad."""
        kinds = [name.endswith(("direction", "angle")) for name in self.signal_names]
        runs = [(angle, len(list(group))) for angle, group in groupby(kinds)]
        noises = [GeneralisedWeber(0, floor=0.1) if angle else Weber(0.1) for angle, _ in runs]
        return Joint(noises, sizes=[n for _, n in runs]) if len(runs) > 1 else noises[0]


def _is_flat(forward: ForwardModel, model: str | None) -> bool:
    """Whether the whisker bends in the plane of its contact, or is taken to."""
    return forward.is_flat or model in ("elastica", "closed_form")


def _named(
    names: Sequence[str],
    axial: Array,
    force: tuple[Array, Array],
    twist: Array,
    bending: tuple[Array, Array],
    azimuth: Array,
    signed: bool,
) -> Array:
    """The signals named (..., S), from forces and moments (along the push, across it).

    A vector that points away from the push has a negative size where sizes are signed, so that the
    directions of a straight whisker are the azimuth itself.
    """
    c, s = np.cos(azimuth), np.sin(azimuth)
    out = []
    for name in names:
        ahead, aside = bending if name.startswith("moment") else force
        if name == "axial_force":
            value = axial
        elif name == "torsion":
            value = twist
        elif name == "torsion_angle":
            value = np.arctan2(twist, np.hypot(*bending))
        elif name.endswith("_direction"):
            value = azimuth if signed else azimuth + _angle(ahead, aside)
        elif name in ("force_y", "moment_z"):
            value = c * ahead - s * aside
        elif name in ("force_z", "moment_y"):
            value = (s * ahead + c * aside) * (-1.0 if name == "moment_y" else 1.0)
        else:
            value = ahead if signed else np.hypot(ahead, aside)
        out.append(np.broadcast_to(value, np.broadcast_shapes(azimuth.shape, ahead.shape)))
    return np.stack(out, axis=-1)


def _angle(ahead: Array, aside: Array) -> Array:
    """Angles (...) from the push, from −π/2 to 3π/2, so that none near 0 or π jumps by a turn."""
    turned: Array = np.arctan2(-ahead, aside)  # from −π at −π/2
    return np.asarray(turned + np.pi / 2)
