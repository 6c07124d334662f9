"""From a contact to the base signals of one whisker: what cues call.

The signals come from the elastica's `Surface` of a straight whisker, the `CurvedSurface` of any
other, or a named model.

A contact is given by its radial distance and its *deflection from rest*: how far the whisker has
turned since it first touched at that distance. It is the deflection angle of `press` on a straight
whisker, and on a curved one ``press(whisker, r, rest_angle(whisker, r) + deflection)``.

Hinges are in ``docs/theory/models.md``. With θ′ = limit·sin p and θ = largest·sin q the deflections
of the clamped and of the hinged whisker are smooth up to their ends. If the compliance is uncertain
contact is lost from the fraction of the largest θ that is half a turn in the middle of its range,
so that the limit has no kink.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize.elementwise import find_root

from .._util.checks import angle, positive, refuse_hinge
from .._util.refusals import Refusal
from .._util.values import Array, Codes, Flags, Value
from ..whisker import Whisker
from . import closed_form, elastica, ladder
from .beam import beams_of, zero_load
from .contact import Outcome, in_pieces, signals_of
from .curved_surface import THINNEST, CurvedSurface, curved_surface, more_curved, pressed
from .elastica import Surface, surface_of
from .profile import rest_angle
from .shape import Profile

__all__ = ["ForwardModel", "forward_of"]


@dataclass(frozen=True, eq=False)
class ForwardModel(Value):
    """One whisker, the model of its mechanics, and the conditions of its contacts.

    By default signals are interpolated from a table: the elastica's for a straight whisker without
    friction, the planar beam's for any other. The models "profile" and "rod" solve every contact.
    The models "elastica" and "closed_form" take a curved whisker as a straight one of the same
    taper and deflection from rest. On a hinge, tables give the deflection θ′ that bends the
    whisker, and a named model the signals at θ′.

    The `friction` angle (rad, as in `press`), the `offset` added to the curvature at rest (1/m) and
    the stiffness of the `hinge` (N m/rad, by default the whisker's) are numbers or arrays that
    broadcast with the contacts; tables cover their ranges. With an `azimuth` (rad, from the side to
    which the whisker curves) contacts are in space (see `CurvedSurface`), otherwise in the plane of
    curvature on that side.

    Examples
    --------
    >>> curved = ForwardModel(Whisker(50e-3, 100e-6, 5e-6, curvature=8.0))
    >>> signals, outcome = curved.signals(np.array([30e-3]), np.array([0.2]))
    >>> bent = ladder.press(curved.whisker, 30e-3, curved.rest(np.array([30e-3])) + 0.2)
    >>> print(np.abs(signals[0, 0] / bent.moment[0] - 1) < 1e-5)
    True
    """

    whisker: Any
    model: str | None = None
    friction: Any = 0.0
    offset: Any = 0.0
    hinge: Any = None
    friction_range: tuple[float, float] = (0.0, 0.0)
    offset_range: tuple[float, float] = (0.0, 0.0)
    hinge_range: tuple[float, float] = (0.0, 0.0)
    azimuth: Any = None

    def __post_init__(self) -> None:
        for name in ("friction", "offset"):
            given, ends = getattr(self, name), f"{name}_range"
            if not any(getattr(self, ends)) and np.any(given):
                self._set(**{ends: (float(np.min(given)), float(np.max(given)))})
        whisker = self.whisker
        cone = isinstance(whisker, Whisker) and np.all(whisker.tip_radius == 0)
        if cone and not self.is_plain:
            # The same whisker without its last thousandth, which is too thin for any contact.
            length, tip = (1 - THINNEST) * whisker.length, THINNEST * whisker.base_radius
            self._set(whisker=replace(whisker, length=length, tip_radius=tip))

    # -- properties ----------------------------------------------------------------------------

    @cached_property
    def base(self) -> Whisker:
        """The clamped whisker that sets scales; for a profile its linear taper."""
        whisker: Whisker = getattr(self.clamped.whisker, "whisker", self.clamped.whisker)
        return whisker

    @cached_property
    def is_hinged(self) -> bool:
        """Whether the base is not clamped."""
        return getattr(self.whisker, "hinge_stiffness", None) is not None

    @cached_property
    def hinge_compliance(self) -> Any:
        """How far the base turns, rad/(N m); 0 where it is clamped."""
        if not self.is_hinged:
            return 0.0
        return 1 / (self.whisker.hinge_stiffness if self.hinge is None else self.hinge)

    @cached_property
    def _compliances(self) -> tuple[float, float]:
        """The ends of the range of the hinge compliance."""
        low, high = self.hinge_range
        return (1 / high, 1 / low) if high > low else (float(self.hinge_compliance),) * 2

    @cached_property
    def clamped(self) -> ForwardModel:
        """The same without a hinge."""
        if not self.is_hinged:
            return self
        bare = replace(self.whisker, hinge_stiffness=None)
        return replace(self, whisker=bare, hinge=None, hinge_range=(0.0, 0.0))

    @property
    def length(self) -> float:
        """Arc length, m."""
        return float(self.base.length)

    @cached_property
    def is_plain(self) -> bool:
        """Whether it is a straight taper without friction: the elastica leaves nothing out."""
        return self.is_smooth and not np.any(self.whisker.curvature)

    @cached_property
    def is_flat(self) -> bool:
        """Whether it bends in the plane of any contact: a straight taper or profile.

        Friction acts in that plane too.
        """
        if not isinstance(self.whisker, Profile):
            bent = np.any(self.whisker.curvature)
        else:
            bent = np.any(self.whisker.law(np.array([0.0, self.length])))
        return not (bent or any(self.offset_range))

    @cached_property
    def is_smooth(self) -> bool:
        """Whether it is a linear taper without friction and of certain curvature."""
        fixed = not any((*self.friction_range, *self.offset_range))
        return fixed and isinstance(self.whisker, Whisker)

    @cached_property
    def surface(self) -> Surface | CurvedSurface:
        """The table of its signals, cached."""
        if self.azimuth is not None:
            return curved_surface(
                self.whisker, self.friction_range, self.offset_range, in_space=True
            )
        if self.is_plain or self.model in ("elastica", "closed_form"):
            return surface_of(_straightened(self.base))
        return curved_surface(self.clamped.whisker, self.friction_range, self.offset_range)

    @property
    def error(self) -> float:
        """Largest error of the table, over the lateral force."""
        return getattr(self.surface, "error", 1e-9)

    def with_uncertain(self, name: str, value: Any, ends: tuple[float, float]) -> ForwardModel:
        """With another ``friction``, ``offset`` or ``hinge``, between two ends."""
        if ends[1] > ends[0] and name != "hinge":
            refuse_hinge(self.whisker, "An unknown friction or curvature")
        changed: dict[str, Any] = {name: value, f"{name}_range": ends}
        return replace(self, **changed)

    def extremes(self, count: int = 3) -> list[ForwardModel]:
        """Models at `count` values of each uncertain condition, its ends among them."""
        grids, out = self._grids(count), []
        for values in product(*(map(float, grid) for grid in grids.values())):
            one: dict[str, Any] = dict(zip(grids, values, strict=True))
            out.append(replace(self, **one))
        return out

    def between(self, values: Array, count: int = 5) -> Array:
        """Values (..., n) at the `extremes`, interpolated (by Lagrange) to this model's, (...)."""
        weight = np.ones(1)
        for name, grid in self._grids(count).items():
            at, nodes = np.asarray(getattr(self, name), dtype=float), grid
            if name == "hinge":
                at, nodes = np.log(at), np.log(grid)
            each = [
                np.prod([(at - m) / (node - m) for m in nodes if m != node], axis=0)
                for node in nodes
            ]
            weights = np.stack(np.broadcast_arrays(*each), axis=-1)
            both = weight[..., :, None] * weights[..., None, :]
            weight = both.reshape(*both.shape[:-2], -1)
        return np.asarray((values * weight).sum(axis=-1))

    def _grids(self, count: int) -> dict[str, Array]:
        """Values of each condition over its range."""
        out = {
            "friction": np.unique(np.linspace(*self.friction_range, count)),
            "offset": np.unique(np.linspace(*self.offset_range, count)),
        }
        if self.hinge_range[1] > self.hinge_range[0]:
            out["hinge"] = np.geomspace(*self.hinge_range, count)
        if self.azimuth is not None:
            out["azimuth"] = np.linspace(0.0, np.pi, count)
        return out

    # -- contacts ------------------------------------------------------------------------------

    def _flattened(self, r: ArrayLike, *more: ArrayLike) -> tuple[tuple[int, ...], list[Array]]:
        """The broadcast shape, and arguments and conditions flat; constant conditions as (1,).

        A surface is contracted once for a constant condition: ten times as fast.
        """
        uncertain = (self.friction, self.offset, self.hinge_compliance)
        given = [np.asarray(a, dtype=float) for a in (r, *more, *uncertain)]
        shape = np.broadcast_shapes(*(a.shape for a in given))
        flat = [np.broadcast_to(a, shape).reshape(-1) for a in given[: len(more) + 1]]
        for a in given[len(more) + 1 :]:
            one = a.size and np.all(a == a.flat[0])
            flat.append(a.reshape(-1)[:1] if one else np.broadcast_to(a, shape).reshape(-1))
        return shape, flat

    def rest(self, r: ArrayLike) -> Array:
        """Deflection angle at which the whisker at rest touches at a distance (...), rad."""
        if self.is_plain:
            return np.zeros(self._flattened(r)[0])
        shape, (flat, _, offset, _) = self._flattened(r)
        beams = beams_of(self._at_rest(offset), flat.shape)
        return zero_load(beams, flat / self.length)[1].reshape(shape)

    def _at_rest(self, offset: Array) -> Profile:
        """The clamped whisker, more curved by offsets (n,) or (1,), 1/m."""
        return more_curved(Profile.of(self.clamped.whisker), offset)

    def limit(self, r: ArrayLike) -> Array:
        """Largest deflection from rest at a distance (...), rad; NaN out of reach."""
        if self.azimuth is not None:
            shape, (*given, _) = self._flattened(r, self.azimuth)
            limit: Any = self.surface.limit  # of a `CurvedSurface`
            return np.asarray(in_pieces(limit, *given)).reshape(shape)
        shape, (flat, psi, kappa, compliance) = self._flattened(r)
        if self.is_hinged:
            compliance = np.broadcast_to(compliance, flat.shape)
            return _largest(self._table, self._compliances, flat, compliance)[3].reshape(shape)
        surface: Any = self.surface
        uncertain = () if isinstance(surface, Surface) else (psi, kappa)
        return np.asarray(surface.limit(flat, *uncertain)).reshape(shape)

    @cached_property
    def reach(self) -> float:
        """Largest radial distance of any contact, m: where the tip is at rest."""
        if self.is_plain or self.model in ("elastica", "closed_form"):
            return self.length
        laws = [self._at_rest(np.asarray(f.offset)).law for f in self.extremes()]
        return float(max(np.max(np.hypot(*law.point(np.array([self.length])))) for law in laws))

    def signals(self, r: ArrayLike, theta: ArrayLike) -> tuple[Array, Codes]:
        """Moment, axial and transverse force (..., 3), NaN where not held, and outcome (...)."""
        if self.is_hinged:
            inner, falls = self._bent(r, theta)
            signals, outcome = self.clamped.signals(r, inner)
            outcome[falls & (outcome == Outcome.SLIPPED_OFF_TIP)] = Outcome.FLICKED_PAST
            return signals, outcome
        if self.model not in (None, "elastica"):
            return self._solved(r, theta)
        surface = self.surface
        if isinstance(surface, Surface):
            both = np.broadcast_arrays(r, theta)
            shape, flat = both[0].shape, [a.reshape(-1) for a in both]
        else:
            shape, (*flat, _) = self._flattened(r, theta)
        out, outcome = in_pieces(surface, *flat, axis=0)
        return out.reshape(*shape, 3), outcome.reshape(shape)

    @cached_property
    def _table(self) -> ForwardModel:
        """The clamped whisker, by a table."""
        straight = not self.is_plain and self.model in ("elastica", "closed_form")
        return replace(self.clamped, model="elastica" if straight else None)

    def _bent(self, r: ArrayLike, theta: ArrayLike) -> tuple[Array, Flags]:
        """θ′ of deflections (...), and whether contact is lost at a fold of the hinge."""
        shape, (flat, angle, _, _, compliance) = self._flattened(r, theta)
        compliance = np.broadcast_to(compliance, flat.shape)
        if self.model == "closed_form":
            inner = angle / (1 + compliance * closed_form.moment(self.base, flat, 1.0))
            return inner.reshape(shape), np.zeros(shape, dtype=bool)
        inner, falls = _clamped_angle(self._table, self._compliances, flat, angle, compliance)
        return inner.reshape(shape), falls.reshape(shape)

    def in_space(self, r: ArrayLike, push: ArrayLike) -> tuple[Array, Codes]:
        """The `SIX` signals (..., 6) in space, NaN where not held, and outcome (...).

        At `azimuth`: by the table or, where the model is "rod", one by one.
        """
        shape, (*flat, _) = self._flattened(r, push, self.azimuth)
        if self.model == "profile":
            raise Refusal(
                "The planar beam knows no contacts out of its plane",
                'model="profile"',
                'write model="rod", or leave it out for a table of the rod',
            )
        if self.model == "rod":
            signals, outcome = pressed(self.whisker, *flat)
        else:
            signals, outcome = in_pieces(self.surface, *flat, axis=0)
        return signals.reshape(*shape, 6), outcome.reshape(shape)

    def _solved(self, r: ArrayLike, theta: ArrayLike) -> tuple[Array, Codes]:
        """Signals and outcomes by solving the named model's equations for every contact."""
        if self.model == "closed_form":
            bare = closed_form.press(_straightened(self.base), r, theta)
            return signals_of(bare), np.asarray(bare.outcome, dtype=np.int8)
        whisker = self._at_rest(np.asarray(self.offset)) if np.any(self.offset) else self.whisker
        theta = np.asarray(theta, dtype=float) + rest_angle(whisker, r)
        reached = ~np.isnan(theta)
        r, theta = np.where(reached, r, 0.5 * self.length), np.where(reached, theta, np.pi)
        # On a compliant hinge θ′ of lost contacts may exceed a whole turn, which `press` refuses.
        theta = np.clip(theta, -2 * np.pi, 2 * np.pi)
        bent = ladder.press(whisker, r, theta, self.friction, model=self.model)
        return signals_of(bent), np.asarray(bent.outcome, dtype=np.int8)

    def jacobian(self, r: ArrayLike, theta: ArrayLike) -> Array:
        """Derivatives (..., 3, 2) of the signals to distance (m) and deflection from rest (rad).

        Of curved whiskers by differences, towards the inside at the edges: good to 1e-6.
        """
        if self.is_hinged:
            clamped = self.clamped.jacobian(r, self._bent(r, theta)[0])
            # dθ′ = (dθ − Λ ∂M/∂r dr)/(1 + Λ ∂M/∂θ′)
            by_r, by_theta = clamped[..., 0], clamped[..., 1]
            compliance = np.asarray(self.hinge_compliance)[..., None]
            share = 1 / (1 + compliance * by_theta[..., :1])
            by_r = by_r - by_theta * share * compliance * by_r[..., :1]
            return np.stack([by_r, by_theta * share], axis=-1)
        if self.model == "closed_form":
            return closed_form.signal_jacobian(self.base, r, theta)
        if isinstance(self.surface, Surface):
            r = positive("radial_distance", r, "give metres, such as 35e-3")
            theta = angle("deflection_angle", theta, "give radians, such as 0.35")
            return elastica.signal_jacobian(_straightened(self.base), r, theta)
        r, theta = np.broadcast_arrays(np.asarray(r, dtype=float), np.asarray(theta, dtype=float))
        columns = []
        for at, to in ((r, (1.0, 0.0)), (theta, (0.0, 1.0))):
            h = 1e-5 * np.maximum(np.abs(at), 1e-6)
            sides = [self.signals(r + s * h * to[0], theta + s * h * to[1])[0] for s in (1, 0, -1)]
            slope = (sides[0] - sides[2]) / (2 * h[..., None])
            for side, sign in ((0, 1), (2, -1)):  # one-sided at an edge
                one_sided = sign * (sides[side] - sides[1]) / h[..., None]
                slope = np.where(np.isnan(slope), one_sided, slope)
            columns.append(slope)
        return np.stack(columns, axis=-1)

    def stiffness(self, r: ArrayLike) -> tuple[Array, Codes]:
        """Moment for each radian of the lightest push, N m, and outcome (...)."""
        r = np.asarray(r, dtype=float)
        if self.is_hinged:
            value, outcome = self.clamped.stiffness(r)
            return value / (1 + self.hinge_compliance * value), outcome
        if isinstance(self.surface, Surface):
            reached = (r > 0) & (r < self.base.apex_distance) & (r <= self.length)
            value = closed_form.moment(self.base, np.where(reached, r, self.length), 1.0)
        else:
            light = 1e-9
            signals, outcome = self.signals(r, np.full(r.shape, light))
            reached, value = outcome == Outcome.HELD, signals[..., 0] / light
        outcome = np.where(reached, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        return np.where(reached, value, np.nan), outcome


def forward_of(whisker: Any, model: str | None = None) -> ForwardModel:
    """The forward model of a whisker; a `ForwardModel` as it is, or with another `model`."""
    if isinstance(whisker, ForwardModel):
        return whisker if model is None else replace(whisker, model=model)
    return ForwardModel(whisker, model)


def _straightened(whisker: Whisker) -> Whisker:
    return replace(whisker, curvature=0.0) if np.any(whisker.curvature) else whisker


# -- on a hinge: `forward` is the clamped whisker, `compliance` Λ (n,), rad/(N m), in `ends` -------


def _largest(
    forward: ForwardModel, ends: tuple[float, float], r: Array, compliance: Array
) -> tuple[Array, Array, Array, Array]:
    """Limits of θ′ and p, largest θ, and largest θ in contact (n,), rad; NaN out of reach."""
    top = forward.limit(r) * (1 - 1e-13)  # rounding must not put it beyond the table's own
    peaks = _peaks(forward, *ends)
    peak = peaks(r, compliance)
    last = middle = _angle(forward, peak, r, top, compliance)
    if ends[1] > ends[0]:
        typical = np.full(r.shape, np.sqrt(ends[0] * ends[1]))
        middle = _angle(forward, peaks(r, typical), r, top, typical)
    return top, peak, last, np.where(middle > np.pi, last / np.maximum(middle, np.pi) * np.pi, last)


def _clamped_angle(
    forward: ForwardModel, ends: tuple[float, float], r: Array, theta: Array, compliance: Array
) -> tuple[Array, Flags]:
    """θ′ (n,), beyond its limit where θ is; and whether contact is lost other than at the tip."""
    top, peak, last, largest = _largest(forward, ends, r, compliance)
    size = np.abs(theta)
    inside = (size > 0) & (size < last) & (size <= largest)
    # Beyond the limit of θ, θ′ is beyond the clamped whisker's, which gives the outcome.
    out = np.where(size > largest, 2 * top + size, np.where(size == last, top * np.sin(peak), size))
    if inside.any():

        def excess(p: Array, *given: Array) -> Array:
            *place, last, q = given
            angle = _angle(forward, p, *place)
            return np.asarray(np.arcsin(np.minimum(angle / last, 1.0)) - q)

        q, end = np.arcsin(size[inside] / last[inside]), peak[inside]
        args = (*(a[inside] for a in (r, top, compliance, last)), q)
        solution: Any = find_root(
            excess, (0 * q, end), args=args, tolerances={"xrtol": 1e-12, "frtol": 1e-12}
        )
        # Rounding can leave no root between the ends where θ is all but the largest.
        p = np.where(solution.success, solution.x, np.where(q > np.pi / 2 - 1e-6, end, np.nan))
        out[inside] = top[inside] * np.sin(p)
    return np.copysign(out, theta), (size > largest) & ((peak < np.pi / 2) | (last > largest))


def _angle(forward: ForwardModel, p: Array, r: Array, top: Array, compliance: Array) -> Array:
    inner = top * np.sin(p)
    return np.asarray(inner + compliance * forward.signals(r, inner)[0][..., 0])


@lru_cache(maxsize=64)
def _peaks(forward: ForwardModel, low: float, high: float) -> Callable[[Array, Array], Array]:
    """p (n,) at which θ is largest, as a function of r and Λ; θ is stationary there."""
    place = forward.reach * np.sin(np.linspace(1e-3, np.pi / 2 - 1e-3, 400)) ** 2
    compliances = np.geomspace(low, high, 33) if high > low else np.array([low])
    r, compliance = (a.ravel() for a in np.meshgrid(place, compliances, indexing="ij"))
    step, end, top = 1e-4, np.full(r.shape, np.pi / 2), forward.limit(r)

    def rise(p: Array, *at: Array) -> Array:
        return _angle(forward, p, *at) - _angle(forward, p - step, *at)

    falls = rise(end, r, top, compliance) < 0
    if falls.any():
        at = tuple(a[falls] for a in (r, top, compliance))
        end[falls] = find_root(rise, (np.full(at[0].shape, step), end[falls]), args=at).x - step / 2
    peak = end.reshape(len(place), -1)
    if not high > low:
        return lambda r, compliance: np.interp(r, place, peak[:, 0])
    table = RegularGridInterpolator((place, np.log(compliances)), peak)

    def between(r: Array, compliance: Array) -> Array:
        inside = np.clip(r, place[0], place[-1]), np.log(np.clip(compliance, *compliances[[0, -1]]))
        return np.asarray(table(np.stack(np.broadcast_arrays(*inside), axis=-1)))

    return between
