#!/usr/bin/env bash
# ArviZ 0.23.4 beside NumPy 2.4: the Monte Carlo error of a standard deviation fails as soon as Numba
# is installed.
#
# Behaviour: with NumPy 2.4.6, `arviz.mcse(method="sd")` raises "TypeError: only 0-dimensional arrays
# can be converted to Python scalars" where Numba can be imported, and `arviz.mcse` gives an array of
# one number in place of a number, of which `float` raises the same. Without Numba, or after
# `arviz.Numba.disable_numba()`, both are right.
# Why: ArviZ turns its Numba functions on by the mere presence of Numba; that of the square root
# takes and gives arrays of one number (arviz/stats/diagnostics.py), of which NumPy before 2.4 made
# a number with a warning that is not shown by default.
# Why it matters: ArviZ 0.23 is the last that runs on Python 3.11, and Numba comes in with other
# tools of the field (PyElastica, PyMC): a report of errors that worked fails in an environment in
# which nothing was changed but that another package was installed.
# Output seen: with Numba: mcse array([0.04881758]); of the sd: TypeError
#              without Numba: mcse 0.0488; of the sd: 0.0349
# Fails if that changes, or another version is installed.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3.11 -m venv "$work/venv"
"$work/venv/bin/pip" install -q "arviz==0.23.4" "numba==0.68.1" "numpy==2.4.6" "scipy==1.17.1"
"$work/venv/bin/python" -W ignore - <<'PYTHON'
import arviz
import numpy as np

assert arviz.__version__ == "0.23.4", arviz.__version__
assert np.__version__ == "2.4.6", np.__version__
draws = np.random.default_rng(0).standard_normal((4, 100))

assert arviz.Numba.numba_flag, "Numba is not on by itself"
error = arviz.mcse(draws)
print("with Numba: mcse", repr(error), end="; ")
assert np.shape(error) == (1,), "mcse gives a number now"
try:
    arviz.mcse(draws, method="sd")
except TypeError as refusal:
    print("of the sd: TypeError:", refusal)
    assert "0-dimensional" in str(refusal)
else:
    raise AssertionError("the error of a standard deviation is given beside Numba now")

arviz.Numba.disable_numba()
error, of_sd = arviz.mcse(draws), arviz.mcse(draws, method="sd")
print(f"without Numba: mcse {error:.4f}; of the sd: {of_sd:.4f}")
assert np.ndim(error) == 0
assert abs(error - 0.0488) < 1e-3
assert abs(of_sd - 0.0349) < 1e-3
PYTHON
