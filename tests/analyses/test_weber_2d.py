"""Weber's law in two dimensions (§3c): the claims of its chart."""

from itertools import product

import numpy as np
import pytest
from analysis_scripts import load
from short_forms import slow_but

from weberwhisk import plots
from weberwhisk.sensitivity import fisher_jnd, jnd_curve, weber_propagation

weber_2d = load("gallery.surveys")
W, K = weber_2d.WHISKER, weber_2d.K


@pytest.mark.parametrize(
    ("k", "rho"),
    slow_but(product([(0.1, 0.1), (0.05, 0.2), (0.1, 0.02)], [-0.8, 0.0, 0.6]), (0, 2, 4, 7)),
)
def test_all_routes_agree_across_the_family_at_small_noise(k, rho):
    """Closed form, exact Jacobian, Fisher information with θ_d unknown, posterior."""
    small = 0.1 * np.array(k)
    o = weber_2d.observer(*small, rho)
    r = np.array([0.4, 0.7]) * W.length
    contact = np.stack([r, np.full(2, 0.01)], axis=-1)
    closed = weber_2d.closed_form(r, *small, rho)
    assert weber_propagation(o, contact) == pytest.approx(closed, rel=2e-3)
    # What the spread itself tells is of relative order k².
    assert fisher_jnd(o, contact) == pytest.approx(closed, rel=2e-3 + 2 * np.max(small) ** 2)
    row = jnd_curve(o, r, 0.01, n_readings=16, seed=1)
    error = 4 * row["posterior_error"] + 0.01 * closed
    assert np.all(np.abs(row["posterior"] - closed) < error)


def test_figure_4b_marks_the_contact_angle_of_90_degrees_and_the_false_zero():
    table = weber_2d.surface(K, weber_2d.NONE, 40)
    ax = plots.jnd_surface(table, length=W.length, weber_fraction=K)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["contact angle of 90°", "false zero of the linear JND"]
    both = weber_2d.surface(*weber_2d.FAMILY["both alike"], 20)
    assert "signed_jnd_mm" not in both
