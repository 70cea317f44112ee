"""A force that turns a body without inertia: named by the verdict where the run shows it, and not where the force holds
it."""

from __future__ import annotations

import pytest

from solver import simulation_of
from solver.analysis.turned import turned
from solver.analysis.verdict import findings
from solver.files.scene import load_scene_text

SCENE = 'mechanism:\n  bodies:\n    p: {{mass: {mass}, inertia: {inertia}, com: {com}, position: [0, 0, -1]}}\n{rest}'
SPRING = '  spring_dampers:\n    s: {{i: world, j: {{body: p, position: {at}}}, free_length: {free}, spring: {rate}}}\n'
SAID = (
    "spring_damper 's' pulls at body 'p' 0.1 m off its centre of mass and turns it, and the body has no inertia: "
    'give it an inertia'
)


def scene(*, mass=1, inertia='[0, 0, 0]', com='[0, 0, 0]', at='[0, 0, 0]', free=1, rate=100, more=''):
    return load_scene_text(
        SCENE.format(mass=mass, inertia=inertia, com=com, rest=SPRING.format(at=at, free=free, rate=rate) + more)
    )


@pytest.mark.parametrize('where', [{'com': '[0.1, 0, 0]'}, {'at': '[0.1, 0, 0]'}, {'at': '[0, 0.1, 0]'}])
def test_a_slack_spring_off_a_point_mass_is_named(where):
    s = simulation_of(scene(**where))
    s.advance(400, audit=True)
    texts = {f.quantity: f.text for f in findings(s)}
    assert SAID in texts['resolution'] and 'attach spring_damper' in texts['resolution']
    assert not any(
        'educe integrator.h' in text
        for quantity, text in texts.items()
        if quantity in ('resolution', 'phase', 'unsettled')
    )


def test_a_spring_that_holds_the_point_mass_by_its_tension_is_none():
    """The arm lies along the spring, which is never slack: a spring that is longer by 0.1 m, at 10 rad/s about m g /
    k."""
    s = simulation_of(scene(com='[0, 0, -0.1]', free=0.5))
    s.advance(400, audit=True)
    assert not findings(s)


def test_other_doubts_keep_their_remedy():
    """A spring at the centre of mass of 1000 rad/s in steps of 1 ms: shorter steps do mend that."""
    s = simulation_of(scene(rate=1e6))
    s.advance(400, audit=True)
    texts = [f.text for f in findings(s) if f.quantity in ('resolution', 'phase')]
    assert texts and all('educe integrator.h' in text and 'off its centre of mass' not in text for text in texts)


@pytest.mark.parametrize(
    ('body', 'said'),
    [
        ({'inertia': '[0.1, 0.1, 0]', 'at': '[0.1, 0, 0.3]'}, 'no inertia about that axis'),  # beside a thin rod
        ({'inertia': '[0.1, 0.1, 0]', 'at': '[0, 0, 0.3]'}, ''),  # on its axis
        ({'inertia': '[0.1, 0.1, 0.1]', 'at': '[0.1, 0, 0.3]'}, ''),
        ({'com': '[0.1, 0, 0]', 'at': '[0.1, 0, 0]'}, ''),
        ({'mass': 0, 'at': '[0.1, 0, 0]'}, ''),  # of no mass: refused by the step
        (
            {
                'at': '[0.1, 0, 0]',
                'more': '  joints: {j: {kind: prismatic, i: world, j: p, at: [0, 0, -1], axis: [0, 0, 1]}}\n',
            },
            '',
        ),
        (
            {'more': '  applied_forces: {f: {marker: {body: p, position: [0, 0.2, 0]}, force: [0, 0, 1]}}\n'},
            "applied_force 'f' pulls",
        ),
    ],
)
def test_what_turns_a_body_about_an_axis_without_inertia(body, said):
    found = turned(scene(**body).model)
    assert (list(found) == ['p'] and said in found['p']) if said else not found
