#!/usr/bin/env bash
# psignifit 4.3: falling sigmoids (`neg_…`) take the guess rate off the top, so that of a forced
# choice a curve is fitted that never exceeds 1 - 1/n correct.
#
# Behaviour: of a 2AFC whose share correct falls from 0.98 to 0.50 as a distance grows,
# `sigmoid="neg_norm"` fits a curve that is 0.50 at most: predictions are wrong wherever the animal
# is better than chance, and the threshold lies beyond the last stimulus. The same counts over
# the negated distance, with `norm`, give 0.98 and the true threshold. In a yes/no task `gamma` and
# `lambda` change their meaning in the same way, and `threshold` keeps the other one: the stimulus
# that it gives for a proportion does not have this proportion on the curve.
# Why: `Sigmoid.__call__` (psignifit/sigmoids.py) scales to gamma … 1 - lambda and then takes
# 1 - psi, which leaves lambda … 1 - gamma; `Sigmoid.inverse` has it turned over before scaling.
# Why it matters: nothing is raised or warned, and a threshold with an interval comes back. Negate
# the stimulus and fit a rising sigmoid.
# Output seen: threshold 10.7 by neg_norm, 5.1 by norm; share correct at 1: 0.50 and 0.98 of 0.98
#              yes/no: `inverse` of 0.80 lies where the curve is 0.62
# Fails if the guess rate is the lower end of falling sigmoids, or another version is installed.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q "psignifit==4.3" "numpy==2.3.5" "scipy==1.16.3"
"$work/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import numpy as np
from psignifit import psignifit
from psignifit.sigmoids import Gaussian

assert version("psignifit") == "4.3", version("psignifit")
distance = np.arange(1.0, 11.0)
correct = [98, 98, 96, 88, 74, 62, 55, 51, 50, 50]  # of 100 each, 0.74 at 5
falling = np.column_stack([distance, correct, np.full(10, 100)])
rising = falling * [-1, 1, 1]

by_neg = psignifit(falling, sigmoid="neg_norm", experiment_type="2AFC")
by_norm = psignifit(rising, sigmoid="norm", experiment_type="2AFC")
wrong, right = by_neg.parameter_estimate["threshold"], -by_norm.parameter_estimate["threshold"]
best, true_best = by_neg.proportion_correct(1.0), by_norm.proportion_correct(-1.0)
print(f"threshold {wrong:.1f} by neg_norm, {right:.1f} by norm; ", end="")
print(f"share correct at 1: {best:.2f} and {true_best:.2f} of 0.98")

sigmoid = Gaussian(negative=True)
values = {"threshold": 5.0, "width": 4.0, "gamma": 0.2, "lambd": 0.02}
there = sigmoid(sigmoid.inverse(0.8, **values), **values)
print(f"yes/no: `inverse` of 0.80 lies where the curve is {there:.2f}")

assert abs(true_best - 0.98) < 0.02 and abs(right - 5) < 0.3
assert best < 0.51, "falling sigmoids rise above 1 - 1/n now"
assert wrong > 8, "the threshold of the falling sigmoid has changed"
assert there < 0.7, "the inverse of falling sigmoids belongs to them now"
PYTHON
