"""What of a receptor's noise goes with its Weber fraction, and what does not."""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from ..receptors import Events, GeneralisedWeber, Joint, LogNormal, ReceptorNoise, Saturating

Array = NDArray[np.float64]


def fractions(noise: ReceptorNoise, signals: int) -> Array:
    """Weber fraction of every signal, 0 where its noise has none.

    Examples
    --------
    >>> fractions(GeneralisedWeber([0.1, 0.0], floor=[0.0, 0.02]), 2)
    array([0.1, 0. ])
    """
    if isinstance(noise, Joint):
        parts = zip(noise.noises, noise.sizes, strict=True)
        return np.concatenate([fractions(*part) for part in parts])
    return np.broadcast_to(np.asarray(getattr(noise, "weber_fraction", 0.0), float), signals)


def varied(noise: ReceptorNoise, factor: float, *, floor: bool) -> ReceptorNoise:
    """The same receptors with their Weber fractions times a factor, with or without their floor.

    Examples
    --------
    >>> varied(GeneralisedWeber(0.1, floor=0.5), 2.0, floor=False).sd([3.0])
    array([0.6])
    """
    if isinstance(noise, Joint):
        return Joint([varied(n, factor, floor=floor) for n in noise.noises], noise.sizes)
    if isinstance(noise, LogNormal):
        return LogNormal(noise.weber_fraction * factor, correlation=noise.correlation)
    other = copy(noise)
    if hasattr(other, "weber_fraction"):
        other.weber_fraction = other.weber_fraction * factor
    if isinstance(other, GeneralisedWeber) and not floor:
        other.floor = np.zeros_like(other.floor)
    return other


def all_or_none(noise: ReceptorNoise) -> bool:
    """Whether all readings report events."""
    if isinstance(noise, Joint):
        return all(map(all_or_none, noise.noises))
    return isinstance(noise, Events)


def saturated(noise: ReceptorNoise, signals: Array) -> NDArray[np.bool_]:
    """Where a signal lies above a ceiling beyond which its receptor tells nothing, (...)."""
    if isinstance(noise, GeneralisedWeber) and not isinstance(noise, Saturating):
        return np.any(noise.saturated(signals), axis=-1)
    return np.zeros(signals.shape[:-1], dtype=bool)
