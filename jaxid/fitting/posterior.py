"""The posterior of a fit's numbers: draws by NUTS from the fit on its own log-density.

The density is that of `jaxid.make_problem`: Gaussian noise as it is stated, priors where they are
stated, otherwise flat between the bounds. Where the residual is larger than that noise or has a
memory, the noise counts for more, so that no interval is narrower than the fit's own standard
deviation: a model that misses the data would else be believed for its number of samples.

The chains begin about the fit: R-hat tells whether they agree there, not whether there is another
minimum elsewhere. Limits of R-hat and of effective samples: Vehtari et al. 2021.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.extras import needed
from jaxid.base.serialise import plain
from jaxid.base.versions import versions
from jaxid.fitting.covariance import covariance, CovarianceEstimate
from jaxid.fitting.fitter import Progress
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.nuts import Box, density_in_box, Draws, sample, Sampling
from jaxid.fitting.problem_builder import default_residual, ProblemBuilder
from jaxid.fitting.profiles import profile_likelihood
from jaxid.fitting.result import Fit
from jaxid.numerics.precision import float64
from jaxid.problem.binding import Binding
from jaxid.problem.problem import FitProblem
from jaxid.problem.pure_problem import pure, with_noise
from jaxid.problem.residual import Residual
from jaxid.problem.step_error import step_error, STEP_SHARE
from jaxid.simulation import sample_buffers as samples


#: Chains that have converged: R-hat of every number at most this, and at least so many effective
#: draws of its middle and of its tails for each chain.
R_HAT, EFFECTIVE = 1.01, 100


@dataclass(frozen=True)
class Marginal:
    """What the draws say of one number: mean, standard deviation, middle 95 %; whether its chains
    agree (`r_hat`, rank-normalised and split) and how many independent draws they are worth in the
    middle and in the tails. `profile_95`: the interval of the profile likelihood, an end None where
    the data do not bound it.
    """

    unit: str
    mean: float
    std: float
    interval_95: tuple[float, float]
    r_hat: float
    ess_bulk: float
    ess_tail: float
    profile_95: tuple[float | None, float | None]

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Posterior:
    """Draws of every fitted number and of unknown starts of runs.

    `draws`: name -> [chains draws] in the number's unit. `noise_factor`: how many times as large as
    stated the noise was counted. `inference_data()` is for ArviZ.
    """

    parameters: dict[str, Marginal]
    draws: dict[str, np.ndarray]
    log_density: np.ndarray  # [chains draws]
    diverging: np.ndarray
    acceptance: np.ndarray
    steps: np.ndarray
    warmup: int
    noise_factor: float
    unsettled: tuple[str, ...]  # why the chains are not to be believed; nothing where they are
    origin: Mapping[str, str]

    @property
    def converged(self) -> bool:
        """Whether the chains agree, do not diverge and have enough independent draws."""
        return not self.unsettled

    @property
    def divergences(self) -> int:
        """Steps on which the simulated energy was lost: the draws near there are not to be
        believed.
        """
        return int(self.diverging.sum())

    @property
    def chains(self) -> int:
        return self.diverging.shape[0]

    @property
    def statement(self) -> str:
        """One sentence on what was drawn and whether it may be believed."""
        each = self.diverging.shape[1]
        drawn = f"{self.chains} chains of {each} draws, {self.divergences} of them diverged"
        if self.converged:
            return f"the chains agree ({drawn})"
        return f"the chains are not to be believed ({drawn}): {'; '.join(self.unsettled)}"

    def inference_data(self) -> Any:
        """The draws as ArviZ's `InferenceData`. Raises `UsageError` without ArviZ."""
        statistics = {
            "lp": self.log_density,
            "diverging": self.diverging,
            "acceptance_rate": self.acceptance,
            "n_steps": self.steps,
        }
        return _arviz().from_dict(
            posterior=self.draws,
            sample_stats=statistics,
            attrs={**self.origin, "noise_factor": self.noise_factor},
        )

    def netcdf(self) -> bytes:
        """`posterior.nc`, which `arviz.from_netcdf` reads."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "posterior.nc"
            self.inference_data().to_netcdf(str(file), engine="h5netcdf")
            return file.read_bytes()

    def to_dict(self) -> dict[str, Any]:
        return plain(
            {
                "chains": self.chains,
                "draws": self.diverging.shape[1],
                "warmup": self.warmup,
                "divergences": self.divergences,
                "converged": self.converged,
                "text": self.statement,
                "noise_factor": self.noise_factor,
                "parameters": self.parameters,
            }
        )


def posterior_of(
    binding: Binding,
    residual: Residual | None,
    fit: Fit,
    sampling: Sampling,
    seed: int = 0,
    progress: Progress | None = None,
) -> Posterior:
    """Draws about a fit of this model and these data. Raises `UsageError` for a fit that failed, a
    loss that is no likelihood, runs that are too long, and where an extra is missing.
    """
    _arviz()
    refuse(fit)
    chosen = residual or default_residual(binding)
    problem = _problem(binding, chosen, fit.theta)
    start = problem.z(fit.theta)
    path = levenberg_marquardt([(problem, start)], 30, 1e-12)[0]
    z = path.z if np.isfinite(path.cost) else start
    cov = covariance(problem, z)
    factor = noise_factor(problem, cov)
    priors = [binding.priors.get(int(i), (np.nan, np.nan)) for i in problem.free]
    plain = pure(problem, z, np.array(priors, float).reshape(-1, 2))
    assert cov.hessian is not None
    with float64():
        counted = with_noise(plain, factor)
        box = Box.about(problem.lower, problem.upper, z, cov.hessian / factor**2)
        drawn = sample(density_in_box, box, counted, sampling, seed, progress)
    origin = {
        "model": fit.model,
        "dataset": fit.dataset,
        "dataset_sha256": fit.dataset_sha256,
        "residual": fit.residual,
        **{f"version_{name}": version for name, version in versions().items()},
    }
    return summarised(problem, z, drawn, sampling.warmup, factor, origin)


def refuse(fit: Fit) -> None:
    """Raises `UsageError` for a fit that has no posterior."""
    if fit.failed:
        raise UsageError(f"a fit that failed has no posterior: {fit.stopped_because}")
    if fit.loss_name != "sum_of_squares":
        raise UsageError(f"the loss {fit.loss_name} is not a likelihood; leave --loss out")
    if fit.recursion:
        raise UsageError("a fit along its blocks has no single posterior; leave --window out")


def _problem(binding: Binding, residual: Residual, theta: np.ndarray) -> FitProblem:
    """What was fitted, on steps fine enough, as a fit chooses them."""
    step = samples.STEP
    while True:
        bench = ProblemBuilder(binding, step)
        problem = bench.problem(residual, "fit", binding.free, theta)
        if problem.runs.engine.long:
            raise UsageError(
                "these runs are too long to be differentiated in reverse; take a part of each by"
                " window_s in dataset.toml"
            )
        if residual.torques or step <= samples.STEP / 8:
            return problem
        half = ProblemBuilder(binding, step / 2).runs(residual, "fit")
        if not step_error(problem, problem.z(theta), half) > STEP_SHARE:
            return problem
        step = step / 2


def noise_factor(problem: FitProblem, cov: CovarianceEstimate) -> float:
    """How many times as large as stated the noise counts, at least 1: until no number is narrower
    than its standard deviation of the fit, which knows of residuals that are larger or have a
    memory.
    """
    n = problem.free.size
    hessian = cov.hessian
    assert hessian is not None
    told = cov.identifiable & ~cov.at_bound & np.isfinite(cov.std)
    if not told[:n].any():
        return 1.0
    at = np.flatnonzero(told)
    narrow = np.sqrt(np.diag(np.linalg.inv(hessian[np.ix_(at, at)])))
    wider = cov.std[at] / narrow
    return float(max(1.0, wider[at < n].max()))


def summarised(
    problem: FitProblem,
    z: np.ndarray,
    drawn: Draws,
    warmup: int,
    factor: float,
    origin: Mapping[str, str],
) -> Posterior:
    """Draws of z in the numbers' units, with what they say of each and of themselves."""
    draws = {}
    for k, name in enumerate(problem.names):
        column = drawn.z[:, :, k]
        log = k < problem.free.size and problem.log[k]
        draws[name] = np.exp(column) if log else column
    units = {
        name: problem.runs.layout.entries[int(i)].unit
        for name, i in zip(problem.names, problem.free, strict=False)
    }
    profiles = profile_likelihood(problem, z)
    arviz = _arviz()
    quality: dict[str, tuple[float, float, float]] = {}
    for name, values in draws.items():
        quality[name] = (
            float(arviz.rhat(values)),
            float(arviz.ess(values, method="bulk")),
            float(arviz.ess(values, method="tail")),
        )
    parameters = {}
    for name, unit in units.items():
        values = draws[name]
        low, high = np.quantile(values, [0.025, 0.975])
        r_hat, bulk, tail = quality[name]
        parameters[name] = Marginal(
            unit=unit,
            mean=float(values.mean()),
            std=float(values.std(ddof=1)),
            interval_95=(float(low), float(high)),
            r_hat=r_hat,
            ess_bulk=bulk,
            ess_tail=tail,
            profile_95=profiles[name].interval,
        )
    return Posterior(
        parameters=parameters,
        draws=draws,
        log_density=drawn.log_density,
        diverging=drawn.diverging,
        acceptance=drawn.acceptance,
        steps=drawn.steps,
        warmup=warmup,
        noise_factor=factor,
        unsettled=tuple(unsettled(quality, drawn.diverging)),
        origin=origin,
    )


def unsettled(
    quality: Mapping[str, tuple[float, float, float]], diverging: np.ndarray
) -> list[str]:
    """Why the chains are not to be believed; nothing where they are."""
    chains = diverging.shape[0]
    said = []
    apart = [name for name, (r_hat, _, _) in quality.items() if not r_hat <= R_HAT]
    if apart:
        said.append(f"R-hat of {', '.join(apart)} is above {R_HAT}")
    least = EFFECTIVE * chains
    few = [name for name, (_, *ess) in quality.items() if not min(ess) >= least]
    if few:
        said.append(f"{', '.join(few)}: fewer than {least} effective draws; ask for more --draws")
    if diverging.any():
        said.append("steps diverged: a bend or an edge of the density was not followed")
    return said


def _arviz() -> Any:
    """ArviZ, without what it says of its own next version."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        needed("blackjax")
        return needed("arviz")
