"""A running node, looked at and driven from a page: its topics become pictures, and what is held becomes commands.

The pictures are those of `/tf`, at the rate `record.poses` of the scene. Commands go out only while a page is at the
wheel, and until the wheel is back in the middle after it has gone; then nobody is heard any more.
"""

from __future__ import annotations

import time
from queue import Empty, Queue
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from mbd_sim_ros.drive.frame import Around, Head, filled_page, page_data, picture
from mbd_sim_ros.drive.hands import LOCK, NOTHING, Hands, Held, Seat, in_force
from mbd_sim_ros.node.commands import PLAIN, commanded
from mbd_sim_ros.node.companion import NoSimulator
from mbd_sim_ros.node.graph import HEARD_HERE, SAID_HERE
from mbd_sim_ros.node.spinning import spin_once
from solver.errors import SceneError
from solver.files.scene import load_scene_text
from solver.files.urdf import link_of
from solver.inputs.command_filter import commands_of
from solver.levels import derive

RATE = 60.0  # Hz of commands; ten times as many would keep the node busy with listening
LINGER = 2.0  # s for which commands go on after the wheel was left: pedals go up, the wheel returns
TIMEOUT = 20.0  # s to wait for the node


class Attached(Node):
    """A desk (mbd_sim_ros.drive.server) at a node. rates: of Hands. Raises MbdError.

    look: why it cannot be driven; '' where it can.
    """

    def __init__(self, name: str, **rates: float) -> None:
        super().__init__('drive')
        self.show: Any = lambda picture: None
        self.look = ''
        self.frames = self.run = 0
        self._simulator, self._rates = name, rates
        space, _, _ = name.rpartition('/')
        self._space = f'{space}/' if space else ''
        self._held: tuple[Held, float] | None = None
        self._left = -LINGER  # clock reading when the wheel was left
        self._asked: Queue[tuple[str, int]] = Queue(8)
        self._sending: dict[str, Publisher] = {}
        self._pose: dict[str, np.ndarray] = {}
        self._force: dict[str, np.ndarray] = {}
        self._shown, self._number, self._notice, self._paused = -1.0, 0, '', False
        self._head = Head(t=0.0)
        self._text = ''
        self._turns = SingleThreadedExecutor()
        self._turns.add_node(self)
        latched = QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        self.create_subscription(String, f'{name}/scene', self._tell, latched, **HEARD_HERE)
        self._find()

    def _tell(self, message: String) -> None:
        self._text = message.data

    def _find(self) -> None:
        """Wait for the scene, and listen to what moves in it."""
        end = time.monotonic() + TIMEOUT
        while not self._text and time.monotonic() < end:
            spin_once(self._turns, self, 0.05)
        if not self._text:
            raise NoSimulator(
                f'--node {self._simulator}: no node of this name tells its scene within {TIMEOUT:g} s; start it, in '
                'the same ROS_DOMAIN_ID, and give its name with its namespace'
            )
        scene = derive(load_scene_text(self._text, f'{self._simulator}/scene')).scene
        spec = scene.model
        if not getattr(spec, 'tires', ()) or spec.chassis is None:
            raise SceneError(
                f'--node {self._simulator}: its scene {scene.name!r} has no car; mbd view shows recordings of it'
            )
        self._names = commands_of(spec.inputs, scene.actuation.steering)
        self.hands: Hands | None = None
        try:
            self.hands = Hands(Seat.of(scene, self._names), **self._rates)
        except SceneError as error:
            self.look = str(error)
        lock = LOCK if self.hands is None else self.hands.seat.lock
        self._drawing, self._page = page_data(scene, f'{self._simulator}: {scene.title or scene.name}', lock)
        self._around, self._place = Around(spec.road), (0.0, 0.0)
        self._links = [link_of(spec, body) for body in self._drawing.bodies]
        self._wheels = [wheel.name for wheel in self._drawing.wheels]
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self.create_subscription(TFMessage, '/tf', self._moved, QoSProfile(depth=10), **HEARD_HERE)
        for wheel in self._wheels:
            self.create_subscription(
                WrenchStamped, f'{self._space}tire/{wheel}/force', self._pressing(wheel), newest, **HEARD_HERE
            )
        self.create_subscription(Imu, f'{self._space}imu', self._shaken, newest, **HEARD_HERE)
        self.create_subscription(Odometry, f'{self._space}odom', self._rolled, newest, **HEARD_HERE)
        self.create_subscription(JointState, f'{self._space}cmd_applied', self._applied, newest, **HEARD_HERE)
        self._calls = {
            action: self.create_client(Trigger, f'{self._simulator}/{action}')
            for action in ('pause', 'resume', 'reset')
        }
        self._steered = time.monotonic()
        self.create_timer(1.0 / RATE, self._steer)

    # -- for pages, on their thread -----------------------------------------------------------------------------------

    def page(self) -> str:
        """The page as HTML."""
        return filled_page(self._page)

    def hold(self, held: Held | None) -> None:
        """Take what is held at the wheel."""
        self._held = None if held is None else (held, time.monotonic())

    def act(self, action: str, value: int) -> None:
        """Pause, resume, reset, or move the lever; more than the node has answered are dropped."""
        if not self._asked.full():
            self._asked.put_nowait((action, value))

    def status(self) -> dict[str, Any]:
        """Account of how it goes, for pages."""
        seat = None if self.hands is None else self.hands.seat
        return {
            'paused': self._paused,
            'begun': True,
            'run': self.run,
            'gears': None if seat is None else [*seat.levers, seat.gears is None or seat.automatic],
            'recording': None,
            'notice': self._notice or self.look,
        }

    def ground(self) -> str:
        """The road around, for pages."""
        return self._around.at(*self._place)

    # -- on the main thread -------------------------------------------------------------------------------------------

    def spin(self, seconds: float) -> bool:
        """Take what comes for a while; whether the node is still there."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            spin_once(self._turns, self, left)
        return self.count_publishers(f'{self._simulator}/scene') > 0

    def close(self) -> None:
        """Leave the wheel, and the graph."""
        self._held = None
        if self._sending:
            self._publish(self.hands.advance(NOTHING, self._head.speed, LINGER) if self.hands else {})
        self._turns.shutdown()
        self.destroy_node()

    def _moved(self, message: TFMessage) -> None:
        for transform in message.transforms:
            p, q = transform.transform.translation, transform.transform.rotation
            self._pose[transform.child_frame_id] = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
        prefix = message.transforms[0].header.frame_id.removesuffix('odom') if message.transforms else ''
        frames = {transform.child_frame_id for transform in message.transforms}
        links = [prefix + link for link in self._links]
        if not frames.issuperset(links):
            return
        stamp = message.transforms[0].header.stamp
        t = stamp.sec + 1e-9 * stamp.nanosec
        self.run += t < self._shown or not self.run
        self._shown = t
        self.frames += 1
        nowhere = np.full(7, np.nan)
        contact = np.array([self._pose.get(f'{prefix}{wheel}_contact', nowhere) for wheel in self._wheels])
        force = np.array([self._force.get(wheel, np.full(3, np.nan)) for wheel in self._wheels])
        pedals = self.hands.pedals if self.hands is not None and self._sending else {}
        head = self._head._replace(
            t=t, number=self._number, gas=pedals.get('gas', 0.0), brake=pedals.get('brake', 0.0),
            hand=pedals.get('hand', 0.0), paused=float(self._paused),
        )  # fmt: skip
        x, y = self._pose[f'{prefix}base_link'][:2].tolist()
        self._place = (x, y)
        self.show(picture(head, np.array([self._pose[link] for link in links]), contact, force))

    def _pressing(self, wheel: str) -> Any:
        def press(message: WrenchStamped) -> None:
            f = message.wrench.force
            self._force[wheel] = np.array([f.x, f.y, f.z])

        return press

    def _shaken(self, message: Imu) -> None:
        a, w = message.linear_acceleration, message.angular_velocity
        self._head = self._head._replace(ax=a.x, ay=a.y, yaw_rate=w.z)

    def _rolled(self, message: Odometry) -> None:
        self._head = self._head._replace(speed=message.twist.twist.linear.x)

    def _applied(self, message: JointState) -> None:
        inputs = dict(zip(message.name, message.position, strict=False))
        gear = inputs.get('gear', float(self.hands.gear) if self.hands is not None and self._sending else 1.0)
        self._head = self._head._replace(steering=inputs.get('steering', 0.0), gear=gear)

    def _steer(self) -> None:
        """Do what pages asked for, and command what is held."""
        now = time.monotonic()
        h, self._steered = now - self._steered, now
        self._ask()
        if self.hands is None:
            return
        if self._held is not None:
            if not self._sending:
                self._sit_down()
            self._left = now
        elif not self._sending:
            return
        elif now - self._left > LINGER:
            for publisher in self._sending.values():
                self.destroy_publisher(publisher)
            self._sending = {}
            return
        held = in_force(self._held)
        self._number = held.number
        self._publish(self.hands.advance(held, self._head.speed, min(h, 0.1)))

    def _sit_down(self) -> None:
        """Take the wheel where it stands."""
        assert self.hands is not None
        self.hands.begin(self._head.steering)
        for name in self._names:
            one = commanded(name)
            if one.topic not in self._sending and (name in PLAIN or one.topic == 'wheel_cmd'):
                kind = JointState if one.topic == 'wheel_cmd' else one.type
                self._sending[one.topic] = self.create_publisher(kind, f'{self._simulator}/{one.topic}', 1, **SAID_HERE)

    def _publish(self, commands: dict[str, float]) -> None:
        single = {}
        for name, value in commands.items():
            one = commanded(name)
            if one.topic == 'wheel_cmd':
                single[name] = value
            elif one.topic in self._sending:
                self._sending[one.topic].publish(one.type(data=int(value) if name == 'gear' else value))
        if single and 'wheel_cmd' in self._sending:
            self._sending['wheel_cmd'].publish(JointState(name=list(single), position=list(single.values())))

    def _ask(self) -> None:
        try:
            action, value = self._asked.get_nowait()
        except Empty:
            return
        if action == 'shift':
            if self.hands is not None:
                self.hands.shift(value)
            return
        client = self._calls[action]
        if not client.service_is_ready():
            self._notice = f'{self._simulator}/{action} does not answer'
            return
        self._notice = ''
        if action != 'reset':
            self._paused = action == 'pause'
        client.call_async(Trigger.Request()).add_done_callback(self._answered)

    def _answered(self, future: Any) -> None:
        answer = future.result()
        self._notice = '' if answer is None or answer.success else answer.message
