"""JNDs over Weber fractions and contacts: `jnd_curve` as a sweep on one core, all or a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import campaign
from ._checks import finite, positive
from ._deprecated import renamed_arguments
from .cues import Compliance, ForceMap
from .jnd import SD, criterion_factor
from .jnd_curves import jnd_curve
from .observer import Observer
from .receptors import Weber
from .whisker import Whisker

if TYPE_CHECKING:
    import pandas as pd


@renamed_arguments(draws="n_readings")
def jnd_sweep(
    whisker: Whisker,
    weber_fraction: ArrayLike,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike | None = None,
    *,
    method: str = "quadrature",
    criterion: str = SD,
    n_readings: int = 200,
    seed: int | np.random.SeedSequence,
    workers: int = 1,
    scheduler: str | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> pd.DataFrame:
    """The JND of every combination of Weber fraction, deflection angle and distance.

    With angles that is figure 4b's surface, by full posteriors: 30 distances × 30 angles × 100
    readings take some 8 s of one core. Its columns ``propagation_mm`` and ``linear`` say what the
    paper's linear surface is there, and where that is not to be believed.

    Parameters
    ----------
    whisker : Whisker
        One, not an array of them.
    weber_fraction : array_like
    radial_distance : array_like
        m.
    deflection_angle : array_like, optional
        rad. Given, distance is felt by the map of moment and axial force (§2f), else by a light
        tap (§2e).
    method, criterion, n_readings
        As for `jnd_curve`.
    seed, workers, scheduler, out, progress
        As for `campaign.run`.

    Returns
    -------
    pandas.DataFrame
        ``weber_fraction``, and in mm and degrees, as their names say, the columns of `JNDCurve`.

    Examples
    --------
    >>> table = jnd_sweep(Whisker(50e-3, 100e-6, 5e-6), [0.05, 0.1], [10e-3, 40e-3],
    ...                   n_readings=20, seed=1)
    >>> table[["weber_fraction", "radial_distance_mm", "closed_form_mm"]].round(3)
       weber_fraction  radial_distance_mm  closed_form_mm
    0            0.05                10.0           0.405
    1            0.05                40.0           0.480
    2            0.10                10.0           0.810
    3            0.10                40.0           0.960
    """
    if not isinstance(whisker, Whisker):
        raise ValueError(f"A sweep needs a Whisker, got {whisker!r}; write Whisker.from_identity.")
    fields = {name: getattr(whisker, name) for name in whisker.__dataclass_fields__}
    if any(np.ndim(value) for value in fields.values()):
        raise ValueError(f"A sweep has one whisker, got {whisker!r}; give its fields as numbers.")
    criterion_factor(criterion)
    k = positive("weber_fraction", weber_fraction, "write 0.1, say").ravel()
    r = positive("radial_distance", radial_distance, "give metres, such as 30e-3").ravel()
    angles: list[float | None] = [None]
    if deflection_angle is not None:
        angles = [*finite("deflection_angle", deflection_angle, "give radians").ravel().tolist()]
    how = {"method": method, "criterion": criterion, "n_readings": n_readings}
    chunks: list[dict[str, Any]] = [
        {
            "whisker": fields,
            "weber_fraction": fraction,
            "radial_distance": r.tolist(),
            "deflection_angle": angle,
            **how,
        }
        for fraction in k.tolist()
        for angle in angles
    ]
    return campaign.run(
        jnd_rows,
        chunks,
        seed=seed,
        workers=workers,
        scheduler=scheduler,
        out=out,
        title="JNDs",
        progress=progress,
    )


def jnd_rows(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """The part of the sweep with one Weber fraction and deflection angle."""
    angle = chunk["deflection_angle"]
    observer = Observer(
        Whisker(**chunk["whisker"]),
        Compliance() if angle is None else ForceMap(),
        Weber(chunk["weber_fraction"]),
    )
    how = {name: chunk[name] for name in ("method", "criterion", "n_readings")}
    curve = jnd_curve(observer, chunk["radial_distance"], angle, seed=seed, **how)
    table = curve.table.reset_index()
    table.insert(0, "weber_fraction", chunk["weber_fraction"])
    return table
