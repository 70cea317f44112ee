"""What a scene requires of accuracy, as text: limits with units beside the numeric keys of `require`, refusals of one
sentence."""

from __future__ import annotations

import math

import pytest

from solver.errors import SceneError
from solver.files.scene import load_scene, load_scene_text
from solver.scene import Accuracy, Bound

CAR = 'light_car_step_steer'


def accuracy(*overrides: str) -> dict[str, Accuracy]:
    return load_scene(CAR, overrides).require.accuracy


def test_quantities_stand_beside_the_other_keys() -> None:
    scene = load_scene(
        CAR,
        [
            'require={residual_max: 0.1, yaw_rate: {rms: 2 %, delay: 5 ms}, tire_force.front_left.y: {max: 5 %}, '
            'position: {max: 0.1 m}}',
            'budget={real_time_factor: 5}',
        ],
    )
    assert scene.require.limits == {'residual_max': 0.1}
    assert scene.require.accuracy == {
        'yaw_rate': Accuracy(rms=Bound(0.02, share=True), delay=Bound(0.005)),
        'tire_force.front_left.y': Accuracy(max=Bound(0.05, share=True)),
        'position': Accuracy(max=Bound(0.1)),
    }
    assert scene.budget.real_time_factor == 5.0
    assert load_scene_text(scene.resolved).require == scene.require


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('0.2 deg/s', math.radians(0.2)),
        ('0.5 rad/s', 0.5),
        ('0.01', 0.01),
    ],
)
def test_limits_are_converted_to_si_units(text: str, value: float) -> None:
    assert accuracy(f'require.yaw_rate.max={text}')['yaw_rate'].max == Bound(
        pytest.approx(value, rel=1e-15), share=False
    )


def test_one_limit_in_two_units_is_one_limit() -> None:
    metres, millimetres = (accuracy(f'require.joint_states/rack/position.max={text}') for text in ('0.125 m', '125 mm'))
    assert metres == millimetres and repr(metres) == repr(millimetres)


def test_dots_of_a_name_may_be_levels_and_columns_of_recordings_have_their_names() -> None:
    assert accuracy('require.tire_force.front_left.y.max=5 %') == accuracy(
        'require={tire_force.front_left.y: {max: 5 %}}'
    )
    assert accuracy('require.joint_states/rack/position.max=1 mm') == {
        'joint_states/rack/position': Accuracy(max=Bound(1e-3))
    }


@pytest.mark.parametrize(
    ('setting', 'sentence'),
    [
        ('require.yaw_rat.rms=2 %', "require.yaw_rat: no such quantity; did you mean 'yaw_rate'"),
        ('require.wheel_load.front_lef.rms=2 %', "did you mean 'wheel_load.front_left'"),
        ('require.residual_mux=1', "require.residual_mux: unknown key; did you mean 'residual_max'"),
        ('require.yaw_rate=2 %', 'require.yaw_rate = 2 %: say which error'),
        ('require.yaw_rate.rms=2 m', 'require.yaw_rate.rms = 2 m: is in m; the unit of this quantity is rad/s'),
        ('require.joint_states/rack/position.max=1 deg', 'is in rad; the unit of this quantity is m (or %)'),
        ('require.imu/az.rms=5 mm', 'is in m; the unit of this quantity is m/s^2 (or %)'),
        ('require.tire_states/front_left/fz.max=3 rpm', 'is in rad/s; the unit of this quantity is N (or %)'),
        ('require.odom/pose/qw.max=1 mm', 'is in m; the unit of this quantity is none (or %)'),
        ('require.yaw_rate.rms=2 parsec', "no such unit 'parsec'"),
        ('require.yaw_rate.rms=small', 'must be a number with its unit'),
        ('require.yaw_rate.rms=-2 %', 'must be > 0'),
        ('require.yaw_rate.rsm=2 %', "require.yaw_rate.rsm: unknown key; did you mean 'rms'"),
        ('require.yaw_rate={}', 'at least one of max, rms and delay'),
        ('require.yaw_rate.delay=5 %', 'must be a time'),
        ('require.yaw_rate.delay=5 m', 'is in m; the unit of this quantity is s'),
        ('budget.real_time_factor=0', 'must be > 0'),
    ],
)
def test_what_is_no_requirement_is_refused_in_one_sentence_with_its_place(setting: str, sentence: str) -> None:
    with pytest.raises(SceneError) as refused:
        load_scene(CAR, [setting])
    assert sentence in str(refused.value)
    assert '\n' not in str(refused.value)
    assert setting.partition('=')[0].partition('.')[0] in str(refused.value)


def test_a_mechanism_has_its_own_columns_and_no_quantities_of_vehicles() -> None:
    load_scene('slider_crank', ['require.joint_states/slide/position.max=1 mm'])
    with pytest.raises(SceneError, match='no such quantity'):
        load_scene('slider_crank', ['require.yaw_rate.rms=2 %'])
