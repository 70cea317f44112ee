"""Data that no vehicle has are refused where they are written, however far from the car's own file that is."""

from __future__ import annotations

import pytest

from solver.errors import SceneError
from solver.files.scene import load_scene, load_scene_text

SALOON, CARAVAN = 'vehicle.front.', 'trailer.axles.axle.suspension.'


@pytest.mark.parametrize(
    ('change', 'says'),
    [
        ('trailer.chassis.mass=-1232', r'mass = -1232.0: must be >= 0'),
        ('trailer.chassis.inertia[0]=640000', r'inertia = .*the largest exceeds the sum of the others'),
        (f'{CARAVAN}brake.stiffness=0', r'brake\.stiffness = 0.0: must be > 0'),
        (f'{CARAVAN}wheel.center[1]=-0.95', r'wheel\.center\[1\] = -0.95: must be > 0: data are those of the left '
            r'side'),
        (f'{SALOON}wheel.center[2]=-0.298', r'wheel\.center\[2\] = -0.298: must be > 0, above the ground'),
        (f'{SALOON}tie_rod.mass=0', r'tie_rod\.mass = 0.0: must be > 0'),
        (f'{SALOON}coil_over.spring.rate=-46000', r'spring\.rate = -46000.0: must be > 0'),
        (f'{SALOON}coil_over.spring.load=-5280', r'spring\.load = -5280.0: must be >= 0'),
        (f'{SALOON}coil_over.damper.law[6][1]=-290', r'damper\.law\[6\]\[1\] = -290.0: drives .*: at 0.05 it must not '
            r'be below'),
        (f'{SALOON}coil_over.damper.stops[8][1]=-1e5', r'damper\.stops\[8\]\[1\] = -100000.0: drives instead of '
            r'resisting'),
        (f'{SALOON}radius_link.bushing.law_x[1][1]=8000', r'law_x\[1\]\[1\] = 8000.0: drives instead of resisting'),
        ('vehicle.steering.rack_damping=-1500', r'rack_damping = -1500.0: must be >= 0'),
        ('vehicle.driveline.damping=-25', r'driveline\.damping = -25.0: must be >= 0'),
        ('vehicle.driveline.ratio=0', r'driveline\.ratio = 0.0: must not be 0'),
        (f'{SALOON}wheel.center=[1375, 775, 298]', r'wheel\.center = .*: is further than 30 m: lengths are in m'),
        ('vehicle.steering.pinion_foot=[1e9, 1e9, 1e9]', r'pinion_foot = .*: lengths are in m'),
        ('vehicle.anti_roll_rear.bend[2]=-300', r'bend = .*: lengths are in m'),
        ('vehicle.hitch=[-2420, 0, 400]', r'hitch = .*: lengths are in m'),
        ('vehicle.driveline.inset=100', r'inset = 100: is further than 30 m: lengths are in m'),
        ('trailer.coupling_mm=[3800, 0, 400000]', r'coupling_mm = .*: is further than 30 m: lengths are in m'),
        (f'{SALOON}tie_rod.inner=[1460, 385, 240.5]', r'tie_rod\.inner = .*: lengths are in m'),
        (f'{SALOON}coil_over.spring.rate=46', r'spring\.rate = 46.0: is compressed by 115 m under its load: rates are '
            r'in N/m'),
        ('vehicle.driveline.mount_bushing.axis=[0, 0, 0]', r'mount_bushing\.axis = .*: must not be zero'),
        (f'{SALOON}tie_rod.inner=[1.5, 0.745, 0.2227]', r'tie_rod\.inner = .*: is not 0.001 m away from outer, \(1.5, '
            r'0.745, 0.2227\)'),
        (f'{SALOON}upper_arm.pivots[1]=[1.430, 0.450, 0.672]', r'upper_arm\.pivots = .*: are not 0.001 m apart'),
        ('vehicle.chassis.com[2]=-0.62', r'com\[2\] = -0.62: must be > 0'),
    ],
)  # fmt: skip
def test_a_mistake_is_told_where_it_is_written(change: str, says: str) -> None:
    """Of a value that is set from outside the place is the assignment."""
    with pytest.raises(SceneError, match=says) as refused:
        load_scene('saloon_with_trailer', [change])
    key = change.partition('=')[0].split('[')[0]
    assert str(refused.value).startswith(
        (f'--set {key}', 'config/vehicles/full_car.yaml:', 'config/vehicles/trailers/caravan.yaml:')
    )
    assert not str(refused.value).startswith('config/vehicles/full_car.yaml:8:')  # where the vehicle begins


def test_a_mistake_in_the_file_of_a_trailer_names_its_line() -> None:
    text = load_scene('saloon_with_trailer').resolved
    assert text.count('mass: 1232') == 1
    with pytest.raises(
        SceneError, match=r'scene:\d+: vehicle\.trailer\.chassis\.mass = -1232.0: must be >= 0'
    ) as refused:
        load_scene_text(text.replace('mass: 1232', 'mass: -1232'))
    line = int(str(refused.value).split(':')[1])
    assert text.splitlines()[line - 1].strip() == 'mass: 1232'


def test_a_damper_with_a_gas_spring_resists_about_its_force_at_rest() -> None:
    """Tables of dampers with a gas force do not pass through zero."""
    load_scene(
        'car_step_steer', ['vehicle.rear.damper.law=[[-1, -900], [-0.1, -250], [0, -150], [0.1, -40], [1, 1200]]']
    )
