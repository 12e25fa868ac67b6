"""Motion in steps of a given length."""

from __future__ import annotations

from animtool.sim.division import Division, divide
from animtool.sim.run import LOOK_EVERY, Run
from animtool.sim.system import Native
from animtool.sim.trajectory import Status


def advance(run: Run, target: float) -> Status:
    """Bring a motion to a later time, in even steps."""
    assert run.options.step is not None
    division = divide(run.time, target, run.options.step)
    native = run.equations.system.native(run.integrator.name)
    go = _stepwise(run, division) if native is None else _blocks(run, division, native)
    # The last step's end is the time asked for, but for rounding.
    run.time = target if go is Status.OK else run.time
    return go


def _stepwise(run: Run, division: Division) -> Status:
    take = run.integrator.step
    assert take is not None
    for i in range(division.count):
        t = division.time(i)
        step = take(run.equations, t, run.state, division.h, run.memory)
        if step is None:
            reason = "Newton's method found no solution"
            return run.stop(Status.NOT_SOLVED, reason)
        go = run.keep(step, division.time(i + 1), division.h)
        if go is not Status.OK:
            return go
    return Status.OK


def _blocks(run: Run, division: Division, native: Native) -> Status:
    """Take the steps many at once, as many as may go without a look."""
    each = run.integrator.evaluations or 1
    for i in range(0, division.count, LOOK_EVERY):
        count = min(LOOK_EVERY, division.count - i)
        run.state = native(division.time(i), run.state, division.h, count)
        run.equations.evaluations += each * count
        go = run.count(division.time(i + count), division.h, count)
        if go is not Status.OK:
            return go
    return Status.OK
