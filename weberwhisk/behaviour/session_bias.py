"""Biases that differ by session, integrated out: a random effect that adds no dimension to a fit.

Given the rest, the biases of sessions are independent, and each is an integral in one dimension:
normal deviations from the shared bias times the probability of the answers of the session. It is
taken by Gauss-Hermite quadrature about the mode (Liu & Pierce 1994), which Fisher scoring finds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.special import logsumexp

from .._util.values import Array

__all__ = ["BiasedSessions", "Sessions", "chunks"]

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
STEPS = 2  # of scoring; the nodes make up for what is left
FAR = 5.0  # sds, beyond which no mode is looked for
NUDGE = 0.1  # of the deviation, for slope and curvature by differences
AXIS = np.linspace(-5.0, 5.0, 25)  # of deviations to draw, in their sds about the mode
AT_ONCE = 100_000  # numbers of an array: a dozen such stay in the cache


class Sessions(Protocol):
    """The answers of each session, given all but how far its bias deviates."""

    @property
    def sessions(self) -> int: ...
    def log_likelihood(self, deviation: Array) -> Array:
        """Of deviations (N, S), (N, S)."""


@dataclass(frozen=True)
class BiasedSessions:
    """Deviations of N draws of parameters in S sessions, from the answers of each session.

    `sd` (N, 1) is that of biases between sessions. Deviations are `sd` times a number that is a
    standard normal before there are answers; the search for its mode begins at deviations `start`
    (N, S).
    """

    answers: Sessions
    sd: Array
    start: Array

    @cached_property
    def _modes(self) -> tuple[Array, Array]:
        """Mode of each number, and the sd of the normal there; (N, S)."""
        sd = np.maximum(self.sd, 1e-9)
        mode = np.clip(self.start / sd, -FAR, FAR)
        for _ in range(STEPS):
            at = sd * mode
            below, here, above = (
                self.answers.log_likelihood(at + by) for by in (-NUDGE, 0.0, NUDGE)
            )
            slope = (above - below) / (2 * NUDGE)
            # Lapses may turn the curvature round: the prior is then left alone.
            curvature = np.maximum(2 * here - above - below, 0.0) / NUDGE**2
            width = 1 / np.sqrt(1 + sd**2 * curvature)
            change = (sd * slope - mode) * width**2
            limit = 1.0 / np.maximum(sd, 0.2)  # one sd of the signal at a time
            mode = mode + np.clip(change, -limit, limit)
        return mode, width

    @property
    def modes(self) -> Array:
        """The most probable deviations, (N, S)."""
        return self.sd * self._modes[0]

    def log_marginal(self) -> Array:
        """Log-probability of all answers, deviations integrated out, (N,)."""
        mode, width = self._modes
        logs = []
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            number = mode + width * node
            normal = 0.5 * (node**2 - number**2) + np.log(weight * width)
            logs.append(normal + self.answers.log_likelihood(self.sd * number))
        of_sessions = logsumexp(np.stack(logs), axis=0) - 0.5 * np.log(2 * np.pi)
        return np.asarray(of_sessions.sum(axis=1))

    def drawn(self, uniform: Array) -> Array:
        """Deviations given all answers, by uniform numbers (N, S)."""
        mode, width = self._modes
        numbers = mode + width * AXIS[:, None, None]
        log = np.stack([self.answers.log_likelihood(self.sd * z) - 0.5 * z**2 for z in numbers])
        density = np.exp(log - log.max(axis=0))
        steps = np.concatenate([np.zeros_like(density[:1]), (density[1:] + density[:-1]) / 2])
        share = np.cumsum(steps, axis=0)
        target = uniform * share[-1]
        after = np.clip((share < target).sum(axis=0), 1, AXIS.size - 1)[None]
        low, high = (np.take_along_axis(share, a, axis=0)[0] for a in (after - 1, after))
        into = (target - low) / np.maximum(high - low, 1e-300)
        step = AXIS[1] - AXIS[0]
        return np.asarray(self.sd * (mode + width * (AXIS[after[0] - 1] + into * step)))


def chunks(count: int, width: int) -> list[slice]:
    """Slices of so many rows of that width that fit in memory together."""
    size = max(AT_ONCE // max(width, 1), 1)
    return [slice(i, i + size) for i in range(0, count, size)]
