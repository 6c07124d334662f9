"""The paper's equations and claims: what we find, the test that shows it, where a sentence ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import paper
from ..cues import Compliance, ForceMap, Vibration
from ..jnd import weber_propagation
from ..mechanics import (
    bend,
    closed_form,
    cylinder,
    flick_past,
    press,
    signal_jacobian,
    sweep,
)
from ..mechanics.muscle import MuscleCurve, moment_balance
from ..observer import Observer
from ..receptors import Weber
from ..surveys import NONE, WHISKER, K
from ..whisker import Whisker
from . import CONE

Array = NDArray[np.float64]

L = float(WHISKER.length)
CYLINDER = WHISKER.cylinder()
SHARES = np.linspace(0.05, 0.95, 19)


class Claim(NamedTuple):
    """A sentence or equation of the paper.

    `found` says, with numbers computed when it is called, what becomes of it; `test` is the file
    and function that shows it over the paper's domain; `limit` says where the sentence ends.
    """

    where: str
    says: str
    found: Callable[[], str]
    test: str
    limit: str = ""


def _compliance_jnd(whisker: Whisker, share: Array) -> Array:
    observer = Observer(whisker, Compliance(), Weber(K))
    return weber_propagation(observer, share[:, None] * L) / (K * L)


def _map_jnd(share: float | Array, theta: float | Array, k_moment: float, k_force: float) -> Array:
    observer = Observer(WHISKER, ForceMap(), Weber([k_moment, k_force]))
    contact = np.stack(np.broadcast_arrays(np.asarray(share) * L, theta), axis=-1)
    return weber_propagation(observer, contact) / (K * L)


def _off(found: Array, expected: Array) -> str:
    return f"{float(np.max(np.abs(found / expected - 1))):.1e}"


def _equation_2_1() -> str:
    c, theta, r = CONE.compliance_constant, 0.02, SHARES * L
    moment = closed_form.moment(CONE, r, theta)
    back = c * theta * L / (c * theta + moment * L)
    return f"inverts (2.3) to {_off(back, r)}; with A = L/(1 − 1/R) for L it holds of any taper"


def _equation_2_3() -> str:
    beam = press(CONE, SHARES * L, 1e-6).moment
    formula = CONE.compliance_constant * 1e-6 * (1 / (SHARES * L) - 1 / L)
    return f"the exact beam's limit at small angle to {_off(beam, formula)}; C is 3EI₀"


def _monotonic() -> str:
    r = np.linspace(0.01, 0.999, 500)[:, None] * L
    rises = [np.sum(np.diff(Compliance().signals(w, r)[0][:, 0]) >= 0) for w in (CONE, WHISKER)]
    return f"dM/dθ falls with distance, with {int(sum(rises))} rises in 998 steps"


def _forces_at_90() -> str:
    arc = np.array([0.3, 0.5, 0.7, 0.9]) * L
    taper, cylinder = (
        paper.loaded(w, arc, np.array(np.pi / 2)).force for w in paper.WHISKERS.values()
    )
    ratio = ", ".join(f"{v:.3f}" for v in taper / cylinder)
    return f"the taper's force over the cylinder's at 90°, 0.3, 0.5, 0.7 and 0.9 L: {ratio}"


def _one_to_one() -> str:
    signs = set(np.sign(paper.map_jacobian(WHISKER)).ravel())
    crossed = paper.crossings(paper.map_boundary(WHISKER, 120))
    return (
        f"signs of the map's Jacobian over all contacts to 90°: {len(signs)}; crossings of the "
        f"image of its edge: {crossed}; so no two contacts share their signals"
    )


def _parabola() -> str:
    bent = press(CYLINDER, np.linspace(0.05, 0.5, 30)[:, None] * L, np.linspace(0.01, 1.6, 40))
    ratio = bent.moment**2 / (2 * CYLINDER.stiffness * bent.axial_force)
    return f"M² = 2EI·Fx at every load, to {_off(ratio, np.ones_like(ratio))}"


def _muscle() -> str:
    theta = np.linspace(np.radians(30), np.radians(150), 2001)
    peak = float(MuscleCurve.PRINTED.moment(theta).max())
    at = float(np.degrees(theta[np.argmax(MuscleCurve.PRINTED.moment(theta))]))
    return f"peaks at {peak:.3f} at {at:.0f}° (w = 1.25); scaled to a peak of 1 here"


def _flick_past_at() -> str:
    end = paper.curve_end(MuscleCurve.NORMALISED)
    return f"from an impact at 60° the balance ends at {end:.3f} L"


def _two_of_four() -> str:
    outcome = moment_balance(WHISKER, np.array(paper.SHOWN) * L, paper.IMPACT).outcome
    held = int(np.sum(outcome == 0))
    return f"at 0.3, 0.5, 0.7, 0.9 L: {held} balance, {len(outcome) - held} flick past"


def _balance_monotonic() -> str:
    b = moment_balance(WHISKER, np.linspace(0.3, 0.69, 100) * L, paper.IMPACT).balance_angle
    low, high = np.degrees(b[[0, -1]])
    falls = int(np.sum(np.diff(b) <= 0))
    return f"from {low:.1f}° at 0.3 L to {high:.1f}° at 0.69 L, with {falls} falls in 99 steps"


def _white_areas() -> str:
    grid = paper.surface(MuscleCurve.NORMALISED, paper.DISTANCES[::10], paper.IMPACTS[::10]).query(
        "outcome != 'BALANCED'"
    )
    share, angle = paper.dashed_line()
    below = grid["impact_angle_deg"] <= np.interp(grid["radial_distance"], share, angle) + 1e-9
    wrong = int((below == (grid["outcome"] == "END_OF_WHISKING")).sum())
    return f"{wrong} of {len(grid)} contacts without balance lie on the wrong side of the line"


def _equation_3_3() -> str:
    r = SHARES * L
    slope = Compliance(angular_velocity=2.0).jacobian(CONE, r[:, None])[:, 0, 0]
    return f"to {_off(slope, -CONE.compliance_constant * 2.0 / r**2)}"


def _equation_3_5() -> str:
    found = _compliance_jnd(CONE, SHARES)
    return f"Weber propagation gives it to {_off(found, SHARES * (1 - SHARES))}"


def _equation_3_6() -> str:
    return f"to {_off(_compliance_jnd(CYLINDER, SHARES), SHARES)}"


def _figure_4a() -> str:
    share = np.linspace(1e-4, 0.9999, 401)
    cone, taper = _compliance_jnd(CONE, share), _compliance_jnd(WHISKER, share)
    return (
        f"the cone's JND is largest, {cone.max():.3f} kL, at {share[np.argmax(cone)]:.2f} L and "
        f"{cone[-1]:.1e} kL at the tip; a whisker of R = 20 keeps {taper[-1]:.3f} kL there"
    )


def _figure_4b() -> str:
    at = {f"{s:g}": _map_jnd(s, np.radians([1.0, 10.0]), K, NONE) for s in (0.3, 0.5, 0.7, 0.9)}
    rows = ", ".join(f"{s} L: {a:.3f} → {b:.3f}" for s, (a, b) in at.items())
    return f"JND/(kL) from 1° to 10°: {rows}"


def _similar() -> str:
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


def _reason() -> str:
    theta = np.radians([1.0, 30.0])
    slope = np.abs(np.linalg.inv(signal_jacobian(WHISKER, 0.5 * L, theta)[..., :2, :])[:, 0, 0])
    slope = slope * WHISKER.moment_scale / L
    moment = press(WHISKER, 0.5 * L, theta).normalised_moment
    return (
        f"at 0.5 L from 1° to 30° |∂r/∂M| falls from {slope[0]:.2f} to {slope[1]:.2f} while M "
        f"grows from {moment[0]:.3f} to {moment[1]:.2f}; their product falls, "
        f"{slope[0] * moment[0]:.2f} to {slope[1] * moment[1]:.2f}"
    )


def _compliance_size() -> str:
    theta, r = 1e-4, 0.5 * L
    ratio = press(CYLINDER, r, theta).moment / press(WHISKER, r, theta).moment
    return f"at 0.5 L the taper's compliance is {float(ratio):.2f} times the cylinder's"


def _small_angle() -> str:
    off = []
    for share in (0.7, 0.9):
        bent = bend(WHISKER, share * L, np.geomspace(1e-8, 1e-3, 20001))
        i = int(np.nanargmin(np.abs(bent.deflection_angle - np.radians(10))))
        small = closed_form.moment(WHISKER, bent.radial_distance[i], bent.deflection_angle[i])
        off.append(f"{float(small / bent.moment[i] - 1):.0%} at s = {share:g} L")
    return f"at θ_d = 10° the small-angle moment is too large by {' and '.join(off)}"


def _signatures() -> str:
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


def _along_a_whisk() -> str:
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


_T = "tests/test_paper.py::test_"
_F = "tests/test_paper_figures.py::test_"
CLAIMS = (
    Claim("(2.1)", "Distance from the rate of moment in a tap", _equation_2_1,
          _T + "equations_2_1_and_2_3", "perfect cones, small angles"),
    Claim("(2.3)", "Moment at small deflection", _equation_2_3,
          _T + "2_3_is_the_small_angle_limit_of_the_beam"),
    Claim("§2e, figure 1d", "Ṁ is monotonic in distance at any velocity", _monotonic,
          _T + "moment_rate_falls_with_distance"),
    Claim("§2d", "No simple unique spectral signature of distance",
          _signatures,
          "tests/test_cue_vibration.py::test_amplitudes_leave_several_places_and_their_phases_one",
          "ends where phase is felt too, which leaves one place"),
    Claim("§2f, figure 2b, c", "The taper needs smaller forces for α = 90°, above all near the tip",
          _forces_at_90,
          _T + "the_tapered_whisker_needs_smaller_forces_for_90_degrees_above_all_near_the_tip"),
    Claim("§2f, figure 2d, e", "(M, Fx) determine distance and angle of a taper", _one_to_one,
          _F + "2de_the_tapered_map_is_one_to_one", "interpolated on linear axes the scattered map "
          "is lost; on logarithmic ones it is right (test_a_scattered_map_must_be_interpolated_on_"
          "logarithmic_axes)"),
    Claim("§2f, figure 2f", "A cylinder's (M, Fx) lie on one curve", _parabola,
          _F + "2f_the_cylinders_map_is_the_parabola"),
    Claim("(2.2)", "The muscle's moment", _muscle,
          "tests/test_muscle.py::test_the_curve_of_figure_3b_ends_where_the_two_curves_touch",
          "with the arctangent as printed it jumps inside the range of whisking: it has to be that "
          "of the full circle; and w is then follicle separation over half the lever"),
    Claim("§2h", "Scaled so that the whisker flicks past at around 70 per cent", _flick_past_at,
          _F + "3b_the_curve_ends_at_around_70_per_cent"),
    Claim("§2h, figure 3a", "Two of four distances balance, two flick past", _two_of_four,
          _F + "3a_of_four_distances_two_are_held_and_two_flick_past"),
    Claim("§2h, figure 3b", "θ_b is monotonic in distance", _balance_monotonic,
          _F + "3b_the_angle_of_balance_grows_with_distance_from_any_impact"),
    Claim("figure 3c", "White below the dashed line: flicked past; above: whisking ended",
          _white_areas,
          _F + "3c_flick_past_below_the_dashed_line_and_the_end_of_whisking_above"),
    Claim("(3.1), (3.4), (3.8)", "Weber's law: ΔI = k I",
          lambda: "sd of receptors at I = 1 and 10: {:.3g} and {:.3g}".format(
              *Weber(K).sd([1.0, 10.0])),
          _T + "equation_3_1_webers_law"),
    Claim("(3.3)", "dṀ/dr = −Cθ̇/r²", _equation_3_3, _T + "equation_3_3_slope_of_the_moment_rate"),
    Claim("(3.2), (3.5)", "Δr = k r(1 − r/L) for the taper", _equation_3_5,
          _T + "equations_3_5_and_3_6", "a perfect cone; else A stands for L"),
    Claim("(3.6)", "Δr = k r for the cylinder", _equation_3_6, _T + "equations_3_5_and_3_6"),
    Claim("§3b, figure 4a", "The JND is zero at the base, and at the tip of the taper alone",
          _figure_4a, _T + "figure_4a_both_start_at_zero_and_only_the_taper_returns",
          "zero at the tip is the perfect cone's"),
    Claim("§3b", "Smaller absolute magnitudes of compliance, of the taper", _compliance_size,
          _T + "the_compliance_of_a_taper_is_larger_its_inverse_smaller",
          "the compliance (dM/dθ)⁻¹ of a taper is larger; its inverse is smaller"),
    Claim("§3b", "The linearised compliance", _small_angle,
          _T + "small_angle_compliance_is_as_far_off_as_theory_says", "small angles"),
    Claim("(3.7), §3c, figure 4b", "The JND falls with distance, and with deflection", _figure_4b,
          _T + "figure_4b_falls_with_distance_and_with_deflection"),
    Claim("§3c", "Similar results with noise in Fx alone", _similar,
          _T + "results_are_similar_in_both_cases_only_up_to_a_false_zero",
          "a false zero of the linear JND inside α ≤ 90°, which no posterior has; with noise in M "
          "alone there is one beyond 90°"),
    Claim("§3c", "Because δr/δM increases faster than the moment", _reason,
          _T + "the_slope_falls_with_deflection_while_the_moment_grows_more_slowly",
          "the reason is upside down: the slope falls, and faster than the moment grows"),
    Claim("§3c", "Resolution increases steadily along a whisk, depending on slip",
          _along_a_whisk, _T + "resolution_along_a_whisk_depends_on_slip",
          "thick objects, on which the contact first slips"),
)  # fmt: skip


def rows() -> Iterator[dict[str, str]]:
    """Every claim with what is found of it, computed now."""
    for claim in CLAIMS:
        yield {
            "where": claim.where,
            "claim": claim.says,
            "found": claim.found(),
            "limit": claim.limit,
            "test": claim.test,
        }


#: The paper's figures in its order, with what each shows.
PANELS = {
    "figure-1d": "1d. dM/dθ is monotonic in radial distance.",
    "figure-2": "2a–f. Large bending of a tapered whisker (radius ratio 20) and a cylinder.",
    "figure-3": "3a–c. Balance of moments: angle of balance, by distance and impact angle.",
    "figure-4a": "4a. JND of radial distance by compliance: closed forms, and posteriors.",
    "figure-4b": "4b. JND by moment and axial force, noise in the moment alone.",
}


def as_markdown(rows: list[dict[str, str]]) -> str:
    """The claims beside what is found, with the figures."""
    lines = [
        "# Radial distance and Weber's law, remade",
        "",
        "Solomon JH, Hartmann MJZ (2011) *Phil. Trans. R. Soc. B* 366:3049, "
        "doi:10.1098/rstb.2011.0166. Numbers are computed by `weberwhisk paper`; values called the "
        "paper's are those of its text. A whisker of 50 mm, radius ratio 20, and k = 0.1 unless "
        "said otherwise; lengths over L.",
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
