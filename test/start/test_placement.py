"""A start is what was asked for, or it is refused in one sentence that names the joint and the remedy; what it changed
is told."""

from __future__ import annotations

import numpy as np
import pytest

from solver import simulation_of
from solver.errors import ConsistencyError
from solver.files.scene import load_scene, load_scene_text
from solver.simulation import Simulation

BOB = 'mechanism:\n  bodies: {bob: {mass: 1, inertia: [0.01, 0.01, 0.01], com: [0, 0, -1]}}\n'
PIVOT = '  joints:\n    pivot: {kind: revolute, i: world, j: bob, at: [0, 0, 0], axis: [0, 1, 0]}\n'
ROD = '    rod: {kind: distance, i: {body: world, at: [0, 0, -3]}, j: {body: bob, at: [0, 0, -1]}, length: 5}\n'


def hinge(i: str, j: str, more: str = '') -> str:
    return BOB + f'  joints:\n    pivot: {{kind: revolute, i: {{body: world, {i}}}, j: {{body: bob, {j}}}}}\n' + more


def start(text: str) -> Simulation:
    return simulation_of(load_scene_text(text))


@pytest.mark.parametrize(
    ('scene', 'says'),
    [
        (hinge('axis: [0, 1, 0]', 'position: [0.1, 0, 0], axis: [0, 1, 0]'), r"joint 'pivot' is open by 0\.1 m as"),
        (hinge('axis: [0, 1, 0]', 'axis: [1, 0, 0]'), r"joint 'pivot' is open by 90 deg as"),
        (hinge('axis: [0, 1, 0]', 'position: [0, 0, 2.0e-6], axis: [0, 1, '
            '0.001]'), r"joint 'pivot' is open by 2e-06 m and 0\.0573 deg as"),
        (BOB + PIVOT + ROD, r"joint 'rod' is open by 3 m as"),
    ],
)  # fmt: skip
def test_a_placement_that_leaves_a_joint_open_is_refused_with_the_remedy(scene: str, says: str) -> None:
    with pytest.raises(ConsistencyError, match=says + r'.*start\.kind: assemble'):
        start(scene)


def test_six_digits_are_enough() -> None:
    """An opening of 0.5 um runs, as numbers with six digits leave it."""
    s = start(hinge('axis: [0, 1, 0]', 'position: [0.0000005, 0, 0], axis: [0, 1, 0]'))
    assert np.isfinite(s.advance(10).pose).all()


def test_the_same_joint_can_be_assembled_and_the_start_tells_how_far_it_moved() -> None:
    s = start(hinge('axis: [0, 1, 0]', 'position: [0.1, 0, 0], axis: [0, 1, 0]', 'start: {kind: assemble}\n'))
    told = s.start.report()
    assert (told['kind'], told['moved'], told['placed_by']) == ('assemble', 'bob', 'assembly')
    assert 0.0 < told['distance'] <= 0.1
    assert 'assembly: bodies moved' in str(s.start)


def test_what_contradicts_itself_cannot_be_assembled_either() -> None:
    with pytest.raises(ConsistencyError, match='cannot be assembled'):
        start(BOB + PIVOT + ROD + 'start: {kind: assemble}\n')


def test_opposed_axes_are_refused() -> None:
    """At 180 deg between the axes the angle of the joint is not defined; before, it became NaN without a word."""
    with pytest.raises(ConsistencyError, match=r"'pivot' point in opposite directions.*turn one of the two markers"):
        start(hinge('axis: [0, 1, 0]', 'axis: [0, -1, 0]'))


@pytest.mark.parametrize('kind', ['as_placed', 'assemble', 'equilibrium'])
def test_a_rolling_disc_that_lies_flat_is_refused(kind: str) -> None:
    """It has no lowest point; its rows were open by nan."""
    with pytest.raises(ConsistencyError, match=r"disc of contact 'road' lies flat on its plane.*tilt the body 'disc'"):
        simulation_of(load_scene('rolling_disc', ['mechanism.bodies.disc.rpy_deg=[0, 0, 0]', f'start.kind={kind}']))


@pytest.mark.parametrize('kind', ['fixed', 'prismatic'])
@pytest.mark.parametrize(
    ('turned', 'start_kind'),
    [('[180, 0, 0]', 'as_placed'), ('[0, 180, 0]', 'as_placed'), ('[0, 0, '
        '180]', 'as_placed'), ('[120, 0, 0]', 'assemble')],
)  # fmt: skip
def test_frames_that_a_joint_holds_half_a_turn_apart_are_refused(kind: str, turned: str, start_kind: str) -> None:
    """Axes of the two are perpendicular as where they are parallel, and assembling from beyond 90 deg ends there;
    before, it was ok."""
    joint = (
        f'  joints:\n    seat: {{kind: {kind}, i: world, j: {{body: bob, rpy_deg: {turned}}}}}\nstart: {{kind: '
        f'{start_kind}}}\n'
    )
    with pytest.raises(
        ConsistencyError, match=rf"joint 'seat' \({kind}\) are turned by 180 deg.*turn one of the two markers"
    ):
        start(BOB + joint)
    assert str(start(BOB + joint.replace(turned, '[60, 0, 0]').replace('as_placed', 'assemble')).start) != 'as given'


def test_a_distance_joint_without_distance_is_refused() -> None:
    both = '{body: world}, j: {body: bob}, length: 0.5'
    with pytest.raises(ConsistencyError, match=r"joint 'rod' \(distance\) coincide.*place one of its bodies elsewhere"):
        start(BOB + f'  joints:\n    rod: {{kind: distance, i: {both}}}\nstart: {{kind: assemble}}\n')


def test_a_given_velocity_that_does_not_fit_is_told() -> None:
    """The bob may only turn about y: 2 m/s along y are taken away, 3 rad/s about y are kept."""
    moving = BOB.replace('com: [0, 0, -1]', 'com: [0, 0, -1], velocity: [0, 2, 0], angular_velocity: [0, 3, 0]')
    s = start(moving + PIVOT)
    told = s.start.report()
    assert (told['corrected'], told['set_by']) == ('bob', 'the constraints')
    assert told['correction'] == pytest.approx(2.0, rel=1e-9)
    assert s.snapshot().joint_velocity[0] == pytest.approx(3.0, rel=1e-9)
    assert 'does not fit the constraints' in str(s.start)


def test_a_start_that_changed_nothing_says_so() -> None:
    assert str(start(BOB + PIVOT).start) == 'as given'


@pytest.mark.parametrize('magnitude', ['1.0e+200', '1.0e-9', '3'])
def test_an_axis_may_have_any_magnitude(magnitude: str) -> None:
    """The same joint, to the last bit, as with the unit axis; before, 1e200 gave another one."""
    text = BOB + PIVOT
    one, other = start(text), start(text.replace('axis: [0, 1, 0]', f'axis: [0, {magnitude}, 0]'))
    for a, b in zip(one.advance(50)[2], other.advance(50)[2], strict=True):
        assert a == b


@pytest.mark.parametrize('kind', ['as_placed', 'equilibrium'])
@pytest.mark.parametrize(
    ('element', 'data'),
    [('rod', 'length: 0.1, law: 100'), ('strut', 'free_length: 0.1, spring: 100, mount: 1.0e+4, mount_damping: 10')],
)  # fmt: skip
def test_a_rod_or_strut_without_length_is_refused(element: str, data: str, kind: str) -> None:
    """Before, a body with mass and inertia was said to need mass and inertia."""
    text = (
        BOB
        + PIVOT
        + f'  {element}s:\n    link: {{i: world, j: bob, at: [0, 0, -1], {data}}}\nstart: {{kind: {kind}}}\n'
    )
    with pytest.raises(ConsistencyError, match=rf"{element} 'link' has length zero.*place its bodies apart"):
        start(text)


class TestSprings:
    """Of no length, where their force has no direction."""

    SPRING = '  spring_dampers:\n    s: {{i: world, j: bob, at: [0, 0, -1], free_length: {}, spring: 100{}}}\n'

    @pytest.mark.parametrize(('free', 'more', 'force'), [('0.1', '', '-10'), ('0', ', preload: 5', '5')])
    def test_with_a_force_it_is_refused(self, free: str, more: str, force: str) -> None:
        with pytest.raises(ConsistencyError, match=rf"spring-damper 's' has length zero, so its force of {force} N"):
            start(BOB + PIVOT + self.SPRING.format(free, more))

    @pytest.mark.parametrize('damper', [0.0, 1.5])
    def test_without_free_length_it_is_a_spring_in_space(self, damper: float) -> None:
        """1 kg let go at the anchor of 10 N/m falls and comes back: z = -(g/w^2)(1 - e^(-d t)(cos + d/n sin)), to 1e-4
        of 1 m."""
        text = 'mechanism:\n  bodies: {m: {mass: 1, inertia: [1, 1, 1]}}\n'
        text += (
            f'  spring_dampers:\n    s: {{i: world, j: m, at: [0, 0, 0], free_length: 0, spring: 10, damper: '
            f'{damper}}}\n'
        )
        s = start(text + 'integrator: {h: 0.001}\n')
        t = np.arange(1, 2001) * 1e-3
        z = np.array([s.advance(1).pose[0, 2] for _ in t])
        d = 0.5 * damper
        n = np.sqrt(10.0 - d * d)
        exact = -0.981 * (1.0 - np.exp(-d * t) * (np.cos(n * t) + d / n * np.sin(n * t)))
        np.testing.assert_allclose(z, exact, rtol=0, atol=1e-4)


def test_delivered_scenes_start_as_they_are_placed() -> None:
    """The largest opening of those with as_placed and a loop: 1e-6 m is enough for numbers with 16 digits."""
    for name in ('four_bar', 'bricard', 'slider_crank', 'andrews'):
        assert simulation_of(load_scene(name)).start.distance == 0.0
