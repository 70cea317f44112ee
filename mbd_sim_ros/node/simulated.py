"""What a simulator runs, as far as a node beside it can hear.

Its parameters `scene` and `overrides` name what `~/load` takes next, which need not be what runs. Its diagnostics name what runs, without
file and overrides. So the parameters count while the scene that they name has the name in the diagnostics; else a scene of that name does.
"""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from solver.errors import MbdError, SceneError
from solver.files.scene import load_scene
from solver.scene import Scene


class Simulated:
    """The scene of a simulator: `look` tells it, learnt anew whenever another one is loaded."""

    def __init__(self, node: Node, simulator: str) -> None:
        self._status = f'{node.resolve_topic_name(simulator)}: simulation'
        self._name = ''  # of what runs
        self._described = False
        self._scene: Scene | None = None
        self._asked: Any = None  # future of the parameters
        self._client = node.create_client(GetParameters, f'{simulator}/get_parameters')
        latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(String, 'robot_description', self.described, latched)
        node.create_subscription(DiagnosticArray, '/diagnostics', self.diagnosed, 10)

    def look(self) -> Scene | None:
        """The scene that runs; None while it is not known. Raises MbdError for one that cannot be loaded."""
        if self._scene is None and self._asked is not None and self._asked.done():
            scene, overrides = self._asked.result().values
            self._scene = named(self._name, scene.string_value, [text for text in overrides.string_array_value if text])
        return self._scene

    def described(self, _: String) -> None:
        """A description is published once for each scene, whatever its name: any but the first one heard is of one just loaded."""
        if self._described:
            self._name, self._scene, self._asked = '', None, None
        self._described = True

    def diagnosed(self, array: DiagnosticArray) -> None:
        """Note what runs, and ask for the parameters, at every diagnosis until they are told: an answer may be lost."""
        for status in array.status:
            if status.name == self._status:
                if status.hardware_id != self._name:
                    self._name, self._scene, self._asked = status.hardware_id, None, None
                if self._scene is None and self._client.service_is_ready():
                    self._asked = self._client.call_async(GetParameters.Request(names=['scene', 'overrides']))


def named(name: str, scene: str, overrides: list[str]) -> Scene:
    """The scene called `name`: that of the parameters if they lead to it, else the one of config/scenes. Raises MbdError for none."""
    reason = f'its parameter scene = {scene!r} names another one by now, and config/scenes has none of that name'
    for place, changes in ((scene, overrides), (name, [])):
        try:
            found = load_scene(place, changes)
        except MbdError as error:
            if place == scene:
                reason = str(error)
            continue
        if found.name == name:
            return found
    raise SceneError(f'the simulator runs {name!r}, which cannot be loaded here: {reason}; give the parameter scene')
