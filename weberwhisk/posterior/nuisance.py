"""The last of three or more unknowns, integrated out at every node of a grid over the others.

A stiffness or a side is known by its prior and by what the rest of a reading leaves of it. At a
given contact its density is close to a Gaussian, whose middle and width change from contact to
contact: a Newton step or two from the mode's own regression line find both. Gauss–Hermite's rule
about them needs five nodes where a grid of three dimensions has a dozen; and the mechanics, which
know no stiffness, are worked out once for all of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray

from ..mechanics.contact import Outcome
from ..observer import Observer
from .densities import taken_apart
from .grid import GridPosterior, integrate
from .mode import Mode
from .solution import Array, mode_root

Index = NDArray[np.intp]

#: Nodes of the rule, from the tolerance on that stands before them.
RULES = ((3e-3, 5), (3e-4, 9), (0.0, 15))
#: Widest and narrowest a conditional density may be, over the mode's.
WIDEST = 4.0
#: Most steps towards the conditional mode, in widths the last of them, and the density (in ln,
#: below the highest) at nodes that are not waited for.
STEPS, NEAR, NEGLIGIBLE = 8, 0.5, 30.0


class Conditional:
    """The density of all unknowns but the last, for readings (B, R) and their modes."""

    def __init__(self, observer: Observer, reading: Array, mode: Mode, tolerance: float) -> None:
        self.observer, self.reading, self.mode = observer, reading, mode
        precision = np.linalg.inv(mode.covariance)
        self.width = precision[:, -1, -1] ** -0.5
        self.slope = -precision[:, -1, :-1] / precision[:, -1, -1, None]
        self.count = next(count for least, count in RULES if tolerance >= least)

    def __call__(self, x: Array, index: Index, *, finer: int = 1) -> tuple[Array, Array]:
        """ln of the density at x (b, N, U − 1), (b, N); and columns (b, N, U + 1).

        The columns are the contact, and of the last unknown the mean and variance at each node.
        """
        observer, reading = self.observer, self.reading[index, None]
        contact, log_prior = observer.contact(x)
        felt = observer.given(contact)

        def log_density(z: Array) -> tuple[Array, Array]:
            value = observer.last_unknown(z)
            signals, outcome = felt(value)
            held = outcome == Outcome.HELD
            signals = np.where(held[..., None], signals, 1.0)
            log = observer.noise.log_likelihood(reading, signals) - 0.5 * z**2
            return np.where(held, log, -np.inf), value

        off = x - self.mode.x[index, None, :-1]
        middle = self.mode.x[index, None, -1] + (off @ self.slope[index, :, None])[..., 0]
        width = np.broadcast_to(self.width[index, None], middle.shape)
        for _ in range(STEPS):
            below, here, above = (log_density(middle + s * width)[0] for s in (-1.0, 0.0, 1.0))
            with np.errstate(divide="ignore", invalid="ignore"):
                rise, bend = (above - below) / 2, 2 * here - below - above
                # Uphill all the way where there is no peak to aim at.
                step = np.where(bend > 0, rise / bend, np.inf * np.sign(rise))
                step = np.nan_to_num(np.clip(step, -WIDEST, WIDEST))
                middle = middle + step * width
                tiny = here < here.max(axis=1, keepdims=True) - NEGLIGIBLE
            if np.all(tiny | (np.abs(step) < NEAR)):
                break
        with np.errstate(invalid="ignore"):
            bend = np.clip(np.nan_to_num(bend, nan=1.0), WIDEST**-2, WIDEST**2)
        width = width * bend**-0.5
        t, weight = hermegauss(finer * self.count)
        rule = np.log(weight) + t**2 / 2
        each = [log_density(middle + node * width) for node in t]
        log = np.stack([value + w for (value, _), w in zip(each, rule, strict=True)])
        top = log.max(axis=0)
        safe = np.where(np.isfinite(top), top, 0.0)
        share = np.exp(log - safe)
        total = share.sum(axis=0)
        values = np.stack([value for _, value in each])
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = (share * values).sum(axis=0) / total
            variance = (share * np.square(values - mean)).sum(axis=0) / total
            marginal = np.log(total * width) + safe + log_prior - 0.5 * np.log(2 * np.pi)
        columns = np.concatenate([contact, mean[..., None], variance[..., None]], axis=-1)
        return marginal, np.where(np.isfinite(marginal)[..., None], columns, 0.0)

    def error(self, found: GridPosterior, rows: Index) -> Array:
        """How far ln of the density is off, across the middle of each posterior (b,).

        The rule with three times as many nodes tells, at one sd to either side along each axis.
        """
        sd = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2), 0.0))
        steps = np.concatenate([s * np.eye(sd.shape[1]) for s in (-1.0, 0.0, 1.0)])
        places = np.nan_to_num(found.mean[:, None, : sd.shape[1]] + steps * sd[:, None])
        change = self(places, rows, finer=3)[0] - self(places, rows)[0]
        with np.errstate(invalid="ignore"):
            return np.ptp(np.nan_to_num(change, nan=1.0, posinf=1.0, neginf=-1.0), axis=1)


def integrate_but_last(
    observer: Observer,
    reading: Array,
    mode: Mode,
    *,
    tolerance: float,
    max_points: int,
    keep_points: bool = False,
) -> GridPosterior:
    """Moments of all unknowns (B, U) for readings (B, R) with these modes: as `integrate` gives."""
    conditional = Conditional(observer, reading, mode, tolerance)
    rest = Mode(mode.x[:, :-1], mode.log_density, mode.covariance[:, :-1, :-1])
    density, functions = taken_apart(conditional)
    found = integrate(
        density,
        rest.x,
        mode_root(rest),
        functions=functions,
        tolerance=tolerance,
        max_points=max_points,
        keep_points=keep_points,
    )
    dim = rest.x.shape[1]
    off = conditional.error(found, np.arange(len(reading)))[:, None]
    # Of the last unknown: the variance of its mean at the nodes, and the mean of its variance.
    mean, sd, mean_error, sd_error = (
        getattr(found, name)[:, dim:] for name in ("mean", "sd", "mean_error", "sd_error")
    )
    whole = np.sqrt(sd[:, dim] ** 2 + mean[:, dim + 1])
    share = sd[:, dim] / whole
    spread = sd[:, dim + 1] * mean_error[:, dim + 1] / (2 * whole**2)
    last_mean_error, last_sd_error = share * mean_error[:, dim], share**2 * sd_error[:, dim]
    return replace(
        found,
        mean=mean[:, : dim + 1],
        sd=np.column_stack([sd[:, :dim], whole]),
        mean_error=np.column_stack([mean_error[:, :dim], last_mean_error]) + off,
        sd_error=np.column_stack([sd_error[:, :dim], last_sd_error + spread]) + off,
    )
