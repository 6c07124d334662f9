"""Which readings the columns of a table are: of which cue, with which errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from .. import _checks
from ..cues import Compliance, Cue, ForceMap, UnknownStiffness
from ..cues.force_map import SIGNALS
from ..cues.protocol import Felt
from ..cues.unknowns import Friction
from ..mechanics import Profile, Spiral, rest_angle
from ..mechanics.contact import Outcome
from ..observer import Observer
from ..receptors import GeneralisedWeber, Joint, ReceptorNoise, Weber
from ..whisker import YOUNGS_MODULUS, Whisker
from .columns import NAMES, Array, likely_prefix, sides_of
from .signals import AT_REST, COMMON, CORRELATION


def is_curved(whisker: Any) -> bool:
    """Whether a Whisker or Profile is curved anywhere."""
    return any(np.any(value) for value in vars(Profile.of(whisker).law).values())


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredAngle(Cue):
    """A map of forces, and the deflection angle as video shows it, with an error of its own.

    The angle is that from the base tangent, on curved whiskers too, whose unknown deflection angle
    is counted from the first touch.

    Parameters
    ----------
    cue : Cue
        Of a distance and an unknown deflection angle.

    Examples
    --------
    >>> cue = MeasuredAngle(ForceMap(["moment"]))
    >>> cue.signal_names, cue.unknowns
    (('moment', 'measured_angle'), ('radial_distance', 'deflection_angle'))
    """

    cue: Cue
    takes_curved = True

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The cue's, and the angle."""
        return (*self.cue.signal_names, "measured_angle")

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Those of the cue."""
        return self.cue.unknowns

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Felt:
        """The cue's signals and the angle, (..., S), and the outcome."""
        _checks.refuse_hinge(whisker, "MeasuredAngle")
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.cue.signals(whisker, contact, model=model)
        angle, held = contact[..., 1].copy(), outcome == Outcome.HELD
        if is_curved(whisker) and held.any():
            angle[held] += rest_angle(whisker, contact[held, 0])
        return np.concatenate([signals, angle[..., None]], axis=-1), outcome

    def default_noise(self) -> ReceptorNoise:
        """Weber's law with k = 0.1, and a degree of the angle."""
        angle = GeneralisedWeber(0.0, floor=float(np.radians(1.0)))
        return Joint([Weber(0.1), angle], [len(self.cue.signal_names), 1])


def turn_round(si: dict[str, Array], sides: list[tuple[Any, Any]], notes: list[str]) -> None:
    """Give axial force, transverse force and angle the signs of this package, in place.

    Of all conventions that a table may have, the one in which its rows are likest to contacts of
    the whisker: where the whisker is curved, axial forces and angles may be of either sign.
    """
    order = ("moment", "deflection_angle", "transverse_force", "axial_force")
    names = [n for n in order if n in si]
    free = names[1:]  # the first says the side
    if not free:
        return
    signs = np.array(list(product([1.0, -1.0], repeat=len(free))))
    cost = np.zeros(len(signs))
    for rows, whisker in sides:
        y = np.stack([si[n][rows] for n in names], axis=-1)
        y = y[np.isfinite(y).all(axis=1) & (y != 0).all(axis=1)]
        y = y[:: 1 + len(y) // 60]
        observer = Observer(whisker, ForceMap())
        contact = observer.contact(observer.space.spread(np.linspace(0.02, 0.98, 25)))[0]
        signals, outcome = MeasuredAngle(ForceMap(SIGNALS)).signals(observer.whisker, contact)
        known = dict(zip((*SIGNALS, "deflection_angle"), signals[outcome == Outcome.HELD].T,
                         strict=True))  # fmt: skip
        model = np.stack([known[n] for n in names], axis=-1)
        softer = np.exp(np.linspace(-1.0, 1.0, 9))[:, None]
        scale = np.where(np.array(names) == "deflection_angle", 1.0, softer)
        model = (scale[:, None] * model).reshape(-1, len(names))
        size = 0.02 * (y[:, None] ** 2 + model**2) + 1e-300
        for i, sign in enumerate(signs):
            off = (y[:, None] * np.append(1.0, sign) - model) ** 2 / size
            cost[i] += np.minimum(off.sum(axis=2).min(axis=1), 30.0).sum()
    best = int(cost.argmin())
    # As the package has it, unless another is clearly likelier.
    for name, sign in zip(free, signs[best] if cost[best] < cost[0] - 6 else [], strict=False):
        if sign < 0:
            si[name] = -si[name]
            notes.append(f"The {name.replace('_', ' ')} has the opposite sign: turned round.")


def signals_of(
    si: dict[str, Array], cue: Cue | None, whisker: Any, known: bool | None, notes: list[str],
    header: list[str],
) -> tuple[Cue, Array, Array | None]:  # fmt: skip
    """The cue, the readings (n, S) and the covariances of their errors, if the table has any."""
    forces = [name for name in SIGNALS if name in si]
    if cue is None:
        if "moment_rate" in si and "angular_velocity" in si and len(forces) < 2:
            cue = Compliance()
        elif "deflection_angle" in si and forces:
            cue = MeasuredAngle(ForceMap(forces))
        elif len(forces) > 1:
            cue = ForceMap(forces)
        else:
            raise ValueError(
                f"No distance follows from the columns {_checks.listed(header, 8)}, of which "
                f"{', '.join(si) or 'none'} is known: needed are two of {', '.join(SIGNALS)}, or "
                "deflection_angle and one of them, or moment_rate and angular_velocity; map them "
                'with columns={"moment": "M"}, or on the command line with --column moment=M.'
            )
        plain: Whisker = getattr(whisker, "whisker", whisker)
        if known is None:
            known = plain.youngs_modulus != YOUNGS_MODULUS
        if not known:
            cue = UnknownStiffness(cue)
            notes.append(
                "Young's modulus is the default, and so taken as unknown: 3.34 GPa with an sd of "
                "ln 0.42; if it was measured, write known_stiffness=True or, on the command line, "
                "--youngs-modulus-gpa."
            )
    names = {"measured_angle": "deflection_angle"}
    wanted = [names.get(name, name) for name in cue.signal_names]
    missing = [name for name in wanted if name not in si]
    if missing:
        if not set(missing) <= set(NAMES):
            raise ValueError(f"A table has no signals of {cue!r}; leave cue out.")
        raise ValueError(
            f"The cue {cue!r} needs {', '.join(missing)}, which the table has no column of; map "
            f'one with columns={{"{missing[0]}": …}}.'
        )
    y = np.stack([si[name] for name in wanted], axis=-1)
    scale = np.ones(len(y))
    if wanted == ["moment_rate"] and "angular_velocity" in si:
        with np.errstate(divide="ignore", invalid="ignore"):
            inner: Any = cue.cue if isinstance(cue, UnknownStiffness) else cue
            scale = getattr(inner, "angular_velocity", 1.0) / si["angular_velocity"]
            y = y * scale[:, None]
        notes.append("The moment's rate was divided by the angular velocity, row by row.")
    sds = [f"{name}_sd" for name in wanted]
    present = [name for name in sds if name in si]
    if present and len(present) < len(sds):
        raise ValueError(
            f"There is a measurement error in {', '.join(present)}, but none in "
            f"{', '.join(n for n in sds if n not in present)}; give all or none."
        )
    if not present:
        return cue, y, None
    sd = np.abs(np.stack([si[name] for name in sds], axis=-1) * scale[:, None])
    y = np.where(np.all(sd > 0, axis=1, keepdims=True), y, np.nan)
    alike = np.broadcast_to(np.eye(len(sds)), (len(y), len(sds), len(sds))).copy()
    if CORRELATION in si and wanted == ["moment", "transverse_force"]:
        alike[:, 0, 1] = alike[:, 1, 0] = si[CORRELATION]
    return cue, y, sd[:, :, None] * sd[:, None] * alike


def check_magnitudes(observer: Observer, y: Array, found: Mapping[str, Any]) -> None:
    """Refuse columns whose middle value is far from what the whisker gives."""
    for name, usual, column in zip(
        observer.cue.signal_names, observer.usual_reading, np.abs(y).T, strict=True
    ):
        known = column[np.isfinite(column) & (column > 0)]
        if not known.size or not np.isfinite(usual) or name == "measured_angle":
            continue
        times = float(np.median(known)) / usual
        if 1e-5 < times < 30:
            continue
        unit = {"moment": "N m", "moment_rate": "N m/s"}.get(name, "N")
        # In space, the component that the plane's was made of.
        part = {"moment": "moment_y", "axial_force": "force_x"}.get(name, "force_y")
        name = part if part in found else name
        header, factor, _ = found.get(name, (name, 1.0, False))
        unit = likely_prefix(2 * times, factor) + unit
        raise ValueError(
            f"{header!r} is {'far above' if times > 1 else 'far below'} what this whisker gives, "
            f"{times:.2g} times the usual {name.replace('_', ' ')}: did you pass {unit}? Write "
            f'units={{"{name}": "{unit}"}}, say.'
        )
    measured = [i for i, n in enumerate(observer.cue.signal_names) if n == "measured_angle"]
    angle = np.abs(y[:, measured])
    angle = angle[np.isfinite(angle)]
    if angle.size and np.median(angle) > np.pi:
        raise ValueError(
            "The deflection angle is above half a turn in most rows: did you pass degrees? Write "
            'units={"deflection_angle": "deg"}.'
        )


def from_shape(
    raw: pd.DataFrame, si: dict[str, Array], whisker: Any, cue: Cue | None, touch: Any,
    notes: list[str],
) -> tuple[Profile, Cue, dict[str, Array], Array]:  # fmt: skip
    """Whisker, cue, signals and sides of a table of `tracked_signals`, for `locate`."""
    profile = Profile.of(whisker)
    common = [*AT_REST, "friction_angle_deg"]
    missing = [n for n in (*common, "contact", "misfit", CORRELATION, COMMON) if n not in raw]
    missing += [n for n in ("moment", "transverse_force") if n not in si]
    if missing:
        raise ValueError(
            f"A table of tracked shapes has no {', '.join(missing)}; keep the columns that "
            "tracked_signals wrote, or drop signals_from to locate its forces alone."
        )
    numbers = raw[common].apply(pd.to_numeric).drop_duplicates()
    if len(numbers) > 1:
        raise ValueError(
            f"These rows are of several sessions, got {len(numbers)} shapes at rest or angles of "
            "friction; locate each alone."
        )
    *rest, friction = (float(v) for v in numbers.iloc[0])
    side = sides_of(si["moment"], si.get("moment_sd"), touch)
    free = ~raw["contact"].astype(str).str.lower().isin(("true", "1", "1.0")).to_numpy()
    out = {name: np.where(free, 0.0, v * (1 if name.endswith("_sd") else side))
           for name, v in si.items()}  # fmt: skip
    out |= {name: np.where(free, 1.0, v) for name, v in out.items() if name.endswith("_sd")}
    out[CORRELATION] = np.where(free, 0.0, raw[CORRELATION].to_numpy(dtype=float))
    if cue is None:
        cue = ForceMap(["moment", "transverse_force"])
        cue = cue if friction == 0 else Friction(cue, float(np.radians(friction)))
    notes.append(
        "Signals are of tracked shapes: the whisker's stiffness drops out of the distance, and its "
        f"curvature at rest is {rest[0]:.3g} /m at the base and rises by {rest[1]:.3g} /m²."
    )
    return profile.curved(Spiral(*rest)), cue, out, side


def touches_of(
    raw: pd.DataFrame, touch: str | Sequence[Any], notes: list[str]
) -> NDArray[np.object_]:
    """The touch of each row, None where it is in none."""
    if isinstance(touch, str):
        if touch not in raw.columns:
            raise ValueError(
                f"The table has no column {touch!r} of touches; it has "
                f"{_checks.listed(map(str, raw.columns), 8)}."
            )
        values = raw[touch].to_list()
    else:
        values = _checks.several("touch", touch, "write the name of a column")
        if len(values) != len(raw):
            raise ValueError(
                f"touch must have a value for each of {len(raw)} rows, got {len(values)}; leave "
                "those in no touch None."
            )
    out = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):
        empty = value is None or value is False or pd.isna(value) or value == 0
        out[i] = None if empty or str(value).strip().lower() in ("", "0", "false") else value
    if any(str(value).strip().lower() == "true" for value in out):
        raise ValueError(
            "touch is True where there is a touch, and does not say which: all would be one. "
            "Number them, in order of time by (t & ~t.shift(fill_value=False)).cumsum().where(t)."
        )
    first = [i for i in range(len(out)) if i == 0 or out[i] != out[i - 1]]
    starts = pd.Series([out[i] for i in first], dtype=object).dropna()
    again = starts[starts.duplicated()].unique()
    if len(again):
        notes.append(
            f"{len(again)} of {starts.nunique()} touches, such as {again[0]!r}, have rows in "
            "several places of the table: one touch each. If numbers begin anew in each trial or "
            "whisker, number touches throughout."
        )
    return out
