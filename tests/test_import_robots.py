# ruff: noqa: E501 (tables of cases, one a line)
"""Recordings of robots by topic, unit and name of joint: bags and MCAP by their own writers,
LeRobot's layouts, chains of a URDF.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxid.base.errors import DatasetError, DatasetWarning, UsageError
from jaxid.data.dataset import Controller, Dataset, ModelSpec
from jaxid.data.importers.robot import import_lerobot, import_mcap, import_rosbag
from jaxid.data.importers.ros import _arm_first, _sliding
from jaxid.data.importers.ros_messages import JointRows
from jaxid.data.importers.runs import ImportedRun
from jaxid.data.io import load_dataset, save_dataset
from jaxid.data.joint_names import in_chain_order


N = 120
T = np.arange(N) * 0.01
Q = np.stack([0.3 * np.sin(3 * T + j) for j in range(3)], 1)
TAU = np.cos(Q)
START = 1_767_225_600 * 10**9
NAMES = ["elbow", "lift", "pan"]


def load(folder: Path) -> Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_dataset(folder, check_model=False)


def quiet(function: Any, *args: Any, **more: Any) -> Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load(function(*args, **more))


# ---- ROS 2


class Bag:
    """Writes messages with rosbags into a bag or an MCAP file."""

    def __init__(self, path: Path, storage: str = "MCAP"):
        pytest.importorskip("rosbags")
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import get_typestore, Stores

        self.store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self.path = path
        self.writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage])
        self.topics: dict[str, Any] = {}

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *_):
        self.writer.close()

    def register(self, name: str, definition: str) -> None:
        from rosbags.typesys import get_types_from_msg

        self.store.register(get_types_from_msg(definition, name))

    def message(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, k: int) -> Any:
        stamp = START + k * 10**7
        time = self.message(
            "builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9
        )
        return self.message("std_msgs/msg/Header", stamp=time, frame_id="")

    def write(self, topic: str, kind: str, k: int, message: Any, behind: bytes = b"") -> None:
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        self.writer.write(
            self.topics[topic],
            START + k * 10**7,
            bytes(self.store.serialize_cdr(message, kind)) + behind,
        )

    def states(
        self,
        topic: str,
        names=NAMES,
        q=Q,
        tau: np.ndarray | None = TAU,
        behind: bytes = b"",
        qd=np.zeros(0),
    ) -> None:
        kind = "sensor_msgs/msg/JointState"
        n = len(names)
        for k in range(N):
            effort = np.zeros(0) if tau is None else tau[k, :n]
            self.write(
                topic,
                kind,
                k,
                self.message(
                    kind,
                    header=self.header(k),
                    name=list(names),
                    position=q[k, :n],
                    velocity=qd,
                    effort=effort,
                ),
                behind,
            )

    @property
    def file(self) -> Path:
        return next(self.path.glob("*.mcap"))


def both(bag: Bag, out: Path, **more: Any) -> Dataset:
    """The recording by either importer, which must agree."""
    first = quiet(import_rosbag, bag.path, out / "bag", **more)
    second = quiet(import_mcap, bag.file, out / "mcap", **more)
    np.testing.assert_array_equal(first.experiments[0].y, second.experiments[0].y)
    np.testing.assert_array_equal(first.experiments[0].u, second.experiments[0].u)
    return first


def test_topics_are_listed_and_never_mixed(tmp_path):
    with Bag(tmp_path / "bag") as bag:
        bag.states("/leader/joint_states", q=Q + 1)
        bag.states("/follower/joint_states")
    for function, file in ((import_rosbag, bag.path), (import_mcap, bag.file)):
        with pytest.raises(
            DatasetError,
            match=r"2 topics hold states of joints.*/leader/joint_states \(120 messages: elbow, lift, pan\).*--topic /follower/joint_states \(and --command-topic /leader/joint_states",
        ):
            function(file, tmp_path / "out")
    data = both(
        bag, tmp_path / "o", topic="/follower/joint_states", command_topic="/leader/joint_states"
    )
    (run,) = data.experiments
    np.testing.assert_array_equal(run.y, Q)
    np.testing.assert_allclose(
        run.t, T, atol=1e-12
    )  # stamps that count from 1970 keep their nanoseconds
    np.testing.assert_array_equal(
        np.stack([run.auxiliary[f"q{k}_cmd"] for k in (1, 2, 3)], 1), Q + 1
    )
    assert data.model is not None and data.model.joints == {
        "q1": "elbow",
        "q2": "lift",
        "q3": "pan",
    }
    with pytest.raises(
        DatasetError,
        match="no topic '/folower/joint_states' .did you mean '/follower/joint_states'",
    ):
        import_mcap(bag.file, tmp_path / "out", topic="/folower/joint_states")


def test_two_publishers_on_one_topic(tmp_path):
    with Bag(tmp_path / "a") as bag:
        bag.states("/joint_states")
        bag.states("/joint_states", ["finger"])
    data = both(bag, tmp_path / "o")
    assert [c.name for c in data.outputs] == [
        "q1",
        "q2",
        "q3",
    ] and "another publisher, of finger (120 messages)" in data.description
    with Bag(tmp_path / "b") as bag:
        for k in range(2 * N):
            kind, other = "sensor_msgs/msg/JointState", k % 2
            q = Q[k // 2] + 0.5 * other
            bag.write(
                "/joint_states",
                kind,
                k,
                bag.message(
                    kind,
                    header=bag.header(k),
                    name=NAMES,
                    position=q,
                    velocity=np.zeros(0),
                    effort=q,
                ),
            )
    with pytest.raises(DatasetError, match="two publishers of the same joints are mixed"):
        quiet(import_mcap, bag.file, tmp_path / "p")


def test_messages_with_bytes_behind_and_quantities_nobody_measured(tmp_path):
    with Bag(tmp_path / "bag") as bag:
        bag.states("/joint_states", behind=b"\0" * 40, qd=np.zeros(3))
    data = both(bag, tmp_path / "o")
    assert "120 messages of sensor_msgs/msg/JointState have trailing bytes" in data.description
    assert "qd is 0 throughout, so it was not measured" in data.description
    np.testing.assert_array_equal(data.experiments[0].y, Q)


def test_commands_of_ros2_control(tmp_path):
    commanded = "std_msgs/msg/Float64MultiArray"
    with Bag(tmp_path / "bag") as bag:
        bag.states("/joint_states", tau=None)
        layout = bag.message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        point, trajectory = (f"trajectory_msgs/msg/JointTrajectory{end}" for end in ("Point", ""))
        for k in range(5, N, 2):
            bag.write(
                "/forward_position_controller/commands",
                commanded,
                k,
                bag.message(commanded, layout=layout, data=Q[k, ::-1] + 1),
            )
            due = bag.message("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
            points = [
                bag.message(
                    point,
                    positions=Q[k, ::-1] + 2,
                    velocities=np.zeros(0),
                    accelerations=np.zeros(0),
                    effort=np.zeros(0),
                    time_from_start=due,
                )
            ]
            bag.write(
                "/arm/joint_trajectory",
                trajectory,
                k,
                bag.message(
                    trajectory, header=bag.header(k), joint_names=NAMES[::-1], points=points
                ),
            )
    with pytest.raises(
        DatasetError,
        match="holds 3 numbers a message without names of joints.*--command-joints elbow,lift,pan",
    ):
        quiet(
            import_rosbag,
            bag.path,
            tmp_path / "o",
            command_topic="/forward_position_controller/commands",
        )
    last = 5 + (np.arange(5, N) - 5) // 2 * 2  # the command before each state
    plain = both(
        bag,
        tmp_path / "a",
        command_topic="/forward_position_controller/commands",
        command_joints=NAMES[::-1],
    )
    np.testing.assert_allclose(plain.experiments[0].u, Q[last] + 1)
    np.testing.assert_array_equal(plain.experiments[0].y, Q[5:])
    assert "5 samples before the first command" in plain.description
    named = both(bag, tmp_path / "b", command_topic="/arm/joint_trajectory")
    np.testing.assert_allclose(named.experiments[0].u, Q[last] + 2)
    with pytest.raises(DatasetError, match=r"is not there.*Name one of: .*/arm/joint_trajectory"):
        quiet(import_rosbag, bag.path, tmp_path / "o", command_topic="/commands")


INTERFACES = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/DynamicJointState": (
        "std_msgs/Header header\nstring[] joint_names\n"
        "control_msgs/InterfaceValue[] interface_values\n"
    ),
}


def test_joints_of_ros2_control_among_sensors(tmp_path):
    value, state = INTERFACES
    with Bag(tmp_path / "bag") as bag:
        for name, definition in INTERFACES.items():
            bag.register(name, definition)
        for k in range(N):
            values = [
                bag.message(
                    value,
                    interface_names=["effort", "position", "temperature"],
                    values=np.array([TAU[k, j], Q[k, j], 40.0]),
                )
                for j in range(3)
            ]
            wrist = bag.message(value, interface_names=["force.x"], values=np.array([1.0]))
            bag.write(
                "/dynamic_joint_states",
                state,
                k,
                bag.message(
                    state,
                    header=bag.header(k),
                    joint_names=[*NAMES, "wrist_sensor"],
                    interface_values=[*values, wrist],
                ),
            )
    data = both(bag, tmp_path / "o")
    np.testing.assert_array_equal(data.experiments[0].y, Q)
    np.testing.assert_array_equal(data.experiments[0].u, TAU)


MOTORS = {
    "unitree_go/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau_est\n",
    "unitree_go/msg/LowState": "uint32 tick\nunitree_go/MotorState[20] motor_state\n",
    "unitree_go/msg/MotorCmd": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 tau\nfloat32 kp\nfloat32 kd\n",
    "unitree_go/msg/LowCmd": "unitree_go/MotorCmd[20] motor_cmd\nuint32 crc\n",
}


def test_a_quadruped_by_the_definitions_in_the_recording(tmp_path):
    with Bag(tmp_path / "bag") as bag:
        for name, definition in MOTORS.items():
            bag.register(name, definition)
        still = {"mode": 1, "q": 0.0, "dq": 0.0}
        for k in range(N):
            states = [
                bag.message(
                    "unitree_go/msg/MotorState",
                    mode=1,
                    q=float(Q[k, j % 3]),
                    dq=1.0,
                    tau_est=float(TAU[k, j % 3]),
                )
                for j in range(12)
            ]
            states += [bag.message("unitree_go/msg/MotorState", **still, tau_est=0.0)] * 8
            bag.write(
                "/lowstate",
                "unitree_go/msg/LowState",
                k,
                bag.message("unitree_go/msg/LowState", tick=k, motor_state=states),
            )
            goals = [
                bag.message(
                    "unitree_go/msg/MotorCmd",
                    mode=1,
                    q=float(Q[k, j % 3]) + 1,
                    dq=0.0,
                    tau=0.0,
                    kp=20.0,
                    kd=0.5,
                )
                for j in range(20)
            ]
            bag.write(
                "/lowcmd",
                "unitree_go/msg/LowCmd",
                k,
                bag.message("unitree_go/msg/LowCmd", motor_cmd=goals, crc=0),
            )
    data = both(bag, tmp_path / "o", command_topic="/lowcmd")
    assert data.model is not None and list(data.model.joints.values())[:4] == [
        "FR_hip_joint",
        "FR_thigh_joint",
        "FR_calf_joint",
        "FL_hip_joint",
    ]
    assert len(data.outputs) == len(data.inputs) == 12
    np.testing.assert_allclose(data.experiments[0].y[:, :3], Q, atol=1e-6)
    np.testing.assert_allclose(data.experiments[0].auxiliary["q2_cmd"], Q[:, 1] + 1, atol=1e-6)
    np.testing.assert_allclose(data.experiments[0].auxiliary["kp12_cmd"], 20.0)


# ---- LeRobot


def lerobot(folder: Path, version: str, names, state: np.ndarray, action: np.ndarray) -> Path:
    """The layout of v2.1 (a file an episode) or v3 (one file)."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    stated = {"motors": names} if version == "v2.1" else names
    features = {
        k: {"dtype": "float32", "shape": [len(names)], "names": stated}
        for k in ("action", "observation.state")
    }
    (folder / "meta" / "info.json").write_text(
        json.dumps({"codebase_version": version, "fps": 100, "features": features})
    )
    n = len(state) // 2
    for episode in (0, 1):
        own = slice(episode * n, (episode + 1) * n)
        table = {
            "observation.state": list(state[own]),
            "action": list(action[own]),
            "timestamp": np.arange(n) / 100,
            "episode_index": np.full(n, episode),
        }
        name = (
            f"episode_{episode:06d}.parquet" if version == "v2.1" else f"file-{episode:03d}.parquet"
        )
        pq.write_table(pa.table(table), folder / "data" / "chunk-000" / name)
    return folder


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_keep_their_names_and_a_unit_a_joint(tmp_path, version):
    state = np.column_stack([np.degrees(Q[:, 0]), 1e3 * Q[:, 1], 50 + 50 * Q[:, 2]])
    names = ["shoulder_pan.pos", "slide.pos", "gripper.pos"]
    data = quiet(
        import_lerobot,
        lerobot(tmp_path / "ds", version, names, state, state + 1),
        tmp_path / "out",
        unit=["deg", "slide=mm"],
    )
    assert data.model is not None and data.model.joints == {"q1": "shoulder_pan", "q2": "slide"}
    assert {c.name: (c.role, c.unit) for c in data.channels if not c.name.endswith("_cmd")} == {
        "q1": ("output", "rad"),
        "q2": ("output", "m"),
        "gripper3": ("auxiliary", "1"),
    }
    np.testing.assert_allclose(data.experiments[1].y, Q[60:, :2], atol=1e-6)
    assert "nominal" in data.description and len(data.experiments) == 2


def test_normalised_values_need_what_they_stand_for(tmp_path):
    action = np.column_stack(
        [
            np.clip(130 * np.sin(3 * T), -100, 100),
            np.clip(120 * np.cos(3 * T), -100, 100),
            50 + 50 * np.sin(T),
        ]
    )
    folder = lerobot(
        tmp_path / "ds", "v3.0", ["pan.pos", "lift.pos", "gripper.pos"], 0.9 * action, action
    )
    with pytest.raises(
        DatasetError,
        match="normalised by the recorder: pan .within -100..100, touching its end., lift.*--calibration FILE.*--range pan=",
    ):
        quiet(import_lerobot, folder, tmp_path / "out", unit="deg")
    small = lerobot(
        tmp_path / "small",
        "v2.1",
        ["pan.pos", "lift.pos", "gripper.pos"],
        0.9 * action,
        action * [1, 0.5, 1],
    )
    with pytest.raises(
        DatasetError, match="lift .within -100..100, beside one that touches its end"
    ):
        quiet(import_lerobot, small, tmp_path / "out", unit="deg", ranges=["pan=-110:110"])
    with pytest.raises(UsageError, match="is not a unit of a joint"):
        quiet(import_lerobot, folder, tmp_path / "out", unit="%")
    with pytest.raises(UsageError, match="joints: pan, lift, gripper"):
        quiet(import_lerobot, folder, tmp_path / "out")
    data = quiet(
        import_lerobot,
        folder,
        tmp_path / "a",
        unit="deg",
        ranges=["pan=-110:110", "lift=-100:90", "gripper=0:60"],
    )
    np.testing.assert_allclose(
        data.experiments[0].u[:, 0], np.radians(1.1 * action[:60, 0]), atol=1e-6
    )
    np.testing.assert_allclose(
        data.experiments[0].u[:, 1], np.radians(0.95 * action[:60, 1] - 5), atol=1e-6
    )
    np.testing.assert_allclose(
        data.experiments[0].u[:, 2], np.radians(0.6 * action[:60, 2]), atol=1e-6
    )
    motors = {
        n: {
            "id": k,
            "drive_mode": int(n == "lift"),
            "homing_offset": 0,
            "range_min": 1024,
            "range_max": 3072,
        }
        for k, n in enumerate(("pan", "lift", "gripper"))
    }
    (tmp_path / "calibration.json").write_text(json.dumps(motors))
    data = quiet(import_lerobot, folder, tmp_path / "b", calibration=tmp_path / "calibration.json")
    np.testing.assert_allclose(
        data.experiments[0].u[:, 0], np.pi / 2 * action[:60, 0] / 100, atol=1e-6
    )
    np.testing.assert_allclose(
        data.experiments[0].u[:, 1], -np.pi / 2 * action[:60, 1] / 100, atol=1e-6
    )
    np.testing.assert_allclose(data.experiments[0].u[:, 2], np.pi * action[:60, 2] / 100, atol=1e-6)
    for bad, words in (
        ("pan=1", "NAME=LO:HI"),
        ("pann=0:1", "did you mean 'pan'"),
        ("pan=1:1", "two ends that differ"),
    ):
        with pytest.raises(UsageError, match=words):
            quiet(import_lerobot, folder, tmp_path / "c", unit="deg", ranges=[bad])


# ---- names of joints


def recording(joints=("elbow", "lift", "pan", "finger")) -> Dataset:
    q = {f"q{k + 1}": Q[:, k % 3] + k for k in range(len(joints))}
    tau = {f"tau{k + 1}": TAU[:, k % 3] + k for k in range(len(joints))}
    commands = {f"q{k + 1}_cmd": Q[:, k % 3] - k for k in range(len(joints))}
    return Dataset.from_arrays(
        T,
        tau,
        q,
        auxiliary=commands,
        model=ModelSpec(joints={f"q{k + 1}": n for k, n in enumerate(joints)}),
        check_model=False,
        initial={"q1": 0.1, "q3": 0.3},
        controller=Controller("pd", {"kp": [1.0, 2.0, 3.0, 4.0][: len(joints)], "kd": 0.5}),
    )


def test_joints_come_in_the_order_of_the_chain():
    data = in_chain_order(recording(), ("pan", "lift", "elbow"))
    (run,) = data.experiments
    np.testing.assert_array_equal(run.y, Q[:, [2, 1, 0]] + [2, 1, 0])
    np.testing.assert_array_equal(run.u, TAU[:, [2, 1, 0]] + [2, 1, 0])
    np.testing.assert_array_equal(run.auxiliary["q1_cmd"], Q[:, 2] - 2)
    np.testing.assert_array_equal(
        run.auxiliary["q4"], Q[:, 0] + 3
    )  # the gripper, which the chain lacks
    assert (
        run.initial == {"q3": 0.1, "q1": 0.3}
        and data.controller is not None
        and data.controller.settings["kp"] == [3.0, 2.0, 1.0]
    )
    assert (
        "the recording has elbow, lift, pan, finger; left out, for the chain lacks them: finger"
        in data.notes[-1]
    )
    assert (
        in_chain_order(data, ("pan", "lift", "elbow")).experiments == data.experiments
    )  # nothing left to do


def test_names_with_what_drivers_put_around_them_and_names_that_do_not_match():
    data = in_chain_order(
        recording(("Elbow.pos", "arm/lift_joint", "pan-joint")),
        ("pan_joint", "lift_joint", "elbow_joint"),
    )
    np.testing.assert_array_equal(data.experiments[0].y, Q[:, [2, 1, 0]] + [2, 1, 0])
    with pytest.raises(
        UsageError,
        match="no joint wrist of the chain pan, lift, wrist; it has elbow, lift, pan, finger",
    ):
        in_chain_order(recording(), ("pan", "lift", "wrist"))
    unnamed = Dataset.from_arrays(
        T, {"tau1": TAU[:, 0], "tau2": TAU[:, 1]}, {"q1": Q[:, 0], "q2": Q[:, 1]}, check_model=False
    )
    assert "left out, for the chain has 1" not in "".join(
        in_chain_order(unnamed, ("pan", "lift")).notes
    )
    assert "by their numbers" in in_chain_order(unnamed, ("pan", "lift")).notes[-1]


CHAIN = """<robot name="a">{links}{joints}</robot>"""


def urdf(names, extra: str = "", inertia: str = "0.1 0.1 0.1", limit: str = "") -> str:
    xx, yy, zz = inertia.split()
    body = f'<inertial><mass value="1"/><origin xyz="0.1 0 0"/><inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
    links = '<link name="base"/>' + "".join(f'<link name="l_{n}">{body}</link>' for n in names)
    parents = ["base", *(f"l_{n}" for n in names)]
    joints = "".join(
        f'<joint name="{n}" type="revolute"><parent link="{p}"/><child link="l_{n}"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>{limit}</joint>'
        for n, p in zip(names, parents, strict=False)
    )
    return CHAIN.format(links=links + extra, joints=joints)


def test_a_dataset_with_its_own_urdf_is_matched_by_name(tmp_path):
    folder = save_dataset(recording(("elbow", "lift", "pan")), tmp_path / "ds")
    (folder / "arm.urdf").write_text(urdf(["pan", "lift", "elbow"]))
    text = (
        (folder / "dataset.toml")
        .read_text()
        .replace("[model]\n", "")
        .replace(
            "[model.joints]", '[model]\nname = "serial_arm"\nurdf = "arm.urdf"\n[model.joints]'
        )
    )
    (folder / "dataset.toml").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = load_dataset(folder)
    np.testing.assert_array_equal(data.experiments[0].y, Q[:, [2, 1, 0]] + [2, 1, 0])
    assert data.model is not None and data.model.joints == {
        "q1": "pan",
        "q2": "lift",
        "q3": "elbow",
    }


# ---- URDF


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (urdf(["a"], inertia="0.1 -0.1 0.1"), "link 'l_a' has a negative principal moment"),
        (
            urdf(["a"]).replace('mass value="1"', 'mass value="-1"'),
            "link 'l_a' has a mass of -1 kg",
        ),
        (
            urdf(["a"], limit='<limit lower="1" upper="-1"/>'),
            "joint 'a' has lower = 1 above upper = -1",
        ),
        (
            urdf(["a"])
            .replace("<robot", '<robot xmlns:xacro="x"')
            .replace('"0.1 0 0"', '"${x} 0 0"'),
            "xacro arm.urdf > arm_expanded.urdf",
        ),
        (
            urdf(
                ["a"],
                '<link name="b"/><joint name="c" type="revolute"><parent link="base"/><child link="b"/><axis xyz="0 1 0"/></joint>',
            ),
            "--tip LINK. Ends to choose from: b, l_a",
        ),
    ],
)
def test_faults_of_a_urdf_are_named_with_what_to_type(tmp_path, content, words):
    from jaxid.robots.urdf_tree import read_urdf

    (tmp_path / "arm.urdf").write_text(content)
    with pytest.raises(UsageError, match=words):
        read_urdf(tmp_path / "arm.urdf")
    assert (tmp_path / "arm.urdf").read_text() == content


def test_an_inertia_that_no_body_can_have_is_named_where_it_moves(tmp_path):
    from jaxid.robots.urdf_tree import read_urdf

    (tmp_path / "b.urdf").write_text(urdf(["a"], inertia="0.1 0.1 0.3"))
    with pytest.warns(
        DatasetWarning,
        match="link 'l_a' has principal moments of inertia 0.1, 0.1, 0.3.*no body can have",
    ):
        read_urdf(tmp_path / "b.urdf")

    body = '<inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.9"/></inertial>'
    (tmp_path / "a.urdf").write_text(
        urdf(["a"]).replace('<link name="base"/>', f'<link name="base">{body}</link>')
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_urdf(tmp_path / "a.urdf").joints == ("a",)


def test_several_roots(tmp_path):
    from jaxid.robots.urdf_tree import read_urdf

    (tmp_path / "a.urdf").write_text(
        urdf(["a", "b"], '<link name="world"/><link name="table"/>')
    )  # loose links belong to nothing
    assert read_urdf(tmp_path / "a.urdf").joints == ("a", "b")
    other = '<link name="w"/><link name="x"/><joint name="c" type="revolute"><parent link="w"/><child link="x"/><axis xyz="0 1 0"/></joint>'
    (tmp_path / "b.urdf").write_text(urdf(["a"], other))
    with pytest.raises(UsageError, match="--root LINK"):
        read_urdf(tmp_path / "b.urdf")
    assert read_urdf(tmp_path / "b.urdf", root="base").joints == ("a",)


def test_a_hand_within_0_and_1_is_no_angle(tmp_path):
    state = np.linspace(0.1, 2.0, 60)[:, None] * np.array([1.0, 0.4])
    for name, unit, kept in (
        ("LeftHandThumb", ["rad"], "auxiliary"),
        ("LeftHandThumb", ["rad", "LeftHandThumb=rad"], "output"),
        ("elbow", ["rad"], "output"),
    ):
        folder = lerobot(tmp_path / f"{name}{len(unit)}", "v2.1", ["shoulder", name], state, state)
        data = quiet(import_lerobot, folder, tmp_path / f"out_{name}{len(unit)}", unit=unit)
        assert [
            c.role for c in data.channels if not c.name.endswith("_cmd") and c.name != "q1"
        ] == [kept]
        assert ("within 0..1" in data.description) == (kept == "auxiliary")


def test_fingers_that_may_slide_are_told_as_no_angle():
    t = np.linspace(0, 1, 60)
    q = np.stack([0.04 * t, t, 0.5 * t], 1)
    rows = JointRows(t, ("left_finger_joint", "elbow", "gripper_base"), {"q": q})
    names = _arm_first(rows)
    assert names == ("elbow", "gripper_base", "left_finger_joint")
    run = ImportedRun("a", t, {"q1": q[:, 1], "q2": q[:, 2], "q3": q[:, 0]})
    assert _sliding(names, [run]) == ["left_finger_joint"]
    assert _sliding(names[2:], [ImportedRun("a", t, {"q1": q[:, 0]})]) == []
