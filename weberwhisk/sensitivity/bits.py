"""Information about distance in a reading, for one cue and for several together.

"None of the methods exclude any others" (§2, §4): the gain of a fusion of cues is the information
that it adds, in bits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .._util.checks import generator, whole
from .._util.refusals import Refusal
from .._util.values import Array, pd
from ..cues import Fused
from ..cues.protocol import Cue
from ..inference.observer import Observer, distance_prior
from ..inference.quadrature import sums_of
from ..inference.weighted import density_of_distance
from ..mechanics.contact import Outcome
from ..receptors import ReceptorNoise, Seed

__all__ = [
    "Bits", "DistancePrior", "added_information", "alone", "information",
    "prior_draws",
]  # fmt: skip


class Bits(NamedTuple):
    """Information in bits, and its Monte Carlo error."""

    value: float
    error: float


class DistancePrior:
    """An observer's marginal prior of distance, for an observer with fewer unknowns.

    It has the methods of SciPy's distributions that `Observer` uses; lengths are in metres. The
    density is linear between grid points.
    """

    def __init__(self, observer: Observer) -> None:
        self.low, self.high = observer.reach
        self.r = np.linspace(self.low, self.high, 20_001)
        # There is no contact at the very ends: take the density next to them.
        inside = np.clip(self.r, np.nextafter(self.low, 1.0), np.nextafter(self.high, 0.0))
        density = distance_prior(observer, inside)
        mass = scipy.integrate.cumulative_trapezoid(density, self.r, initial=0)
        self.density, self.mass = density / mass[-1], mass / mass[-1]

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


def information(observer: Observer, *, n_readings: int = 400, seed: Seed = 1) -> Bits:
    """Mutual information of radial distance and one reading, in bits.

    The entropy of the prior of r minus the mean entropy of its posterior, with the other unknowns
    marginalised.

    Parameters
    ----------
    observer : Observer
    n_readings : int
        Contacts drawn from the prior, with one reading each.
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
    The mean of log₂ p(r | reading)/p(r) at the true r, other unknowns marginalised by quadrature.
    For a flat prior over the reach R and JNDs Δ ≪ R it is ⟨log₂(R/(Δ√(2πe)))⟩.

    Examples
    --------
    >>> from weberwhisk import Whisker, cues
    >>> tap = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> bits = information(tap, n_readings=200, seed=1)
    >>> print(f"{bits.value:.1f} ± {bits.error:.1f} bits")
    4.0 ± 0.1 bits
    """
    n_readings = whole("n_readings", n_readings, "write 400, say", least=2)
    sequence = np.random.SeedSequence(int(generator(seed).integers(2**63)))
    contact_seed, reading_seed = sequence.spawn(2)
    contact = prior_draws(observer, n_readings, contact_seed)
    reading = observer.read(contact, reading_seed)
    r = contact[:, 0]
    with np.errstate(divide="ignore"):  # a reading very rarely excludes its contact
        gained = np.log(density_of_distance(sums_of(observer, reading), r))
    gained = np.maximum(gained, gained[np.isfinite(gained)].min())
    gained = (gained - DistancePrior(observer).logpdf(r)) / np.log(2)
    return Bits(float(gained.mean()), float(gained.std(ddof=1) / np.sqrt(n_readings)))


def prior_draws(observer: Observer, count: int, seed: Seed = None) -> Array:
    """Contacts (count, U) drawn from an observer's prior."""
    rng = np.random.default_rng(seed)
    if not observer.space.reach_varies:
        r = DistancePrior(observer).ppf(rng.random(count))
        width = observer.space.angle_range(r)[1] if observer.bounded > 1 else r
        return _drawn(observer, r, width, rng)
    # The reach depends on a further unknown: draw from the widest range, keep possible contacts.
    low, high = observer.reach
    ends = np.linspace(low, high, 514)[1:-1]
    widest = 1.001 * observer.space.angle_range(ends)[1].max() if observer.bounded > 1 else 0.0
    out = np.empty((0, len(observer.unknowns)))
    while len(out) < count:
        r = low + (high - low) * rng.random(count)
        if "radial_distance" in observer.prior:
            r = _within(observer.prior["radial_distance"], low, high, rng.random(count))
        drawn = _drawn(observer, r, np.full(count, widest), rng)
        if observer.bounded > 1:
            least, width = observer.space.angle_range(drawn[:, 0], drawn)
            in_contact = drawn[:, 1] < least + width
        else:
            in_contact = observer.signals(drawn)[1] == Outcome.HELD
        out = np.concatenate([out, drawn[in_contact]])
    return out[:count]


def _within(prior: Any, low: Any, high: Any, u: Array) -> Array:
    """Quantiles (n,) at probabilities u (n,) of a distribution truncated to two ends."""
    below = prior.cdf(low)
    return np.asarray(prior.ppf(below + u * (prior.cdf(high) - below)))


def _drawn(observer: Observer, r: Array, width: Array, rng: np.random.Generator) -> Array:
    """Contacts (n, U) at distances r (n,), with angles in the first `width` (n,) of their range."""
    _, *others = observer.unknowns
    drawn = {name: rng.random(len(r)) for name in others}
    for name, u in drawn.items():
        if name != "deflection_angle":
            drawn[name] = observer.prior[name].ppf(u)
            continue
        low = observer.space.angle_range(r)[0]
        prior = observer.prior.get(name)
        drawn[name] = low + u * width if prior is None else _within(prior, low, low + width, u)
    return np.stack([r, *drawn.values()], axis=-1)


def alone(observer: Observer) -> list[Observer]:
    """The observers of the single cues of a fusion, with their own noise and the fusion's prior.

    A cue without an unknown deflection angle has the marginal prior of distance.

    Parameters
    ----------
    observer : Observer
        Of a `Fused` cue.

    Returns
    -------
    list of Observer

    Raises
    ------
    ValueError
        For another cue, and noise that was not given cue by cue.
    """
    return [_part(observer, [i]) for i in range(len(_fused(observer).cues))]


def _fused(observer: Observer) -> Fused:
    if not isinstance(observer.cue, Fused):
        raise Refusal(
            "Only a fusion has parts",
            f"{observer.cue!r}",
            "write ww.cues.Fused(cue, ww.cues.ForceMap())",
        )
    return observer.cue


def _part(observer: Observer, kept: list[int]) -> Observer:
    """The observer of a subset of a fusion's cues, by index."""
    fused = _fused(observer)
    ends = np.cumsum([0, *(len(cue.signal_names) for cue in fused.cues)])
    noises = []
    for i in kept:
        part = observer.noise.part(int(ends[-1]), int(ends[i]), int(ends[i + 1]))
        if part is None:
            raise Refusal(
                "The noise must be given cue by cue",
                f"{observer.noise!r}",
                "write fused.joint(ww.receptors.Weber(0.1), ww.receptors.Weber(0.1)), say",
            )
        noises.append(part)
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


def added_information(observer: Observer, *, n_readings: int = 400, seed: Seed = 1) -> pd.DataFrame:
    """Information about distance in each cue of a fusion alone, and added to the other cues.

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
        One row per cue, and a last one for all: ``cue``, ``alone_bits`` and ``added_bits``, with
        Monte Carlo errors ``alone_error_bits`` and ``added_error_bits``. Added information does
        not sum to that of all cues: what two cues share, neither adds.

    Raises
    ------
    ValueError
        As for `alone` and `information`.
    """
    cues_alone = alone(observer)
    entropy = int(generator(seed).integers(2**63))
    seeds = np.random.SeedSequence(entropy).spawn(2 * len(cues_alone) + 1)
    whole = information(observer, n_readings=n_readings, seed=seeds[-1])
    records = []
    for i, part in enumerate(cues_alone):
        rest = _part(observer, [j for j in range(len(cues_alone)) if j != i])
        single = information(part, n_readings=n_readings, seed=seeds[2 * i])
        others = information(rest, n_readings=n_readings, seed=seeds[2 * i + 1])
        added = whole.value - others.value, float(np.hypot(whole.error, others.error))
        records.append((repr(part.cue), *single, *added))
    records.append(("all", *whole, *whole))
    columns = ["cue", "alone_bits", "alone_error_bits", "added_bits", "added_error_bits"]
    return pd.DataFrame(records, columns=columns)
