"""The paper's equations and claims: what we find, the test that shows it, where a sentence ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from ..receptors import Weber
from ..surveys import K
from . import found


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


_T = "tests/test_paper.py::test_"
_F = "tests/test_paper_figures.py::test_"
CLAIMS = (
    Claim("§2a", "A touch of the tip: the object is as far as the whisker is long", found.length,
          "tests/test_cue_vibrissa_length.py::test_a_known_length_leaves_an_interval",
          "a touch of the shaft, which rules out what lies beyond the whisker alone"),
    Claim("§2b", "Touched by the longer whisker alone, it lies between the two lengths",
          found.two_lengths, "tests/test_cue_comparative_length.py::"
          "test_a_shorter_whisker_can_touch_what_a_longer_one_does_not",
          "as the paper says, where bases and sweeps differ"),
    Claim("§2b", "Performance improves as the number of whiskers increases", found.more_whiskers,
          "tests/test_array.py::test_fewer_whiskers_discriminate_worse"),
    Claim("§2c, figure 1b", "Two angles and the side between them determine distance",
          found.triangle,
          "tests/test_cue_angle_side_angle.py::"
          "test_a_short_side_costs_jnd_and_distance_costs_its_square",
          "out of reach of either base; the error grows as r²/side"),
    Claim("(2.1)", "Distance from the rate of moment in a tap", found.equation_2_1,
          _T + "equations_2_1_and_2_3", "perfect cones, small angles"),
    Claim("(2.3)", "Moment at small deflection", found.equation_2_3,
          _T + "2_3_is_the_small_angle_limit_of_the_beam"),
    Claim("§2e, figure 1d", "Ṁ is monotonic in distance at any velocity", found.monotonic,
          _T + "moment_rate_falls_with_distance"),
    Claim("§2d", "No simple unique spectral signature of distance",
          found.signatures,
          "tests/test_cue_vibration.py::test_amplitudes_leave_several_places_and_their_phases_one",
          "ends where phase is felt too, which leaves one place"),
    Claim("§2e", "It can be extended to slip out of the plane of rotation", found.out_of_the_plane,
          "tests/test_cue_compliance.py::"
          "test_the_lateral_slip_is_that_of_a_rod_pressed_by_a_tilted_plane", "small angles"),
    Claim("§2f", "With M and Fy determination of distance would be straightforward", found.lever,
          "tests/test_cue_force_map.py::"
          "test_the_transverse_force_makes_the_map_one_to_one_on_a_cylinder_too",
          "by their ratio at small angles; by the map, or with Fx, at all"),
    Claim("§2f, figure 2b, c", "The taper needs smaller forces for α = 90°, above all near the tip",
          found.forces_at_90,
          _T + "the_tapered_whisker_needs_smaller_forces_for_90_degrees_above_all_near_the_tip"),
    Claim("§2f, figure 2d, e", "(M, Fx) determine distance and angle of a taper", found.one_to_one,
          _F + "2de_the_tapered_map_is_one_to_one", "interpolated on linear axes the scattered map "
          "is lost; on logarithmic ones it is right (test_a_scattered_map_must_be_interpolated_on_"
          "logarithmic_axes)"),
    Claim("§2f, figure 2f", "A cylinder's (M, Fx) lie on one curve", found.parabola,
          _F + "2f_the_cylinders_map_is_the_parabola"),
    Claim("§2g", "Sweeping by moment and angle alone could be adapted to tapered whiskers",
          found.followed,
          "tests/test_cue_sweep.py::test_exact_moments_give_the_contact_and_the_contour",
          "noise adds up along the sweep; a filter forgets it"),
    Claim("(2.2)", "The muscle's moment", found.muscle,
          "tests/test_muscle.py::test_the_curve_of_figure_3b_ends_where_the_two_curves_touch",
          "with the arctangent as printed it jumps inside the range of whisking: it has to be that "
          "of the full circle; and w is then follicle separation over half the lever"),
    Claim("§2h", "Scaled so that the whisker flicks past at around 70 per cent",
          found.flick_past_at, _F + "3b_the_curve_ends_at_around_70_per_cent"),
    Claim("§2h, figure 3a", "Two of four distances balance, two flick past", found.two_of_four,
          _F + "3a_of_four_distances_two_are_held_and_two_flick_past"),
    Claim("§2h, figure 3b", "θ_b is monotonic in distance", found.balance_monotonic,
          _F + "3b_the_angle_of_balance_grows_with_distance_from_any_impact"),
    Claim("figure 3c", "White below the dashed line: flicked past; above: whisking ended",
          found.white_areas,
          _F + "3c_flick_past_below_the_dashed_line_and_the_end_of_whisking_above"),
    Claim("§3", "Taper leads to smaller signals, especially near the tip", found.smaller_signals,
          _T + "taper_takes_the_moment_towards_nothing_and_the_axial_force_to_a_third",
          "M falls with 1 − r/A, towards nothing; Fx with 1 − 2r/(3A), no further than to a third"),
    Claim("(3.1), (3.4), (3.8)", "Weber's law: ΔI = k I",
          lambda: "sd of receptors at I = 1 and 10: {:.3g} and {:.3g}".format(
              *Weber(K).sd([1.0, 10.0])),
          _T + "equation_3_1_webers_law"),
    Claim("(3.3)", "dṀ/dr = −Cθ̇/r²", found.equation_3_3,
          _T + "equation_3_3_slope_of_the_moment_rate"),
    Claim("(3.2), (3.5)", "Δr = k r(1 − r/L) for the taper", found.equation_3_5,
          _T + "equations_3_5_and_3_6", "a perfect cone; else A stands for L"),
    Claim("(3.6)", "Δr = k r for the cylinder", found.equation_3_6, _T + "equations_3_5_and_3_6"),
    Claim("§3b, figure 4a", "The JND is zero at the base, and at the tip of the taper alone",
          found.figure_4a, _T + "figure_4a_both_start_at_zero_and_only_the_taper_returns",
          "zero at the tip is the perfect cone's"),
    Claim("§3b", "Smaller absolute magnitudes of compliance, of the taper", found.compliance_size,
          _T + "the_compliance_of_a_taper_is_larger_its_inverse_smaller",
          "the compliance (dM/dθ)⁻¹ of a taper is larger; its inverse is smaller"),
    Claim("§3b", "Until torque or saturation end it at the base, a threshold at the tip",
          found.limits_of_the_jnd,
          "tests/test_along_whisk.py::"
          "test_torque_threshold_and_saturation_cut_the_curve_where_they_should",
          "limits for looking at: the paper gives no numbers"),
    Claim("§3b", "The linearised compliance", found.small_angle,
          _T + "small_angle_compliance_is_as_far_off_as_theory_says", "small angles"),
    Claim("(3.7), §3c, figure 4b", "The JND falls with distance, and with deflection",
          found.figure_4b, _T + "figure_4b_falls_with_distance_and_with_deflection"),
    Claim("§3c", "Similar results with noise in Fx alone", found.similar,
          _T + "results_are_similar_in_both_cases_only_up_to_a_false_zero",
          "a false zero of the linear JND inside α ≤ 90°, which no posterior has; with noise in M "
          "alone there is one beyond 90°"),
    Claim("§3c", "Because δr/δM increases faster than the moment", found.reason,
          _T + "the_slope_falls_with_deflection_while_the_moment_grows_more_slowly",
          "the reason is upside down: the slope falls, and faster than the moment grows"),
    Claim("§3c", "Resolution increases steadily along a whisk, depending on slip",
          found.along_a_whisk, _T + "resolution_along_a_whisk_depends_on_slip",
          "thick objects, on which the contact first slips"),
    Claim("§4", "Important implications for the resolution over the array", found.over_the_array,
          "tests/test_array.py::test_a_map_is_that_of_the_posterior_region"),
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
