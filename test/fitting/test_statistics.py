"""Intervals contain the truth as often as they say, whatever the residuals are: a model that is cheap and linear."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mbd_sim_ros.fitting import estimation, solve
from mbd_sim_ros.fitting.covariance import covariance_of, scatter_of
from mbd_sim_ros.fitting.estimation import noise_of
from mbd_sim_ros.fitting.file import Channel, Known
from mbd_sim_ros.fitting.noise import Noise, estimated, whitened
from mbd_sim_ros.fitting.problem import STEP, Piece, Problem
from mbd_sim_ros.fitting.recordings import Window
from mbd_sim_ros.fitting.runs import Job
from mbd_sim_ros.fitting.sensors import LOOK
from mbd_sim_ros.fitting.solve import Found, descend, within
from mbd_sim_ros.fitting.unknowns import Unknown, unknowns_of
from mbd_sim_ros.lab.studies.fit_coverage import SWINGS, drives, file_of
from mbd_sim_ros.lab.usual_track import UsualTrack, distances
from solver.errors import MbdError, StepError
from solver.vehicle.size import Size


class Linear(Problem):
    """Signals that are sums of smooth functions of time, one for each unknown; residuals with noise and discrepancy."""

    def __init__(
        self, seed: int, *, windows: int, discrepancy: float, prior: float = math.inf, hard: float = 1.0
    ) -> None:
        random = np.random.default_rng(seed)
        self.t = 0.1 * np.arange(80)
        self.windows = [Window('made', 'fit', 10.0 * k, 10.0 * k, 10.0 * k + 8.0) for k in range(windows)]
        self.unknowns = [
            Unknown(f'p{k}', 'vehicle', f'p{k}', 0.0, prior if k == 0 else math.inf, 1.0, sought=True) for k in range(3)
        ]
        self.names = [u.name for u in self.unknowns]
        phase = 6.3 * random.random((windows, 3, 4))
        rates = 0.3 + 1.7 * random.random((windows, 3, 4))
        self.basis = np.sin(rates[..., None] * self.t + phase[..., None]).sum(axis=2).transpose(0, 2, 1)
        self.truth = np.array([prior * random.standard_normal() if math.isfinite(prior) else 0.7, -0.4, 0.2])
        L = Noise(0.3, discrepancy, 0.8).factor(self.t)
        # every fourth window has residuals that are larger by a factor, of which the weights know nothing
        sizes = np.where(np.arange(windows) % 4 == 0, hard, 1.0)
        values = [B @ self.truth + s * (L @ random.standard_normal(80)) for B, s in zip(self.basis, sizes, strict=True)]
        self.pieces = [Piece(k, 'signal', self.t, y, np.zeros(80)) for k, y in enumerate(values)]
        self.undriven = set()
        self.noise, self._factors, self.runs = {'signal': Noise(0.3, 0.1, 0.4)}, {}, 0
        self.file = type('File', (), {'channels': {'signal': None}, 'seed': 1, 'level': 'made'})()

    def many(self, points, which):
        return [[self.basis[k] @ x for k in which] for x in points]

    def signals(self, x, motions, which):
        return list(motions)


def fitted(problem: Linear):
    which, free = problem.of('fit'), np.ones(3, bool)
    best = descend(problem, problem.start, which, free)
    for _ in range(3):
        problem.set_noise(noise_of(problem, best.r, which))
        best = descend(problem, best, which, free)
    covariance, _ = covariance_of(problem, best)
    return best.x, np.sqrt(np.diag(covariance))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('discrepancy', 'windows', 'hard'), [(0.05, 10, 1.0), (0.6, 10, 1.0), (0.3, 5, 1.0), (0.3, 12, 4.0)]
)
def test_coverage(discrepancy: float, windows: int, hard: float) -> None:
    """95 % intervals of 60 fits of 3 numbers, also where windows are few or their residuals of another size than the
    weights say: of 180 that cover with 95 % at most 21 miss (1 in 1000) and at least one does (1 in 10000), and with
    weights of white noise alone far more would."""
    inside, white = 0, 0
    for seed in range(60):
        problem = Linear(seed, windows=windows, discrepancy=discrepancy, hard=hard)
        x, sd = fitted(problem)
        inside += int(np.sum(np.abs(x - problem.truth) < 1.96 * sd))
        W = np.concatenate(problem.basis)
        plain = np.linalg.lstsq(W, np.concatenate([p.y for p in problem.pieces]), rcond=None)[0]
        r = np.concatenate([p.y for p in problem.pieces]) - W @ plain
        naive = np.sqrt(np.diag(np.linalg.inv(W.T @ W)) * np.var(r))
        white += int(np.sum(np.abs(plain - problem.truth) < 1.96 * naive))
    assert 180 - 21 <= inside < 180
    if discrepancy > 0.5:
        assert white < 150  # who takes residuals for white claims intervals that are too small


def clusters(windows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened derivatives of windows of another weight each, the window of every sample, and what is known before."""
    random = np.random.default_rng(4)
    J = np.concatenate([(0.3 + k) * random.standard_normal((12, 3)) for k in range(windows)])
    return J, np.repeat(np.arange(windows), 12), np.array([0.0, 5000.0, 0.0])


def test_scatter_of_windows() -> None:
    """Where the weights are right the variance of the windows has the mean of theirs, and the scatter of its degrees of
    freedom: over 1000 draws to 4 of their standard errors, and the scatter to a seventh."""
    J, rows, prior = clusters(6)
    C = np.linalg.inv(J.T @ J + np.diag(prior))
    random, found = np.random.default_rng(1), []
    for _ in range(1000):
        truth = np.array([0.7, random.standard_normal() / math.sqrt(prior[1]), -0.3])
        y = J @ truth + random.standard_normal(rows.size)
        found.append(scatter_of(J, y - J @ (C @ J.T @ y), rows, prior).variance)
    variance, freedom = np.mean(found, axis=0), scatter_of(J, np.zeros(rows.size), rows, prior).freedom
    assert np.abs(variance / np.diag(C) - 1.0).max() < 4.0 * math.sqrt(2.0 / freedom.min() / 1000)
    assert np.std(found, axis=0) == pytest.approx(variance * np.sqrt(2.0 / freedom), rel=0.15)
    assert freedom[0] < 6.0 < freedom[1]  # what is known before has a variance that is known


def test_scatter_beside_a_bootstrap_of_blocks() -> None:
    """Windows drawn with replacement and fitted again ([Efron1993]) scatter as far, where they are many and alike."""
    windows = 40
    random = np.random.default_rng(3)
    J, rows = random.standard_normal((12 * windows, 3)), np.repeat(np.arange(windows), 12)
    shared = random.standard_normal((windows, 3))  # residuals that are alike in a window: no weights of white noise
    r = np.einsum('ij,ij->i', J, 0.8 * shared[rows]) + random.standard_normal(rows.size)
    r -= J @ np.linalg.lstsq(J, r, rcond=None)[0]
    sd = np.sqrt(scatter_of(J, r, rows, np.zeros(3)).variance)
    drawn = []
    for _ in range(1000):
        at = np.concatenate([np.flatnonzero(rows == k) for k in random.integers(0, windows, windows)])
        drawn.append(np.linalg.lstsq(J[at], r[at], rcond=None)[0])
    assert sd == pytest.approx(np.std(drawn, axis=0), rel=0.15)
    assert (sd > 1.5 * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))).all()


def test_no_drive_tells_the_scale_of_a_mass() -> None:
    """Mass, yaw inertia and all forces of a single track times one factor leave its motion as it is. Derivatives say so
    at the limit of the tires too: all samples together see of 3 % less than a twentieth of a standard deviation."""
    problem, _ = drives(3, SWINGS['at the limit'])
    which = problem.of('fit')[:6]
    x = problem.start
    J = problem.white(problem.jacobian(x, which, problem.motions(x, which)), which)
    scaled = ('mass', 'yaw_inertia', 'stiffness_front', 'stiffness_rear', 'friction_front', 'friction_rear')
    factor = np.array([0.03 * u.centre / u.width if u.name in scaled else 0.0 for u in problem.unknowns])
    assert np.linalg.norm(J[:, factor > 0.0] * factor[factor > 0.0]) > 10.0
    assert np.linalg.norm(J @ factor) < 0.05


class Bent(Problem):
    """Signals (x, x + bend x^2) of each of two numbers beside measured (-1, 1), times 1000: the sum of squares
    1e6 (2 + 2 (1 - bend) x^2 + 2 bend x^3 + bend^2 x^4) has its minimum at 0, where Gauss-Newton goes on to `bend` of
    the distance ([Dennis1981])."""

    def __init__(self, bend: float) -> None:
        self.bend, self.turn = bend, np.array([[0.8, 0.6], [-0.6, 0.8]])
        self.unknowns = [Unknown(f'p{k}', 'made', f'p{k}', 0.0, math.inf, 1.0, sought=True) for k in range(2)]
        self.asked = 0

    def motions(self, x, which):
        return [x]

    def residuals(self, x, which, motions=None):
        z = self.turn @ x
        return 1e3 * np.concatenate([-1.0 - z, 1.0 - z - self.bend * z * z])

    def jacobian(self, x, which, motions, only=None, step=STEP, central=True):
        self.asked += 1
        z = self.turn @ x
        return 1e3 * np.concatenate([self.turn, (1.0 + 2.0 * self.bend * z)[:, None] * self.turn])

    def white(self, values, which):
        return values


@pytest.mark.parametrize('bend', [0.9, -0.9, 0.5, 0.0])
def test_residuals_that_are_large(bend: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where residuals are large, Gauss-Newton alone goes on by a part of the distance; with the curvature that the
    derivatives before tell, the minimum is found with half of them at most, and within the iterations there are."""
    free, begin = np.ones(2, bool), Bent(bend).turn.T @ [0.5, 0.3]  # on this side there is no other minimum
    problem, plain = Bent(bend), Bent(bend)
    found = descend(problem, begin, [0], free)
    assert 2e6 * (1.0 - bend) * float(found.x @ found.x) < 10.0 * solve.GAIN
    monkeypatch.setattr(solve.Curvature, 'added', lambda self, G, damping: G)
    if bend > 0.8:
        with pytest.raises(StepError, match='does not come to rest'):
            descend(plain, begin, [0], free)
    else:
        descend(plain, begin, [0], free)
    assert problem.asked <= (0.5 * plain.asked if bend else plain.asked)


def test_prior_is_kept_where_nothing_is_told() -> None:
    """Of a number that no signal depends on the interval is that known before."""
    problem = Linear(3, windows=6, discrepancy=0.1, prior=0.5)
    problem.basis[:, :, 0] = 0.0
    problem.pieces = [p._replace(y=B @ problem.truth) for p, B in zip(problem.pieces, problem.basis, strict=True)]
    x, sd = fitted(problem)
    assert abs(x[0]) < 1e-3
    assert sd[0] == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(('noise', 'size', 'time'), [(0.3, 0.6, 0.8), (0.1, 1.0, 0.3), (1.0, 0.5, 1.5)])
def test_noise_is_found(noise: float, size: float, time: float) -> None:
    """Noise, discrepancy and its time from 60 windows: to a quarter, the scatter of autocovariances of so many."""
    random, t = np.random.default_rng(5), 0.05 * np.arange(240)
    L = Noise(noise, size, time).factor(t)
    found = estimated([(t, L @ random.standard_normal(t.size)) for _ in range(60)], 1e-6)
    assert found.noise**2 + found.size**2 == pytest.approx(noise**2 + size**2, rel=0.1)
    assert found.size == pytest.approx(size, rel=0.25)
    assert 0.5 * time < found.time < 2.0 * time


def test_white_residuals_are_taken_for_white() -> None:
    """Without correlation nearly all is noise."""
    random, t = np.random.default_rng(2), 0.05 * np.arange(200)
    found = estimated([(t, random.standard_normal(t.size)) for _ in range(30)], 1e-6)
    assert found.noise == pytest.approx(1.0, rel=0.05)
    assert found.size < 0.25


def test_whitened() -> None:
    """Over its Cholesky factor a covariance is the identity."""
    t = np.sort(np.random.default_rng(0).random(30))
    L = Noise(0.2, 1.0, 0.3).factor(t)
    assert np.allclose(whitened(L, L @ L.T) @ np.linalg.inv(L).T, np.eye(30), atol=1e-9)


def test_derivative_at_the_edge_of_what_a_vehicle_can_have() -> None:
    """One-sided derivatives are taken from the other side where no vehicle has the number on the first one; without
    both sides the error says why."""
    problem = Linear(1, windows=2, discrepancy=0.1)
    which, x = problem.of('fit'), np.array([0.3, -0.2, 0.1])
    high, low = 0.3 + 0.2 * STEP, -1.0

    def many(points, which):
        return [
            [problem.basis[k] @ p for k in which] if low <= p[0] <= high else StepError('no vehicle has this number')
            for p in points
        ]

    problem.many = many
    motions = many([x], which)[0]
    exact = np.concatenate([problem.basis[k] for k in which])
    for central in (False, True):
        J = problem.jacobian(x, which, motions, central=central)
        assert np.allclose(J, exact, atol=1e-9)
    low = 0.3 - 0.2 * STEP
    with pytest.raises(StepError, match='no vehicle has this number'):
        problem.jacobian(x, which, motions, central=False)


def test_weights_may_be_taken_on_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """One iteration is not enough: a fit that must be at rest is refused, and one that need not has come nearer, with
    derivatives of where it is."""
    problem = Linear(2, windows=3, discrepancy=0.1)
    which, free = problem.of('fit'), np.ones(3, bool)
    there = descend(problem, problem.start, which, free)
    monkeypatch.setattr(solve, 'MOST', 1)
    with pytest.raises(StepError, match='does not come to rest within 1 iterations'):
        descend(problem, problem.start, which, free)
    found = descend(problem, problem.start, which, free, rest=False)
    white = problem.white(problem.residuals(problem.start, which), which)
    assert there.cost <= found.cost < 0.9 * float(white @ white)
    assert np.allclose(found.J, np.concatenate([problem.basis[k] for k in which]), atol=1e-9)


@pytest.mark.parametrize('factor', [-0.8, -0.65, 0.0, 0.5])
def test_a_level_is_derived_where_its_minimum_stays(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables derived c from the minimum of the exact model have theirs factor * c from it: 5 standard deviations off,
    six derivations one after the other would leave 5 * 0.8^6 = 1.3, and 5 * 0.65^6 = 0.38."""
    exact, asked = np.array([1.0, -2.0]), list[np.ndarray]()

    class Derived:
        unknowns, prior = (), np.zeros(2)

        def linearize(self, x: np.ndarray) -> None:
            asked.append(x)

        def white(self, J: np.ndarray, _: object) -> np.ndarray:
            return J

    def at(x: np.ndarray) -> Found:
        return Found(x, [], np.zeros(2), np.eye(2), 0.0)

    def minimum(_: object, begin: np.ndarray, *__: object) -> Found:
        assert begin is asked[-1]
        return at(exact + factor * (begin - exact))

    monkeypatch.setattr(estimation, 'descend', minimum)
    first = at(exact + np.array([5.0, -1.0]))
    found = estimation._recentred(Derived(), first, [0], np.ones(2, bool), lambda _: None)  # type: ignore[arg-type]
    # it moved by less than SAME, which is 1 - factor times what the place of derivation was off
    assert np.abs(found.x - exact).max() <= abs(factor) / (1.0 - factor) * estimation.SAME
    assert len(asked) <= estimation.RECENTRED


@pytest.mark.parametrize(
    ('least', 'most', 'expected'),
    [
        ((-9.0, -9.0), (9.0, 9.0), (-4.2105263, 5.7894737)),  # inside
        ((0.0, -9.0), (9.0, 9.0), (0.0, 2.0)),  # the first is held, and the second one compensates for nothing
        ((-9.0, -9.0), (9.0, 1.0), (0.1, 1.0)),  # A[0, 0] x + 0.9 * 1 = 1: the other way round
        ((-2.0, -9.0), (9.0, 1.0), (0.1, 1.0)),
        ((-1.0, -9.0), (9.0, 9.0), (-1.0, 2.9)),
        ((0.5, 0.5), (0.6, 0.6), (0.5, 0.6)),
    ],
)
def test_step_between_bounds(least: tuple, most: tuple, expected: tuple) -> None:
    """The minimum of a parabola in a box, by its conditions: no slope along what is free."""
    A, g = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([1.0, 2.0])
    assert within(A, g, np.array(least), np.array(most)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ('known', 'lead'),
    [
        (None, 0.08),  # a usual sensor, to 20 ms
        (Known(sd=0.005), 0.02),
        (Known(value=-0.05, sd=0.01), 0.09),
        (Known(value=0.1, sd=0.01), 0.0),
        (Known(value=-0.03, sd='none'), 0.03),
        (Known(sd='none'), 0.0),
        (Known(), LOOK),  # nothing is known
    ],
)
def test_sensors_may_be_early(known: Known | None, lead: float) -> None:
    """A sensor shows a motion up to four standard deviations of its delay before it happens."""
    file = dataclasses.replace(file_of(('one', 'held')), channels={'yaw_rate': Channel(channel='r', delay=known)})
    car = UsualTrack(1500.0, *distances(2.7, 0.54), 0.01, Size())
    assert unknowns_of(file, car, {'yaw_rate': 'yaw_rate'}).lead('yaw_rate', LOOK) == pytest.approx(lead)


@pytest.mark.parametrize(('seed', 'swing'), [(900002, 0.55), (900002, 0.9), (900005, 0.9), (900007, 0.9)])
def test_truth_has_no_residual(seed: int, swing: float) -> None:
    """Without noise the true numbers explain every window to its last sample, also where sensors are early (the first
    two by up to 25 ms). No unknown is off by more of its standard deviations than the norm of the whitened residuals;
    what a run-in leaves of its start is less than a third."""
    problem, truth = drives(seed, swing, loud=0.0)
    x = np.array([(truth[u.name] - u.centre) / u.width for u in problem.unknowns])
    which = problem.of('fit')
    assert np.linalg.norm(problem.white(problem.residuals(x, which), which)) < 0.3


@pytest.mark.slow
def test_a_fit_goes_on_without_the_windows_that_cannot_be_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    """One window in which the vehicle as it is given spins, and one held out in which it does with fitted sensors: both
    are named, and the numbers are those of the others, as of a drive that never had them."""
    problem, truth = drives(900002, SWINGS['below the limit'])
    given, drive = problem._job(problem.start, [0]), problem.drive

    def spins(job: Job) -> np.ndarray | MbdError:
        if 2 in job.which or (16 in job.which and job.steering != given.steering and job.car == given.car):
            return StepError('it spins')
        return drive(job)

    monkeypatch.setattr(problem, 'drive', spins)
    found = estimation.fit(problem)
    assert [*problem.of('fit'), *problem.of('held_out')] == [k for k in range(21) if k not in (2, 16)]
    assert sum('cannot drive them (it spins)' in line for line in problem.told) == 2
    alone, _ = drives(900002, SWINGS['below the limit'])
    alone.undriven |= {2, 16}
    alone.pieces = [p for p in alone.pieces if p.window not in (2, 16)]
    same = estimation.fit(alone)
    for name, one in same.parameters.items():
        assert found.parameters[name].value == pytest.approx(one.value, abs=0.1 * one.sd)
        assert abs(one.value - truth[name]) < 4.0 * one.sd
