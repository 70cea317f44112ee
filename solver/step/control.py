"""Control of steps and penalties: settings, memory, events and scratch, as arrays that compiled code works on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.inputs.maneuver import ACCELERATION, RATE, is_motion
from solver.model.saddle import CONDENSED, Saddle, new_saddle
from solver.model.state import State, new_state
from solver.step.settings import IntegratorSettings

RAISE = 10.0  # factor by which a penalty changes at a time; ten times as much passes over penalties that would do
EASY_STEPS = 10  # easy steps in a row before penalties and step relax; twice as many after every new trouble
# Easy steps in a row, most that are waited for; ten times as much keeps a small step ten times as long.
LONGEST_PATIENCE = 640.0

WANTED, TAKEN, LAST_ERROR, EASY, PATIENCE = range(5)  # entries of Control.memory
(
    OPEN,
    DONE,
    CAUSE,
    UNDETERMINED,
    TRIED,
    H_BEFORE,
    ERROR_BEFORE,
    H_LAST,
    ERROR_LAST,
    H_BEST,
    ERROR_BEST,
    ABANDON,
    FAILED,
) = range(13)
PROGRESS = FAILED + 1  # entries of Control.progress, which OPEN is the first of
SUBSTEPS, REJECTED, PENDING = range(3)  # entries of Control.counts
KINDS = ('step', 'penalty', 'error')
CAUSES = ('failure', 'error', 'stagnation', 'no help', 'easy', 'undetermined')
OF_STEP, OF_PENALTY, OF_ERROR = map(float, range(len(KINDS)))
FAILURE, ERROR, STAGNATION, NO_HELP, EASY_GOING, NOT_DETERMINED = map(float, range(len(CAUSES)))
ROOM = 256  # events beyond those that one attempt can make


class Event(NamedTuple):
    """A change of the step or of the penalty of a constraint row; kind 'error': the error that had to be accepted."""

    t: float  # start of the step that caused it [s]
    kind: str  # of KINDS
    name: str  # of the row, else empty
    old: float  # s, or dimensionless
    new: float
    cause: str  # of CAUSES


class History(NamedTuple):
    """Data that a state needs beside itself when the next step is of another size."""

    size: np.ndarray  # (2,) [s] of the step that led to it, and between the stage before the last and the last
    offset: np.ndarray  # (nb + 1, 6) its velocity minus the projected one
    z_rate: np.ndarray  # (nz,) rate of zd


class Kept(NamedTuple):
    """Copies of what an attempt or an interval changes, to go back to."""

    memory: np.ndarray  # that of Control at the start of the interval, and so on
    history: History
    penalty: np.ndarray  # (nc,)
    account: np.ndarray  # its numbers (solver.output.account)
    account_before: np.ndarray  # before an attempt, but the first of an interval
    penalty_before: np.ndarray  # before penalties were raised
    v: np.ndarray  # of a state whose history is moved
    a: np.ndarray
    zd: np.ndarray
    v_full: np.ndarray  # (nb + 1, 6) projected velocity of the step that another two are compared with


class Control(NamedTuple):
    """The control of one simulation. Its memory, history and the penalties are all that the future depends on."""

    by_error: int  # 1: the local error is controlled
    fourth: int  # address of solver.step.extrapolation.extrapolate, 0: second order
    adaptive: int  # 1: penalties adapt
    group: int  # steps that are taken together
    h_ns: int  # the grid of inputs and outputs
    grid: float  # the same [s]
    hold: float  # part of an interval of the grid from where force-like inputs are taken to its end
    h_min: float
    error_tolerance: float
    tolerance: float  # of the iteration
    penalty_cap: float
    base: np.ndarray  # (nc,) penalties to return to
    internal_size: np.ndarray  # (nz,) what errors of internal states count relative to
    motion: np.ndarray  # (n, 3) inputs of prescribed motions: value, rate, acceleration
    memory: np.ndarray  # (5,) WANTED and TAKEN step [s], LAST_ERROR [1/s], EASY steps so far, PATIENCE
    history: History  # of the present state
    counts: np.ndarray  # (3,) SUBSTEPS, REJECTED, PENDING events
    events: np.ndarray  # (room, 6) time, kind, row, old, new, cause
    reserve: int  # events that one attempt can make
    # (PROGRESS,) of the interval that is OPEN; an interval that is not done yet is taken up by the next call
    progress: np.ndarray
    middle: History  # after the first of two steps
    next: History  # after an attempt of two steps, which may not be accepted
    begin: State  # of the interval, once a part of it is done
    full: State  # after one step instead of two
    masses: Saddle  # of order four, else empty
    half: State  # after the first of two steps
    kept: Kept
    u_middle: np.ndarray  # (nu,) inputs after the first of two steps
    u_end: np.ndarray  # and after both


def new_history(model) -> History:
    """Allocate for a model."""
    return History(np.zeros(2), np.zeros((model.n_bodies + 1, 6)), np.zeros(model.n_internal))


def new_control(model, settings: IntegratorSettings, hold: float, fourth: int, size: int) -> Ref:
    """Allocate for a model (Control, by reference). hold, fourth: see there. size: numbers of its account."""
    nb, nc, nz, names = model.n_bodies, model.n_rows, model.n_internal, model.spec.inputs
    by_error, adaptive = settings.step_policy == 'error', settings.penalty_policy == 'adaptive'
    motions = [n for n in names if is_motion(n, names)]
    raises = 1 + max(1, math.ceil(math.log10(settings.penalty_cap / settings.penalty))) if adaptive else 0
    reserve = 4 + (3 * raises + 4) * nc
    masses = new_saddle(model, CONDENSED)
    if not fourth:
        masses = Saddle(*(np.zeros((1, *array.shape[1:])) for array in masses))
    six = lambda: np.zeros((nb + 1, 6))  # noqa: E731
    kept = Kept(
        memory=np.zeros(5), history=new_history(model), penalty=np.zeros(nc), account=np.zeros(size),
        account_before=np.zeros(size),
        penalty_before=np.zeros(nc), v=six(), a=six(), zd=np.zeros(nz), v_full=six(),
    )  # fmt: skip
    control = Control(
        by_error=int(by_error), fourth=fourth, adaptive=int(adaptive), group=2 if by_error or fourth else 1,
        h_ns=settings.h_ns, grid=settings.h_ns * 1e-9, hold=hold, h_min=settings.smallest_step,
        error_tolerance=settings.error_tolerance, tolerance=settings.tolerance, penalty_cap=settings.penalty_cap,
        base=np.full(nc, settings.penalty), internal_size=np.array(model.internal_size, float),
        motion=np.array([[names.index(n + end) for end in ('', RATE, ACCELERATION)] for n in motions],
        np.int64).reshape(-1, 3),
        memory=np.zeros(5), history=new_history(model), counts=np.zeros(3, np.int64),
        events=np.zeros((reserve + ROOM, 6)),
        reserve=reserve, progress=np.zeros(PROGRESS), middle=new_history(model), next=new_history(model),
        begin=new_state(model), full=new_state(model), masses=masses, half=new_state(model), kept=kept,
        u_middle=np.zeros(len(names)), u_end=np.zeros(len(names)),
    )  # fmt: skip
    return Ref(control)


@kernel(inner=True)
def note_event(control, t, kind, row, old, new, cause):
    """Append an event; whoever makes attempts sees to the room for it (Control.reserve)."""
    k = control.counts[PENDING]
    if k >= control.events.shape[0]:
        return
    event = control.events[k]
    event[0], event[1], event[2], event[3], event[4], event[5] = t, kind, row, old, new, cause
    control.counts[PENDING] = k + 1


@kernel(inner=True)
def copy_vector(source, target):
    """target <- source, (n,)."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@kernel(inner=True)
def copy_table(source, target):
    """target <- source, (n, m)."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@kernel(inner=True)
def copy_history(source, target):
    """target <- source."""
    copy_vector(source.size, target.size)
    copy_table(source.offset, target.offset)
    copy_vector(source.z_rate, target.z_rate)


@kernel(inner=True)
def copy_whole_state(source, target):
    """target <- source, as solver.model.state.copy_state does from Python."""
    copy_table(source.q, target.q)
    copy_table(source.v, target.v)
    copy_table(source.a, target.a)
    copy_table(source.a_stage, target.a_stage)
    copy_table(source.a_stage_before, target.a_stage_before)
    copy_vector(source.z, target.z)
    copy_vector(source.zd, target.zd)
    copy_vector(source.lam, target.lam)
    copy_vector(source.lam_before, target.lam_before)
    copy_vector(source.angle, target.angle)
