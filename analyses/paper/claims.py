"""The paper's claims (`claims.toml`), and what we find of each, in computed numbers."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gallery.along_whisk import limits
from gallery.array_maps import array_by_count, array_resolution
from gallery.lateral_slip import LateralSlip
from gallery.surveys import NONE, WHISKER, K
from paper import remade
from paper.remade import CONE

from weberwhisk import (
    ArrayObserver,
    Observer,
    Whisker,
    WhiskerArray,
    bend,
    flick_past,
    posterior,
    press,
)
from weberwhisk.cues import (
    AngleSideAngle,
    BalanceOfMoments,
    ComparativeLength,
    Compliance,
    ForceMap,
    MuscleCurve,
    Vibration,
    VibrissaLength,
)
from weberwhisk.mechanics import closed_form, signal_jacobian
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import weber_propagation
from weberwhisk.sweeping import cylinder, follow, sweep

Array = np.ndarray
L = float(WHISKER.length)
CYLINDER = WHISKER.cylinder()
BALANCE = BalanceOfMoments(remade.IMPACT)
SHARES = np.linspace(0.05, 0.95, 19)


def _compliance_jnd(whisker: Whisker, share: Array) -> Array:
    observer = Observer(whisker, Compliance(), Weber(K))
    return weber_propagation(observer, share[:, None] * L) / (K * L)


def _map_jnd(share: float | Array, theta: float | Array, k_moment: float, k_force: float) -> Array:
    observer = Observer(WHISKER, ForceMap(), Weber([k_moment, k_force]))
    contact = np.stack(np.broadcast_arrays(np.asarray(share) * L, theta), axis=-1)
    return weber_propagation(observer, contact) / (K * L)


def _off(found: Array, expected: Array) -> str:
    return f"{float(np.max(np.abs(found / expected - 1))):.1e}"


def length() -> str:
    said = []
    for event, name in (([1, 1], "tip"), ([1, 0], "shaft")):
        p = posterior(Observer(WHISKER, VibrissaLength(spread=0.05)), event)
        said.append(f"of the {name} {p.mean / L:.2f} ± {p.sd / L:.2f} L")
    return f"of a length known to 5 %, a touch {', '.join(said)}"


def two_lengths() -> str:
    sure: Any = {"spread": 1e-6, "base_sd": 1e-9, "angle_sd": 1e-9, "position_sd": 0.0}
    cue = ComparativeLength([1.2 * L], [[0.0, 1e-5]], **sure, orientation_sd=0.0)
    low, high, _ = cue.interval(WHISKER, [0, 1])
    behind = ComparativeLength([1.2 * L], [[-0.4 * L, 0.0]], **sure, orientation_sd=0.0)
    near, far, _ = behind.interval(WHISKER, [1, 0])
    return (
        f"touched by one of 1.2 L alone it lies {low / L:.2f} to {high / L:.2f} L away; with a "
        "base 0.4 L further back the shorter one can touch alone, from "
        f"{near / L:.2f} to {far / L:.2f} L"
    )


def _array(rows: str = "CDE") -> ArrayObserver:
    array = WhiskerArray("rat", "right").protract(np.radians(40))
    return ArrayObserver(array.only([name for name in array.identities if name[0] in rows]))


def more_whiskers() -> str:
    counts = (1, 4, 20)
    told = array_by_count(_array(), 20e-3, np.linspace(-8e-3, 8e-3, 5), counts, subsets=60, seed=1)
    right = ", ".join(f"{share:.0%}" for share in told["correct"])
    return f"widths that differ by 3 mm, by {', '.join(map(str, counts))} whiskers: {right} correct"


def over_the_array() -> str:
    table = array_resolution(_array(), np.array([10e-3, 20e-3, 30e-3]), np.array([0.0, 5e-3]))
    first, last = table["error_mm"].min(), table["error_mm"].max()
    return (
        f"sd of a pole's place, by rows C to E together, at six places 10 to 30 mm to the side: "
        f"{first:.2f} to {last:.2f} mm"
    )


def triangle() -> str:
    cue, r = AngleSideAngle(0.2 * L), np.array([0.2, 0.4, 0.8]) * L
    contact = np.stack([r, np.full(3, np.pi / 2)], axis=-1)
    back, _ = cue.radial_distance(WHISKER, cue.signals(WHISKER, contact)[0])
    jnds = weber_propagation(Observer(WHISKER, cue), contact) / L
    rows = ", ".join(f"{v:.3f} L at {s / L:.1f} L" for v, s in zip(jnds, r, strict=True))
    return (
        f"inverted to {_off(back, r)}; with angles felt to 1° and a side of 0.2 L the JND is {rows}"
    )


def out_of_the_plane() -> str:
    tilts = np.radians([20.0, 40.0, 60.0])
    slips = weber_propagation(
        Observer(WHISKER, LateralSlip()),  # k = 0.1 of both components of the moment
        np.stack([np.full(3, 0.5 * L), tilts], axis=-1),
    )
    ratio = slips / (K * L) / _compliance_jnd(WHISKER, np.array([0.5]))
    rows = ", ".join(f"{v:.2f} at {d:.0f}°" for v, d in zip(ratio, np.degrees(tilts), strict=True))
    return f"two moments tell distance and tilt; JND over that of a tap in the plane: {rows}"


def lever() -> str:
    bent = press(WHISKER, np.array([0.3, 0.9]) * L, np.radians([[1.0], [10.0]]))
    off = bent.moment / bent.transverse_force / bent.radial_distance - 1
    return (
        f"M/Fy is the distance to {off[0].max():.1%} at 1°, and to {off[1, 0]:.1%} at 0.3 L and "
        f"{off[1, 1]:.0%} at 0.9 L at 10°; with Fx too it is exact, of a cylinder as well"
    )


def followed() -> str:
    push, body = np.radians(np.linspace(2, 40, 20)), cylinder(0.6 * L, -20e-3, 20e-3)
    first = sweep(WHISKER, body, np.radians([-1.0, 30.0])).first_contact
    bent = sweep(WHISKER, body, np.concatenate([[first - 0.01], first + push])).bending
    r, track = bent.radial_distance[1:], follow(WHISKER, push, bent.moment[1:])
    off = np.max(np.abs(track.radial_distance - r)[1:]) / L
    return (
        f"along a cylinder of 20 mm the contact slides from {r[0] / L:.2f} to {r[-1] / L:.2f} L in "
        f"40°, and is followed on the tapered whisker to {off:.0e} L"
    )


def smaller_signals() -> str:
    shares = np.array([0.3, 0.5, 0.7, 0.9])
    taper, other = (press(w, shares * L, np.radians(1.0)) for w in (WHISKER, CYLINDER))
    rows = [
        ", ".join(f"{v:.2f}" for v in getattr(taper, name) / getattr(other, name))
        for name in ("moment", "axial_force")
    ]
    return f"taper over cylinder at 0.3, 0.5, 0.7, 0.9 L: {rows[0]} in M, {rows[1]} in Fx"


def limits_of_the_jnd() -> str:
    table = limits(WHISKER, np.array([0.1, 0.5, 0.9]) * L, push=np.radians(5))
    weber, floor = table["weber_mm"] / (K * L) / 1e3, table["threshold_mm"] / (K * L) / 1e3
    return (
        f"JND/(kL) at 0.9 L is {weber[2]:.3f}, and {floor[2]:.3f} with a threshold of 0.03 µN m; "
        f"at 0.1 L a torque of 4 µN m stops the push at {table['deflection_angle_deg'][0]:.1f}° of "
        "5°"
    )


def equation_2_1() -> str:
    c, theta, r = CONE.compliance_constant, 0.02, SHARES * L
    moment = closed_form.moment(CONE, r, theta)
    back = c * theta * L / (c * theta + moment * L)
    return f"inverts (2.3) to {_off(back, r)}; with A = L/(1 − 1/R) for L it holds of any taper"


def equation_2_3() -> str:
    beam = press(CONE, SHARES * L, 1e-6).moment
    formula = CONE.compliance_constant * 1e-6 * (1 / (SHARES * L) - 1 / L)
    return f"the exact beam's limit at small angle to {_off(beam, formula)}; C is 3EI₀"


def monotonic() -> str:
    r = np.linspace(0.01, 0.999, 500)[:, None] * L
    rises = [np.sum(np.diff(Compliance().signals(w, r)[0][:, 0]) >= 0) for w in (CONE, WHISKER)]
    return f"dM/dθ falls with distance, with {int(sum(rises))} rises in 998 steps"


def forces_at_90() -> str:
    arc = np.array([0.3, 0.5, 0.7, 0.9]) * L
    taper, cylinder = (
        remade.loaded(w, arc, np.array(np.pi / 2)).force for w in remade.WHISKERS.values()
    )
    ratio = ", ".join(f"{v:.3f}" for v in taper / cylinder)
    return f"the taper's force over the cylinder's at 90°, 0.3, 0.5, 0.7 and 0.9 L: {ratio}"


def one_to_one() -> str:
    signs = set(np.sign(remade.map_jacobian(WHISKER)).ravel())
    crossed = remade.crossings(remade.map_boundary(WHISKER, 120))
    return (
        f"signs of the map's Jacobian over all contacts to 90°: {len(signs)}; crossings of the "
        f"image of its edge: {crossed}; so no two contacts share their signals"
    )


def parabola() -> str:
    bent = press(CYLINDER, np.linspace(0.05, 0.5, 30)[:, None] * L, np.linspace(0.01, 1.6, 40))
    ratio = bent.moment**2 / (2 * CYLINDER.stiffness * bent.axial_force)
    return f"M² = 2EI·Fx at every load, to {_off(ratio, np.ones_like(ratio))}"


def muscle() -> str:
    theta = np.linspace(np.radians(30), np.radians(150), 2001)
    peak = float(MuscleCurve.PRINTED.moment(theta).max())
    at = float(np.degrees(theta[np.argmax(MuscleCurve.PRINTED.moment(theta))]))
    return f"peaks at {peak:.3f} at {at:.0f}° (w = 1.25); scaled to a peak of 1 here"


def flick_past_at() -> str:
    end = remade.curve_end(MuscleCurve.NORMALISED)
    return f"from an impact at 60° the balance ends at {end:.3f} L"


def two_of_four() -> str:
    _, outcome = BALANCE.signals(WHISKER, np.array(remade.SHOWN)[:, None] * L)
    held = int(np.sum(outcome == 0))
    return f"at 0.3, 0.5, 0.7, 0.9 L: {held} balance, {len(outcome) - held} flick past"


def balance_monotonic() -> str:
    b = BALANCE.signals(WHISKER, np.linspace(0.3, 0.69, 100)[:, None] * L)[0][:, 0]
    low, high = np.degrees(b[[0, -1]])
    falls = int(np.sum(np.diff(b) <= 0))
    return f"from {low:.1f}° at 0.3 L to {high:.1f}° at 0.69 L, with {falls} falls in 99 steps"


def white_areas() -> str:
    grid = remade.surface(
        MuscleCurve.NORMALISED, remade.DISTANCES[::10], remade.IMPACTS[::10]
    ).query("outcome != 'HELD'")
    share, angle = remade.dashed_line()
    below = grid["impact_angle_deg"] <= np.interp(grid["radial_distance"], share, angle) + 1e-9
    wrong = int((below == (grid["outcome"] == "END_OF_WHISKING")).sum())
    return f"{wrong} of {len(grid)} contacts without balance lie on the wrong side of the line"


def equation_3_3() -> str:
    r = SHARES * L
    slope = Compliance(angular_velocity=2.0).jacobian(CONE, r[:, None])[:, 0, 0]
    return f"to {_off(slope, -CONE.compliance_constant * 2.0 / r**2)}"


def equation_3_5() -> str:
    found = _compliance_jnd(CONE, SHARES)
    return f"Weber propagation gives it to {_off(found, SHARES * (1 - SHARES))}"


def equation_3_6() -> str:
    return f"to {_off(_compliance_jnd(CYLINDER, SHARES), SHARES)}"


def figure_4a() -> str:
    share = np.linspace(1e-4, 0.9999, 401)
    cone, taper = _compliance_jnd(CONE, share), _compliance_jnd(WHISKER, share)
    return (
        f"the cone's JND is largest, {cone.max():.3f} kL, at {share[np.argmax(cone)]:.2f} L and "
        f"{cone[-1]:.1e} kL at the tip; a whisker of R = 20 keeps {taper[-1]:.3f} kL there"
    )


def figure_4b() -> str:
    at = {f"{s:g}": _map_jnd(s, np.radians([1.0, 10.0]), K, NONE) for s in (0.3, 0.5, 0.7, 0.9)}
    rows = ", ".join(f"{s} L: {a:.3f} → {b:.3f}" for s, (a, b) in at.items())
    return f"JND/(kL) from 1° to 10°: {rows}"


def similar() -> str:
    parts = []
    for share in (0.3, 0.5, 0.7, 0.9):
        peak = flick_past(WHISKER, share * L).at_moment_peak
        theta = float(peak.deflection_angle)
        moment, axial = (_map_jnd(share, theta, *k) for k in ((K, NONE), (NONE, K)))
        parts.append(
            f"{share:g} L: θ_d = {np.degrees(theta):.1f}° (α = "
            f"{np.degrees(peak.contact_angle):.0f}°), {float(axial):.0e} against "
            f"{float(moment):.2f}"
        )
    return f"alike up to where the moment peaks, and there JND/(kL) is {'; '.join(parts)}"


def reason() -> str:
    theta = np.radians([1.0, 30.0])
    slope = np.abs(np.linalg.inv(signal_jacobian(WHISKER, 0.5 * L, theta)[..., :2, :])[:, 0, 0])
    slope = slope * WHISKER.moment_scale / L
    moment = press(WHISKER, 0.5 * L, theta).normalised_moment
    return (
        f"at 0.5 L from 1° to 30° |∂r/∂M| falls from {slope[0]:.2f} to {slope[1]:.2f} while M "
        f"grows from {moment[0]:.3f} to {moment[1]:.2f}; their product falls, "
        f"{slope[0] * moment[0]:.2f} to {slope[1] * moment[1]:.2f}"
    )


def compliance_size() -> str:
    theta, r = 1e-4, 0.5 * L
    ratio = press(CYLINDER, r, theta).moment / press(WHISKER, r, theta).moment
    return f"at 0.5 L the taper's compliance is {float(ratio):.2f} times the cylinder's"


def small_angle() -> str:
    off = []
    for share in (0.7, 0.9):
        bent = bend(WHISKER, share * L, np.geomspace(1e-8, 1e-3, 20001))
        i = int(np.nanargmin(np.abs(bent.deflection_angle - np.radians(10))))
        small = closed_form.moment(WHISKER, bent.radial_distance[i], bent.deflection_angle[i])
        off.append(f"{float(small / bent.moment[i] - 1):.0%} at s = {share:g} L")
    return f"at θ_d = 10° the small-angle moment is too large by {' and '.join(off)}"


def signatures() -> str:
    share, alone = np.linspace(0.05, 0.98, 300), []
    for phase in (False, True):
        observer = Observer(WHISKER, Vibration(3, phase=phase))
        signals = observer.signals(share[:, None] * L)[0]
        alike = np.abs(signals[:, None] - signals) < 2 * np.sqrt(2) * observer.noise.sd(signals)
        far = np.abs(share[:, None] - share) > 0.1
        alone.append(1 - (alike.all(axis=-1) & far).any(axis=1).mean())
    return (
        "impacts whose ratios of three modes, within 2 sd, are those of no impact 0.1 L away: "
        f"{alone[0]:.0%} by amplitudes, {alone[1]:.0%} with phase"
    )


def along_a_whisk() -> str:
    parts = []
    for radius in (6e-3, 20e-3):
        rotation = np.radians([-2.0, *np.linspace(2, 46, 12)])
        bent = sweep(WHISKER, cylinder(0.6 * L, -radius, radius), rotation).bending
        jnd = _map_jnd(bent.radial_distance[1:] / L, bent.deflection_angle[1:], K, NONE)
        top = int(np.nanargmax(jnd))
        parts.append(
            f"{1e3 * radius:g} mm: {jnd[0]:.3f} kL, at most {jnd[top]:.3f} at "
            f"{np.degrees(rotation[1 + top]):.0f}°, {jnd[-1]:.3f} at 46°"
        )
    return f"on cylinders met at 0.6 L, rotated 2° to 46°; radius {'; radius '.join(parts)}"


def equation_3_1() -> str:
    one, ten = Weber(K).sd([1.0, 10.0])
    return f"sd of receptors at I = 1 and 10: {one:.3g} and {ten:.3g}"


# -- together --------------------------------------------------------------------------------------


class Claim(NamedTuple):
    """A sentence or equation of the paper.

    `found` is the function above that says, with numbers, what becomes of it; `test` the file and
    function that shows it over the paper's domain; `limit` says where the sentence ends.
    """

    where: str
    says: str
    found: str
    test: str
    limit: str = ""


_TOML = tomllib.loads(Path(__file__).with_name("claims.toml").read_text("utf-8"))
CLAIMS = tuple(Claim(**claim) for claim in _TOML["claim"])
#: The paper's figures in its order, with what each shows.
PANELS: dict[str, str] = _TOML["panels"]


def found_of(claim: Claim) -> str:
    """What is found of one claim, computed now."""
    return str(globals()[claim.found]())


def rows() -> Iterator[dict[str, str]]:
    """Every claim with what is found of it, computed now."""
    for claim in CLAIMS:
        yield {
            "where": claim.where,
            "claim": claim.says,
            "found": found_of(claim),
            "limit": claim.limit,
            "test": claim.test,
        }


def as_markdown(rows: list[dict[str, str]]) -> str:
    """The claims beside what is found, with the figures."""
    lines = [
        "# Radial distance and Weber's law, remade",
        "",
        "Solomon JH, Hartmann MJZ (2011) *Phil. Trans. R. Soc. B* 366:3049, "
        "doi:10.1098/rstb.2011.0166. Numbers are computed by `python analyses/paper/make.py`; "
        "values called the paper's are those of its text. A whisker of 50 mm, radius ratio 20, and "
        "k = 0.1 unless said otherwise; lengths over L.",
    ]
    for name, words in PANELS.items():
        lines += ["", f"**Figure {words}**", "", f"![{words}]({name}.png)"]
    lines += [
        "",
        "| where | the paper says | we find | where the sentence ends | shown by |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [row["where"], row["claim"], row["found"], row["limit"] or "–", f"`{row['test']}`"]
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines) + "\n"
