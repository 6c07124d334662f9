"""The fit of one observer as ArviZ data: draws, priors, likelihood, counts, and their units."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._util.sampling import ArvizData, integers, to_arviz
from .._util.values import Array
from .estimates import Estimates
from .likelihood import Draws
from .posteriors import log_prior_density, prior_draws
from .tasks import SameDifferent, SignedChoice, Task, YesNo
from .trials import STIMULI

__all__ = ["observer_data"]

_BIAS_UNITS: dict[type[Task], str] = {
    SignedChoice: "sd of the difference between the signals",
    YesNo: "sd of the signal of the standard",
    SameDifferent: "sd of the difference between two signals of stimulus 1",
}


def observer_data(fit: Estimates, seed: int = 1) -> ArvizData:
    """Posterior, prior, posterior-predictive, log-likelihood, log-prior and observed data.

    A cell is a pair of stimuli: `n` trials of which `answers` had the answer. Its log-likelihood is
    that of the sequence of answers, binomial coefficient left out. `seed` is that of the draws from
    the prior and of the replicated counts.
    """
    model, chains, cells = fit.model, fit.posterior.chains, fit.model.cells
    draws = fit.posterior.draws()
    rng = np.random.default_rng(seed)
    by_standard = fit.bias == "per standard" and model.free_bias

    def chained(values: NDArray[Any]) -> NDArray[Any]:
        size = len(values) // chains
        return values[: size * chains].reshape(chains, size, *values.shape[1:])

    def parameters(of: Draws) -> dict[str, Array]:
        columns = {
            name: chained(values)
            for name, values in of.named(model).items()
            if name not in model.group_names
        }
        if model.free_bias:
            columns["bias"] = chained(of.bias if by_standard else of.bias[:, 0])
        return columns

    dims = {name: ["cell"] for name in ("answers", "n", *STIMULI[1:])}
    coords: dict[str, Any] = {"cell": np.arange(cells.n.size)}
    if by_standard:
        dims["bias"], coords["standard"] = ["standard"], fit.standards
    prior_densities = log_prior_density(model, draws)
    if not by_standard and "bias" in prior_densities:
        prior_densities["bias"] = prior_densities["bias"][:, 0]
    answers = integers(model.simulate(draws, rng))
    return to_arviz(
        parameters(draws),
        prior=parameters(prior_draws(model, len(draws), rng)),
        posterior_predictive={"answers": chained(answers)},
        log_likelihood={"answers": chained(model.log_said(draws))},
        log_prior={name: chained(values) for name, values in prior_densities.items()} or None,
        observed_data={"answers": integers(cells.count)},
        constant_data={
            "n": integers(cells.n),
            "stimulus_1": cells.stimulus_1,
            "stimulus_2": cells.stimulus_2,
        },
        coords=coords,
        dims=dims,
        attrs={"status": fit.status.message, "method": fit.method, "source": fit.trials.source},
        units=_units(fit),
        comments={"log_likelihood": _of_likelihood(fit)},
    )


def _units(fit: Estimates) -> dict[str, str]:
    """Units by the name of a variable; "1" for a ratio, a probability or a count."""
    model = fit.model
    names = [n for n in fit.parameters if n not in model.group_names]
    units = dict.fromkeys(["answers", "n", *names], "1")
    units["bias"] = _BIAS_UNITS.get(type(model.task), "sd of the decision variable")
    if fit.unit:
        units["weber_fraction"] = fit.unit
    if "floor" in units:
        units["floor"] = "unit of the signal"
    columns = fit.trials.frame.attrs.get("columns", {})
    for name in STIMULI:
        units[name] = fit.stimulus_unit or f"unit of the column {columns.get(name, name)}"
    return units


def _of_likelihood(fit: Estimates) -> str:
    """What one value of the log-likelihood is of, and so what leaving it out means."""
    if fit.model.n_states > 1:
        return (
            "A value is of all answers to a pair of stimuli, each given the answers before it: "
            "none can be left out alone, and LOO of it means nothing."
        )
    return (
        "A value is of all answers to a pair of stimuli (a cell): LOO of it leaves out a pair, "
        "where weberwhisk.compare leaves out a trial. Binomial coefficients are left out."
    )
