#!/usr/bin/env bash
# emcee 3.1.6: `moves.GaussianMove` with a full covariance gives every walker the same step.
#
# Behaviour: with a scalar or a vector of variances each walker is proposed a step of its own; with a
# covariance matrix one step is drawn and added to all walkers, so that an ensemble moves as a
# rigid body wherever proposals are accepted.
# Why: `multivariate_normal` is called once, without a size (emcee/moves/gaussian.py).
# Why it matters: the walkers are then no independent chains. R-hat, the effective sample size and
# the autocorrelation time that are computed over walkers count one random walk as many, and
# errors of means are understated by up to the root of the number of walkers.
# Output seen: full covariance: 1 distinct step of 8; variances: 8 distinct steps of 8
# Fails if walkers get steps of their own, or another version is installed.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q "emcee==3.1.6" "numpy==2.3.5"
"$work/venv/bin/python" - <<'PYTHON'
import emcee
import numpy as np
from emcee import moves

assert emcee.__version__ == "3.1.6", emcee.__version__


def distinct_steps(covariance):
    np.random.seed(5)  # emcee copies the global state
    start = np.random.default_rng(2).standard_normal((8, 2))
    sampler = emcee.EnsembleSampler(
        8, 2, lambda x: np.zeros(len(x)), moves=moves.GaussianMove(covariance), vectorize=True
    )  # of a flat density all proposals are accepted
    steps = sampler.run_mcmc(start, 1).coords - start
    return len(np.unique(steps.round(9), axis=0))


full = distinct_steps(np.array([[1.0, 0.3], [0.3, 1.0]]))
diagonal = distinct_steps(np.array([1.0, 1.0]))
print(f"full covariance: {full} distinct step of 8; variances: {diagonal} distinct steps of 8")
assert full == 1, "walkers get steps of their own now"
assert diagonal == 8
PYTHON
