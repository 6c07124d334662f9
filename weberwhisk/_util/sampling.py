"""emcee's walkers, thousands of posteriors in one run, and ArviZ's data and diagnostics.

A step of emcee costs the same bookkeeping for 32 walkers as for 32 000. The moves here pair walkers
only inside their own *block* of W rows, so that one `emcee.EnsembleSampler` carries any number of
independent ensembles, E of them for each of B posteriors. The walkers of one ensemble depend on
each other, so R-hat across them would mean nothing: a chain here is a whole ensemble.

Of ArviZ, 0.23 and 1.x serve alike: they differ in what holds the groups (InferenceData there,
xarray's DataTree here) and in how they are handed over. Both packages take seconds to import, and
are imported where they are first used.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from enum import IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .refusals import Refusal
from .values import Array, Flags, Seed

if TYPE_CHECKING:
    import emcee
    from xarray import Dataset

__all__ = [
    "MOVES", "RHAT", "ArvizData", "BlockDifferentialEvolution", "BlockMove", "BlockStretch",
    "Shortfall", "StackedSample", "integers", "mcse", "pointwise_loo", "rhat", "sample_stacked",
    "to_arviz",
]  # fmt: skip

#: R-hat below which independent ensembles agree (Vehtari et al. 2021, Bayesian Analysis 16, 667).
RHAT = 1.01
#: Autocorrelation times in all ensembles together: 40 in each of four; emcee advises 50 for one.
LENGTH = 160


class Shortfall(IntFlag):
    """Why a posterior's sample is not to be relied on; 0 is converged, reasons add up."""

    RHAT = 1
    SHORT = 2
    IMPRECISE = 4
    STUCK = 8

    @property
    def message(self) -> str:
        """The reasons in words."""
        reasons = {
            Shortfall.RHAT: f"independent ensembles disagree (R-hat above {RHAT})",
            Shortfall.SHORT: f"fewer than {LENGTH} autocorrelation times in all ensembles together",
            Shortfall.IMPRECISE: "Monte Carlo error above the tolerance",
            Shortfall.STUCK: "a walker has not moved, or not to where the mass is",
        }
        return "; ".join(reasons[flag] for flag in Shortfall if flag & self) or "converged"


# -- moves -----------------------------------------------------------------------------------------


class BlockMove:
    """An emcee move that pairs walkers only inside their own block of W rows.

    At each step a block is split in two halves at random; each is updated against the other. Which
    place pairs with which is shared by all blocks; the stretch, the sign and the acceptance are
    drawn for each walker. Given the shared draws every block's step still leaves its own density
    invariant, so the blocks stay independent. emcee hands its moves an old `RandomState`; `rng` is
    faster, and seeded by the caller.
    """

    def __init__(self, walkers: int, rng: np.random.Generator) -> None:
        self.walkers, self.rng = walkers, rng

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        """New places for `active` (blocks, W/2, D) from `rest`, and the log Hastings factor."""
        raise NotImplementedError

    def propose(self, model: emcee.model.Model, state: emcee.State) -> tuple[emcee.State, Flags]:
        """One step of every walker of every block; emcee calls this."""
        rows, dim = state.coords.shape
        blocks, half = rows // self.walkers, self.walkers // 2
        coords = state.coords.reshape(blocks, self.walkers, dim)
        log_prob = state.log_prob.reshape(blocks, self.walkers)
        accepted = np.zeros((blocks, self.walkers), dtype=bool)
        halves = self.rng.permutation(self.walkers).reshape(2, half)
        for active, rest in (halves, halves[::-1]):
            old, old_log_prob = coords[:, active], log_prob[:, active]
            new, factor = self.proposal(old, coords[:, rest])
            # emcee's own compute_log_prob_fn converts value by value, at 0.2 µs each.
            new_log_prob = model.log_prob_fn(new.reshape(-1, dim)).reshape(blocks, half)
            # log(u) is the negative of a standard exponential, and never -inf.
            threshold = old_log_prob - factor - self.rng.standard_exponential(new_log_prob.shape)
            take = new_log_prob > threshold
            coords[:, active] = np.where(take[..., None], new, old)
            log_prob[:, active] = np.where(take, new_log_prob, old_log_prob)
            accepted[:, active] = take
        return state, accepted.ravel()


class BlockStretch(BlockMove):
    """Goodman and Weare's (2010): a walker moves along the line through a partner, by a factor z of
    density ∝ 1/√z on (1/stretch, stretch)."""

    stretch = 8.0  # where emcee has 2: half as many steps make an independent draw of a Gaussian

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        blocks, half, dim = active.shape
        partner = rest[:, self.rng.integers(half, size=half)]
        z = ((self.stretch - 1.0) * self.rng.random((blocks, half)) + 1.0) ** 2 / self.stretch
        return partner + z[..., None] * (active - partner), (dim - 1.0) * np.log(z)


class BlockDifferentialEvolution(BlockMove):
    """Ter Braak's (2006): a walker moves by ±γ times the difference of two of the other half.

    Its own sign makes the move symmetric whatever pair was drawn. γ is 2.38/√(2D), best for a
    Gaussian, with 10 % jitter, which keeps a small ensemble from living on a lattice, or in a tenth
    of the moves 1, a step from one peak to another.
    """

    jitter, unit = 0.1, 0.1

    def proposal(self, active: Array, rest: Array) -> tuple[Array, Array | float]:
        blocks, half, dim = active.shape
        first = self.rng.integers(half, size=half)
        second = (first + self.rng.integers(1, half, size=half)) % half
        step = 2.38 / np.sqrt(2.0 * dim) * (1.0 + self.jitter * self.rng.standard_normal(half))
        step = np.where(self.rng.random(half) < self.unit, 1.0, step)
        sign = self.rng.integers(0, 2, size=(blocks, half), dtype=np.int8) * 2 - 1
        return active + (sign * step)[..., None] * (rest[:, first] - rest[:, second]), 0.0


#: Half of the steps each: differential evolution is three times better for a Gaussian, the stretch
#: move for a banana.
MOVES = (BlockDifferentialEvolution, BlockStretch)

# -- the run ---------------------------------------------------------------------------------------


class StackedSample(NamedTuple):
    """Draws of B posteriors and what they are worth.

    `values` (B, E, N, C) are N draws of each of the E independent ensembles, evenly in time, of the
    C requested functions or the coordinates. `mean`, `sd` and their Monte Carlo errors, (B, C),
    are of all `steps` (B,) of every walker but the first quarter, and the rank-normalised split
    `rhat` of the draws; `shortfall` (B,) has `Shortfall` flags.
    """

    values: Array
    mean: Array
    sd: Array
    mcse_mean: Array
    mcse_sd: Array
    rhat: Array
    shortfall: NDArray[np.int64]
    steps: NDArray[np.int64]

    @property
    def converged(self) -> Flags:
        """Which posteriors met every criterion, shape (B,)."""
        return self.shortfall == 0


def sample_stacked(
    log_density: Callable[..., ArrayLike],
    start: ArrayLike,
    *,
    seed: Seed,
    functions: Callable[[Array], Array] | None = None,
    precision: float = 0.02,
    max_steps: int = 20_000,
    indexed: bool = False,
) -> StackedSample:
    """Sample B posteriors in one emcee run, each until it is good enough or `max_steps` are made.

    They are judged after 128 steps and whenever there are half as many more, a first quarter left
    out as burn-in. One is done when the Monte Carlo errors of all means and sds are small enough,
    its ensembles agree and are long enough, and every walker moves to where the mass is.

    ``log_density(x)``, with x (B, M, D), any M, returns (B, M): −inf, but never NaN or +inf; with
    `indexed`, ``log_density(x, index)`` is of some posteriors, as those that are done drop out;
    else all go on to the last. `start` (B, E, W, D) has the walkers of E ≥ 4 ensembles, an even
    number W ≥ 2 D + 2, all inside the support, rather too wide than too narrow. ``functions(x)``
    (B, M, C) are judged and summarised in place of the coordinates. `precision` is the largest
    Monte Carlo error of an sd, relative to it; the mean's may be √2 times as much, as it is for
    independent draws. The same seed, density and start give the same bits.
    """
    import emcee

    places = np.asarray(start, dtype=float)
    rng = np.random.default_rng(seed)
    count, ensembles, walkers, dim = places.shape
    alive = np.arange(count)

    def density(rows: Array) -> Array:
        x = rows.reshape(len(alive), -1, dim)
        out = np.asarray(log_density(x, alive) if indexed else log_density(x), dtype=float)
        if not np.max(out) < np.inf:  # or NaN
            raise Refusal(
                "A log-density is NaN or +inf", remedy="return -inf where the density is zero"
            )
        return out.ravel()

    def columns(rows: Array) -> Array:
        """Steps (n, rows, D) as functions or coordinates, (B, E, n, W, C)."""
        x = rows.reshape(len(rows), len(alive), -1, dim).swapaxes(0, 1)
        flat = x.reshape(len(alive), -1, dim)
        out = flat if functions is None else functions(flat)
        return out.reshape(len(alive), len(rows), ensembles, walkers, -1).swapaxes(1, 2)

    # A new sampler copies NumPy's global state, unless the state to go on from has its own.
    own = np.random.RandomState(rng.integers(2**32, size=4)).get_state()
    rows = places.reshape(-1, dim).copy()
    state = emcee.State(rows, density(rows), None, own)
    outside = np.isneginf(state.log_prob).reshape(count, -1).sum(axis=1)
    if outside.any():  # emcee takes them, and they stay
        raise Refusal(
            f"walkers ({outside.sum()} of {np.sum(outside > 0)} posteriors) start where the "
            f"log-density is -inf, the first in posterior {np.argmax(outside > 0)}",
            remedy="start them inside the support",
        )
    moves = [(move(walkers, rng), 0.5) for move in MOVES]
    chain = columns(rows[None])[:, :, :0]
    fields: dict[str, NDArray] = {}
    steps, check = 0, 128
    while alive.size:
        # Every second step is kept: half the memory, for 5 % of the information at best.
        pairs = -(-(min(check, max_steps) - steps) // 2)
        sampler = emcee.EnsembleSampler(*state.coords.shape, density, moves=moves, vectorize=True)
        sampler.log_prob_fn = density  # emcee's wrapper prints all walkers on an error
        state = sampler.run_mcmc(state, pairs, thin_by=2, skip_initial_state_check=True)
        steps, check = steps + 2 * pairs, check * 3 // 2
        chain = np.concatenate([chain, columns(sampler.get_chain())], axis=2)
        log = sampler.get_log_prob().max(axis=0).reshape(len(alive), -1)
        # One that stays so many nats below the best is on a peak of next to no mass.
        stuck = (log < log.max(axis=1, keepdims=True) - 20.0).any(axis=1)
        stuck |= (sampler.backend.accepted == 0).reshape(len(alive), -1).any(axis=1)
        last = steps >= max_steps
        verdict = _judged(chain, steps, stuck, precision, last)
        done = verdict.converged | last
        done &= indexed or done.all()
        for name, value in verdict._asdict().items():
            blank = np.zeros((count, *value.shape[1:]), value.dtype)
            fields.setdefault(name, blank)[alive[done]] = value[done]
        on = np.repeat(~done, ensembles * walkers)
        state = emcee.State(state.coords[on], state.log_prob[on], None, state.random_state)
        alive, chain = alive[~done], chain[~done]
    return StackedSample(**fields)


def _judged(chain: Array, steps: int, stuck: Flags, precision: float, every: bool) -> StackedSample:
    """What a chain (B, E, n, W, C) of so many steps is worth, a quarter left out.

    Errors are those of the ensembles' means over walkers, of the columns and of their squares.
    R-hat takes most of the time: it is worked out where nothing else is wrong, or for `every` one.
    """
    chain = chain[:, :, chain.shape[2] // 4 :]
    _, _, n, walkers, _ = chain.shape
    mean = chain.mean(axis=(1, 2, 3))
    off = chain - mean[:, None, None, None]
    variance = np.square(off).mean(axis=(1, 2, 3))
    sd = np.where(variance > 0, np.sqrt(variance), np.nan)
    first, second = (np.moveaxis(v.mean(axis=3), -1, 1) for v in (off, np.square(off)))
    mcse_mean, mcse_sd = mcse(first), mcse(second) / (2 * sd)
    error = np.maximum(mcse_sd, mcse_mean / np.sqrt(2)) / sd
    fault = np.zeros(len(chain), dtype=np.int64)
    fault |= Shortfall.SHORT * ~(first.var(axis=(2, 3)) / mcse_mean**2 >= LENGTH).all(axis=1)
    fault |= Shortfall.IMPRECISE * ~(error <= precision).all(axis=1)
    fault |= Shortfall.STUCK * stuck
    # Draws of an ensemble that stay: as many as its 40 autocorrelation times hold, and more.
    even = np.linspace(0, n - 1, max(1024 // walkers, 8)).round().astype(np.intp)
    values = chain[:, :, even].reshape(*chain.shape[:2], -1, chain.shape[4])
    rhats, asked = np.full(mean.shape, np.nan), (fault == 0) | every
    rhats[asked] = rhat(np.moveaxis(values[asked], -1, 1))
    fault[asked] |= Shortfall.RHAT * ~(rhats[asked] < RHAT).all(axis=1)
    sd, made = np.sqrt(variance), np.full(len(chain), steps)
    return StackedSample(values, mean, sd, mcse_mean, mcse_sd, rhats, fault, made)


# -- ArviZ -----------------------------------------------------------------------------------------


class ArvizData(Protocol):
    """What ArviZ takes: its InferenceData on 0.23, xarray's DataTree on 1.x."""

    def __getitem__(self, group: str, /) -> Dataset:
        """A group, such as "posterior"."""

    def to_netcdf(self, filepath: str, /) -> object:
        """Keep all groups in a file."""


Variables = Mapping[str, ArrayLike]


def to_arviz(
    posterior: Variables,
    *,
    log_likelihood: Variables | None = None,
    log_prior: Variables | None = None,
    observed_data: Variables | None = None,
    constant_data: Variables | None = None,
    prior: Variables | None = None,
    posterior_predictive: Variables | None = None,
    coords: Mapping[str, ArrayLike] | None = None,
    dims: Mapping[str, Sequence[str]] | None = None,
    attrs: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
    comments: Mapping[str, str] | None = None,
) -> ArvizData:
    """Draws as ArviZ data: InferenceData on arviz 0.23, xarray's DataTree on 1.x.

    Sampled groups are arrays (chain, draw, ...) by name, a chain independent of the others: a whole
    ensemble of emcee, not one of its walkers. `coords` and `dims` label further dimensions, as
    ArviZ has them; `attrs` are remarks stored with the posterior, `comments` with other groups, and
    `units` with variables and coordinates, by their names. Both kinds offer ``data["posterior"]``
    and ``data.to_netcdf(path)``.

    Counts must be integers: `arviz.loo_pit` and plots take floats for a continuous quantity.

    Examples
    --------
    >>> draws = np.random.default_rng(1).normal(size=(4, 100))
    >>> data = to_arviz({"r": draws}, observed_data={"moment": 1.0}, attrs={"method": "emcee"})
    >>> dict(data["posterior"]["r"].sizes)
    {'chain': 4, 'draw': 100}
    """
    sampled = {
        "posterior": posterior,
        "log_likelihood": log_likelihood,
        "log_prior": log_prior,
        "prior": prior,
        "posterior_predictive": posterior_predictive,
    }
    fixed = {"observed_data": observed_data, "constant_data": constant_data}
    groups = {name: _draws(name, group) for name, group in sampled.items() if group is not None}
    for name, group in fixed.items():
        if group is not None:
            groups[name] = {key: np.asarray(value) for key, value in group.items()}
    named = {name: list(value) for name, value in (dims or {}).items()}
    labels = {name: np.asarray(value) for name, value in (coords or {}).items()}
    arviz = _arviz()
    if "InferenceData" in vars(arviz):  # asking 1.x for the attribute warns
        later = {"log_prior": groups.pop("log_prior")} if log_prior is not None else {}
        data = arviz.from_dict(**groups, coords=labels, dims=named)
        if later:  # which from_dict of 0.23 does not take
            data.add_groups(later, coords=labels, dims=named)
        groups |= later
    else:
        data = arviz.from_dict(groups, coords=labels, dims=named)
    data["posterior"].attrs.update(attrs or {})
    for name, said in (comments or {}).items():
        data[name].attrs["comment"] = said
    for name in groups.keys() - {"log_likelihood", "log_prior"}:  # which are in nats
        for key in (units or {}).keys() & {*data[name].data_vars, *data[name].coords}:
            data[name][key].attrs["units"] = (units or {})[key]
    return data


def integers(counts: ArrayLike) -> NDArray[np.int64]:
    """Counts, kept as floats for arithmetic, as the whole numbers that they are."""
    return np.rint(np.asarray(counts, dtype=float)).astype(np.int64)


def _arviz() -> Any:
    with warnings.catch_warnings():
        # arviz 0.23 announces its successor at every first import.
        warnings.simplefilter("ignore", FutureWarning)
        import arviz
    return arviz


def _draws(name: str, group: Variables) -> dict[str, NDArray[Any]]:
    """Arrays that all start with the same (chain, draw)."""
    arrays = {key: np.asarray(value) for key, value in group.items()}
    if not arrays:
        raise Refusal(f"{name} holds no variable", remedy="give at least one, or leave it out")
    first = next(iter(arrays.values())).shape[:2]
    for key, value in arrays.items():
        if value.ndim < 2 or value.shape[:2] != first:
            raise Refusal(
                f"{name} variable {key!r} must have shape (chain, draw, ...) like the others",
                value.shape,
                "put chains on the first axis and draws on the second",
            )
    return arrays


class Loo(NamedTuple):
    """Log predictive density of each observation left out, and its Pareto k, both (N,)."""

    elpd: Array
    pareto_k: Array


def pointwise_loo(log_likelihood: ArrayLike) -> Loo:
    """Leave each of N independent observations out (Vehtari, Gelman & Gabry 2017).

    Of log-likelihoods (chain, draw, N). Where `pareto_k` is above 0.7 the estimate is not to be
    relied on.
    """
    values = np.asarray(log_likelihood, dtype=float)
    # Where no draw differs, importance sampling has nothing to do, and its diagnostic no meaning.
    varies = np.ptp(values, axis=(0, 1)) > 1e-12
    elpd, pareto_k = values[0, 0].copy(), np.zeros(values.shape[2])
    if varies.any():
        data = to_arviz(
            {"unused": np.zeros(values.shape[:2])},
            log_likelihood={"y": values[..., varies]},
            observed_data={"y": np.zeros(int(varies.sum()))},
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # large Pareto k, which are returned
            found = _arviz().loo(data, pointwise=True, var_name="y")
        pointwise = found["elpd_i"] if hasattr(found, "elpd_i") else found["loo_i"]
        elpd[varies] = np.asarray(pointwise).ravel()
        pareto_k[varies] = np.asarray(found["pareto_k"]).ravel()
    return Loo(elpd, pareto_k)


def rhat(draws: Array) -> Array:
    """ArviZ's rank-normalised split R-hat of draws (..., chain, draw), in shape (...)."""
    return _each("rhat", draws)


def mcse(draws: Array) -> Array:
    """ArviZ's Monte Carlo error of the mean of draws (..., chain, draw), in shape (...)."""
    return _each("mcse", draws, method="mean")


def _each(name: str, draws: Array, **options: str) -> Array:
    function = getattr(_arviz(), name)
    with np.errstate(invalid="ignore", divide="ignore"):  # NaN where no draw differs from another
        # ArviZ 0.23 gives some of them as arrays of one number where Numba is installed.
        flat = [np.asarray(function(x, **options)).item()
                for x in draws.reshape(-1, *draws.shape[-2:])]  # fmt: skip
    return np.reshape(np.array(flat), draws.shape[:-2])
