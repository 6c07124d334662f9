"""What the property tests draw: whiskers, contacts and noise all over their domain."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

import weberwhisk as ww


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of a range, its ends included."""
    return st.floats(low, high, allow_nan=False, allow_infinity=False, allow_subnormal=False)


def logarithmic(low: float, high: float) -> st.SearchStrategy[float]:
    """Positive numbers, every decade alike."""
    return floats(np.log(low), np.log(high)).map(lambda x: float(np.clip(np.exp(x), low, high)))


#: A factor that changes no digit: scaled scenes must then agree to the last bit.
POWERS = st.integers(-20, 4).map(lambda n: 2.0**n)  # whiskers to 16 m: longer ones are refused

#: Tip over base radius: perfect cones, needles, whiskers, near-cylinders, cylinders.
TIPS = st.one_of(st.just(0.0), st.just(1.0), floats(0.0, 1.0), logarithmic(1e-6, 0.1))


@st.composite
def whiskers(draw: st.DrawFn, curved: bool = False) -> ww.Whisker:
    """Whiskers from hairs to fishing rods; if `curved`, up to half a radian of turn."""
    length = draw(logarithmic(1e-4, 1.0))
    base = length * draw(logarithmic(1e-4, 5e-2))
    turn = draw(floats(-0.5, 0.5)) if curved else 0.0
    modulus = draw(logarithmic(1e6, 1e12))
    return ww.Whisker(length, base, base * draw(TIPS), modulus, turn / length)


#: Fractions of the length, the two ends and what lies just beyond the tip included.
FRACTIONS = st.lists(
    st.one_of(floats(1e-3, 1.05), logarithmic(1e-9, 1.0), st.sampled_from([1.0, 1 - 1e-15])),
    min_size=1,
    max_size=8,
).map(np.array)
#: Deflection angles, rad.
ANGLES = st.lists(
    st.one_of(
        logarithmic(1e-12, 3.1),
        logarithmic(1e-12, 3.1).map(lambda a: -a),
        st.just(0.0),
        floats(0.1, 3.1),
    ),
    min_size=1,
    max_size=8,
).map(np.array)


def scaled(w: ww.Whisker, size: float = 1.0, stiffness: float = 1.0) -> ww.Whisker:
    """The whisker in another unit of length, or of another material."""
    return ww.Whisker(
        w.length * size,
        w.base_radius * size,
        w.tip_radius * size,
        w.youngs_modulus * stiffness,
        w.curvature / size,
        w.density,
    )
