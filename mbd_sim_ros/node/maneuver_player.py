"""Executable `maneuver`: plays a maneuver onto the command topics in simulation time.

It answers the newest `cmd_applied` of the simulator (whose stamp is the simulation time) with the three commands for that time, in
one stamped message on `lockstep_cmd`, at most `rate` times a second (a command costs the simulator more than a step does), so it keeps
pace in every mode; in lockstep the pair is deterministic. To a simulator without `lockstep_cmd` it sends the three plain commands. A
simulator in lockstep publishes its state again when no answer comes; that is answered only once it is clear that the first answer was
lost: two plain answers to one state would become the commands of two steps. Exit code 0 when the maneuver or the simulator ends.
"""

from __future__ import annotations

import sys

from mbd_sim_ros import interrupts
from mbd_sim_ros.node.main import run

if __name__ == '__main__':
    interrupts.install(lambda text: interrupts.write(2, text), code=0)

import struct
import time

from solver.errors import MbdError
from solver.inputs.hands import COMMANDS, STEERING

FIND = 1.5  # s after the first state in which a simulator that takes stamped commands is found out
LOST = 0.3  # s without a newer state after which the answer to a repeated one is sent again


class NoSimulator(MbdError):
    """There is no simulator to play to."""

    exit_code = 6


def _play() -> int:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64

    from mbd_sim_ros.node.parameters import unknown
    from solver.errors import SceneError
    from solver.files.scene import load_maneuver, load_scene

    node = Node('maneuver')
    name = node.declare_parameter('maneuver', '').value
    scene = node.declare_parameter('scene', '').value  # plays the maneuver of a scene, for its duration
    simulator = node.declare_parameter('simulator', 'simulator').value
    timeout = node.declare_parameter('timeout', 20.0).value  # [s] to wait for the simulator
    rate = node.declare_parameter('rate', 100.0).value  # [Hz] of wall time; 0: answer every step (for fast lockstep)
    duration = node.declare_parameter('duration', 0.0).value  # [s] of simulation time; 0: that of the scene, or no end
    for sentence in unknown(node):
        node.get_logger().warning(sentence)
    if bool(name) == bool(scene):
        raise SceneError('give either a maneuver or a scene: --ros-args -p maneuver:=FILE_OR_NAME, or -p scene:=FILE_OR_NAME')
    if scene:
        loaded = load_scene(scene)
        maneuver, duration = loaded.maneuver, duration or loaded.duration
    else:
        maneuver = load_maneuver(name)
    newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
    publishers = [node.create_publisher(Float64, f'{simulator}/{topic}', newest) for topic in ('steering_cmd', 'torque_cmd', 'brake_cmd')]
    stamped = node.create_publisher(JointState, f'{simulator}/lockstep_cmd', QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE))
    heard = float('inf')  # clock reading of the first state
    now_ns = -1
    repeated = float('inf')  # clock reading when the newest state came again

    def answer(encoded: bytes) -> None:
        nonlocal now_ns, repeated, heard
        heard = min(heard, time.monotonic())
        if now_ns < 0 and stamped.get_subscription_count() == 0 and time.monotonic() - heard < FIND:
            return  # it will come again, or a newer one
        seconds, nanoseconds = struct.unpack_from('<iI', encoded, 4)  # header.stamp
        t_ns = seconds * 1_000_000_000 + nanoseconds
        if t_ns == now_ns:
            repeated = min(repeated, time.monotonic())
            return
        now_ns = t_ns
        send()

    def send() -> None:
        nonlocal repeated
        repeated = float('inf')
        values = maneuver.commands(now_ns * 1e-9)
        if stamped.get_subscription_count():
            named = dict(zip(COMMANDS, values)) | maneuver.further_commands(now_ns * 1e-9)
            if STEERING['torque'] in named:
                del named[COMMANDS[0]]  # the wheel is free
            message = JointState(name=list(named), position=list(named.values()))
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
            stamped.publish(message)
            return
        for publisher, value in zip(publishers, values):
            publisher.publish(Float64(data=value))

    node.create_subscription(JointState, 'cmd_applied', answer, newest, raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    interrupts.now(f'playing {maneuver.name or name or scene} to {simulator}')
    begin = time.monotonic()
    node.get_logger().info(f'waiting for {simulator}')
    while not interrupts.event.is_set():
        answered = now_ns
        executor.spin_once(timeout_sec=0.1)
        if time.monotonic() - repeated > LOST:
            send()
        if rate > 0.0 and now_ns != answered:
            time.sleep(1.0 / rate)  # meanwhile the queue of depth one keeps the newest
        if now_ns < 0 and time.monotonic() - begin > timeout:
            listening = publishers[0].get_subscription_count() > 0
            what = 'is there but sends no cmd_applied (is it paused?)' if listening else 'is not there'
            raise NoSimulator(
                f'the simulator {simulator!r} {what}: nothing came within {timeout:g} s; see the parameters simulator and timeout'
            )
        if now_ns >= 0 and publishers[0].get_subscription_count() == 0:
            node.get_logger().info(f'the simulator has ended at t = {now_ns * 1e-9:.3f} s')
            break
        if duration > 0.0 and now_ns >= duration * 1e9:
            node.get_logger().info(f'the maneuver has ended at t = {now_ns * 1e-9:.3f} s')
            break
    executor.shutdown()
    node.destroy_node()
    interrupts.check()
    return 0


def main(args: list[str] | None = None) -> int:
    """Play a maneuver; returns the exit code."""
    return run(_play, args, 'maneuver')


if __name__ == '__main__':
    sys.exit(main())
