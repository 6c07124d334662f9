"""A whisker that whisks against a pole, as a tracker sees it: what tests and sample data are of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from weberwhisk import Outcome, Whisker, press
from weberwhisk.mechanics import Profile, rest_angle
from weberwhisk.mechanics.shape import bent_shape
from weberwhisk.recordings.measures import segment
from weberwhisk.recordings.trackers import tidy


def simulate_tracking(
    whisker: Whisker | Profile,
    radial_distances: ArrayLike,
    *,
    frames: int = 200,
    frame_rate: float = 500.0,
    whisking_hz: float = 10.0,
    amplitude: float = 0.5,
    deflection: float = 0.2,
    friction_angle: float = 0.0,
    pixels_per_mm: float = 20.0,
    noise_px: float = 0.3,
    noise_length_px: float = 0.0,
    spacing_px: float = 1.0,
    missing: float = 0.02,
    seed: int | np.random.Generator = 0,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A whisker that whisks against a pole, as a tracker sees it, and the truth beside it.

    Parameters
    ----------
    whisker : Whisker or Profile
        Its curvature is that of rest, and its sign the side that is touched: positive, convex.
    radial_distances : array
        Of the pole, m: one for each whisk, over and over. It is moved while the whisker is back.
    frames, frame_rate
        How many frames, and frames a second.
    whisking_hz, amplitude : float
        The base turns by `amplitude`, rad, and back, (1 − cos)/2 of the phase.
    deflection : float
        By how much of it, rad, the whisker is pressed beyond where it first touches.
    friction_angle : float
        As of `press`.
    pixels_per_mm : float
    noise_px : float
        Standard deviation of each coordinate of each point, pixels.
    noise_length_px : float
        Length along the whisker over which noise is alike; 0: each point has its own.
    spacing_px : float
        Between points.
    missing : float
        Share of the frames in which the tracker found nothing.
    seed : int or Generator

    Returns
    -------
    tracking : DataFrame
        As of `read_tracking`, with `pixels_per_mm` and `frame_rate` in its ``attrs``.
    truth : DataFrame
        A row a frame: `frame`, `time_s`, `whisk` from 1, `contact`, and where there is one
        `radial_distance_mm`, `arc_length_mm`, `deflection_angle_deg` from the base tangent,
        `moment_uNm`, `axial_force_uN`, `transverse_force_uN`; `pole_x` and `pole_y`, pixels.

    Raises
    ------
    ValueError
        For a whisker that flicks past the pole.

    Notes
    -----
    Contacts are those of the planar beam, `press`: slow against the whisker's vibrations. The
    shape is integrated from the contact to the base by SciPy's DOP853.

    Examples
    --------
    >>> w = Whisker.from_identity("C2", curved=True)
    >>> tracking, truth = simulate_tracking(w, [15e-3, 20e-3], frames=50, seed=1)
    >>> len(tracking), int(truth["contact"].sum())
    (50, 21)
    """
    profile, places = Profile.of(whisker), np.atleast_1d(radial_distances)
    rng = np.random.default_rng(seed)
    time = np.arange(frames) / frame_rate
    whisk = np.floor(time * whisking_hz + 1e-9).astype(int)
    turned = amplitude * (1 - np.cos(2 * np.pi * whisking_hz * time)) / 2
    r = places[whisk % len(places)]
    # The base turns towards −y, so that the pole pushes the whisker to +y.
    bearing = rest_angle(profile, r) - (amplitude - deflection)
    theta = bearing + turned
    contact = turned > amplitude - deflection
    bent = press(profile, r[contact], theta[contact], friction_angle)
    outcome = np.asarray(bent.outcome)
    lost = np.flatnonzero(outcome != Outcome.HELD)
    if lost.size:
        raise ValueError(
            f"The whisker does not stay on a pole at {1e3 * r[contact][lost[0]]:g} mm: "
            f"{Outcome(int(outcome[lost[0]])).message}; lower deflection or the distance."
        )
    scale = 1e3 * pixels_per_mm
    arc = np.arange(0, float(profile.whisker.length), spacing_px / scale)
    rest = np.array([profile.law.turn(arc), *profile.law.point(arc)])
    rows, at = [], iter(zip(bent.arc_length, bent.force, strict=True))
    kept = rng.random(frames) >= missing
    blur = np.exp(-spacing_px / noise_length_px) if noise_length_px > 0 else 0.0
    for i in range(frames):
        shape = bent_shape(profile, arc, *next(at), friction_angle) if contact[i] else rest
        turn = np.exp(-1j * turned[i])
        points = scale * turn * (shape[1] + 1j * shape[2])
        noise = rng.standard_normal((2, 1 + len(arc)))
        start, noise = blur * noise[:, :1], np.sqrt(1 - blur**2) * noise[:, 1:]
        noise = lfilter([1.0], [1.0, -blur], noise, axis=1, zi=start)[0]
        if kept[i]:
            x, y = np.array([points.real, points.imag]) + noise_px * noise
            rows.append({"frame": i, "whisker": 0, **segment(x, y)})
    pole = scale * r * np.exp(1j * bearing)
    truth = pd.DataFrame({
        "frame": np.arange(frames), "time_s": time, "whisk": whisk + 1, "contact": contact,
        "tracked": kept, "pole_x": pole.real, "pole_y": pole.imag,
    })  # fmt: skip
    for name, values in (
        ("radial_distance_mm", 1e3 * bent.radial_distance),
        ("arc_length_mm", 1e3 * bent.arc_length),
        ("deflection_angle_deg", np.degrees(bent.deflection_angle)),
        ("moment_uNm", 1e6 * bent.moment), ("axial_force_uN", 1e6 * bent.axial_force),
        ("transverse_force_uN", 1e6 * bent.transverse_force),
    ):  # fmt: skip
        truth[name] = np.nan
        truth.loc[contact, name] = values
    tracking = tidy(pd.DataFrame(rows), Path("simulated"))
    tracking.attrs = {"pixels_per_mm": pixels_per_mm, "frame_rate": frame_rate}
    return tracking, truth
