"""Jobs side by side: their order, what they tell, and what stops them."""

import threading
from concurrent.futures import CancelledError

import jax.numpy as jnp
import pytest

from jaxid.numerics.side_by_side import side_by_side


def test_results_come_in_order_in_float64_and_are_told_in_the_callers_thread():
    own, told = threading.current_thread(), []

    def tell(*words):
        told.append((words, threading.current_thread() is own))

    def job(k):
        def work(say):
            say("begun", k)
            return k, jnp.asarray(0.1).dtype.name, threading.current_thread() is own

        return work

    made = side_by_side([job(k) for k in range(5)], tell)
    assert [b.result() for b in made] == [(k, "float64", False) for k in range(5)]
    assert sorted(told) == [(("begun", k), True) for k in range(5)]


def test_what_interrupts_the_caller_stops_jobs_where_they_next_tell_something():
    """A job that is finished stays, one at work is stopped, one that has not begun is cancelled."""

    def finished(say):
        return "kept"

    def endless(say):
        while True:
            say("still at it")

    def never(say):
        raise AssertionError("was begun")

    def tell(*_):
        raise KeyboardInterrupt

    made = side_by_side([finished, endless, never], tell, workers=1)
    assert made[0].result() == "kept"
    with pytest.raises(KeyboardInterrupt):
        made[1].result()
    with pytest.raises(CancelledError):
        made[2].result()


@pytest.mark.parametrize("where", ["a job", "tell"])
def test_a_fault_does_not_wait_for_the_others_to_finish(where):
    def endless(say):
        while True:
            say()

    def faulty(say):
        say()
        if where == "a job":
            raise ValueError("broken")
        return endless(say)

    def tell():
        if where == "tell":
            raise ValueError("broken")

    if where == "tell":
        with pytest.raises(ValueError, match="broken"):
            side_by_side([endless, faulty], tell, workers=2)
    else:
        made = side_by_side([endless, faulty], tell, workers=2)
        assert isinstance(made[0].exception(), KeyboardInterrupt) and isinstance(
            made[1].exception(), ValueError
        )
