"""Reactions next to singular positions are marked where the motion does not determine them, and only there.

Truth is the same mechanism with a sixteenth of the step. An error is told relative to the largest reaction. Steps are
resolved, so what they lose of a reaction is (omega h)^2 / 12 or less, below a hundredth here. An unmarked reaction is
off by less than 2 ROUGH: half of that, as a single error in a second difference of multipliers, is marked.
"""

import json

import numpy as np
import pytest

from mbd_sim_ros.analysis.comparison import compare
from mbd_sim_ros.analysis.runs import export
from mbd_sim_ros.bags import reader
from mbd_sim_ros.batch import simulate
from mbd_sim_ros.lab.mechanisms.change_points import linkages
from mbd_sim_ros.lab.mechanisms.families import drawn
from mbd_sim_ros.messages.encode import require_finite
from solver import simulation_of
from solver.analysis.error_bar import Twin
from solver.analysis.reactions import joint_reaction, undetermined
from solver.errors import StepError
from solver.files.scene import load_scene, load_scene_text
from solver.output.undetermined import ROUGH, TIME
from solver.simulation import Simulation

H = 4760437e-9  # s; with it two parallelograms pass four change points within rounding of some of them
PASSAGE = ('four_bar_n', 'mechanism.loops=2', f'integrator.h={H}', 'duration=1.499537655')


def simulation(scene: str, *overrides: str) -> Simulation:
    return simulation_of(load_scene(scene, [*overrides]))


def reactions(simulation: Simulation, every: int = 1) -> np.ndarray:
    """(n, nc) reactions as forces [N], NaN where they are marked."""
    rows = [simulation.advance(every).reactions for _ in range(simulation.scene.steps // every)]
    return np.array(rows) / simulation.bodies.work.row_length


@pytest.mark.slow
def test_reactions_that_a_step_does_not_determine_are_marked_and_no_others():
    """Two parallelograms, penalty 1e6: passages make reactions of 1e4 N of bars of 1 kg."""
    run = simulation(*PASSAGE)
    shown = reactions(run)
    fine = reactions(simulation(*PASSAGE[:2], f'integrator.h={297527}e-9', 'duration=1.499536080'), every=16)
    peak = np.nanquantile(np.abs(fine).max(axis=1), 0.95)
    marked = np.isnan(shown)
    rows = {run.model.row_names[k] for k in np.flatnonzero(marked.any(axis=0))}
    assert rows == {'A0/x', 'A1/x', 'A2/x', 'B0/x', 'B1/x', 'C1/x', 'C2/x'}  # along the bars; across them all is known
    when = (np.flatnonzero(marked.any(axis=1)) + 1) * H
    assert set(np.round(when, 1)) == {0.7, 1.2, 1.3}
    assert np.nanmax(np.abs(shown)) < 2.0 * peak
    sure = ~marked & ~np.isnan(fine)
    assert np.abs(shown - fine)[sure].max() < 2.0 * ROUGH * peak
    time = run.last_step.account.undetermined[TIME]
    assert time == pytest.approx(len(when) * H)
    assert undetermined(run).startswith("Reactions of 'A1/x' and up to 6 more rows are not determined for ")


@pytest.mark.parametrize(
    ('scene', 'overrides'),
    [
        ('slider_crank', ['integrator.h=0.005', 'duration=2']),  # through two singular positions, exact all the same
        ('bricard', ['integrator.h=0.01', 'duration=2']),  # redundant at all times
        ('four_bar_n', ['mechanism.loops=1', 'integrator.h=0.007', 'duration=2.1']),  # one parallelogram stays exact
    ],
)
def test_what_is_determined_is_shown(scene, overrides):
    run = simulation(scene, *overrides)
    shown = reactions(run)
    fine = reactions(simulation(scene, *overrides[:-2], f'integrator.h={run.h / 4}', overrides[-1]), every=4)
    unique = [k for k, row in enumerate(run.model.row_names) if row not in run.describe()['reactions_not_unique']]
    peak = np.quantile(np.abs(fine).max(axis=1), 0.95)
    assert np.isfinite(shown).all()
    assert np.abs(shown - fine)[: len(fine)][:, unique].max(initial=0.0) < 0.05 * peak
    assert undetermined(run) == ''


def test_the_signs_have_no_scale_but_that_of_the_mechanism():
    """Three cranks of grams and centimetres: no step combines augmentations, but multipliers grow."""
    links = {one.name: one for one in linkages()}['small_links']
    run, fine = (simulation_of(load_scene_text(links.text(h, round(0.444 / h), 1e6))) for h in (0.0037, 0.0037 / 20.0))
    shown, right = reactions(run), reactions(fine, every=20)
    peak = np.nanquantile(np.abs(right).max(axis=1), 0.9)
    assert np.isnan(shown).any(axis=1).sum() == 16
    assert np.nanmax(np.abs(shown)) < 2.0 * peak


@pytest.mark.slow
def test_no_reaction_of_mechanisms_without_singular_positions_is_marked():
    """Of the families of random mechanisms those two that pass singular positions are left out: of the others none is
    near one, and what jumps, vibrates, or is redundant or ill-conditioned is shown."""
    for number in range(28):
        mechanism = drawn(number, 2)
        if mechanism.family in ('sarrus', 'parallelogram'):
            continue
        run = simulation_of(load_scene_text(mechanism.text, overrides=['integrator.h=0.005', 'duration=0.5']))
        try:
            run.advance(run.scene.steps)
        except StepError:
            continue
        assert undetermined(run) == '', mechanism.name


def test_marks_do_not_depend_on_calls_and_survive_a_saved_state():
    one, whole, again = (simulation(*PASSAGE) for _ in range(3))
    for _ in range(153):
        last = one.advance(1)
    assert np.isnan(last.reactions).any()
    assert np.array_equal(whole.advance(153).numbers, last.numbers, equal_nan=True)
    again.restore(one.save())
    assert np.array_equal(one.advance(1).numbers, again.advance(1).numbers, equal_nan=True)
    assert not np.isnan(whole.advance(1, audit=False).reactions).any()  # of steps without an account nothing is known
    one.reset()
    assert not np.isnan(one.snapshot().reactions).any()


def test_joint_reactions_and_efforts_of_drives_are_marked_with_their_rows():
    run = simulation(*PASSAGE)
    run.advance(151)
    assert np.isnan(joint_reaction(run, 'A1').force).any()
    assert np.isfinite(joint_reaction(run, 'A1').point).all()
    driven = simulation_of(load_scene_text(DRIVEN))
    driven.advance(3)
    work, drives = driven.bodies.work, driven.model.tables.drives
    work.marks[drives.output[0]] = work.marks[-1] = 1.0
    driven.bodies.collect(driven.inputs)
    assert np.isnan(driven.snapshot().joint_effort).tolist() == [k == drives.coordinate[0] for k in range(1)]


DRIVEN = """
mechanism:
  inputs: [angle, angle_rate, angle_acceleration]
  bodies: [{name: arm, mass: 1.0, inertia: [0.1, 0.1, 0.1]}]
  joints:
    - {name: pivot, kind: revolute, i: {body: world}, j: {body: arm}}
  couplers: [{name: motor, terms: [[pivot, 1.0]], input: angle}]
duration: 0.01
"""


def test_what_is_not_finite_without_being_undetermined_is_refused():
    run = simulation(*PASSAGE)
    shown = run.advance(1)
    shown.reactions[3] = np.inf
    with pytest.raises(StepError, match=r"reaction 'A0/.*' is not finite"):
        require_finite(shown, run.channels)
    shown = run.advance(1)
    shown.twist[0, 0] = np.nan
    with pytest.raises(StepError, match='velocity of body'):
        require_finite(shown, run.channels)


@pytest.mark.slow
def test_recordings_say_what_is_not_determined_and_compare_the_rest(tmp_path):
    made = {}
    for name, penalty in (('one', '1e6'), ('other', '1e4')):
        run = simulation(*PASSAGE, f'integrator.penalty={penalty}', 'record.reactions=true', 'record.every=1')
        data = simulate(run, run.scene.steps, directory=tmp_path / name)
        made[name] = reader.read(tmp_path / name)
        assert made[name].reactions_text == data['reactions_text'] != ''
        assert data['status'] == 'ok'  # the motion is right
    doubts = [text for text in made['one'].doubts if text.startswith('topic reactions: reactions that the motion does')]
    assert len(doubts) == 1
    assert compare(made['one'], made['one'], exact=True).ok
    found = compare(made['one'], made['other'])
    axial = {d.channel: d for d in found.differences}['reactions/A0/x']
    marked = np.isnan(made['one']['reactions/A0/x']) | np.isnan(made['other']['reactions/A0/x'])
    assert np.isfinite(axial.max) and axial.instants == marked.size - marked.sum() < marked.size
    assert [text for text in found.notes if text.startswith('instants that are not compared')]
    files = {file.name: file for file in export(made['one'], tmp_path / 'csv')}
    assert (
        files['reactions.csv'].read_text().count('nan')
        == np.isnan([made['one'][name] for name in made['one'].names if name.startswith('reactions/')]).sum()
    )
    json.dumps(data, allow_nan=False)


def test_a_twin_whose_reactions_are_marked_measures_the_error_of_its_run():
    """The double step, of which one instant that is compared is within the passage."""
    run = simulation(*PASSAGE, 'record.every=1')
    twin = Twin(run, run.scene.steps)
    while run.k < run.scene.steps:
        twin.note(run.advance(1))
    assert twin.made().twin == 'double step'
    again = run.twin(0.8, h=2.0 * H)
    assert any(np.isnan(again.advance(1).reactions).any() for _ in range(84))
