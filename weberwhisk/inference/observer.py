"""The observer: whisker × cue × receptor noise × prior → the density of the unknown contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, numbers, one_of, positive_number, shown
from .._util.refusals import Refusal
from .._util.values import Array, Codes, Fields, Index
from ..cues.protocol import Cue, straight
from ..mechanics import model_choice
from ..mechanics.contact import Outcome
from ..mechanics.forward import ForwardModel
from ..mechanics.shape import Profile
from ..receptors import Gaussian, ReceptorNoise, Seed
from ..whisker import Whisker
from .coordinates import (
    ContactCoordinates,
    family,
    from_normal,
    is_all_around,
    priors_of,
    to_normal,
    within_half_turn,
)
from .floors import check_noise, default_noise, usual_contacts

__all__ = ["Observer", "distance_prior", "held_prior"]


class _Filled(NamedTuple):
    """The noise and priors that are the cue's own: whoever is made from an observer has others."""

    noise: ReceptorNoise | None
    priors: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Observer(Fields):
    """An ideal observer of one contact. Frozen; `dataclasses.replace` makes one that differs.

    Parameters
    ----------
    whisker : Whisker
        One whisker: its fields are numbers, not arrays.
    cue : Cue
        How distance is sensed; see `weberwhisk.cues`.
    noise : ReceptorNoise
        Default `default_noise`: the cue's own, which is Weber's law with k = 0.1 wherever signals
        are forces, with a floor for signals that change sign within the whisker's reach.
    prior : mapping of name to frozen SciPy distribution, optional
        Prior of any of the cue's unknowns (``"radial_distance"`` in m, ``"deflection_angle"`` in
        rad). By default these two are flat over every contact that the whisker can hold: up to
        the tip, and up to the angle at which it flicks past; further unknowns have the cue's.
    model : {"closed_form", "elastica", "profile"}, optional
        The model of the mechanics. By default the cheapest that biases the distance by less than
        `tolerance` JNDs, anywhere in the reach: the straight elastica, which leaves nothing out on
        a straight whisker without friction, or else the planar beam, solved once and tabled
        (`mechanics.curved_surface`), which then costs as little. `model` is then the one chosen,
        and `why` says why. One that is named solves its equations for every contact anew.
    tolerance : float
        Largest bias of the distance in JNDs that a model may bring, where one is chosen.

    Raises
    ------
    ValueError
        For anything but a whisker, a cue, noise and a mapping of priors, whisker fields that are
        arrays, probabilities with noise of signals or the other way round, noise without a floor
        of a signal that changes sign within the whisker's reach, a prior of something that is not
        unknown, a prior that has no overlap with the whisker's reach.

    Notes
    -----
    Observers compare and hash by value, their priors by family and parameters: cells that were
    evaluated for one serve all that are equal. Posteriors are summed in the coordinates of
    `weberwhisk.inference.coordinates`.

    Examples
    --------
    >>> from weberwhisk import cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> observer.unknowns, observer.reach
    (('radial_distance',), (0.0, 0.05))
    """

    whisker: Whisker
    cue: Cue
    noise: ReceptorNoise = None  # type: ignore[assignment]  # the cue's own, then
    prior: Mapping[str, Any] = field(default_factory=dict, repr=False)
    _: KW_ONLY
    model: str | None = field(default=None, repr=False)
    tolerance: float = field(default=0.1, repr=False)
    _filled: _Filled = field(default=_Filled(None, MappingProxyType({})), repr=False)
    #: The change of variables between contacts and coordinates without edges.
    space: ContactCoordinates = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if isinstance(self.cue, type) or not isinstance(self.cue, Cue):
            raise Refusal(
                "An observer needs a cue", shown(self.cue), "write ww.cues.Compliance(), say"
            )
        if not (self.cue.takes_curved and isinstance(self.whisker, Whisker | Profile)):
            straight(self.whisker)
        if isinstance(self.noise, type) or not isinstance(self.noise, ReceptorNoise | None):
            raise Refusal(
                "An observer needs receptor noise",
                shown(self.noise),
                "write ww.receptors.Weber(0.1), say",
            )
        fields = vars(getattr(self.whisker, "whisker", self.whisker))
        names = "length", "base_radius", "tip_radius", "youngs_modulus", "curvature"
        laws: dict[str, Any] = vars(self.whisker.law) if isinstance(self.whisker, Profile) else {}
        for name, value in {**{n: fields[n] for n in names}, **laws}.items():
            if np.ndim(value):
                raise Refusal(
                    "An observer has one whisker",
                    f"{np.size(value)} values of {name}",
                    "make one Observer for each",
                )
        set_ = object.__setattr__
        # By an observer that this one is made from, or by nobody.
        before = self._filled if isinstance(self._filled, _Filled) else _Filled(None, {})
        if self.noise is before.noise:
            set_(self, "noise", None)
        if isinstance(self.prior, Mapping):
            inherited = before.priors
            set_(self, "prior", {n: p for n, p in self.prior.items() if inherited.get(n) is not p})
        given = priors_of(self.prior, self.cue)
        cue_priors = {n: p for n, p in self.cue.priors(self.whisker).items() if n not in given}
        prior = {**cue_priors, **given}
        if isinstance(self.model, model_choice.Chosen):  # by an observer that this one is made from
            set_(self, "model", None)
        if self.model is not None:
            one_of("model", self.model, ("closed_form", "elastica", "profile", "rod"))
        positive_number("tolerance", self.tolerance, "give a fraction of the JND, such as 0.1")
        usual = default_noise(self.whisker, self.cue) if self.noise is None else None
        set_(self, "_filled", _Filled(usual, MappingProxyType(cue_priors)))
        set_(self, "noise", self.noise if usual is None else usual)
        set_(self, "prior", MappingProxyType(prior))
        set_(self, "space", ContactCoordinates(self.whisker, self.cue, prior))
        check_noise(self.noise, self.whisker, self.cue, self.forward.is_flat)
        if self.model is None:
            set_(self, "model", model_choice.chosen(self))

    @property
    def solver(self) -> str | None:
        """The model that a cue is called with: none where a table serves."""
        if isinstance(self.model, model_choice.Chosen):
            return "elastica" if self.model == "elastica" and not self.forward.is_plain else None
        return self.model

    def __repr__(self) -> str:
        return f"Observer({self.whisker}, {self.cue!r}, {self.noise!r})"

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        priors = [(name, family(self.prior[name])) for name in sorted(self.prior)]
        return self.whisker, self.cue, self.noise, tuple(priors), str(self.model), self.solver

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Observer) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __reduce__(self) -> Any:  # its mappings are views, which do not pickle
        make = partial(Observer, model=self.model, tolerance=self.tolerance)
        noise = None if self.noise is self._filled.noise else self.noise
        prior = {n: p for n, p in self.prior.items() if n not in self._filled.priors}
        return make, (self.whisker, self.cue, noise, prior)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Names of what the cue does not know of the contact, radial distance first."""
        return self.cue.unknowns

    @property
    def bounded(self) -> int:
        """How many unknowns the whisker bounds: the first ones; the rest have priors alone."""
        return self.space.bounded

    @cached_property
    def forward(self) -> ForwardModel:
        """What makes signals of contacts: with friction and curvature of the cue's medians."""
        middle = [float(self.prior[name].median()) for name in self.unknowns[self.bounded :]]
        contact = np.array([*[0.0] * self.bounded, *middle])
        return self.cue.forward(self.whisker, contact)

    @property
    def reach(self) -> tuple[float, float]:
        """Ends of the radial distance, m."""
        return self.space.reach

    @cached_property
    def usual_weber_fractions(self) -> Array:
        """Of each signal, (S,): that of its law, or where it is Gaussian and has none, median
        sd/|signal| at usual contacts; 0 where nothing is said of it."""
        size = len(self.cue.signal_names)
        k = np.array(self.noise.weber_fractions(size))
        laws = [law for law in self.noise.components(size) if isinstance(law.noise, Gaussian)]
        by_contact = [law for law in laws if not hasattr(law.noise, "weber_fraction")]
        if by_contact:
            contact = self.space.constrain(usual_contacts(self.space, others=3))[0]
            signals, outcome = self.signals(contact)
            in_contact = signals[outcome == Outcome.HELD]
            for law in by_contact if len(in_contact) else ():
                of_law = in_contact[:, law.signals]
                with np.errstate(divide="ignore"):
                    k[law.signals] = np.median(law.noise.sd(of_law) / np.abs(of_law), axis=0)
        return k

    @cached_property
    def why(self) -> str:
        """Which model of the mechanics serves this observer, and why.

        The bias of the radial distance is to first order (see `model_choice`), over 144 contacts of
        the reach, but for a fiftieth at the ends of distances and angles.

        Examples
        --------
        >>> from weberwhisk import cues
        >>> print(Observer(Whisker(50e-3, 100e-6, 5e-6), cues.ForceMap()).why)
        the elastica models all there is; the closed form is off by up to 24 JND, 0.1 allowed
        """
        return model_choice.why(self)

    @cached_property
    def note(self) -> str:
        """What the observer leaves out, or nothing.

        A shape at rest that moves the distance by more than a JND (to first order, of 16 contacts
        in the middle of the reach, and of 36 up to its ends where these say less): of whiskers
        `from_identity` their measured one, taken as straight or, if curved, as an arc; of others
        without a `curvature` the rat's usual one. A curvature that is given, 0 too, is the
        whisker's. And a table of signals that is off by more than a hundredth of a Weber fraction.

        Examples
        --------
        >>> from weberwhisk import cues
        >>> print(Observer(Whisker.from_identity("C2"), cues.ForceMap()).note)
        C2 is taken as straight; its shape at rest moves r by up to 15 JND: write curved=True
        """
        return model_choice.note(self)

    @property
    def is_smooth(self) -> bool:
        """Whether the likelihood is a smooth function of the contact, without kinks."""
        noises = self.noise.components(len(self.cue.signal_names))
        return self.cue.is_smooth and all(c.noise.is_smooth for c in noises)

    @property
    def inner(self) -> int:
        """How many unknowns a tree takes: those that the whisker bounds, or two if there are.

        Where the reach depends on a further unknown that one has layers.
        """
        return max(self.bounded, min(len(self.unknowns), 1 if self.space.reach_varies else 2))

    def ends(self, unknowns: int) -> tuple[Array, Array]:
        """The coordinates (U,) of so many between which there is next to all of the prior."""
        # Of the ranges of distance and angle. Readings 3 sd short of the tip's lose 2.5 % of their
        # mass if these end at 1 − 1e-7.
        fractions = np.array([1e-7, 1e-3, 0.5, 1 - 1e-3, 1 - 1e-10])
        x = self.space.spread(fractions)[:, : self.bounded]
        far = np.full(unknowns - self.bounded, 4.8)
        return np.append(x.min(axis=0), -far), np.append(x.max(axis=0), far)

    def at_middle(self, contact: ArrayLike) -> Array:
        """Contacts (..., U) of the first unknowns (..., ≤ U), the others at their prior medians."""
        contact = np.asarray(contact, dtype=float)
        rest = [
            np.full(contact.shape[:-1], float(self.prior[name].median()))
            for name in self.unknowns[contact.shape[-1] :]
        ]
        return np.concatenate([contact, *(a[..., None] for a in rest)], axis=-1)

    def prior_information(self, contact: ArrayLike) -> Array:
        """What their priors tell of the unknowns that have priors alone, (..., U, U).

        The precision of the standard normal, carried to each such unknown; 0 for the others.
        """
        contact = np.asarray(contact, dtype=float)
        out = np.zeros((*contact.shape, contact.shape[-1]))
        for i in range(self.bounded, contact.shape[-1]):
            name, value = self.unknowns[i], contact[..., i]
            distribution = self.prior[name]
            if name == "azimuth" and is_all_around(distribution):  # which has no ends
                value = np.full(value.shape, float(distribution.median()))
            z = to_normal(distribution, value)
            slope = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) / distribution.pdf(value)
            out[..., i, i] = slope**-2
        return out

    # -- densities -----------------------------------------------------------------------------

    def signals(self, contact: ArrayLike) -> tuple[Array, Codes]:
        """Signals (..., S) of a contact (..., U), NaN where not held, and the outcome (...)."""
        return self.cue.signals(self.whisker, np.asarray(contact, dtype=float), model=self.solver)

    def log_likelihood(self, reading: ArrayLike, contact: ArrayLike) -> Array:
        """ln p(reading | contact), (...); −∞ where the contact is not held."""
        signals, outcome = self.signals(contact)
        in_contact = outcome == Outcome.HELD
        value = self.log_reading(reading, np.where(in_contact[..., None], signals, 1.0))
        return np.where(in_contact, value, -np.inf)

    def log_reading(self, reading: ArrayLike, signals: Array) -> Array:
        """ln p(reading | signals), (...), of readings (..., R) and signals (..., S)."""
        return np.asarray(self.noise.log_likelihood(self.near(reading, signals), signals))

    @cached_property
    def circular(self) -> Index:
        """Which numbers of a reading are directions, which whole turns leave the same."""
        return np.flatnonzero(self.cue.circular if self.noise.reads_signals else [])

    def near(self, reading: ArrayLike, signals: Array) -> Array:
        """Readings (..., R), directions in as many whole turns as brings them near the signals'."""
        out, turning = np.asarray(reading, dtype=float), self.circular
        if turning.size:
            off = out[..., turning] - signals[..., turning]
            out = np.broadcast_to(out, (*off.shape[:-1], out.shape[-1])).copy()
            out[..., turning] = signals[..., turning] + within_half_turn(off)
        return out

    def log_density(self, x: ArrayLike, reading: ArrayLike) -> Array:
        """ln of the posterior density in the coordinates x, up to the evidence, (...)."""
        return self.log_density_and_contact(x, reading)[0]

    def log_density_and_contact(self, x: ArrayLike, reading: ArrayLike) -> tuple[Array, Array]:
        """ln of the posterior density in the coordinates x (...), and the contact (..., U)."""
        contact, log_prior = self.space.constrain(x)
        return self.log_likelihood(reading, contact) + log_prior, contact

    def information(self, contact: ArrayLike) -> Array:
        """Fisher information of one reading about the contact, (..., U, U).

        ∂μᵀΣ⁻¹∂μ + ½tr(Σ⁻¹∂ΣΣ⁻¹∂Σ); NaN where the contact is not held.
        """
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.signals(contact)
        in_contact = (outcome == Outcome.HELD)[..., None]
        slope = self.cue.jacobian(self.whisker, contact, model=self.solver)
        inner = self.noise.fisher(np.where(in_contact, signals, 1.0))
        value = np.swapaxes(slope, -1, -2) @ inner @ slope
        return np.where(in_contact[..., None], value, np.nan)

    # -- readings ------------------------------------------------------------------------------

    def reading_outcome(self, reading: ArrayLike) -> Codes:
        """The outcome of the cue's own inverse for readings (..., R), taken as exact.

        An `Outcome` each: `NOT_A_READING` where a number is missing; `HELD` where the inverse finds
        a contact, for cues without an inverse, and for readings that are not of the signals
        themselves (spikes are counts).
        """
        y = self.checked_reading(reading, missing=True)
        if not (hasattr(self.cue, "reading_outcome") and self.noise.reads_signals):
            is_finite = np.isfinite(y).all(axis=-1)
            return np.where(is_finite, Outcome.HELD, Outcome.NOT_A_READING).astype(np.int8)
        readings = y.reshape(-1, y.shape[-1])
        outcome = np.full(len(readings), Outcome.NOT_A_READING, dtype=np.int8)
        is_finite = np.isfinite(readings).all(axis=1)
        if is_finite.any():
            outcome[is_finite] = self.cue.reading_outcome(self.whisker, readings[is_finite])
        return outcome.reshape(y.shape[:-1])

    @cached_property
    def usual_reading(self) -> Array:
        """Magnitudes (R,) that readings of three quarters of the whisker's contacts stay below."""
        contact = self.space.constrain(self.space.spread(np.linspace(0.1, 0.9, 9)))[0]
        signals, outcome = self.signals(contact)
        size = np.abs(self.noise.mean(signals[outcome == Outcome.HELD]))
        return np.quantile(size, 0.75, axis=0) if size.size else np.full(size.shape[1:], np.inf)

    def read(self, contact: ArrayLike, seed: Seed = None) -> Array:
        """Noisy readings (..., S) of a contact (..., U).

        Raises
        ------
        ValueError
            Where the whisker cannot hold the contact.
        """
        signals, outcome = self.signals(self.checked(contact))
        if np.any(outcome != Outcome.HELD):
            bad = Outcome(int(outcome[outcome != Outcome.HELD].flat[0]))
            raise Refusal(
                "There is no reading of a contact that the whisker loses",
                f"one {bad.message}",
                "choose distances and angles inside flick_past()",
            )
        return self.noise.sample(signals, seed)

    def checked(self, contact: ArrayLike) -> Array:
        """`contact` as an array (..., U) of finite numbers."""
        array = finite("contact", contact, "give metres and radians")
        count = len(self.unknowns)
        if count == 1 and (array.ndim == 0 or array.shape[-1] != 1):
            array = array[..., None]
        if array.shape[-1] != count:
            raise Refusal(
                f"A contact of {self.cue!r} has {count} numbers ({', '.join(self.unknowns)})",
                f"shape {array.shape}",
                "put them along the last axis",
            )
        return array

    def checked_reading(self, reading: ArrayLike, *, missing: bool = False) -> Array:
        """`reading` as an array (..., S) of finite numbers, or with `missing` also of others."""
        hint = "give the base signals in SI units"
        array = numbers("reading", reading, hint) if missing else finite("reading", reading, hint)
        count = self.noise.reading_size(len(self.cue.signal_names))
        if count == 1 and (array.ndim == 0 or array.shape[-1] != 1):
            array = array[..., None]
        if array.ndim == 0 or array.shape[-1] != count:
            of = f"of {', '.join(self.cue.signal_names)}"
            if hasattr(self.noise, "reports"):
                of = f"one of {self.noise.reports.tolist()}"
            raise Refusal(
                f"A reading of {self.cue!r} under {self.noise!r} has {count} numbers ({of})",
                f"shape {array.shape}",
                "put them along the last axis",
            )
        return array


def distance_prior(observer: Observer, r: ArrayLike) -> Array:
    """Prior density of the radial distance r (...), m, up to a factor; 0 outside the reach.

    The prior of the contact with all else integrated out: where the deflection angle is
    unknown and its prior flat, the range of angles that the whisker holds at that distance.
    """
    r = np.asarray(r, dtype=float)
    low, high = observer.reach
    inside = (r > low) & (r < high)
    place = np.where(inside, r, (low + high) / 2)
    density = held_prior(observer, place)
    if "radial_distance" in observer.prior:
        density = density * observer.prior["radial_distance"].pdf(place)
    return np.where(inside, density, 0.0)


def held_prior(observer: Observer, r: Array, given: float | None = None) -> Array:
    """The prior of all angles that are held at distances (...) inside the reach, up to a factor.

    The mean over unknowns that have priors alone, but for friction at the value `given`, if any.
    """
    if observer.bounded == 1 and not observer.space.reach_varies:
        return np.ones(r.shape)
    names = observer.unknowns[observer.bounded :]
    free = [name for name in names if given is None or name == "friction_angle"]
    free = free if observer.space.reach_varies else []
    z = np.linspace(-4.8, 4.8, 25) if len(free) == 1 else np.linspace(-3.0, 3.0, 5)
    scores = np.stack([a.ravel() for a in np.meshgrid(*[z] * len(free))] or [np.zeros(1)])
    contact = np.ones((*r.shape, scores.shape[1], len(observer.unknowns)))
    contact[..., 0] = r[..., None]
    for i, name in enumerate(names, observer.bounded):
        prior = observer.prior[name]
        fixed = from_normal(prior, np.zeros(1)) if given is None else given
        varies = name in free
        contact[..., i] = from_normal(prior, scores[free.index(name)]) if varies else fixed
    if observer.bounded > 1:
        least, allowed = observer.space.angle_range(contact[..., 0], contact)
        if "deflection_angle" in observer.prior:
            angle = observer.prior["deflection_angle"]
            allowed = angle.cdf(least + allowed) - angle.cdf(least)
    else:
        allowed = (observer.signals(contact)[1] == Outcome.HELD).astype(float)
    weight = np.exp(-0.5 * np.square(scores).sum(axis=0))
    return np.asarray(allowed @ weight / weight.sum())
