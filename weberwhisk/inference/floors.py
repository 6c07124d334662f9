"""Floors of receptor noise where a signal changes sign: the default noise of an observer."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import receptors
from .._util.checks import positive
from .._util.refusals import Refusal, named
from .._util.values import Array
from ..cues.protocol import Cue
from ..mechanics.contact import Outcome
from ..receptors import GeneralisedWeber, Joint, ReceptorNoise
from ..whisker import Whisker
from .coordinates import ContactCoordinates

__all__ = ["check_noise", "default_noise", "usual_contacts"]

#: Signals of one sign at every contact; `axial_force` too without curvature and friction.
ONE_SIGN = ("moment", "moment_rate", "angular_velocity", "effort")


def default_noise(
    whisker: Whisker, cue: Cue, weber_fraction: ArrayLike | None = None
) -> ReceptorNoise:
    """The noise of an observer that is given none: the cue's own, with a floor where it needs one.

    Weber's law is of magnitudes. Of a signal that changes sign within the whisker's reach, or of a
    force that turns round, it would leave contacts without noise, so that signal has a floor: 1 %
    of its median size in the reach. Such are the axial force of a whisker that is touched on its
    concave side or rubs towards its tip, the transverse force of heavy contacts, components of
    forces in space, and torsion.

    Parameters
    ----------
    whisker : Whisker or Profile
    cue : Cue
    weber_fraction : float or sequence of float, optional
        k of the signals whose noise has one, or one for each signal; by default the cue's own.

    Raises
    ------
    ValueError
        For Weber fractions that are not positive, or neither one nor one for each signal.

    Examples
    --------
    >>> from weberwhisk import cues
    >>> for curvature in (0.0, -12.0):
    ...     w = Whisker(50e-3, 100e-6, 5e-6, curvature=curvature)
    ...     print(default_noise(w, cues.ForceMap(), 0.05))
    Weber(0.05)
    GeneralisedWeber(0.05, floor=[0, 7.6e-07])
    """
    noise, size = cue.default_noise(), len(cue.signal_names)
    if weber_fraction is not None:
        if np.size(weber_fraction) not in (1, size):
            raise Refusal(
                named("weber_fraction") + f" must be one number, or one for each of {size} signals "
                f"({', '.join(cue.signal_names)})",
                np.size(weber_fraction),
                "write 0.1, say",
            )
        k = positive("weber_fraction", weber_fraction, "write 0.1, say")
        noise = noise.with_weber_fraction(k)
    floored = with_floors(noise, lacking_floors(noise, whisker, cue))
    assert floored is not None  # a cue's own noise has a Weber fraction or a floor
    return floored


def usual_contacts(space: ContactCoordinates, others: int = 5) -> Array:
    """Coordinates (N, U) from one end of the reach to the other, and so many of each nuisance."""
    return space.spread(np.r_[1e-3, np.arange(0.1, 0.95, 0.1), 1 - 1e-3], others=others)


@lru_cache(maxsize=256)
def _floors(whisker: Whisker, cue: Cue) -> Array:
    """Floor of each signal that changes sign in the reach, or vanishes, (S,), 0 of the others."""
    floors = np.zeros(len(cue.signal_names))
    space = ContactCoordinates(whisker, cue, cue.priors(whisker))
    usual, tails = usual_contacts(space), usual_contacts(space, others=3)
    tails[:, space.bounded :] *= 2.4  # as far out as posteriors go over nuisance parameters
    with np.errstate(all="ignore"):
        signals, outcome = cue.signals(whisker, space.constrain(np.concatenate([usual, tails]))[0])
    in_contact = outcome == Outcome.HELD
    if in_contact[: len(usual)].any():
        size = np.median(np.abs(signals[: len(usual)][in_contact[: len(usual)]]), axis=0)
        least, most = signals[in_contact].min(axis=0), signals[in_contact].max(axis=0)
        changes = (least < -1e-6 * size) & (most > 1e-6 * size)
        if cue.forward(whisker, np.ones(len(cue.unknowns))).azimuth is not None:
            # It turns round beside the push, and may vanish there.
            changes |= np.char.startswith(cue.signal_names, "transverse_force")
        # 1 % to two digits, so that a refusal names the very floor that is the default.
        floors[changes] = [float(f"{0.01 * s:.2g}") for s in size[changes]]
    floors.flags.writeable = False  # kept
    return floors


def lacking_floors(noise: ReceptorNoise, whisker: Whisker, cue: Cue) -> Array:
    """The floor of each signal (S,) that changes sign where this noise vanishes; else 0."""
    plain = cue.forward(whisker, np.ones(len(cue.unknowns))).is_plain
    one_sign = (*ONE_SIGN, "axial_force") if plain else ONE_SIGN
    lacks = np.array([name.rstrip("_0123456789") not in one_sign for name in cue.signal_names])
    for component, signals, _ in noise.components(len(lacks)):
        if component.is_categorical or not component.reads_signals:
            lacks[signals] = False
        elif lacks[signals].any():
            lacks[signals] &= component.sd(np.zeros(lacks[signals].size)) == 0
    if not lacks.any():  # before signals are worked out
        return np.zeros(len(lacks))
    return np.where(lacks, _floors(whisker, cue), 0.0)


def with_floors(noise: ReceptorNoise, floors: Array) -> ReceptorNoise | None:
    """Noise with further floors (S,); None where a law has neither a floor nor Weber's place."""
    laws, sizes = [], []
    for component in noise.components(len(floors)):
        law = _floored(component.noise, floors[component.signals])
        if law is None:
            return None
        laws.append(law)
        sizes.append(component.signals.stop - component.signals.start)
    return Joint(laws, sizes) if len(laws) > 1 else laws[0]


def _floored(noise: Any, floors: Array) -> ReceptorNoise | None:
    """The law with further floors if it can have any, else Weber's with its Weber fraction."""
    if not floors.any():
        return noise
    if "floor" in (field.name for field in fields(noise)):
        return replace(noise, floor=np.where(floors > 0, floors, noise.floor))
    if not hasattr(noise, "weber_fraction"):
        return None
    rho = getattr(noise, "correlation", 0.0)
    return GeneralisedWeber(noise.weber_fraction, floor=floors, correlation=rho)


def check_noise(noise: ReceptorNoise, whisker: Whisker, cue: Cue, is_flat: bool) -> None:
    """Refuse noise that is not of the cue's signals, or that lacks a floor where it needs one."""
    usual = cue.default_noise()
    if noise.is_categorical != usual.is_categorical:
        raise Refusal(
            f"The signals of {cue!r} are not what this noise reports",
            f"{noise!r}",
            f"leave noise out for {usual!r}",
        )
    size = len(cue.signal_names)
    count = noise.reading_size(size)
    try:
        shape = np.shape(noise.sd(np.ones(size)))
    except ValueError:  # as many values as some other cue has signals
        shape = ()
    if shape != (count,):
        raise Refusal(
            f"The noise is not of {size} signals ({', '.join(cue.signal_names)})",
            f"{noise!r}",
            "give one value, or one for each signal",
        )
    twists = [name.split("_")[0] == "torsion" for name in cue.signal_names]
    exact = any(twists) and not np.all(noise.sd(np.where(twists, 0.0, 1.0)))
    if exact and is_flat:
        raise Refusal(
            "A straight whisker has no torsion, which this noise would tell exactly",
            f"{noise!r}",
            "leave torsion out, or give its noise a floor",
        )
    floors = lacking_floors(noise, whisker, cue)
    if floors.any():
        names = " and ".join(np.array(cue.signal_names)[floors > 0])
        floored = with_floors(noise, floors)
        ours = "|".join(receptors.__all__)
        line = re.sub(rf"\b(?=(?:{ours})\()", "ww.receptors.", repr(floored)).replace("inf", "None")
        sds = ", ".join(f"{floor:.3g}" for floor in floors)
        law = f"give its law a field `floor`, the sd at no signal in SI units, of [{sds}]"
        raise Refusal(
            f"The sign or the direction of {names} changes within this whisker's reach, where "
            "this noise would be zero",
            f"{noise!r}",
            law if floored is None else f"write {line}",
        )
