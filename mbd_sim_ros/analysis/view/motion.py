"""Motion of a drawing, from a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbd_sim_ros.analysis.runs import must_match
from mbd_sim_ros.analysis.view.drawing import WORLD_BODY, Drawing, drawing_of
from mbd_sim_ros.analysis.view.ground import Ground
from mbd_sim_ros.bags import reader
from mbd_sim_ros.bags.patterns import fits
from mbd_sim_ros.bags.poses import Poses, read_poses
from mbd_sim_ros.bags.published import load_published, told
from solver.errors import BagError
from solver.files.scene import load_scene_text
from solver.files.urdf import link_of
from solver.levels import derive

VEHICLE = ('odom/twist/vx', 'imu/ay', 'imu/wz', 'joint_states/steering_wheel/position', 'tire/*/force/fz')
MOST_CURVES = 6  # of a mechanism, where nobody says which


@dataclass(frozen=True, kw_only=True)
class RecordedMotion:
    """One recording in motion.

    follows: the body in the middle of the picture, or WORLD_BODY. time: (n,) instants [s]. pose: (n, nb, 7) of the
    bodies of the drawing in the world: positions [m], quaternions xyzw. contact: (n, nw, 3) where the tires touch the
    road [m]; force: (n, nw, 3) on the wheels there, in the axes of the world [N]; both are NaN where there is none.
    run: the columns that are shown beside. ground: the road.
    """

    name: str
    drawing: Drawing
    ground: Ground
    follows: int
    time: np.ndarray
    pose: np.ndarray
    contact: np.ndarray
    force: np.ndarray
    run: reader.Run

    def point(self, k: int, body: int, place: tuple[float, float, float]) -> np.ndarray:
        """Place of a point of a body at instant k, in the world [m]."""
        if body == WORLD_BODY:
            return np.array(place)
        pose = self.pose[k, body]
        return pose[:3] + rotated(pose[3:], np.array(place))


def rotated(q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Vectors x (..., 3) turned by unit quaternions q (..., 4) xyzw."""
    u, w = q[..., :3], q[..., 3:]
    t = 2.0 * np.cross(u, x)
    return x + w * t + np.cross(u, t)


def read_motion(path: Path, channels: tuple[str, ...] = (), scene: str | None = None) -> RecordedMotion:
    """A recording of ours, or of the topics of the node, in motion. channels: patterns of those that are drawn as
    curves. scene: name or file of that which is drawn where the recording does not say it.

    Raises BagError if nobody says the scene, or the recording does not place its bodies.
    """
    poses = read_poses(path)
    patterns = list(channels) if channels else [*VEHICLE, 'joint_states/*/position']
    said = told(path)
    run = reader.read(path, [*patterns, 'tire/*/force/*'], namespace='' if said is None else said.namespace)
    text = run.metadata.get('resolved_scene', '') if said is None else said.scene
    if said is not None:
        run.metadata['namespace'] = said.namespace
    if text:
        shown = load_scene_text(text, run.metadata.get('scene', f'scene in {path}'))
    elif scene is not None:
        shown = load_published(scene)
    else:
        raise BagError(
            f'{path} names no scene, so there is nothing to draw: record the topic ~/scene too, or name the scene with '
            '--scene'
        )
    spec = derive(shown).scene.model
    drawing = drawing_of(spec)
    prefix = _prefix(poses)
    frames = [prefix + link_of(spec, name) for name in drawing.bodies]
    missing = [frame for frame in frames if frame not in poses.frames]
    if missing:
        other = '' if text else f', or {scene} is not its scene'
        raise BagError(
            f'{path}: /tf does not place {missing[0]!r} ({len(missing)} bodies missing); record with record.poses '
            f'above 0{other}'
        )
    order = [poses.frames.index(frame) for frame in frames]
    contact, force = _contacts(poses, drawing, prefix, run)
    follows = drawing.bodies.index(spec.chassis) if spec.chassis and drawing.wheels else WORLD_BODY
    return RecordedMotion(
        name=Path(path).name,
        drawing=drawing,
        ground=Ground(spec.road),
        follows=follows,
        time=poses.time_ns * 1e-9,
        pose=poses.pose[:, order],
        contact=contact,
        force=force,
        run=run,
    )


def _prefix(poses: Poses) -> str:
    return poses.root.removesuffix('odom')


def _contacts(poses: Poses, drawing: Drawing, prefix: str, run: reader.Run) -> tuple[np.ndarray, np.ndarray]:
    """Places of contact and forces there, in the world, at the instants of the poses."""
    n = len(poses.time_ns)
    contact, force = np.full((n, len(drawing.wheels), 3), np.nan), np.full((n, len(drawing.wheels), 3), np.nan)
    topics = {
        name.rsplit('/tire/', 1)[-1] if '/tire/' in name else name.removeprefix('tire/'): name for name in run.series
    }
    for w, wheel in enumerate(drawing.wheels):
        frame, topic = f'{prefix}{wheel.name}_contact', topics.get(f'{wheel.name}/force')
        if frame not in poses.frames or topic is None:
            continue
        one, at = run.series[topic], poses.pose[:, poses.frames.index(frame)]
        values = np.column_stack(
            [np.interp(poses.time_ns, one.time_ns, one.columns[f'{topic}/{axis}']) for axis in ('fx', 'fy', 'fz')]
        )
        contact[:, w], force[:, w] = at[:, :3], rotated(at[:, 3:], values)
    return contact, force


def curves_of(motion: RecordedMotion, channels: tuple[str, ...] = ()) -> list[str]:
    """The channels that are drawn beside the motion."""
    names = list(motion.run.columns)
    patterns = channels or (VEHICLE if motion.drawing.wheels else ())
    chosen = [name for pattern in patterns for name in names if fits(name, pattern)]
    if not chosen and not channels:
        chosen = [name for name in names if fits(name, 'joint_states/*/position')][:MOST_CURVES]
    must_match(motion.run, channels, motion.name)
    return list(dict.fromkeys(chosen))
