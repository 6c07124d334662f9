"""Radial distances in millimetres as stimuli: what `simulate` and `fit` feel through a whisker."""

from __future__ import annotations

import weberwhisk as ww

from ..behaviour import CuePercept
from .options import the_cue, the_whisker


def distance_percept(
    shape: tuple[str | None, float | None, float | None, float | None, float | None],
    cue: str | None,
    angles_deg: list[str] | None,
) -> tuple[CuePercept | None, ww.Whisker | None]:
    """The percept and the whisker that the options describe; None where they name no whisker."""
    if all(value is None for value in shape):
        if cue is not None or angles_deg:
            given = "--cue" if cue is not None else "--deflection-angle-deg"
            raise ValueError(
                f"{given} needs a whisker to feel with, got none; write --identity C2, say."
            )
        return None, None
    whisker = the_whisker(*shape, None)
    felt, angles = the_cue(cue, angles_deg)
    if angles.size > 1:
        raise ValueError(
            f"Choices are made at one deflection angle, got {angles.size} values of "
            "--deflection-angle-deg; give one."
        )
    observer = ww.Observer(whisker, felt, ww.receptors.Weber(1.0))
    return CuePercept(observer, angles[0] if angles.size else None, unit=1e-3), whisker
