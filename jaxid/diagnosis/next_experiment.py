"""What to record next so that what cannot be told apart now can be told apart then."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from jaxid.base.wording import listed
from jaxid.diagnosis.evidence import knowledge
from jaxid.diagnosis.hypothesis import Hypothesis
from jaxid.diagnosis.unseen import Unseen
from jaxid.dynamics import catalogue
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.excitation.discriminate import recorded, Rivals
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.simulation.sample_buffers import columns


#: What the effects of a transmission ask for beside a motion.
SECOND = re.compile(r"(?:;|, and) a second encoder at the link")


def rivals_of(bench: ProblemBuilder, pair: tuple[Hypothesis, Hypothesis]) -> Rivals | None:
    """The two hypotheses that further data should decide between, as models without all other
    candidates.
    """
    b = bench.binding
    if not b.dataset.experiments:
        return None
    first, second = pair
    present = {c.effect for c in (*first.effects, *second.effects)}
    spare = []
    for e in b.chain.effects:
        own = not b.nominal.isdisjoint(b.layout.of_effect(e.name))
        if not own and e.name not in present:
            spare.append(e.name)
    layout = ParameterVector(b.chain.without(*spare))
    at = [b.layout.index(name) for name in layout.names]
    place = {i: k for k, i in enumerate(at)}
    p, told = second.path.problem, knowledge(second.path)
    free = [int(i) for i in p.free]
    information = np.zeros((len(free), len(free))) if told is None else told[1]
    iu, iy = columns(b.dataset, b.chain)
    joints = [iy[k] for k in b.chain.joint_outputs]
    return Rivals(
        names=(words(first), words(second)),
        layout=layout,
        theta=np.array([h.theta[at] for h in pair]),
        free=tuple(place[i] for i in free),
        slope=p.dtheta(second.path.z),
        information=information,
        noise=b.sigma,
        recorded=recorded(b.dataset.experiments, iu, joints),
    )


def words(h: Hypothesis) -> str:
    return " and ".join(map(str, h.effects)) or "the model as it is"


def advice(
    verdict: str,
    named: Sequence[str],
    mates: Sequence[str],
    rivals: Rivals | None = None,
    unseen: Sequence[Unseen] = (),
    repeated: bool = False,
    still: Sequence[str] = (),
    read_twice: Sequence[str] = (),
) -> str:
    """Sentences a person can act on; effects by id. `repeated`: the recording holds repeats of a
    run, which gave the noise; `still`: splits in which nothing moves; `read_twice`: two encoders of
    one joint that the recording holds.
    """
    if still:
        kept = " and ".join(still)
        return (
            f"What is kept as {kept} data has to move: record another run, state in dataset.toml"
            " the split of runs that move, or cut the standstill off with window_s, so that the"
            " parts of one run fall where it moves."
        )
    text = _advice(verdict, named, mates, unseen, repeated)
    if read_twice and SECOND.search(text):
        told = f"`jaxid check` says what the difference of {listed(tuple(read_twice))} shows"
        text = f"{SECOND.sub('', text)} Both ends of a joint are recorded: {told}."
    open_ = (
        any(not u.absorbed for u in unseen) if verdict == "none" else verdict != "named" or mates
    )
    if rivals is None or not rivals.recorded.top.any() or not open_:
        return text
    a, b = rivals.names
    return (
        f'{text} The option --next DIR designs the input that best tells "{a}" from "{b}", and'
        " writes it to be played."
    )


def _advice(
    verdict: str,
    named: Sequence[str],
    mates: Sequence[str],
    unseen: Sequence[Unseen],
    repeated: bool,
) -> str:
    if verdict == "none":
        text = (
            "No further experiment is needed for this model: it reaches the noise floor on data"
            " that were not fitted."
        )
        others = [u for u in unseen if not u.absorbed]
        if others:
            first = others[0]
            text += f" Motions of another kind may need more: {first} would not show in these"
            if first.moved:
                m = first.moved[0]
                text += (
                    f" ({m.name} would pass for it: {m.without:.3g} {m.unit} fitted, {m.beside:.3g}"
                    " with it)"
                )
            text += f"; to see it: {catalogue.effect_class(first.effect).excitation}."
        return text
    wanted = list(dict.fromkeys([*named, *mates]))
    if mates and len(wanted) == 1:
        kind = catalogue.effect_class(wanted[0])
        look = f"{kind.check[:1].lower()}{kind.check[1:].rstrip('.')}"
        return (
            f"The data leave open at which place {kind.name} acts. At the machine: {look}. As far"
            f" as motions can tell, these do: {kind.excitation}."
        )
    if mates:
        parts = [f"for {name}: {catalogue.effect_class(name).excitation}" for name in wanted]
        return "To tell apart what the data leave open, record " + "; ".join(parts) + "."
    if verdict == "named":
        repeat = "" if repeated else "; repeat one run to learn the repeatability of the machine"
        return f"No further experiment is needed to separate causes{repeat}."
    repeat = "Record" if repeated else "Repeat one run unchanged (repeatability), record"
    rest = (
        "Something remains that no effect of the library explains."
        if verdict == "partly"
        else "What is missing is not known yet."
    )
    return (
        f"{rest} {repeat} slow ramps through zero speed, a standstill under several loads, and one"
        " run each at half and full speed."
    )
