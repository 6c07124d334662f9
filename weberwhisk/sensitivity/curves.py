"""JND curves by every route, over distances and over numbers of touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, overload

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal
from .._util.values import Array, Shown, pd, with_units
from ..inference import Observer
from ..inference.coordinates import UNITS
from ..inference.touches import shared_unknowns, touches
from ..mechanics import elastica, flick_past, press
from ..mechanics.contact import Outcome
from ..receptors import Seed
from ..whisker import Whisker
from .jnd import SD, criterion_factor, fisher_jnd, is_linear, weber_propagation

__all__ = [
    "JNDCurve", "jnd_curve", "linear_surface", "touches_jnd", "up_to_the_fold",
]  # fmt: skip

#: Columns of a `JNDCurve` that are JNDs, m.
_JNDS = ("closed_form", "propagation", "fisher", "posterior", "posterior_error", "estimator",
         "estimator_error")  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class JNDCurve(Shown):
    """JNDs of radial distance by every route, one row per contact; from `jnd_curve`.

    Attributes
    ----------
    observer : Observer
    table : DataFrame
        Indexed by ``radial_distance_mm`` and, where the cue needs it, ``deflection_angle_deg``.
        Columns: ``criterion``, ``closed_form_mm`` (small angles), ``propagation_mm`` (the
        observer's model), ``fisher_mm``, ``posterior_mm`` (mean sd of the posteriors) and
        ``estimator_mm`` (sd of the posterior means; NaN where all readings are the same event),
        both with Monte Carlo errors, ``posterior_error_mm`` and ``estimator_error_mm``;
        ``unreliable`` (share of posteriors whose status is not `CONVERGED`), ``linear`` (whether
        the first two routes are reliable, see `is_linear`) and ``outcome`` (in words). JNDs are
        NaN without contact.

    Notes
    -----
    ``curve["posterior"]`` is a column in SI units, by its name without the unit; the contact's
    unknowns are columns too.
    """

    _figure: ClassVar[str] = "jnd_lines"
    observer: Observer
    _frame: pd.DataFrame  # in SI units, by the names of the unknowns

    @classmethod
    def joined(cls, curves: Sequence[JNDCurve]) -> JNDCurve:
        """One curve with the contacts of several curves of one observer."""
        frame = pd.concat([curve._frame for curve in curves], ignore_index=True)
        return cls(curves[0].observer, frame)

    @cached_property
    def table(self) -> pd.DataFrame:
        """JNDs in mm, with the contact as index."""
        converted = with_units(self._frame, _JNDS, units=UNITS)
        index = ["radial_distance_mm", "deflection_angle_deg"]
        return converted.set_index([name for name in index if name in converted])

    @overload
    def __getitem__(self, columns: str) -> pd.Series[float]: ...
    @overload
    def __getitem__(self, columns: list[str]) -> pd.DataFrame: ...
    def __getitem__(self, columns: str | list[str]) -> pd.Series[float] | pd.DataFrame:
        return self._frame[columns]

    def __len__(self) -> int:
        return len(self._frame)

    def _line(self) -> str:
        in_contact = self._frame[self._frame["posterior"].notna()]
        if in_contact.empty:
            return f"{len(self)} contacts, none of them held"
        mm = 1e3 * in_contact[["radial_distance", "posterior"]]
        at = [mm.iloc[int(k)] for k in (mm["posterior"].argmin(), mm["posterior"].argmax())]
        ends = (f"{p['posterior']:.3g} mm (at {p['radial_distance']:.3g} mm)" for p in at)
        bad = int((in_contact["unreliable"] > 0).sum())
        line = f"JND {' to '.join(ends)}, {self['criterion'].iloc[0]}, by posteriors; "
        line += f"{len(in_contact)} of {len(self)} contacts held"
        line += f", {bad} with posteriors to check" if bad else ""
        return f"{line}; {self.observer.note}" if self.observer.note else line

    def lines(self) -> dict[str, pd.DataFrame]:
        """Tables for a chart, by deflection angle: `table`, and points of the lines between."""
        criterion, contacts = str(self["criterion"].iloc[0]), self.table.reset_index()
        factor = criterion_factor(criterion)
        r = np.linspace(0.005, 0.999, 200) * self.observer.forward.length
        angles: list[float | None] = [None]
        if "deflection_angle" in self._frame:
            angles = list(dict.fromkeys(self["deflection_angle"]))
            if len(angles) > len(self) / 2 > 1:  # too few contacts at each angle for lines
                return {"": contacts}
        tables = {}
        for at in angles:
            columns = [r] if at is None else [r, np.full_like(r, at)]
            contact = self.observer.at_middle(np.stack(columns, axis=-1))
            routes = {
                "closed_form": weber_propagation(self.observer, contact, model="closed_form"),
                "propagation": weber_propagation(self.observer, contact),
            }
            line = pd.DataFrame(
                {"radial_distance_mm": 1e3 * r, "criterion": criterion}
                | {f"{name}_mm": 1e3 * factor * jnd for name, jnd in routes.items()}
                | {"posterior_mm": np.nan, "posterior_error_mm": np.nan}
            )
            mine = slice(None) if at is None else (self["deflection_angle"] == at).to_numpy()
            both = pd.concat([line, contacts.loc[mine, list(line.columns)]])
            label = "" if at is None else f"{np.degrees(at):.4g}°"
            tables[label] = both.dropna(subset=["propagation_mm", "posterior_mm"], how="all")
        return tables


def jnd_curve(
    observer: Observer, radial_distance: ArrayLike, deflection_angle: ArrayLike | None = None, *,
    method: str = "quadrature", criterion: str = SD, n_readings: int = 200, seed: Seed = 1,
) -> JNDCurve:  # fmt: skip
    """The JND of radial distance by every route, one row per contact.

    Parameters
    ----------
    observer : Observer
    radial_distance : float or array
        m.
    deflection_angle : float or array, optional
        rad; needed by cues with an unknown angle, and broadcast with the distance. Further unknowns
        have the medians of their priors.
    method : {"quadrature", "emcee", "laplace"}
        How posteriors are computed; see `posterior`.
    criterion : str
        See `criterion_factor`.
    n_readings : int
        Noisy readings for each contact, two or more.
    seed : int, SeedSequence or Generator
        Of the readings and, for emcee, of the walkers.

    Returns
    -------
    JNDCurve
        Its ``table`` is in mm; ``plot()`` draws it.

    Raises
    ------
    ValueError
        For input that is not finite or positive, an unknown criterion or method, a missing or
        superfluous deflection angle, and fewer than two readings.

    Notes
    -----
    Quadrature has an error of at most 1e-2 of the posterior's sd (1e-6 with one unknown), mostly a
    few thousandths. The mean over readings has a far larger Monte Carlo error, about 1e-2 of the
    JND for 200 readings.

    Examples
    --------
    >>> from weberwhisk import Observer, Whisker, cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> curve = jnd_curve(observer, [10e-3, 40e-3], n_readings=100, seed=1)
    >>> curve.table[["closed_form_mm", "fisher_mm"]].round(3)
                        closed_form_mm  fisher_mm
    radial_distance_mm
    10.0                          0.81      0.802
    40.0                          0.96      0.951
    """
    from ..inference import Status, posterior

    checks.one_of("method", method, ("quadrature", "emcee", "laplace"))
    criterion_factor(criterion)
    n_readings = checks.whole("n_readings", n_readings, "write 200, say", least=2)
    contact = _contact(observer, radial_distance, deflection_angle)
    signals, outcome = observer.signals(contact)
    in_contact = outcome == Outcome.HELD
    table = pd.DataFrame(dict(zip(observer.unknowns, contact.T, strict=True)))
    table["criterion"] = criterion
    for name, jnd in (
        ("closed_form", weber_propagation(observer, contact, model="closed_form")),
        ("propagation", weber_propagation(observer, contact)),
        ("fisher", fisher_jnd(observer, contact)),
    ):
        table[name] = np.where(in_contact, jnd, np.nan)
    table[[*_JNDS[3:], "unreliable"]] = np.nan
    if in_contact.any():
        entropy = None if seed is None else int(checks.generator(seed).integers(2**63))
        reading_seed, walker_seed = np.random.SeedSequence(entropy).spawn(2)
        repeated = np.repeat(signals[in_contact], n_readings, axis=0)
        readings = observer.noise.sample(repeated, reading_seed)
        result = posterior(observer, readings, method=method, seed=walker_seed)
        sd, mean, status = (
            np.reshape(v, (-1, n_readings)) for v in (result.sd, result.mean, result.status)
        )
        # Identical readings, such as those of one event, say nothing about the scatter.
        of_contacts = readings.reshape(-1, n_readings, readings.shape[-1])
        identical = np.ptp(of_contacts, axis=1).max(axis=-1) == 0
        scatter = np.where(identical, np.nan, mean.std(axis=1, ddof=1))
        for name, values in (
            ("posterior", sd.mean(axis=1)),
            ("posterior_error", sd.std(axis=1, ddof=1) / np.sqrt(n_readings)),
            ("estimator", scatter),
            ("estimator_error", scatter / np.sqrt(2 * (n_readings - 1))),
            ("unreliable", (status != Status.CONVERGED).mean(axis=1)),
        ):
            table.loc[in_contact, name] = values
    table[list(_JNDS)] *= criterion_factor(criterion)
    table["linear"] = is_linear(observer, contact)
    table["outcome"] = [Outcome(int(o)).message for o in outcome]
    return JNDCurve(observer, table)


def _contact(
    observer: Observer, radial_distance: ArrayLike, deflection_angle: ArrayLike | None
) -> Array:
    r = checks.distance("radial_distance", radial_distance, "give metres, such as 30e-3")
    if "deflection_angle" not in observer.unknowns:
        if deflection_angle is not None:
            raise Refusal(
                f"{observer.cue!r} has no unknown deflection angle", "one", "leave it out"
            )
        return observer.at_middle(r.reshape(-1, 1))
    if deflection_angle is None:
        raise Refusal(
            f"{observer.cue!r} needs the deflection angle of each contact",
            "none",
            "write deflection_angle=np.radians(10), say",
        )
    theta = checks.angle("deflection_angle", deflection_angle, "give radians, such as 0.2")
    if np.any(theta <= 0):
        raise Refusal(
            "A contact deflects the whisker by more than 0",
            f"deflection_angle={np.min(theta):g}",
            "write np.radians(5), say",
        )
    return observer.at_middle(np.stack([a.ravel() for a in np.broadcast_arrays(r, theta)], axis=-1))


# -- surfaces --------------------------------------------------------------------------------------


def linear_surface(observer: Observer, points: int = 90) -> pd.DataFrame:
    """The linear JND of moment and axial force at every contact up to flick-past (figure 4b).

    Parameters
    ----------
    observer : Observer
        Of a `ForceMap` with Weber noise.
    points : int
        Number of distances, and of angles at each distance.

    Returns
    -------
    DataFrame
        For `plots.jnd_surface`. If only one signal is noisy there is ``signed_jnd_mm``: to first
        order an error of that signal changes r in proportion to the *other* signal's slope in θ_d,
        so the signed JND is zero where that slope is, a false zero that no posterior has.
    """
    # Slopes vary fast close to the limit, so angles are denser there.
    share = np.sin(0.5 * np.pi * np.linspace(0.002, 0.998, points))
    contact, alpha = up_to_the_fold(observer.whisker, np.linspace(0.02, 0.99, points), share)
    columns = {
        "radial_distance": contact[..., 0], "deflection_angle": contact[..., 1],
        "jnd": weber_propagation(observer, contact), "contact_angle": alpha,
    }  # fmt: skip
    moment, force = observer.noise.weber_fractions(2)
    if min(moment, force) < 1e-6 * max(moment, force):
        slopes = elastica.signal_jacobian(observer.whisker, *np.moveaxis(contact, -1, 0))[..., 1]
        columns["signed_jnd"] = columns["jnd"] * np.sign(slopes[..., int(moment > force)])
    table = pd.DataFrame({name: np.ravel(column) for name, column in columns.items()})
    angles = ["deflection_angle", "contact_angle"]
    return with_units(table, [name for name in columns if name not in angles], angles)


def up_to_the_fold(whisker: Whisker, places: Array, shares: Array) -> tuple[Array, Array]:
    """Contacts (P, S, 2) at `places` (r/L) and shares of the largest deflection; contact angles."""
    r = places * whisker.length
    limit = np.asarray(flick_past(whisker, r).deflection_angle)
    contact = np.stack(np.broadcast_arrays(r[:, None], limit[:, None] * shares), axis=-1)
    return contact, press(whisker, contact[..., 0], contact[..., 1]).contact_angle


def _fisher_of_all(observer: Observer, contact: Array) -> float:
    """Sd of the distance from the Fisher information of one reading per contact (n, U), m.

    Information about shared unknowns adds over touches; each touch's own unknowns are eliminated.
    """
    unit = np.maximum(np.abs(contact), 1e-12)
    unit[:] = unit.max(axis=0)
    once = observer.prior_information(contact[:1])[0] * unit[0] * unit[0, :, None]
    each = observer.information(contact) * unit[:, None] * unit[..., None]
    shared = ("radial_distance", *shared_unknowns(observer))
    one = np.isin(observer.unknowns, shared)
    each[:, ~one[:, None] & ~one] += once[~one[:, None] & ~one]
    across = each[:, one][..., ~one]
    projection = np.linalg.solve(each[:, ~one][..., ~one], np.swapaxes(across, -1, -2))
    total = (each[:, one][..., one] - across @ projection).sum(axis=0) + once[one][:, one]
    return float(np.sqrt(np.linalg.inv(total)[0, 0]) * unit[0, 0])


def touches_jnd(
    observer: Observer, radial_distance: float, deflection_angles: ArrayLike,
    counts: ArrayLike = (1, 2, 5, 10, 20, 50), *, n_readings: int = 100, seed: Seed = 1,
) -> pd.DataFrame:  # fmt: skip
    """The JND of a distance against the number of touches, compared with 1/√n.

    Parameters
    ----------
    observer : Observer
        Further unknowns have the medians of their priors.
    radial_distance : float
        m.
    deflection_angles : float or array
        rad; successive touches go through these angles repeatedly.
    counts : array of int
        Numbers of touches.
    n_readings : int
        Simulated sets of touches for each number.
    seed : int, SeedSequence or Generator

    Returns
    -------
    pandas.DataFrame
        One row per number: ``count``, ``posterior_mm`` (mean sd of posteriors), its Monte Carlo
        error ``posterior_error_mm``, ``fisher_mm`` (information summed over touches, with other
        shared unknowns estimated too) and ``root_n_mm`` (the first touch's Fisher JND over √n).

    Raises
    ------
    ValueError
        For no angles, counts below 1, fewer than two readings, and contacts that cannot be held.

    Notes
    -----
    Mice discriminate pole positions about 1 mm apart with one whisker and 1 to 17 touches (Pammer
    et al. 2013, J Neurosci 33:6726).
    """
    radial_distance = checks.positive_number("radial_distance", radial_distance, "give metres")
    angles = np.atleast_1d(checks.finite("deflection_angles", deflection_angles, "give radians"))
    if not angles.size:
        raise Refusal("deflection_angles must be one or more", "none", "give radians")
    numbers = [checks.whole("counts", n, "give numbers of touches") for n in np.ravel(counts)]
    n_readings = checks.whole("n_readings", n_readings, "write 100, say", least=2)
    rng = np.random.default_rng(seed)
    place = [observer.prior[n].ppf(0.5) for n in observer.unknowns[observer.bounded :]]
    records = []
    for n in numbers:
        theta = np.resize(angles, n)
        contact = np.stack([np.full(n, radial_distance), theta], axis=-1)[:, : observer.bounded]
        contact = np.column_stack([contact, np.tile(place, (n, 1))])
        jnd = np.atleast_1d(fisher_jnd(observer, contact))
        sds = [touches(observer, observer.read(contact, rng)).sd for _ in range(n_readings)]
        error = np.std(sds, ddof=1) / np.sqrt(n_readings)
        fisher = _fisher_of_all(observer, contact)
        records.append((n, np.mean(sds), error, fisher, jnd[0] / np.sqrt(n)))
    lengths = ["posterior", "posterior_error", "fisher", "root_n"]
    return with_units(pd.DataFrame(records, columns=["count", *lengths]), lengths)
