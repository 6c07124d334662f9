"""Just noticeable differences (JNDs) of radial distance.

A JND is an sd of distance times the factor of a named *criterion*. There are three routes: Weber
propagation (3.2)–(3.8), noise divided by the slope of the signals; the Fisher information, which
includes the information in the size of the noise; and the posterior, over many noisy readings.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from .._util.refusals import Refusal
from .._util.values import Array, Flags
from ..inference.observer import Observer
from ..mechanics.contact import Outcome

__all__ = ["SD", "convert_jnd", "criterion_factor", "fisher_jnd", "is_linear", "weber_propagation"]

#: The default criterion: the sd of one observation.
SD = "d'=1"
_PATTERN = re.compile(r"^\s*(\d+(?:\.\d+)?)\s*%\s*(2AFC|2IFC|yes/no)\s*$", re.IGNORECASE)
_EXAMPLES = 'write "d\'=1", "75% 2AFC" or "75% yes/no", say'


def criterion_factor(criterion: str = SD) -> float:
    """The JND under a criterion, in sds of one observation.

    Parameters
    ----------
    criterion : str
        ``"d'=1"``: one sd (76.02 % correct in 2AFC). ``"75% 2AFC"`` (any percentage, also 2IFC):
        √2·z, the difference at which two noisy observations are ordered correctly that often.
        ``"75% yes/no"``: z, the difference from a fixed criterion that is reported that often.

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
        raise Refusal(f"The criterion {criterion!r} is unknown", remedy=_EXAMPLES)
    percent = float(match.group(1))
    if not 50 < percent < 100:
        raise Refusal("A criterion lies between 50 and 100 per cent", f"{percent:g}", _EXAMPLES)
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
    """Sd of radial distance by propagation of receptor noise through the signals' slopes, (...), m.

    Equations (3.2) and (3.7): Δr = |dr/dI| ΔI, and √[J⁻¹ΣJ⁻ᵀ]_rr for several signals, with all
    unknowns of the cue estimated together (a signal without noise is held fixed, as in (3.7)). With
    more signals than unknowns, the best linear combination is used. An unknown that the whisker
    does not bound (a stiffness, say) has its prior, which counts as one more signal.

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
        NaN without contact, and for probabilities of events; infinite where the signals do not
        determine distance (the cylinder's force map).

    Raises
    ------
    ValueError
        For contacts of the wrong shape, a signal without noise where it is 0, and more signals
        than unknowns whose noise is perfectly correlated.

    Notes
    -----
    The linear JND has *false zeros* that no posterior has, in either limit of the map cue. With
    noise in the axial force only it falls to zero where ∂M/∂θ_d = 0, and rises again beyond: at
    R = 20 and r/L = 0.3, 0.5, 0.7, 0.9, at θ_d = 46.6°, 33.3°, 20.8°, 8.8° (contact angles of
    84°, 71°, 59°, 47°). With noise in the moment only the zero is where ∂Fx/∂θ_d = 0, at contact
    angles of 100° to 106° and r ≤ 0.5 L, beyond the 90° where the paper stops. `is_linear` checks.

    Events are left out, in a fusion of cues too: an event either occurs or not, which is never
    close to its probability, so a slope does not apply. Information and posterior include events.
    """
    contact = observer.checked(contact)
    covariance = _propagated(observer, contact, model or observer.solver)
    # With perfectly correlated noise the variance can be zero, and negative by rounding.
    return np.sqrt(np.maximum(covariance[..., 0, 0], 0.0))


def is_linear(observer: Observer, contact: ArrayLike) -> Flags:
    """Whether Weber propagation is reliable at a contact, (...).

    The criterion: along each principal axis of the propagated covariance, the mean JND one sd to
    either side is within a factor of two of that at the contact. Propagation is unreliable near
    false zeros, near the tip and the fold for large noise, and where the signals do not determine
    distance.

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
    is_finite = np.asarray(np.isfinite(covariance).all(axis=(-2, -1)))
    further = np.arange(contact.shape[-1]) >= observer.bounded  # these may be 0 or negative
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    unit = np.fmax(_contact_scale(contact), np.where(further & is_finite[..., None], sd, 0.0))
    rescaled = covariance / (unit[..., :, None] * unit[..., None, :])
    rescaled = np.where(is_finite[..., None, None], rescaled, np.eye(unit.shape[-1]))
    size, axes = np.linalg.eigh(rescaled)
    step = np.swapaxes(axes * np.sqrt(np.maximum(size, 0.0))[..., None, :], -1, -2)
    step = np.stack([step, -step], axis=-2) * unit[..., None, None, :]
    least = np.where(further, -np.inf, 1e-3 * np.abs(contact))[..., None, None, :]
    around = np.maximum(contact[..., None, None, :] + step, least)
    at = np.where(is_finite, np.sqrt(np.maximum(covariance[..., 0, 0], 0.0)), 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = weber_propagation(observer, around).mean(axis=-1) / at[..., None]
    return np.asarray(is_finite & ((ratio > 0.5) & (ratio < 2)).all(axis=-1))


def _propagated(observer: Observer, contact: Array, model: str | None) -> Array:
    """Covariance (..., U, U) of the contact to first order in the noise; NaN without contact."""
    size = len(observer.cue.signal_names)
    linear = np.empty(observer.noise.reading_size(size), dtype=bool)
    for noise, _, readings in observer.noise.components(size):
        linear[readings] = not noise.is_categorical
    if not linear.any():
        return np.full((*contact.shape, contact.shape[-1]), np.nan)
    signals, outcome = observer.cue.signals(observer.whisker, contact, model=model)
    in_contact = np.asarray(outcome == Outcome.HELD)
    signals = np.where(in_contact[..., None], signals, 1.0)
    of_cue = observer.cue.jacobian(observer.whisker, contact, model=model)
    slope = (observer.noise.jacobian(signals) @ of_cue)[..., linear, :]
    covariance = observer.noise.covariance(signals)[..., linear, :][..., linear]
    if observer.bounded < contact.shape[-1]:
        slope, covariance = _with_priors(observer, contact, slope, covariance)
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    if np.any((sd == 0) & in_contact[..., None]):
        raise Refusal(
            "A signal without noise leaves no JND",
            f"one in {observer.noise!r} where the signal is 0",
            "give it a floor, such as ww.receptors.GeneralisedWeber(0.1, floor=0.1)",
        )
    unit = _contact_scale(contact)
    # Rescaled by the noise and the contact, so that a small determinant means singular.
    rescaled = slope / sd[..., None] * unit[..., None, :]
    rescaled = np.where(in_contact[..., None, None], rescaled, 0.0)
    correlation = covariance / (sd[..., :, None] * sd[..., None, :])
    if rescaled.shape[-1] == rescaled.shape[-2]:
        inverse = _inverse(rescaled)
        lost = np.isinf(inverse)
        inverse = np.where(lost, 0.0, inverse)
        variance = inverse @ correlation @ np.swapaxes(inverse, -1, -2)
        variance = np.where(lost.any(axis=(-2, -1), keepdims=True), np.inf, variance)
    else:
        if np.any(np.linalg.det(correlation) < 1e-14):
            raise Refusal(
                f"Of {slope.shape[-2]} perfectly correlated signals for {slope.shape[-1]} "
                "unknowns there is no best combination",
                f"{observer.noise!r}",
                "write a correlation between -1 and 1",
            )
        information = np.swapaxes(rescaled, -1, -2) @ np.linalg.inv(correlation) @ rescaled
        variance = _inverse(information)
    in_contact = in_contact[..., None, None]
    return np.where(in_contact, variance * unit[..., :, None] * unit[..., None, :], np.nan)


def fisher_jnd(observer: Observer, contact: ArrayLike) -> Array:
    """Sd of radial distance from the Fisher information of one reading, (...), m.

    The whole matrix is inverted: the cue's other unknowns are estimated too, with their priors
    where the whisker does not bound them. For one signal under Weber's law the result is a factor
    √(1 + 2k²) below (3.5), because the size of the noise is informative too.

    Parameters
    ----------
    observer : Observer
    contact : array, shape (..., U)

    Returns
    -------
    array
        NaN without contact; infinite where the signals do not determine distance.
    """
    contact = observer.checked(contact)
    unit = _contact_scale(contact)
    information = observer.information(contact) + observer.prior_information(contact)
    information = information * unit[..., :, None] * unit[..., None, :]
    is_finite = np.asarray(np.isfinite(information).all(axis=(-2, -1)))
    variance = _inverse(np.where(is_finite[..., None, None], information, 0.0))[..., 0, 0]
    return np.where(is_finite, np.sqrt(variance) * unit[..., 0], np.nan)


def _with_priors(
    observer: Observer, contact: Array, slope: Array, covariance: Array
) -> tuple[Array, Array]:
    """Slopes (..., R + n, U) and covariance of a reading extended by n unknowns with priors."""
    first, size = observer.bounded, slope.shape[-2]
    count = contact.shape[-1] - first
    unit = np.eye(contact.shape[-1])[first:]
    unit = np.broadcast_to(unit, (*slope.shape[:-2], *unit.shape))
    precision = np.diagonal(observer.prior_information(contact), axis1=-2, axis2=-1)[..., first:]
    both = np.zeros((*contact.shape[:-1], size + count, size + count))
    both[..., :size, :size] = covariance
    both[..., np.arange(size, size + count), np.arange(size, size + count)] = 1 / precision
    return np.concatenate([slope, unit], axis=-2), both


def _contact_scale(contact: Array) -> Array:
    """Units of the contact in which its matrices are of order one."""
    return np.maximum(np.abs(contact), 1e-12)


def _inverse(matrix: Array) -> Array:
    """Inverses (..., n, n); all infinite where the rescaled determinant is 1e-9 or less."""
    row_lengths = _length(matrix, -1)
    column_lengths = _length(matrix / row_lengths, -2)
    rescaled = matrix / row_lengths / column_lengths
    singular = np.abs(np.linalg.det(rescaled)) <= 1e-9
    safe = np.where(singular[..., None, None], np.eye(matrix.shape[-1]), rescaled)
    inverse = np.linalg.inv(safe)
    inverse = inverse / np.swapaxes(row_lengths, -1, -2) / np.swapaxes(column_lengths, -1, -2)
    return np.where(singular[..., None, None], np.inf, inverse)


def _length(matrix: Array, axis: int) -> Array:
    """Lengths of rows (axis −1) or columns (−2); 1 where they are zero."""
    length = np.sqrt(np.square(matrix).sum(axis=axis, keepdims=True))
    return np.where(length > 0, length, 1.0)
