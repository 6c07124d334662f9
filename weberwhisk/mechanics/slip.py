"""How a contact moves along a whisker that is pushed on along an object (§2g), without friction.

In the frame of the base, with φ the direction of the whisker's tangent at the contact, β = φ − θ_d
its angle to the line base → contact, and ρ the push angle: the contact moves along the tangent,

    r d(θ_d − ρ) = tan β dr,                                                            (slip)

and the object's own tangent, φ − ρ in the world, is what the object lets it be: on a wall it does
not turn, so that its contacts move at a rate that depends on the contact alone,

    dr/dρ = (1 − ∂φ/∂θ_d) / (∂φ/∂r + ∂φ/∂θ_d tan β / r).                                (wall)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..whisker import Whisker
from . import elastica
from .contact import Outcome
from .surface import surface_of

Array = NDArray[np.float64]

#: Relative step of the differences in (wall); contacts of the tip in its table, and how far they
#: are, in θ_d, from slipping off.
STEP, NODES, INSIDE = 1e-5, 401, 1e-6


def slid(
    whisker: Whisker, r: Array, theta: Array, slip: Array, push: Array | float
) -> tuple[Array, Array]:
    """r and θ_d (n,) after slips dr (n,) and pushes dρ: (slip), by the trapezoid rule."""
    start = slope(whisker, r, theta)
    there = r + slip
    # A contact that is not held has no slope of its own: it is lost, whatever is written here.
    end = slope(whisker, there, theta + push + start * slip)
    mean = np.where(np.isfinite(end), (start + end) / 2, start)
    return there, theta + push + mean * slip


def slope(whisker: Whisker, r: Array, theta: Array) -> Array:
    """tan β/r (n,)."""
    inside = np.clip(r, 1e-6 * whisker.length, whisker.length)
    bent = elastica.press(whisker, inside, theta)
    return np.asarray(np.tan(bent.contact_angle - theta) / inside)


def rate_on_wall(whisker: Whisker, r: Array, theta: Array) -> Array:
    """dr/dρ (n,) of contacts with a wall, m per rad: (wall); 0 of contacts that are not held.

    Examples
    --------
    A wall is left behind as the whisker is pushed on, soon at a slower pace:

    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> rate = rate_on_wall(w, np.array([45e-3, 30e-3]), np.array([0.1, 0.4]))
    >>> bool(rate[0] < rate[1] < 0)
    True
    """
    length = float(whisker.length)
    r, theta = np.clip(r, 1e-3 * length, length), np.maximum(theta, 1e-6)
    # On this side of the largest angles and of the tip.
    inwards, less = r * (1 - STEP), theta * (1 - STEP)
    places = np.concatenate([r, inwards, r]), np.concatenate([theta, theta, less])
    here, there, before = np.split(elastica.press(whisker, *places).contact_angle, 3)
    by_r, by_theta = (here - there) / (r - inwards), (here - before) / (theta - less)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (1 - by_theta) / (by_r + by_theta * np.tan(here - theta) / r)
    return np.where(np.isfinite(rate), rate, 0.0)


def tip_contacts(whisker: Whisker) -> tuple[Array, Array, Array]:
    """r, θ_d and β (n,) along the contacts of the tip, from the straight whisker on.

    A wall at the angle β from the whisker at first contact is met by the tip until the whisker is
    bent as much there; by the flank from then on.

    Examples
    --------
    >>> r, theta, beta = tip_contacts(Whisker(50e-3, 100e-6, 5e-6))
    >>> print("%.1f mm, %.2f rad" % (1e3 * np.interp(0.5, beta, r), np.interp(0.5, beta, theta)))
    49.8 mm, 0.05 rad
    """
    r = whisker.length * (1 - np.linspace(0.0, 1.0, NODES)[:-1] ** 2)
    theta = np.nan_to_num(surface_of(whisker).limit(r)) * (1 - INSIDE)
    slipped = elastica.press(whisker, r, theta * (1 + 2 * INSIDE)).outcome
    tip = slipped == Outcome.SLIPPED_OFF_TIP
    tip[0] = False
    r, theta = np.r_[whisker.length, r[tip]], np.r_[0.0, theta[tip]]
    beta = elastica.press(whisker, r, theta).contact_angle - theta
    return r, theta, beta
