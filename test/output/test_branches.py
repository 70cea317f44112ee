"""A mechanism that leaves a singular position on another branch than it came in on is found out."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from solver import simulation_of
from solver.analysis.verdict import findings
from solver.compiled.so3 import quaternion_exp
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.model.state import copy_state
from solver.output.branches import BranchSwitch, BranchWatch
from solver.simulation import Simulation
from solver.start.newton import ConsistentState

WATCHED = ['record.branches=true']


def folded(branch: str) -> Simulation:
    """The slider-crank at 1 ms, struck where its rods coincide (crank at 90 deg): it goes on with its rods mirrored or
    together."""
    s = simulation_of(load_scene('slider_crank', WATCHED))
    while s.advance().joint_position[0] < np.pi / 2 - 4e-3:
        pass
    rate = s.state.v[1, 5]
    s.state.q[1:3, 3:] = quaternion_exp((0.0, 0.0, np.pi / 2)), quaternion_exp((0.0, 0.0, -np.pi / 2))
    s.state.q[1:4, :3] = (0.0, 0.5, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.0)
    turn, slide = (-rate, -2 * rate) if branch == 'mirrored' else (rate, 0.0)
    s.state.v[1:4] = 0.0
    s.state.v[1:3, 5] = rate, turn
    s.state.v[1:3, 0] = -0.5 * rate, -0.5 * rate if branch == 'together' else -1.5 * rate
    s.state.v[3, 0] = slide
    ConsistentState(s.model).start_integrator(s.state, np.zeros(0), s.h, s.scheme.am, s.scheme.af)
    return s


@pytest.mark.parametrize(('branch', 'switches'), [('mirrored', 0), ('together', 1)])
def test_a_blow_in_the_singular_position_decides_the_branch_and_is_counted(branch, switches):
    """50 ms after it: the knee has turned by -2 or by 0 times the turn of the crank; only the second is a switch, at
    0.39 s."""
    s = folded(branch)
    crank, knee = s.advance(50).joint_position[:2] - (np.pi / 2, -np.pi)
    assert crank > 0.05
    assert knee == pytest.approx(-2 * crank if branch == 'mirrored' else 0.0, abs=1e-2)
    assert s.totals()['branch_switches'] == switches
    for event in s.branches.events:
        assert event.t == pytest.approx(0.39, abs=3e-3)
        assert event.turn > 0.3


@pytest.mark.parametrize(('branch', 'found'), [('mirrored', 0), ('together', 1)])
def test_divided_steps_that_come_out_on_the_other_branch_make_a_run_suspect(branch: str, found: int) -> None:
    """What is looked at behind a step that failed: the state before the passage, and one behind it on either branch."""
    s = simulation_of(load_scene('slider_crank'))
    while s.advance().joint_position[0] < np.pi / 2 - 4e-3:
        pass
    assert s.adaptation is not None
    copy_state(s.state, s.adaptation.values.begin)
    passed = folded(branch)
    passed.advance(3)
    copy_state(passed.state, s.state)
    s.engine._look_at_rescue(s.k, s.inputs)
    assert len(s.switches) == found
    assert [f.quantity for f in findings(s)].count('branch_switches') == found


@pytest.mark.parametrize(('at', 'seen'), [(1, 0), (50, 1)])
def test_a_watched_run_that_was_saved_finds_the_same_switches(at: int, seen: int) -> None:
    """Saved between the singular position and the look that finds the switch, or behind both: elsewhere, and from its
    pickle, it is as suspect as the run that went on, and as it was itself when it goes back.
    """
    s = folded('together')
    s.advance(at)
    assert len(s.switches) == seen
    saved, pickled = s.save(), pickle.dumps(s)
    s.advance(60 - at)
    switches, found, totals = list(s.switches), [str(f) for f in findings(s)], s.totals()
    assert len(switches) == 1
    other = simulation_of(s.scene)
    other.restore(saved)
    s.restore(saved)
    for again in (other, pickle.loads(pickled), s):
        assert len(again.switches) == seen
        again.advance(60 - at)
        assert again.switches == switches
        assert [str(f) for f in findings(again)] == found
        assert again.totals() == totals


def test_a_switch_across_divided_steps_is_saved_too() -> None:
    """It is in the findings of whoever goes on, watched or not; what another run found is not."""
    s, other = (simulation_of(load_scene('slider_crank')) for _ in range(2))
    s.advance(5)
    clean = s.save()
    s.bodies.rescued.append(BranchSwitch(0.002, 0.5))
    other.restore(s.save())
    watched = simulation_of(load_scene('slider_crank', WATCHED))
    watched.restore(s.save())
    for again in (s, other, watched, pickle.loads(pickle.dumps(other))):
        assert again.switches == [(0.002, 0.5)]
        assert [f.quantity for f in findings(again)] == ['branch_switches']
    watched.restore(clean)
    other.restore(clean)
    assert watched.switches == other.switches == []


def test_looks_that_do_not_belong_together_are_refused() -> None:
    watch = BranchWatch()
    looks, free = np.zeros((2, 2)), np.zeros((2, 1, 3))
    watch.recall({'looks': looks, 'free': free}, [])
    for memory in ({'looks': looks}, {'looks': looks, 'free': free[:1]}, {'looks': looks.ravel(), 'free': free}):
        with pytest.raises(SpecError, match=r'restore: (looks|free) has shape .* the saved state is of another model'):
            watch.recall(memory, [])


@pytest.mark.parametrize('h', [0.01, 0.005, pytest.param(0.002, marks=pytest.mark.long)])
@pytest.mark.parametrize('name', ['slider_crank', 'four_bar_n', 'bricard', 'flyball_governor'])
def test_runs_that_keep_their_branch_have_no_switches(name, h):
    """5 s through up to ten singular positions (parallelograms and slider-crank), and mechanisms without any."""
    loops = ['mechanism.loops=2'] if name == 'four_bar_n' else []
    s = simulation_of(load_scene(name, [*WATCHED, *loops, f'integrator.h={h}']))
    s.advance(round(5 / h))
    assert s.totals()['branch_switches'] == 0


def test_coming_to_rest_and_returning_is_no_switch():
    """A pendulum that swings to and fro, its velocity through zero at both ends."""
    s = simulation_of(load_scene('pendulum', WATCHED))
    s.advance(5000)
    assert s.totals()['branch_switches'] == 0


def test_watch_finds_the_switch_of_two_crossing_lines_and_not_the_bend_of_a_curve():
    """phi = x y: along y = 0 to the origin and on, or off along x = 0; a circle turns by as much, but all the time."""
    for after, found in (((1.0, 0.0), 0), ((0.0, 1.0), 1)):
        watch = BranchWatch()
        for k in range(-5, 6):
            x, y = (0.01 * k, 0.0) if k < 0 else 0.01 * k * np.array(after)
            watch.look(0.1 * k, np.array([[y, x]]) + 1e-9)
        assert [e.turn for e in watch.events] == pytest.approx([np.pi / 2] * found, abs=1e-5)
    watch = BranchWatch()
    for k in range(50):
        angle = 0.3 * k
        watch.look(0.1 * k, (1 + 0.1 * np.cos(5 * angle)) * np.array([[np.cos(angle), np.sin(angle)]]))
    assert not watch.events


def test_nothing_is_watched_unless_the_scene_asks():
    s = simulation_of(load_scene('slider_crank'))
    s.advance(10)
    assert s.branches is None
    assert 'branch_switches' not in s.totals()


def test_run_reports_switches_and_judges_them(capsys):
    """`mbd run --json` has the number and the times; a limit on them is a requirement like any other."""
    arguments = [
        'run',
        'slider_crank',
        '--no-record',
        '--json',
        '--duration',
        '1',
        '--set',
        'require.branch_switches_max=0',
    ]
    assert main(arguments) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data['branch_switches'], data['branch_switch_times'], data['require']['branch_switches_max']) == (0, [], 0)
