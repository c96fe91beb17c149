"""What a diagnosis will need, before it begins: which way it goes, over how much of the data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from jaxid.base.errors import UsageError
from jaxid.data.capacity import Need, need, shortened
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.goals.run import dear, led
from jaxid.diagnosis.hypothesis import possible
from jaxid.diagnosis.last_resort import first_asked
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Effect
from jaxid.dynamics.joint_readings import all_read
from jaxid.fitting.lost_runs import AN_ARM
from jaxid.problem.binding import bind, resolve_model


#: Seconds of free runs beyond which an arm is compared along its measured motion, which takes few.
FREE_RUNS_S = 300.0


def foreseen(
    model: object,
    dataset: Dataset,
    effects: Iterable[str | Effect | type[Effect]] | None = None,
    without: Iterable[str] = (),
    residual: str | None = None,
) -> Need:
    """What a diagnosis of a model as it is given to a command will need."""
    nominal = resolve_model(model, dataset, without)
    asked = first_asked() if effects is None else tuple(map(catalogue.enrolled, effects))
    library = possible(nominal, asked, residual or "")
    way = way_of(nominal, residual or "")
    if way == "goals" and dataset.experiments and _is_dear(model, dataset, without):
        way = "motion"
    return _needed(nominal, dataset, library, way)


def looked_at(
    nominal: Chain, dataset: Dataset, library: Sequence[type[Effect]], residual: str = ""
) -> Dataset:
    """As much of a dataset as there is room and time for. Runs under goals that take too long to
    simulate are compared along the measured motion, and need not be cut.
    """
    if not dataset.experiments:
        return dataset
    way = way_of(nominal, residual)
    way = "motion" if way == "goals" else way
    return shortened(dataset, _needed(nominal, dataset, library, way))


def way_of(nominal: Chain, residual: str) -> str:
    """ "goals" under a drive law; the measured "motion" where torques are compared, as they are of
    an arm whose free run does not follow its recording; else "free runs".
    """
    if led(nominal) and not residual:
        return "goals"
    by_motion = residual == "inverse_dynamics" or (_is_arm(nominal) and not residual)
    return "motion" if by_motion else "free runs"


def long_free_runs(
    nominal: Chain, dataset: Dataset, library: Sequence[type[Effect]], residual: str = ""
) -> str:
    """Why an arm is compared along its measured motion though its free runs could be simulated:
    they would take too long. Empty where they would not, and where a residual is asked for.
    """
    if residual or not dataset.experiments or led(nominal) or not _is_arm(nominal):
        return ""
    seconds = _needed(nominal, dataset, library, "free runs").seconds
    if seconds <= FREE_RUNS_S:
        return ""
    return (
        f"free runs of this arm would take about {seconds / 60:.0f} minutes: the torque that the"
        " measured motion needs is compared instead (inverse_dynamics); --residual output_error"
        " asks for free runs"
    )


def _is_arm(nominal: Chain) -> bool:
    """Whether torques of several joints and their positions are recorded."""
    measured = nominal.direct and all_read(nominal) and not nominal.mechanism.hidden_states
    return measured and nominal.nq >= AN_ARM


def _needed(nominal: Chain, dataset: Dataset, library: Sequence[type[Effect]], way: str) -> Need:
    candidates = sum(len(nominal.offers(kind)) for kind in library)
    return need("diagnose", dataset, nominal.nq, candidates, way)


def _is_dear(model: object, dataset: Dataset, without: Iterable[str]) -> bool:
    """Whether simulations under the law would take too long."""
    try:
        return dear(bind(model, dataset, without=without))
    except UsageError:  # is said by who needs it
        return False
