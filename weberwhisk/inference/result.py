"""What an inference returns: moments, quantiles, draws, and a status that is always there.

And what every engine gives back for that, and asks of a posterior before it starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import domain
from .._util.checks import between, finite, one_of, whole
from .._util.refusals import Refusal
from .._util.sampling import ArvizData, integers, to_arviz
from .._util.values import Array, Codes, Flags, Index, Shown, Worded, interval_text, member, pd
from ..mechanics.contact import Outcome
from ..receptors import ReceptorNoise, Seed
from .coordinates import UNITS, ContactCoordinates, signal_unit
from .observer import Observer

__all__ = [
    "AtReadings", "Estimate", "Posterior", "Solution", "Status", "beyond_reach", "contact_slope",
    "is_improbable", "is_outside", "is_unidentified", "refuse_impossible",
]  # fmt: skip


class Status(Worded):
    """How far a posterior can be relied on; `message` says it in words."""

    CONVERGED = 0, "converged"
    UNIDENTIFIED = (
        1,
        "the reading does not determine the contact: in some direction the posterior is as wide "
        "as the prior",
    )
    IMPROBABLE_READING = 2, "the reading lies more than 5 sd from every contact on this whisker"
    NOT_GAUSSIAN = 3, "the posterior is far from Gaussian: Laplace's approximation fails"
    IMPRECISE = 4, "the estimated error is above the tolerance"
    NOT_CONVERGED = 5, "the walkers have not converged"
    SEVERAL_PEAKS = 6, "the posterior has several peaks, and this method may know of one alone"
    NOT_A_READING = 7, "not a reading: a number of it is missing or infinite"
    NO_CONTACT = 8, "no contact: signals are zero that no contact leaves at zero"
    OUTSIDE_DOMAIN = 9, "outside the domain: see outside_domain"


class Estimate(NamedTuple):
    """Posterior mean and sd of one unknown, (B,), and the estimated errors of both."""

    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array


class Solution(Protocol):
    """What a method gives for B readings and keeps of their posteriors.

    Implemented by `quadrature.QuadratureSolution`, by the two of `approximate.py`, and by
    `AtReadings` for the rows that are readings.
    """

    @property
    def estimates(self) -> list[Estimate]:
        """Of each unknown, (B,)."""

    @property
    def status(self) -> Codes:
        """A `Status` of each, (B,)."""

    @property
    def log_evidence(self) -> Array:
        """(B,); NaN where the method does not give it."""

    def quantiles(self, p: Array, unknown: int) -> Array:
        """Quantiles (B, Q) of an unknown at probabilities (Q,)."""

    def quantile_errors(self, p: Array, unknown: int) -> Array:
        """Their estimated errors (B, Q); NaN where the method does not know them."""

    def draws(self, count: int, seed: Seed) -> Array:
        """Draws (B, chain, count, U) of the contact."""


@dataclass(frozen=True, eq=False)
class AtReadings:
    """A solution at readings (B,) that are these rows of its own; −1 is none, its numbers NaN."""

    solution: Solution
    row: Index
    estimates: list[Estimate]
    status: Codes
    log_evidence: Array

    @classmethod
    def of(cls, solution: Solution, row: Index) -> AtReadings:
        status = _at_rows(row, solution.status)
        return cls(
            solution, row, [Estimate(*(_at_rows(row, v) for v in e)) for e in solution.estimates],
            np.where(row < 0, Status.NOT_A_READING, status).astype(np.int8),
            _at_rows(row, solution.log_evidence),
        )  # fmt: skip

    def quantiles(self, p: Array, unknown: int) -> Array:
        return _at_rows(self.row, self.solution.quantiles(p, unknown))

    def quantile_errors(self, p: Array, unknown: int) -> Array:
        return _at_rows(self.row, self.solution.quantile_errors(p, unknown))

    def draws(self, count: int, seed: Seed) -> Array:
        return _at_rows(self.row, self.solution.draws(count, seed))


def _at_rows(row: Index, values: NDArray[Any]) -> Array:
    """Rows of values, NaN where the row is −1."""
    out = np.full((len(row), *values.shape[1:]), np.nan)
    out[row >= 0] = values[row[row >= 0]]
    return out


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Shown):
    """The posterior of a contact given a reading, or of many.

    With readings of shape (B, S) everything has a leading axis B; with one reading, none.

    Attributes
    ----------
    observer : Observer
    reading : array
    method : str
        ``"quadrature"``, ``"emcee"`` or ``"laplace"``.
    estimates : mapping of name to Estimate
        Mean, sd and their errors for each unknown.
    status : Status or array of int
    log_evidence : float or array
        NaN where the method does not give it (emcee).
    """

    _figure: ClassVar[str] = "posteriors"
    observer: Observer
    reading: Array
    method: str
    estimates: Mapping[str, Estimate]
    status: Status
    log_evidence: Array
    solution: AtReadings

    @classmethod
    def of(cls, observer: Observer, reading: Array, method: str, solution: AtReadings) -> Posterior:
        """With a leading axis where there are many readings, and none where there is one."""
        i = 0 if reading.ndim == 1 else slice(None)
        estimates = {
            name: Estimate(*(values[i] for values in estimate))
            for name, estimate in zip(observer.unknowns, solution.estimates, strict=True)
        }
        status = member(Status, solution.status[i])
        return cls(observer, reading, method, estimates, status, solution.log_evidence[i], solution)

    @cached_property
    def outcome(self) -> Outcome:
        """The outcome of the cue's own inverse, with the reading taken as exact.

        An `Outcome`, or an array of int: `HELD` where the inverse finds a contact;
        `CONTRADICTORY`, `NO_TOUCH`, `PARALLEL` and the like where it fails. The posterior, which
        allows for noise, does not fail there.
        """
        return member(Outcome, np.asarray(self.observer.reading_outcome(self.reading)))

    @cached_property
    def outside_domain(self) -> str:
        """What lies outside the domain (`weberwhisk.domain`), in a sentence; empty if nothing does.

        Examples
        --------
        >>> from weberwhisk import Observer, Whisker, cues, posterior, receptors
        >>> sharp = Observer(Whisker(50e-3, 1e-4, 5e-6), cues.Compliance(), receptors.Weber(0.001))
        >>> p = posterior(sharp, sharp.read(30e-3, seed=1))
        >>> p.status.name, p.outside_domain[:43]
        ('OUTSIDE_DOMAIN', 'Outside the domain: a Weber fraction of 0.0')
        """
        r = np.atleast_1d(self.mean)
        is_finite = np.isfinite(r)
        near = domain.of_contact(r[is_finite], self.observer.reach[1]) if is_finite.any() else ()
        readings = self.reading.reshape(len(r), -1)
        beyond = beyond_reach(self.observer, readings, self.estimates).any()
        far = "a contact that may be beyond the reach, to where a tip pushed straight can go"
        return domain.sentence((*domain.of_observer(self.observer), *near, *[far] * int(beyond)))

    @property
    def mean(self) -> Array:
        """Posterior mean of the radial distance, m."""
        return self.estimates["radial_distance"].mean

    @property
    def sd(self) -> Array:
        """Posterior sd of the radial distance, m."""
        return self.estimates["radial_distance"].sd

    @property
    def mean_error(self) -> Array:
        """Estimated error of `mean`, m."""
        return self.estimates["radial_distance"].mean_error

    @property
    def sd_error(self) -> Array:
        """Estimated error of `sd`, m."""
        return self.estimates["radial_distance"].sd_error

    def quantile(self, probability: Any, *, of: str = "radial_distance") -> Array:
        """Posterior quantiles; probabilities (Q,) add a last axis.

        Raises
        ------
        ValueError
            For a probability outside 0 to 1, or an unknown name.
        """
        p = finite("probability", probability, "write a number between 0 and 1")
        if np.any((p <= 0) | (p >= 1)):
            raise Refusal("A probability lies between 0 and 1", p, "write 0.975, say")
        values = self.solution.quantiles(np.atleast_1d(p), self._column(of))
        values = values if p.ndim else values[:, 0]
        return values if self.reading.ndim > 1 else values[0]

    def quantile_error(self, probability: Any, *, of: str = "radial_distance") -> Array:
        """Estimated errors of `quantile`, in its unit and of its shape.

        NaN where the method does not estimate them: quadrature does.

        Raises
        ------
        ValueError
            For a probability outside 0 to 1, or an unknown name.

        Examples
        --------
        >>> from weberwhisk import Observer, Whisker, cues, posterior
        >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.ForceMap())
        >>> p = posterior(observer, observer.read([30e-3, 0.2], seed=1))
        >>> bool(p.quantile_error(0.975) < 0.01 * p.sd)
        True
        """
        shape = np.shape(self.quantile(probability, of=of))
        p = np.atleast_1d(np.asarray(probability, dtype=float))
        return np.reshape(self.solution.quantile_errors(p, self._column(of)), shape)[()]

    def interval(self, mass: float = 0.95, *, of: str = "radial_distance") -> Array:
        """Equal-tailed interval: lower and upper end along the last axis.

        Raises
        ------
        ValueError
            For a mass outside 0 to 1, or an unknown name.
        """
        tail = (1 - between("mass", mass, "write 0.95, say")) / 2
        return self.quantile([tail, 1 - tail], of=of)

    def _column(self, of: str) -> int:
        return self.observer.unknowns.index(one_of("of", of, self.observer.unknowns))

    def summary(self) -> pd.DataFrame:
        """One row for each reading and unknown: moments, errors, 95 % interval, how it went.

        And the observer's `note`, where there is one.
        """
        said = {
            key: np.array([kind(i).message for i in range(len(kind))])[np.atleast_1d(values)]
            for key, kind, values in (
                ("status", Status, self.status), ("outcome", Outcome, self.outcome)
            )
        }  # fmt: skip
        tables = []
        ends = {name: self.interval(0.95, of=name) for name in self.observer.unknowns}
        for name, estimate in self.estimates.items():
            low, high = np.moveaxis(np.atleast_2d(ends[name]), -1, 0)
            columns = {key: np.atleast_1d(v) for key, v in estimate._asdict().items()}
            tables.append(
                pd.DataFrame(
                    {"reading": np.arange(len(low)), "unknown": name, "unit": UNITS.get(name, "1")}
                    | columns
                    | {"low_95": low, "high_95": high}
                    | said
                )
            )
        table = pd.concat(tables, ignore_index=True)
        return table.assign(note=self.observer.note) if self.observer.note else table

    def _line(self) -> str:
        note = f"; {self.observer.note}" if self.observer.note else ""
        if self.reading.ndim > 1:
            good = int(np.sum(np.asarray(self.status) == Status.CONVERGED))
            return f"{len(self.reading)} readings by {self.method}, {good} of them converged{note}"
        if not np.isfinite(self.mean):
            return f"none; {self.status.message}{note}"
        low, high = 1e3 * self.interval()
        pieces = [f"r = {interval_text(float(1e3 * self.mean), low, high, ' mm')}"]
        if "deflection_angle" in self.estimates:
            angle = self.estimates["deflection_angle"]
            pieces.append(f"θ_d = {np.degrees(angle.mean):.3g} ± {np.degrees(angle.sd):.2g}°")
        return f"{', '.join(pieces)}, by {self.method}; {self.status.message}{note}"

    def to_arviz(
        self, *, draws: int = 1000, seed: Seed = 1, log_likelihood: bool | None = None
    ) -> ArvizData:
        """ArviZ data with draws of every unknown (InferenceData on 0.23, DataTree on 1.x).

        Draws of emcee are the walkers' own, four or more independent ensembles as chains;
        quadrature and Laplace are drawn from with `seed`, `draws` in each of four chains. Many
        readings share the dimension `reading`, and each is a posterior of its own: choose one,
        ``data.sel(reading=0)``, for LOO or prior sensitivity.

        Parameters
        ----------
        draws : int
            Of each chain.
        seed
            Of the draws.
        log_likelihood : bool, optional
            Whether to add that of the reading at each draw, which takes a solution of the whisker
            a draw: by default that of one reading alone. `log_prior` has the log density of the
            priors that were given; where all are flat there is none to be sensitive to.

        Examples
        --------
        >>> from weberwhisk import Observer, Whisker, cues, posterior, receptors
        >>> whisker = Whisker(50e-3, 100e-6, 5e-6)
        >>> observer = Observer(whisker, cues.Compliance(), receptors.Weber(0.1))
        >>> many = posterior(observer, observer.read([[20e-3], [30e-3]], seed=1))
        >>> drawn = many.to_arviz(draws=100)["posterior"]["radial_distance"]
        >>> drawn.dims, drawn.attrs["units"]
        (('chain', 'draw', 'reading'), 'm')
        """
        whole("draws", draws, "write 1000, say")
        values = self.solution.draws(draws, seed)
        values = np.moveaxis(values, 0, 2)  # chain, draw, reading, unknown
        observer, many = self.observer, self.reading.ndim > 1
        with_likelihood = not many if log_likelihood is None else log_likelihood
        likelihood = self._log_likelihood(values) if with_likelihood else None
        values = values if many else values[:, :, 0]
        names = observer.cue.signal_names
        if len(names) != self.reading.shape[-1]:  # counts or reports, not signals
            names = tuple(f"reading_{i}" for i in range(self.reading.shape[-1]))
        unknowns = {name: values[..., i] for i, name in enumerate(observer.unknowns)}
        return to_arviz(
            unknowns,
            log_prior={
                name: observer.prior[name].logpdf(value)
                for name, value in unknowns.items()
                if name in observer.prior
            }
            or None,
            log_likelihood=None if likelihood is None else {"contact": likelihood},
            observed_data={name: self._observed(i) for i, name in enumerate(names)},
            coords={"reading": np.arange(len(self.reading))} if many else None,
            dims={key: ("reading",) for key in (*unknowns, *names, "contact")} if many else None,
            attrs={
                "method": self.method,
                "observer": repr(observer),
                "status": "; ".join(
                    sorted({Status(int(s)).message for s in np.atleast_1d(self.status)})
                ),
            },
            units={name: UNITS.get(name, "1") for name in unknowns}
            | {name: signal_unit(name) for name in names},
        )

    def _log_likelihood(self, contact: Array) -> Array:
        """ln p(reading | contact) at draws (chain, draw, B, U); without B for one reading."""
        readings = self.reading.reshape(contact.shape[2], -1)
        out = np.full(contact.shape[:3], np.nan)
        for i, reading in enumerate(readings):
            if not np.isfinite(contact[:, :, i]).all():  # not a reading
                continue
            value = self.observer.log_likelihood(reading, contact[:, :, i])
            # A draw between two nodes may lie just beyond a fold, where no contact is held.
            in_contact = np.isfinite(value)
            if in_contact.any():
                out[:, :, i] = np.where(in_contact, value, value[in_contact].min())
        return out if self.reading.ndim > 1 else out[:, :, 0]

    def _observed(self, i: int) -> NDArray[Any]:
        """One number of the reading: of counts and reports, integers."""
        values = self.reading[..., i]
        if self.observer.noise.reads_signals or not np.array_equal(values, np.rint(values)):
            return values
        return integers(values)


def beyond_reach(observer: Observer, reading: Array, estimates: Mapping[str, Estimate]) -> Flags:
    """Readings (B, R) that may be of a tip beyond where it is at rest, which no observer knows.

    Pushed against its curvature a whisker is straightened. Such a reading has no contact of its
    own, and a posterior up against the reach: its mean was 3 sd short, in space 5.
    """
    out = np.zeros(len(reading), dtype=bool)
    forward, end = observer.forward, observer.reach[1]
    if observer.space.is_wedge:  # which ends where the whisker flicks past
        end = observer.cue.farthest(observer.whisker)
    if "deflection_angle" not in observer.unknowns or forward.is_plain:
        return out
    mean, sd = (np.atleast_1d(a) for a in estimates["radial_distance"][:2])
    in_space = forward.azimuth is not None
    near = mean + (2 if in_space else 4) * sd > end
    if not near.any():
        return out
    contact = np.stack([np.atleast_1d(e.mean)[near] for e in estimates.values()], axis=-1)
    forward = observer.cue.forward(observer.whisker, contact)
    straightened = forward.limit(np.full(len(contact), 0.999 * forward.reach)) > 0.05
    if not in_space and straightened.any():  # in space there is no inverse
        straightened &= observer.reading_outcome(reading[near]) == Outcome.OUT_OF_REACH
    out[near] = straightened
    return out


def is_improbable(observer: Observer, reading: Array, contact: Array) -> Flags:
    """Readings with a number more than 5 sd from what their own most probable contact gives."""
    signals = observer.signals(contact)[0]
    return is_outside(observer.noise, observer.near(reading, signals), signals)


def is_outside(noise: ReceptorNoise, reading: Array, signals: Array) -> Flags:
    """Readings (B, R) with a number more than 5 sd from their signals (B, S)."""
    low, high = noise.interval(signals, 5.0)
    return np.any((reading < low) | (reading > high), axis=-1)


def contact_slope(space: ContactCoordinates, x: Array) -> Array:
    """d contact/dx, (B, U, U), by central differences."""
    h = 1e-5
    steps = h * np.eye(x.shape[1])
    ends = (space.constrain(x[:, None] + sign * steps)[0] for sign in (1, -1))
    return np.asarray(np.subtract(*ends).swapaxes(1, 2) / (2 * h))


def is_unidentified(observer: Observer, contact: Array) -> Flags:
    """Posteriors to which the reading adds less than the prior in some direction.

    In the coordinates x a flat prior has a curvature of ¼ and more: information below that
    leaves the prior to decide. The priors limit unknowns that the whisker does not bound,
    and what is left to know of them is taken from the others (Schur complement).
    """
    contact = contact.copy()
    for i, name in enumerate(observer.unknowns[observer.bounded :], observer.bounded):
        low, high = observer.prior[name].support()  # at whose very ends a coordinate is infinite
        if np.isfinite(high - low):
            room = 1e-6 * (high - low)
            contact[:, i] = np.clip(contact[:, i], low + room, high - room)
    space = observer.space
    slope = contact_slope(space, space.unconstrain(contact))
    of_contact = observer.information(contact) + observer.prior_information(contact)
    information = np.swapaxes(slope, 1, 2) @ of_contact @ slope
    information = information[np.isfinite(information).all(axis=(1, 2))]
    n = observer.bounded
    cross = information[:, :n, n:]
    shared = cross @ np.linalg.solve(information[:, n:, n:], np.swapaxes(cross, 1, 2))
    least = np.zeros(len(contact))
    is_finite = np.isfinite(of_contact).all(axis=(1, 2))
    least[is_finite] = np.linalg.eigvalsh(information[:, :n, :n] - shared)[:, 0]
    return least < 0.25


def refuse_impossible(reading: Array, highest: Array) -> None:
    """Refuse readings (B, R) whose log-density is −inf everywhere: there is no posterior."""
    impossible = np.isneginf(highest)
    if np.any(impossible):
        raise Refusal(
            f"No contact can give the reading {reading[impossible][0].tolist()} under this noise",
            remedy=(
                "check its sign and unit (N m, N, rad), or choose noise that allows it, "
                "such as Weber"
            ),
        )
