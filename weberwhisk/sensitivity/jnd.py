"""How well radial distance is known: just noticeable differences and bits, of one cue or several.

The JND here is an sd of distance times the factor of a *criterion* that is always named. The
routes: Weber propagation (3.2)–(3.8), noise carried to distance through the slope of the signals;
the Fisher information, which also counts what the spread itself tells; and the posterior, over
many noisy readings.

"None of the methods exclude any others" (§2, §4): what a fusion of cues gains is the information
that it adds, in bits.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy.special import ndtri

from .._util.checks import generator, whole
from .._util.values import Array, Flags, pd, with_units
from ..cues import Fused
from ..cues.protocol import Cue
from ..inference.coordinates import UNITS
from ..inference.observer import Observer
from ..inference.quadrature import sums_of
from ..inference.result import distance_prior
from ..inference.weighted import density_of_distance
from ..mechanics.contact import Outcome
from ..receptors import ReceptorNoise, Seed

#: The criterion that is meant where none is named: the sd of one observation.
SD = "d'=1"
_PATTERN = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*%\s*(2AFC|2IFC|yes/no)\s*$", re.IGNORECASE)
_EXAMPLES = 'write "d\'=1", "75% 2AFC" or "75% yes/no", say'


def criterion_factor(criterion: str = SD) -> float:
    """How many sds of one observation make a JND under a named criterion.

    Parameters
    ----------
    criterion : str
        ``"d'=1"``: one sd (76.02 % correct in 2AFC). ``"75% 2AFC"`` (any percentage, also 2IFC):
        the difference at which two noisy observations are put in the right order so often, √2·z.
        ``"75% yes/no"``: the difference from a fixed criterion that is reported so often, z.

    Raises
    ------
    ValueError
        For a criterion that cannot be read, or a percentage outside 50 to 100.

    Examples
    --------
    >>> [round(0.1 * criterion_factor(c), 4) for c in ("d'=1", "75% 2AFC", "75% yes/no")]
    [0.1, 0.0954, 0.0674]
    """
    if criterion == SD:
        return 1.0
    match = _PATTERN.match(criterion) if isinstance(criterion, str) else None
    if match is None:
        raise ValueError(f"The criterion {criterion!r} is unknown; {_EXAMPLES}.")
    percent = float(match.group(1))
    if not 50 < percent < 100:
        raise ValueError(
            f"A criterion lies between 50 and 100 per cent, got {percent:g}; {_EXAMPLES}."
        )
    z = float(ndtri(percent / 100))
    return z if match.group(2).lower() == "yes/no" else float(np.sqrt(2)) * z


def convert_jnd(jnd: ArrayLike, *, from_criterion: str, to_criterion: str) -> Array:
    """A JND under one criterion, expressed under another.

    Examples
    --------
    >>> float(convert_jnd(0.0954, from_criterion="75% 2AFC", to_criterion="79.37% 2AFC").round(4))
    0.1159
    """
    ratio = criterion_factor(to_criterion) / criterion_factor(from_criterion)
    return np.asarray(jnd, dtype=float) * ratio


def weber_propagation(observer: Observer, contact: ArrayLike, *, model: str | None = None) -> Array:
    """Sd of radial distance by carrying receptor noise through the slope of the signals, (...), m.

    Equations (3.2) and (3.7): Δr = |dr/dI| ΔI, for several signals √[J⁻¹ΣJ⁻ᵀ]_rr, with every
    unknown of the cue unknown (at a second signal held fixed, as in (3.7), where its noise is
    zero). With more signals than unknowns, the best linear combination. An unknown that the
    whisker does not bound (a stiffness, say) is known as well as its prior says: that is one more
    signal.

    Parameters
    ----------
    observer : Observer
    contact : array, shape (..., U)
    model : str, optional
        ``"closed_form"`` gives the paper's closed forms, with the apex distance: k r(1 − r/A) for
        the compliance cue, ½(A−r)(3A−2r)/(2A−r)·√(4k_M² + k_F² − 4ρk_M k_F) for the map cue. By
        default the observer's own.

    Returns
    -------
    array
        NaN where the contact is not held, and for probabilities of events; infinite where the
        signals cannot tell distance (the cylinder's force map).

    Notes
    -----
    Linear, and so with *false zeros* that no posterior has, in either limit of the map cue. With
    noise in the axial force alone the JND reaches zero where ∂M/∂θ_d = 0 and rises again: at
    R = 20 and r/L = 0.3, 0.5, 0.7, 0.9 from θ_d = 46.6°, 33.3°, 20.8°, 8.8° on (contact angles of
    84°, 71°, 59°, 47°). With noise in the moment alone it does where ∂Fx/∂θ_d = 0, at contact
    angles of 100° to 106° and r ≤ 0.5 L, past the 90° where the paper stops. `is_linear` tells.

    An event is all or none, and never near its probability: no noise is so small that one event
    could be carried to distance along a slope. Events are left out, in a fusion of cues too; the
    information and the posterior have them.
    """
    contact = observer.checked(contact)
    covariance = _propagated(observer, contact, model or observer.solver)
    # With perfectly correlated noise the exact variance can be zero, and rounding take it below.
    return np.sqrt(np.maximum(covariance[..., 0, 0], 0.0))


def is_linear(observer: Observer, contact: ArrayLike) -> Flags:
    """Whether Weber propagation can be relied on at a contact, (...).

    Where one sd of the contact to either side, along each axis of its propagated covariance, the
    mean JND is within a factor of two of that at the contact itself. It is not about false zeros,
    near the tip and the fold for large noise, and where the signals cannot tell distance.

    Parameters
    ----------
    observer : Observer
    contact : array, shape (..., U)

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues
    >>> from weberwhisk.receptors import Weber
    >>> axial = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.ForceMap(), Weber([1e-3, 0.1]))
    >>> is_linear(axial, [[35e-3, np.radians(5)], [35e-3, np.radians(20.8)]])
    array([ True, False])
    """
    contact = observer.checked(contact)
    covariance = _propagated(observer, contact, observer.solver)
    known = np.asarray(np.isfinite(covariance).all(axis=(-2, -1)))
    further = np.arange(contact.shape[-1]) >= observer.bounded  # these may be 0 or negative
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    unit = np.fmax(_contact_scale(contact), np.where(further & known[..., None], sd, 0.0))
    scaled = covariance / (unit[..., :, None] * unit[..., None, :])
    size, axes = np.linalg.eigh(np.where(known[..., None, None], scaled, np.eye(unit.shape[-1])))
    step = np.swapaxes(axes * np.sqrt(np.maximum(size, 0.0))[..., None, :], -1, -2)
    step = np.stack([step, -step], axis=-2) * unit[..., None, None, :]
    least = np.where(further, -np.inf, 1e-3 * np.abs(contact))[..., None, None, :]
    around = np.maximum(contact[..., None, None, :] + step, least)
    at = np.where(known, np.sqrt(np.maximum(covariance[..., 0, 0], 0.0)), 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = weber_propagation(observer, around).mean(axis=-1) / at[..., None]
    return np.asarray(known & ((ratio > 0.5) & (ratio < 2)).all(axis=-1))


def _propagated(observer: Observer, contact: Array, model: str | None) -> Array:
    """Covariance (..., U, U) of the contact to first order in the noise; NaN where not held."""
    size = len(observer.cue.signal_names)
    linear = np.empty(observer.noise.reading_size(size), dtype=bool)
    for noise, _, readings in observer.noise.components(size):
        linear[readings] = not noise.is_categorical
    if not linear.any():
        return np.full((*contact.shape, contact.shape[-1]), np.nan)
    signals, outcome = observer.cue.signals(observer.whisker, contact, model=model)
    held = np.asarray(outcome == Outcome.HELD)
    signals = np.where(held[..., None], signals, 1.0)
    of_cue = observer.cue.jacobian(observer.whisker, contact, model=model)
    slope = (observer.noise.jacobian(signals) @ of_cue)[..., linear, :]
    covariance = observer.noise.covariance(signals)[..., linear, :][..., linear]
    if observer.bounded < contact.shape[-1]:
        slope, covariance = _with_priors(observer, contact, slope, covariance)
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    if np.any((sd == 0) & held[..., None]):
        raise ValueError(
            "A signal without noise leaves no JND, got one in "
            f"{observer.noise!r} where the signal is 0; give it a floor, such as "
            "receptors.GeneralisedWeber(0.1, floor=0.1)."
        )
    unit = _contact_scale(contact)
    # In units of the noise and of the contact itself, so that singular means singular.
    scaled = np.where(held[..., None, None], slope / sd[..., None] * unit[..., None, :], 0.0)
    correlation = covariance / (sd[..., :, None] * sd[..., None, :])
    if scaled.shape[-1] == scaled.shape[-2]:
        inverse = _inverse(scaled)
        lost = np.isinf(inverse)
        inverse = np.where(lost, 0.0, inverse)
        variance = inverse @ correlation @ np.swapaxes(inverse, -1, -2)
        variance = np.where(lost.any(axis=(-2, -1), keepdims=True), np.inf, variance)
    else:
        if np.any(np.linalg.det(correlation) < 1e-14):
            raise ValueError(
                f"Of {slope.shape[-2]} perfectly correlated signals for {slope.shape[-1]} unknowns "
                f"there is no best combination, got {observer.noise!r}; "
                "write a correlation between -1 and 1."
            )
        information = np.swapaxes(scaled, -1, -2) @ np.linalg.inv(correlation) @ scaled
        variance = _inverse(information)
    held = held[..., None, None]
    return np.where(held, variance * unit[..., :, None] * unit[..., None, :], np.nan)


def fisher_jnd(observer: Observer, contact: ArrayLike) -> Array:
    """Least sd of radial distance that the information of one reading allows, (...), m.

    The whole matrix is inverted, so that every other unknown of the cue is unknown too, or as well
    known as its prior says where the whisker does not bound it. For one
    signal under Weber's law √(1 + 2k²) below (3.5), as the spread informs as well.

    Parameters
    ----------
    observer : Observer
    contact : array, shape (..., U)
    """
    contact = observer.checked(contact)
    unit = _contact_scale(contact)
    information = observer.information(contact) + observer.prior_information(contact)
    information = information * unit[..., :, None] * unit[..., None, :]
    held = np.asarray(np.isfinite(information).all(axis=(-2, -1)))
    variance = _inverse(np.where(held[..., None, None], information, 0.0))[..., 0, 0]
    return np.where(held, np.sqrt(variance) * unit[..., 0], np.nan)


def _with_priors(
    observer: Observer, contact: Array, slope: Array, covariance: Array
) -> tuple[Array, Array]:
    """Slopes (..., R + n, U) and covariance of a reading and of n unknowns' prior values."""
    first, size = observer.bounded, slope.shape[-2]
    count = contact.shape[-1] - first
    unit = np.broadcast_to(
        np.eye(contact.shape[-1])[first:], (*slope.shape[:-2], count, first + count)
    )
    precision = np.diagonal(observer.prior_information(contact), axis1=-2, axis2=-1)[..., first:]
    both = np.zeros((*contact.shape[:-1], size + count, size + count))
    both[..., :size, :size] = covariance
    both[..., np.arange(size, size + count), np.arange(size, size + count)] = 1 / precision
    return np.concatenate([slope, unit], axis=-2), both


def _contact_scale(contact: Array) -> Array:
    """The contact itself, as the unit in which its matrices are of order one."""
    return np.maximum(np.abs(contact), 1e-12)


def _inverse(matrix: Array) -> Array:
    """Inverses (..., n, n); infinite throughout where singular to rounding.

    That is where the determinant, of a matrix with columns of length one, is below 1e-9.
    """
    rows = _length(matrix, -1)
    columns = _length(matrix / rows, -2)
    scaled = matrix / rows / columns
    singular = np.abs(np.linalg.det(scaled)) <= 1e-9
    safe = np.where(singular[..., None, None], np.eye(matrix.shape[-1]), scaled)
    inverse = np.linalg.inv(safe) / np.swapaxes(rows, -1, -2) / np.swapaxes(columns, -1, -2)
    return np.where(singular[..., None, None], np.inf, inverse)


def _length(matrix: Array, axis: int) -> Array:
    """Lengths of rows (−1) or columns (−2); 1 where they are empty."""
    length = np.sqrt(np.square(matrix).sum(axis=axis, keepdims=True))
    return np.where(length > 0, length, 1.0)


# -- information, of cues alone and together -------------------------------------------------------

#: Distances at which the prior is known.
_PLACES = 20_000


class Bits(NamedTuple):
    """Information in bits, and its Monte Carlo error."""

    value: float
    error: float


class DistancePrior:
    """The prior of distance that an observer of more unknowns has, for one of fewer.

    Made for `Observer`'s ``prior``; density between places is linear.
    """

    def __init__(self, observer: Observer) -> None:
        self.low, self.high = observer.reach
        self.r = np.linspace(self.low, self.high, _PLACES + 1)
        # At the ends themselves there is no contact: what is next to them tells.
        inside = np.clip(self.r, np.nextafter(self.low, 1.0), np.nextafter(self.high, 0.0))
        density = distance_prior(observer, inside)
        mass = np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(self.r))
        self.density, self.mass = density / mass[-1], np.append(0.0, mass / mass[-1])

    def support(self) -> tuple[float, float]:
        """Ends of the reach, m."""
        return self.low, self.high

    def pdf(self, r: ArrayLike) -> Array:
        """Density, 1/m."""
        return np.interp(np.asarray(r, dtype=float), self.r, self.density, left=0.0, right=0.0)

    def logpdf(self, r: ArrayLike) -> Array:
        """ln of the density."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.pdf(r)))

    def cdf(self, r: ArrayLike) -> Array:
        """The probability of a distance up to r."""
        return np.interp(np.asarray(r, dtype=float), self.r, self.mass)

    def sf(self, r: ArrayLike) -> Array:
        """The probability of one beyond r."""
        return 1.0 - self.cdf(r)

    def ppf(self, probability: ArrayLike) -> Array:
        """Quantiles, m."""
        return np.interp(np.asarray(probability, dtype=float), self.mass, self.r)


def information(observer: Observer, *, n_readings: int = 400, seed: Seed = None) -> Bits:
    """How much one reading tells of the radial distance, on average over the prior.

    The mutual information of distance and reading: entropy of the prior of r less the mean
    entropy of its posterior, everything else integrated out.

    Parameters
    ----------
    observer : Observer
    n_readings : int
        Contacts drawn from the prior, with a reading each.
    seed : int, SeedSequence or Generator

    Returns
    -------
    Bits

    Raises
    ------
    ValueError
        For fewer than two readings.

    Notes
    -----
    The mean of ln p(r | reading)/p(r) at the true r, other unknowns integrated out by quadrature.
    Of the prior flat over the reach R, and JNDs Δ small beside it, it is ⟨log₂(R/(Δ√(2πe)))⟩.

    Examples
    --------
    >>> from weberwhisk import Whisker, cues
    >>> tap = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> bits = information(tap, n_readings=200, seed=1)
    >>> print(f"{bits.value:.1f} ± {bits.error:.1f} bits")
    4.0 ± 0.1 bits
    """
    n_readings = whole("n_readings", n_readings, "write 400, say", least=2)
    contact_seed, reading_seed = np.random.SeedSequence(int(generator(seed).integers(2**63))).spawn(
        2
    )
    contact = prior_draws(observer, n_readings, contact_seed)
    reading = observer.read(contact, reading_seed)
    r = contact[:, 0]
    with np.errstate(divide="ignore"):  # where a reading excludes its contact, next to never
        gained = np.log(density_of_distance(sums_of(observer, reading), r))
    gained = np.maximum(gained, gained[np.isfinite(gained)].min())
    gained = (gained - DistancePrior(observer).logpdf(r)) / np.log(2)
    return Bits(float(gained.mean()), float(gained.std(ddof=1) / np.sqrt(n_readings)))


def prior_draws(observer: Observer, count: int, seed: Seed = None) -> Array:
    """Contacts (count, U) drawn from an observer's prior."""
    rng = np.random.default_rng(seed)
    if not observer.space.reach_varies:
        r = DistancePrior(observer).ppf(rng.random(count))
        return _drawn(observer, r, observer.angle_range(r)[1] if observer.bounded > 1 else r, rng)
    # Of all that may be, what a further unknown lets the whisker hold.
    low, high = observer.reach
    ends = np.linspace(low, high, 514)[1:-1]
    widest = 1.001 * observer.angle_range(ends)[1].max() if observer.bounded > 1 else 0.0
    out = np.empty((0, len(observer.unknowns)))
    while len(out) < count:
        r = low + (high - low) * rng.random(count)
        if "radial_distance" in observer.prior:
            r = _within(observer.prior["radial_distance"], low, high, rng.random(count))
        drawn = _drawn(observer, r, np.full(count, widest), rng)
        if observer.bounded > 1:
            least, width = observer.space.angle_range(drawn[:, 0], drawn)
            held = drawn[:, 1] < least + width
        else:
            held = observer.signals(drawn)[1] == Outcome.HELD
        out = np.concatenate([out, drawn[held]])
    return out[:count]


def _within(prior: Any, low: Any, high: Any, u: Array) -> Array:
    """Values (n,) of a distribution between two ends, at probabilities u (n,) there."""
    below = prior.cdf(low)
    return np.asarray(prior.ppf(below + u * (prior.cdf(high) - below)))


def _drawn(observer: Observer, r: Array, width: Array, rng: np.random.Generator) -> Array:
    """Contacts (n, U) at distances r (n,), angles within a width (n,) of their range."""
    _, *others = observer.unknowns
    drawn = {name: rng.random(len(r)) for name in others}
    for name, u in drawn.items():
        if name != "deflection_angle":
            drawn[name] = observer.prior[name].ppf(u)
            continue
        low = observer.angle_range(r)[0]
        known = observer.prior.get(name)
        drawn[name] = low + u * width if known is None else _within(known, low, low + width, u)
    return np.stack([r, *drawn.values()], axis=-1)


def alone(observer: Observer) -> list[Observer]:
    """The observers of the single cues of a fusion, each with its own noise and the same prior.

    Where a cue does not know of the deflection angle, the prior of distance is what the fusion's
    prior says of it.
    """
    return [_part(observer, [i]) for i in range(len(_fused(observer).cues))]


def _fused(observer: Observer) -> Fused:
    if not isinstance(observer.cue, Fused):
        raise ValueError(f"Only a fusion has parts, got {observer.cue!r}; write Fused(cue, other).")
    return observer.cue


def _part(observer: Observer, kept: list[int]) -> Observer:
    """The observer of some of a fusion's cues."""
    fused = _fused(observer)
    ends = np.cumsum([0, *(len(cue.signal_names) for cue in fused.cues)])
    noises = []
    for i in kept:
        own = observer.noise.part(int(ends[-1]), int(ends[i]), int(ends[i + 1]))
        if own is None:
            raise ValueError(
                f"The noise must be given cue by cue, got {observer.noise!r}; "
                "write fused.joint(Weber(0.1), Weber(0.1)), say."
            )
        noises.append(own)
    cue: Cue = fused.cues[kept[0]]
    noise: ReceptorNoise = noises[0]
    if len(kept) > 1:
        cue = several = Fused(*(fused.cues[i] for i in kept))
        noise = several.joint(*noises)
    prior: dict[str, Any] = {n: d for n, d in observer.prior.items() if n in cue.unknowns}
    if observer.bounded > 1 and "deflection_angle" not in cue.unknowns:
        prior["radial_distance"] = DistancePrior(observer)
    elif cue.farthest(observer.whisker) > observer.reach[1]:  # as far as all cues work
        low, high = observer.reach
        prior.setdefault("radial_distance", scipy.stats.uniform(low, high - low))
    how: dict[str, Any] = {"model": observer.model, "tolerance": observer.tolerance}
    return Observer(observer.whisker, cue, noise, prior, **how)


def added_information(
    observer: Observer, *, n_readings: int = 400, seed: Seed = None
) -> pd.DataFrame:
    """What each cue of a fusion tells of distance alone, and what it adds to the others.

    Parameters
    ----------
    observer : Observer
        Of a `Fused` cue.
    n_readings : int
        As for `information`.
    seed : int, SeedSequence or Generator

    Returns
    -------
    pandas.DataFrame
        A row a cue, and last one of all together: ``cue``, ``alone_bits`` and ``added_bits``, with
        Monte Carlo errors ``alone_error_bits`` and ``added_error_bits``. What the cues add does
        not sum to the whole: what two of them tell alike, neither adds.

    Raises
    ------
    ValueError
        As for `alone` and `information`.
    """
    parts = alone(observer)
    seeds = np.random.SeedSequence(int(generator(seed).integers(2**63))).spawn(2 * len(parts) + 1)
    whole = information(observer, n_readings=n_readings, seed=seeds[-1])
    rows = []
    for i, part in enumerate(parts):
        rest = _part(observer, [j for j in range(len(parts)) if j != i])
        single = information(part, n_readings=n_readings, seed=seeds[2 * i])
        others = information(rest, n_readings=n_readings, seed=seeds[2 * i + 1])
        added = whole.value - others.value, float(np.hypot(whole.error, others.error))
        rows.append((repr(part.cue), *single, *added))
    rows.append(("all", *whole, *whole))
    columns = ["cue", "alone_bits", "alone_error_bits", "added_bits", "added_error_bits"]
    return pd.DataFrame(rows, columns=columns)


def fused_jnds(observer: Observer, contact: ArrayLike, *, criterion: str = SD) -> pd.DataFrame:
    """JNDs of each cue of a fusion alone and of all together, one row a contact.

    Parameters
    ----------
    observer : Observer
        Of a `Fused` cue.
    contact : array, shape (..., U)
        Of all of its unknowns.
    criterion : str
        See `criterion_factor`.

    Returns
    -------
    pandas.DataFrame
        The unknowns, ``criterion``; Fisher JNDs: of each cue under its name, of the ``best_mm`` of
        them, of their ``optimal_mm`` combination as though they shared nothing but the distance
        (1/Δ² = Σ 1/Δᵢ²), and ``together_mm``; and ``gain``, best over together. Where cues
        share another unknown, together is better than optimal if one tells what the other needs,
        and worse if both lean on the same prior of it.

    Raises
    ------
    ValueError
        As for `alone`, and for a contact of the wrong shape.

    Examples
    --------
    >>> from weberwhisk import Whisker, cues
    >>> fused = cues.Fused(cues.Compliance(), cues.ForceMap())
    >>> table = fused_jnds(Observer(Whisker(50e-3, 100e-6, 5e-6), fused), [30e-3, 0.2])
    >>> table[["best_mm", "optimal_mm", "together_mm"]].round(3)
       best_mm  optimal_mm  together_mm
    0    1.277       1.158        1.158
    """
    fused, parts = _fused(observer), alone(observer)
    place = observer.checked(contact).reshape(-1, len(observer.unknowns))
    factor = criterion_factor(criterion)
    jnds = factor * np.stack([fisher_jnd(o, fused.part(o.cue, place)) for o in parts])
    table = pd.DataFrame(dict(zip(observer.unknowns, place.T, strict=True)))
    table["criterion"] = criterion
    names = [f"{i}: {part.cue!r}" for i, part in enumerate(parts, start=1)]
    table[names] = jnds.T
    table["best"] = np.min(jnds, axis=0)
    with np.errstate(divide="ignore"):  # infinite where no cue tells anything alone
        table["optimal"] = np.sum(jnds**-2.0, axis=0) ** -0.5
    table["together"] = factor * fisher_jnd(observer, place)
    table["gain"] = table["best"] / table["together"]
    return with_units(table, [*names, "best", "optimal", "together"], units=UNITS)
