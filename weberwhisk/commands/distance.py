"""Radial distances in millimetres as stimuli: what `simulate` and `fit` feel through a whisker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import weberwhisk as ww

from .. import _checks
from ..behaviour import CueEncoding
from ..receptors import GeneralisedWeber, LogNormal, NearMiss, ReceptorNoise, Saturating, Weber
from .options import SCENES, Shape, Texts, one_angle, the_scene, the_whisker

_Model = Callable[[float, NDArray[np.float64]], ReceptorNoise]
#: Receptors of a number and the signals at half the length. Their own Weber fraction, 0.1, is the
#: scale of the one that is fitted.
RECEPTORS: dict[str, _Model] = {
    "near-miss": lambda number, typical: NearMiss(0.1, exponent=number, reference=typical),
    "floor": lambda number, typical: GeneralisedWeber(0.1, floor=number * typical),
    "ceiling": lambda number, typical: GeneralisedWeber(0.1, floor=0.0, ceiling=number * typical),
    "saturating": lambda number, typical: Saturating(0.1, ceiling=number * typical),
}
PLAIN: dict[str, ReceptorNoise] = {"weber": Weber(1.0), "log-normal": LogNormal(0.1)}


def distance_encoding(
    shape: Shape,
    cue: str | None,
    angles_deg: Texts,
    receptors: str | None = None,
    *,
    fitted: bool = True,
) -> tuple[CueEncoding | None, ww.Whisker | None]:
    """The encoding and the whisker that the options describe; None where they name no whisker.

    With `fitted` the answers must tell of a Weber fraction.
    """
    if not shape.given:
        options = (("--cue", cue), ("--deflection-angle-deg", angles_deg))
        for name, given in (*options, ("--receptors", receptors)):
            if given:
                raise ValueError(
                    f"{name} needs a whisker to feel with, got none; write --identity C2, say."
                )
        return None, None
    whisker = the_whisker(shape)
    observer, angles = the_scene(cue, angles_deg, None, whisker)
    if observer.noise.is_categorical:
        raise ValueError(
            f"The cue {cue} reports events, all or none, which leave no two noisy signals to "
            "compare; write --cue compliance, say."
        )
    angle = one_angle(angles)
    if cue not in SCENES:
        noise = _receptors(receptors or "weber", observer, angle)
        observer = replace(observer, noise=noise)
    elif receptors:
        raise ValueError(
            f"The cue {cue} has receptors of its own, got --receptors {receptors}; leave it out, "
            "or write --cue force-map."
        )
    encoding = CueEncoding(observer, angle, unit=1e-3)
    if fitted and not encoding.has_weber_fraction:
        raise ValueError(
            f"The noise of the cue {cue} is that of angles, a constant: there is no Weber fraction "
            "to find; write --cue compliance, say."
        )
    return encoding, whisker


def _receptors(text: str, observer: ww.Observer, angle: float | None) -> ReceptorNoise:
    """The noise of forces that `--receptors` names."""
    name, _, given = text.partition("=")
    _checks.one_of("--receptors", name, (*PLAIN, *RECEPTORS))
    if (name in PLAIN) == bool(given):
        raise ValueError(
            f"--receptors {name} takes {'no' if given else 'a'} number, got {text!r}; write "
            f"{name if given else f'{name}=0.5'}, say."
        )
    if name in PLAIN:
        return PLAIN[name]
    number = float(_checks.positive("--receptors", given, f"write {name}=0.5, say"))
    contact: list[Any] = [0.5 * observer.whisker.length]
    if "deflection_angle" in observer.unknowns:
        contact.append(angle)
    typical = np.abs(observer.signals(contact)[0])
    if not np.isfinite(typical).all():
        raise ValueError(
            "--receptors are told in units of the signals at half the length, and there the "
            "contact is not held; give a smaller --deflection-angle-deg."
        )
    return RECEPTORS[name](number, typical)
