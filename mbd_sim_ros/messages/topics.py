"""Topics and the types of their messages, for those who publish them and those who read them: no solver is needed to
know them."""

from __future__ import annotations

from typing import NamedTuple

JOINT_STATE = 'sensor_msgs/msg/JointState'
ODOMETRY = 'nav_msgs/msg/Odometry'
IMU = 'sensor_msgs/msg/Imu'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
TF = 'tf2_msgs/msg/TFMessage'
STRING = 'std_msgs/msg/String'
ARRAY = 'std_msgs/msg/Float64MultiArray'

# The type hashes (REP-2016) of ROS 2 Jazzy; a test compares them with the installed ones.
TYPE_HASHES = {
    JOINT_STATE: 'RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e',
    ODOMETRY: 'RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0',
    IMU: 'RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b',
    WRENCH: 'RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77',
    TF: 'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
    ARRAY: 'RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f',
    STRING: 'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18',
}
DEPTH = 100  # messages kept for a subscriber that has no core just now: a tenth of a second at 1 kHz


class Topic(NamedTuple):
    """Name (relative, except /tf), type and quality of service of what is published; all are volatile, keep last."""

    name: str
    type: str
    depth: int = DEPTH
    reliable: bool = True
    latched: bool = False


INPUTS = Topic('inputs_applied', ARRAY)  # recorded only (mbd_sim_ros.bags.inputs)
MOTIONS = 'body_motions'
ENERGY = 'energies'
ELEMENTS = 'element_states'  # the topic of the outputs of elements, or what those of single kinds begin with


def family(topic: str) -> str:
    """Family of a topic, common to topics that show parts of one thing: ELEMENTS for one of a kind of elements, other
    names as they are."""
    return ELEMENTS if topic.startswith(f'{ELEMENTS}/') else topic
