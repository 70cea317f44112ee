"""Drives the maneuver of a norm with a vehicle: finds its amplitude first, and uses complete recordings of earlier
calls again.

The name of the directory of a run contains a hash: of the resolved scene, of files that belong to it (its plan, a
recording that it replays), and of the sources of the solver. So a recording of that name is one of the same run.

The file is long because a call that finds earlier runs, one that drives new ones and the report of both share their
names and hashes.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from mbd_sim_ros import compiling, interrupts
from mbd_sim_ros.analysis import runs
from mbd_sim_ros.analysis.evaluation import judging
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation
from mbd_sim_ros.analysis.evaluation.measures import line, low_passed
from mbd_sim_ros.analysis.evaluation.signals import NEEDED, Vehicle, signals
from mbd_sim_ros.batch import simulate
from solver import simulation_of
from solver.analysis.verdict import OK, SUSPECT
from solver.disk import digest, sources
from solver.errors import BagError, MbdError, SceneError, SpecError
from solver.files.naming import included
from solver.files.scene import find_file, load_scene_text
from solver.inputs.signals import Ramp
from solver.levels.auto import beside_text
from solver.scene import Scene
from solver.units import STANDARD_GRAVITY
from solver.vehicle.size import size_of
from solver.vehicle.trailer import has_trailer

RAMP = math.radians(13.5)  # rate of the steering wheel in a slow ramp [rad/s]
# Time [s] in which a ramp reaches RAMPED_TO at the soonest, by geometry: with a direct steering the ramp is slower than
# RAMP.
SOONEST = 1.0
RAMPED_TO = 0.5 * STANDARD_GRAVITY  # lateral acceleration up to which the ramp for the reference angle A goes [m/s^2]
# Lateral accelerations [m/s^2] between which the straight line for A is fitted.
LINE = (0.1 * STANDARD_GRAVITY, 0.375 * STANDARD_GRAVITY)
BRAKES = 'maneuver.brake_torque.value'  # key of the braking torque
ROLLS = 0.3  # slip below which a wheel rolls, and does not lock
CREEPS = 3.0  # speed [m/s] below which a wheel may lock
# Search for the largest braking torque: factor between two trials, halvings of the interval, trials at most.
GROWTH, HALVINGS, MOST = 1.25, 3, 12
# Factors that a driver tries: on the preview of the file, and on the understeer gradient of the car.
PREVIEWS, MORE = (1.0, 0.87, 1.13), (1.0, 1.15, 1.3)
WHEELBASE = 0.6  # wheelbase, relative to the length of a car without mirrors, which vehicle files do not have
# durations [s] of a ramp, tried in turn until it reaches what is wanted; 418 deg at last
SECONDS = (5.0, 8.0, 12.0, 20.0, 32.0)
# Index of the last duration that is tried in any case; a longer one only if the car still answers at the end of a ramp.
USUAL = 2
# Growth of the lateral acceleration in the last half second of a ramp, from which on a car still answers. In the
# longest ramp it is 1.6 % for a linear car.
RISES = 0.01
CALIBRATION = 'slowly_increasing_steer'  # maneuver of the slow ramp
OWN = ('maneuver', 'duration', 'record', 'road')  # keys of --set that apply to the maneuver, not to the ramp before it


def scene_text(drive: Drive, vehicle: Path, name: str, overrides: Sequence[str] = ()) -> str:
    """Text of the scene of a maneuver. overrides: settings that will be applied to it; a start speed among them
    replaces that here."""
    speed = '' if {'start.speed', 'start.speed_kmh'} & {key_of(o) for o in overrides} else f', speed: {drive.speed!r}'
    lines = [
        f'name: {name}',
        f'vehicle: {included(vehicle)}',
        f'start: {{kind: equilibrium{speed}}}',
        f'maneuver: {included(find_file(drive.maneuver, "maneuvers"))}',
        'integrator: {h: 1.0e-3, iterations: 2}',
        f'duration: {drive.duration!r}',
        f'record: {{every: {drive.every}, elements: false}}',
    ]
    if drive.road:
        lines.append(f'road: {included(find_file(drive.road, "roads"))}')
    return '\n'.join(lines) + '\n'


def key_of(override: str) -> str:
    """The key of a KEY=VALUE."""
    return override.partition('=')[0].strip()


class Driving:
    """Drives maneuvers of one vehicle, with recordings in a directory.

    overrides: settings of the user (--set), applied after all others. say: whether to show progress. driven, kept:
    numbers of runs that were driven, and that were there already.
    """

    def __init__(self, vehicle: str, directory: Path, overrides: Sequence[str] = (), *, say: bool = False) -> None:
        self.vehicle, self.directory, self.overrides, self.say = (
            find_file(vehicle, 'vehicles').resolve(),
            directory,
            list(overrides),
            say,
        )
        self.driven = self.kept = 0
        self._vehicle: Vehicle | None = None
        self._angles: dict[tuple[str, ...], tuple[np.ndarray, np.ndarray, bool]] = {}

    def drive(self, evaluation: Evaluation) -> tuple[list[Path], dict[str, float]]:
        """(recordings in order, results of the runs before: `reference` or `amplitude` of the steering wheel [rad],
        `brake_torque` [N m], `preview` and `understeer` of the driver).

        Speeds are those of the norm, whatever the size of the vehicle. Raises MbdError; for a vehicle that is not as
        large as a passenger car, the sentence names the speed that corresponds to its size.
        """
        try:
            return self._drive(evaluation)
        except SceneError:
            raise
        except MbdError as error:
            said = self.speed_note(evaluation)
            if not said:
                raise
            raise type(error)(f'{error}; {said}') from error

    def speed_note(self, evaluation: Evaluation) -> str:
        """Sentence on the speed of the norm and the corresponding speed of a vehicle of another length than passenger
        cars.

        '' for one of their length. Source: [Buckingham1914], solver.vehicle.size. Raises MbdError.
        """
        text = scene_text(evaluation.driven, self.vehicle, evaluation.name, self.overrides)
        scene = load_scene_text(text, evaluation.name, self.overrides)
        size, usual = size_of(scene.model), 3.6 * evaluation.driven.speed
        if size.length == 1.0:
            return ''
        similar = usual * size.speed
        own = (
            f', driven here at {3.6 * scene.start.speed:.3g} km/h'
            if not math.isclose(3.6 * scene.start.speed, usual)
            else ''
        )
        return (
            f'{usual:.3g} km/h are for passenger cars{own}, on the wheelbase of {self.vehicle.stem} that is '
            f'{similar:.3g} km/h: --set start.speed_kmh={similar:.3g}'
        )

    def _drive(self, evaluation: Evaluation) -> tuple[list[Path], dict[str, float]]:
        one = evaluation.driven
        text = scene_text(one, self.vehicle, evaluation.name, self.overrides)
        settings = [
            *self._sized(text),
            *self._fitted(evaluation, text),
            *(self._driver(text, one.cones) if one.driver else []),
        ]
        if one.brakes and not any(key_of(o).startswith(BRAKES.rpartition('.')[0]) for o in self.overrides):
            torque = self._torque(evaluation.name, text, one, settings)
            return [self._run(evaluation.name, text, [*settings, f'{BRAKES}={torque!r}'])], {'brake_torque': torque}
        if one.cones and not any(key_of(o).startswith('maneuver.driver') for o in self.overrides):
            place, found = self._practised(evaluation, text, settings)
            return [place], found
        if not one.amplitude:
            return [self._run(evaluation.name, text, settings)], {}
        if any(key_of(o).startswith(one.amplitude.rpartition('.')[0]) for o in self.overrides):
            return [self._run(evaluation.name, text, settings)], {}  # the user has given the steering
        if one.series is None:
            angle = self._reaching(text, one.reaches)
            return [self._run(evaluation.name, text, [*settings, f'{one.amplitude}={angle!r}'])], {'amplitude': angle}
        reference = math.radians(round(math.degrees(self._reference(text, one.reaches)), 1))
        settings.append(f'maneuver.evaluate_with.reference={reference!r}')
        try:
            amplitudes = [side * a for side in (1.0, -1.0) for a in one.series(reference)]
        except SpecError as error:
            raise SpecError(f'{self.vehicle.stem}: {error}') from None
        places = []
        for a in tqdm(amplitudes, desc=evaluation.name, unit='run', disable=None if self.say else True, leave=False):
            places.append(
                self._run(
                    f'{evaluation.name}_{math.degrees(a):+.0f}deg',
                    text,
                    [*settings, f'{one.amplitude}={a!r}'],
                    quiet=True,
                )
            )
        return places, {'reference': reference}

    def _known(self, text: str) -> tuple[Scene, Vehicle]:
        """(scene of a maneuver, figures of its vehicle)."""
        scene = load_scene_text(text, 'scene of the maneuver', self._vehicle_overrides())
        if self._vehicle is None or self._vehicle.scene is None or self._vehicle.scene.model != scene.model:
            self._vehicle = Vehicle.of(scene)
        return scene, self._vehicle

    def _sized(self, text: str) -> list[str]:
        """Settings that scale the maneuver file, made for passenger cars, to a vehicle of another size: the torques of
        the speed control, and the rate of a slow ramp of the steering wheel."""
        scene, vehicle = self._known(text)
        size, control = size_of(scene.model), scene.maneuver.speed
        if size.ordinary or control is None or 'mass' not in vehicle.masses:
            return []
        steering = scene.maneuver.steering
        ramp = [f'maneuver.steering.slope={steering.slope * vehicle.turned!r}'] if isinstance(steering, Ramp) else []
        radii = [tire.data['UNLOADED_RADIUS'] for tire in scene.model.tires]
        torques = {name: getattr(control, name) * size.torque for name in ('most', 'least', 'brakes')}
        settings = {'inertia': vehicle.masses['mass'] * float(np.mean(radii))} | torques
        return ramp + [f'maneuver.speed.{name}={float(f"{value:.4g}")!r}' for name, value in settings.items()]

    def _fitted(self, evaluation: Evaluation, text: str) -> list[str]:
        """Settings that an evaluation computes from the scene, with all settings of the user in it."""
        if evaluation.driven.fitted is None:
            return []
        scene = load_scene_text(text, evaluation.name, self.overrides)
        return [f'{key}={value!r}' for key, value in evaluation.driven.fitted(scene).items()]

    def _alone(self, scene: Scene) -> None:
        """Raise SpecError for a car with a trailer."""
        if has_trailer(scene.model):
            raise SpecError(
                f'{self.vehicle.stem} pulls a trailer, and the norm is for cars alone: remove vehicle.trailer, or '
                'drive a scene'
            )

    def _driver(self, text: str, cones: bool) -> list[str]:
        """Settings of the preview driver that depend on the car. cones: whether the maneuver has cones."""
        scene, vehicle = self._known(text)
        self._alone(scene)
        if vehicle.ratio is None:
            raise SpecError(
                f'{self.vehicle.stem} is no vehicle with four wheels and a steering: it has no such maneuver'
            )
        known = {'wheelbase': vehicle.masses['wheelbase'], 'ratio': vehicle.ratio}
        settings = [f'maneuver.driver.{name}={value!r}' for name, value in known.items()]
        if cones:
            settings.append(f'maneuver.driver.path.width={round(width_of(scene), 2)!r}')
            settings.append(f'maneuver.evaluate_with.length={round(known["wheelbase"] / WHEELBASE, 2)!r}')
        return settings

    def _practised(self, evaluation: Evaluation, text: str, settings: list[str]) -> tuple[Path, dict[str, float]]:
        """(recording of the first run that leaves all cones standing, else of the best one; settings of its driver that
        differ).

        The first driver has preview and understeer gradient of the file. The others have previews around that of the
        file, and the gradient of the car or more: a driver steers ahead of a car that answers late.
        """
        scene, vehicle = self._known(text)
        driver = scene.maneuver.driver
        assert driver is not None and vehicle.ratio is not None
        best = self._run(evaluation.name, text, settings)
        found: dict[str, float] = {}
        most = self._clearance(evaluation, best)
        if most >= 0.0:
            return best, found
        slope = self._slope(*self._ramp(text, 1.0, RAMPED_TO)[:2])[0]  # on a dry road: it is that of small angles
        own = max(slope / vehicle.ratio - vehicle.masses['wheelbase'] / scene.start.speed**2, 0.0)
        for more in MORE:
            for factor in PREVIEWS:
                tried = {'preview': round(factor * driver.preview, 3), 'understeer': round(more * own, 5)}
                by = [f'maneuver.driver.{name}={value!r}' for name, value in tried.items()]
                place = self._run(evaluation.name, text, [*settings, *by])
                clearance = self._clearance(evaluation, place)
                if clearance > most:
                    best, most, found = place, clearance, tried
                if most >= 0.0:
                    return best, found
        return best, found

    def _clearance(self, evaluation: Evaluation, place: Path) -> float:
        """Least distance to the cones in a run [m]; minus infinity for one that does not pass them."""
        recording, held, scene = judging.read(place)
        try:
            result = judging.judge(evaluation, recording, str(place), {}, held=held, scene=scene)
        except BagError:
            return -math.inf
        values = [figure.value for figure in result.figures if figure.name.startswith('clearance')]
        return -math.inf if any(math.isnan(value) for value in values) else min(values)

    def _vehicle_overrides(self) -> list[str]:
        """Settings of the user that also apply to the ramp before a maneuver."""
        return [o for o in self.overrides if key_of(o).partition('.')[0] not in OWN]

    def _ramp(
        self, text: str, side: float, enough: float, friction: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """(lateral accelerations [m/s^2], angles of the steering wheel [rad], whether the ramp was too short) of a slow
        ramp.

        It goes to one side (side: 1 left, -1 right; the results are positive), at the speed of the scene, on a flat
        road of this friction [-], up to the acceleration `enough` if the car reaches it. It was too short if it ended
        while the car still answered.
        """
        scene, vehicle = self._known(text)
        speed = scene.start.speed
        drive = Drive(maneuver=CALIBRATION, speed=speed, duration=SECONDS[-1])
        turned = (
            math.inf
            if not vehicle.ratio
            else vehicle.ratio * vehicle.masses['wheelbase'] / max(speed, 1.0) ** 2 * RAMPED_TO
        )
        rate = min(RAMP, turned / SOONEST)
        ramp = scene_text(drive, self.vehicle, CALIBRATION, self.overrides)
        settings = [*self._sized(ramp), f'maneuver.steering.slope={side * rate!r}']
        if friction != 1.0:
            settings.append(f'road.friction={friction!r}')
        key = (f'{enough!r}', ramp, *settings, *self._vehicle_overrides())
        if key not in self._angles:
            for k, seconds in enumerate(SECONDS):
                place = self._run(
                    f'{CALIBRATION}_{"left" if side > 0.0 else "right"}',
                    ramp,
                    [*settings, f'duration={seconds}'],
                    calibration=True,
                )
                s = signals(runs.read(place, NEEDED), str(place), ('steering', 'lateral_acceleration'))
                a, d = (side * low_passed(s[name], s.rate, 6.0) for name in ('lateral_acceleration', 'steering'))
                ended = bool(a.max() <= enough) and rising(a, s.rate)
                if a.max() > enough or (k >= USUAL and not ended):
                    break
            top = int(np.argmax(a > enough)) if a.max() > enough else int(np.argmax(a))
            self._angles[key] = a[: top + 1], d[: top + 1], ended
        return self._angles[key]

    def _friction(self, text: str) -> float:
        """Friction of the road that the maneuver is driven on [-], away from patches."""
        return load_scene_text(text, 'scene of the maneuver', self.overrides).model.road.friction

    def _reaching(self, text: str, wanted: float) -> float:
        """Angle [rad] of the steering wheel for a steady lateral acceleration `wanted` [m/s^2], from a slow ramp to the
        left.

        The car answers late: at any time of the ramp the angle is ahead, by the same amount, of the angle that belongs
        to the acceleration. This amount is the angle at zero acceleration of a straight line through small
        accelerations.
        """
        friction = self._friction(text)
        a, d, ended = self._ramp(text, 1.0, 1.05 * wanted, friction)
        if a.max() < wanted:
            there = ', where the ramp ended' if ended else ''
            raise SpecError(
                f'{self.vehicle.stem} does not reach a lateral acceleration of {wanted:.3g} m/s^2 at this '
                f'speed{on(friction)}: {a.max():.3g} m/s^2 at {math.degrees(d[-1]):.3g} deg of the steering '
                f'wheel{there}; give the steering with --set maneuver.steering=...'
            )
        small = (a >= 0.2 * wanted) & (a <= 0.6 * wanted)
        ahead = line(a[small], d[small])[1] if small.sum() >= 5 else 0.0
        return float(np.interp(wanted, np.maximum.accumulate(a), d)) - ahead

    def _reference(self, text: str, wanted: float) -> float:
        """Angle of the steering wheel [rad] at the lateral acceleration `wanted`, by a straight line; mean of both
        sides."""
        found = []
        friction = self._friction(text)
        for side in (1.0, -1.0):
            a, d, _ = self._ramp(text, side, RAMPED_TO, friction)
            slope, zero = self._slope(a, d, on(friction))
            found.append(zero + slope * wanted)
        return float(np.mean(found))

    def _slope(self, a: np.ndarray, d: np.ndarray, where: str = '') -> tuple[float, float]:
        """(slope, intercept) of the straight line through a ramp for A. where: the road, for the sentence of a
        SpecError."""
        used = (a >= LINE[0]) & (a <= LINE[1])
        if used.sum() < 5 or a.max() < LINE[1]:
            raise SpecError(
                f'{self.vehicle.stem} does not reach {LINE[1]:.3g} m/s^2 in the slowly increasing steer at this '
                f'speed{where}'
            )
        slope, zero = line(a[used], d[used])
        return float(slope), float(zero)

    def _torque(self, label: str, text: str, one: Drive, settings: Sequence[str]) -> float:
        """Braking torque [N m] for the deceleration of the maneuver; if it asks for the hardest braking, the largest
        torque with which no wheel locks."""
        scene, vehicle = self._known(text)
        self._alone(scene)
        heights = {body.name: body.position[2] for body in scene.model.bodies}
        radii = [heights[tire.marker.body] for tire in scene.model.tires]
        if not radii or 'mass' not in vehicle.masses:
            raise SpecError(f'{self.vehicle.stem} is no vehicle with wheels: it has no such maneuver')
        start = float(f'{vehicle.masses["mass"] * float(np.mean(radii)) * one.brakes:.4g}')
        may_lock = scene.assistance.anti_lock is None and scene.fidelity != 'single_track'
        return self._hardest(label, text, start, settings) if one.hardest and may_lock else start

    def _hardest(self, label: str, text: str, start: float, settings: Sequence[str]) -> float:
        """Largest braking torque [N m] with which no wheel locks, to 3 %, found by a search that begins at `start`."""

        def rounded(torque: float) -> float:
            return float(f'{torque:.4g}')

        def rolls(torque: float) -> bool:
            return rolling(self._run(label, text, [*settings, f'{BRAKES}={torque!r}'], quiet=True))

        low = high = start
        grows = rolls(start)
        for _ in range(MOST):
            if grows:
                low, high = high, rounded(high * GROWTH)
            else:
                low, high = rounded(low / GROWTH), low
            if rolls(high if grows else low) != grows:
                break
        else:
            raise SpecError(
                f'{self.vehicle.stem}: no braking torque was found at which its wheels begin to lock; give {BRAKES} '
                'with --set'
            )
        for _ in range(HALVINGS):
            middle = rounded(math.sqrt(low * high))
            low, high = (middle, high) if rolls(middle) else (low, middle)
        return low

    def _run(
        self, label: str, text: str, settings: Sequence[str], *, calibration: bool = False, quiet: bool = False
    ) -> Path:
        """The recording of a run, which is driven unless it is there already. calibration: whether it is the ramp
        before a maneuver."""
        overrides = [*settings, *(self._vehicle_overrides() if calibration else self.overrides)]
        scene = load_scene_text(text, label, overrides)
        place = self.directory / f'{label}-{digest(scene.hash, sources(), *beside_text(scene)).hex()[:12]}'
        if complete(place, scene):
            self.kept += 1
            return place
        if place.exists():
            shutil.rmtree(place)  # an interrupted run of ours, by its name
        interrupts.now(f'driving {label}')
        compiling.tell(self.say, scene.model)
        simulate(simulation_of(scene), scene.steps, directory=place, progress=self.say and not quiet)
        self.driven += 1
        return place


def rolling(place: Path) -> bool:
    """True where no wheel of a recording locks at a speed above CREEPS."""
    run = runs.read(place, ('odom/twist/vx', 'tire_states/*'))
    moving = run['odom/twist/vx'] > CREEPS
    slips = [
        values for name, values in run.columns.items() if name.startswith('tire_states/') and name.endswith('/kappa')
    ]
    return all(bool(np.all(np.abs(slip[moving]) < ROLLS)) for slip in slips)


def rising(a: np.ndarray, rate: float) -> bool:
    """True where the acceleration a (n,) of a ramp, at `rate` [Hz], still grows at its end."""
    k = max(a.size - round(0.5 * rate), 0)
    return bool(a[-1] > (1.0 + RISES) * a[k] and a[-1] > (1.0 - RISES) * a.max())


def on(friction: float) -> str:
    """Words ' on a road of friction ...' for a sentence; '' for a dry road."""
    return '' if friction == 1.0 else f' on a road of friction {friction:g}'


def width_of(scene: Scene) -> float:
    """Width of a car over the outer edges of its tires [m]."""
    places = {body.name: body.position for body in scene.model.bodies}
    return 2.0 * max(abs(places[tire.marker.body][1]) + 0.5 * tire.data['WIDTH'] for tire in scene.model.tires)


def complete(place: Path, scene: Scene) -> bool:
    """True where a recording exists and holds the whole scene."""
    if not place.is_dir():
        return False
    try:
        run = runs.read(place, ('cmd_applied/*',))
    except BagError:
        return False
    return run.metadata.get('scene_hash', '')[:16] == scene.hash and run.metadata.get('status') in (OK, SUSPECT)
