"""Imports of robots' recordings, on files made by the formats' own libraries where there are
any.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxid.base.errors import DatasetError, DatasetWarning, UsageError
from jaxid.cli.app import main
from jaxid.data.importers.robot import (
    import_csv,
    import_lerobot,
    import_mcap,
    import_rosbag,
    import_ur_rtde_csv,
)
from jaxid.data.io import load_dataset


T = np.arange(500) * 0.002
Q = np.stack([0.3 * np.sin(3 * T + j) for j in range(6)], axis=1)


def ur_file(path: Path, keep=None, space: bool = False, **change) -> Path:
    columns = {"timestamp": 100 + T}
    columns |= {f"actual_q_{j}": Q[:, j] for j in range(6)} | {
        f"actual_current_{j}": np.cos(T + j) for j in range(6)
    }
    columns |= {"speed_scaling": np.ones(500), "robot_mode": np.full(500, 7.0)} | change
    table = np.column_stack(list(columns.values()))[keep if keep is not None else slice(None)]
    np.savetxt(
        path,
        table,
        delimiter=" " if space else ",",
        header=(" " if space else ",").join(columns),
        comments="",
        fmt="%.6f",
    )
    return path


@pytest.mark.parametrize("space", [False, True])
def test_files_of_ur_rtde(tmp_path, space):
    with pytest.warns(DatasetWarning, match="1 columns left out"):
        folder = import_ur_rtde_csv(ur_file(tmp_path / "a.csv", space=space), tmp_path / "out")
    data = load_dataset(folder, check_model=False)
    (run,) = data.experiments
    np.testing.assert_allclose(run.y, Q, atol=1e-6)
    np.testing.assert_allclose(run.t, T, atol=1e-6)
    assert [c.name for c in data.inputs] == [f"current{j}" for j in range(1, 7)]
    assert data.outputs[0].resolution == 1e-6


def test_what_ur_rtde_repeats_and_loses_is_counted(tmp_path):
    keep = np.r_[0:100, 99, 99, 105:300, 360:500]
    with pytest.warns(DatasetWarning) as caught:
        folder = import_ur_rtde_csv(ur_file(tmp_path / "a.csv", keep), tmp_path / "out")
    text = " | ".join(str(w.message) for w in caught)
    assert (
        "2 rows repeat a time" in text
        and "65 samples are missing in 2 gaps (13.0 %), the longest of 60" in text
    )
    data = load_dataset(folder, check_model=False)
    assert sum(len(e.t) for e in data.experiments) == 435 and len(data.experiments) == 2
    assert "65 samples are missing" in data.description


def test_rows_of_one_time_that_differ_are_told(tmp_path):
    q = Q[:, 0].copy()
    time = 100 + T.copy()
    time[50] = time[49]
    with pytest.warns(DatasetWarning, match="1 rows repeat a time, 1 of them with other values"):
        import_ur_rtde_csv(
            ur_file(tmp_path / "a.csv", timestamp=time, actual_q_0=q), tmp_path / "out"
        )


def test_a_slowed_robot_and_a_still_joint_are_told(tmp_path):
    file = ur_file(tmp_path / "a.csv", speed_scaling=np.full(500, 0.5), actual_q_3=np.zeros(500))
    with pytest.warns(DatasetWarning) as caught:
        data = load_dataset(import_ur_rtde_csv(file, tmp_path / "out"), check_model=False)
    text = " | ".join(str(w.message) for w in caught)
    assert "slowed down to 50 %" in text and "q4 never moves" in text and len(data.outputs) == 6


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"timestamp,x\n1,2\n2,3\n", "no column actual_q_0"),
        (b"timestamp,actual_q_0\n1,a\n", "row 2, column actual_q_0"),
        (b"", "empty"),
        (None, "no such file"),
    ],
)
def test_other_files_are_refused(tmp_path, content, words):
    file = tmp_path / "a.csv"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(DatasetError, match=words):
        import_ur_rtde_csv(file, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def joint_state(typestore, k: int, names=("shoulder", "elbow")):
    kinds = typestore.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=5, nanosec=int(T[k] * 1e9 + 0.5))
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    order = [0, 1] if k % 2 else [1, 0]  # drivers may change the order

    def pick(values):
        return np.array([values[j] for j in order])

    return kinds["sensor_msgs/msg/JointState"](
        header=header,
        name=[names[j] for j in order],
        position=pick(Q[k, :2]),
        velocity=np.array([]),
        effort=pick(np.cos(Q[k, :2])),
    )


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_joint_states_of_a_ros_bag(tmp_path, storage):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin[storage]) as writer:
        connection = writer.add_connection(
            "/joint_states", "sensor_msgs/msg/JointState", typestore=store
        )
        for k in range(300):
            writer.write(
                connection,
                10**9 + k,
                store.serialize_cdr(joint_state(store, k), "sensor_msgs/msg/JointState"),
            )
    with pytest.warns(DatasetWarning, match="joints are 1 = elbow, 2 = shoulder"):
        data = load_dataset(import_rosbag(tmp_path / "bag", tmp_path / "out"), check_model=False)
    (run,) = data.experiments
    np.testing.assert_array_equal(run.y, Q[:300, [1, 0]])
    np.testing.assert_array_equal(run.u, np.cos(Q[:300, [1, 0]]))
    np.testing.assert_allclose(run.t, T[:300], atol=1e-9)
    if storage == "MCAP":
        with pytest.warns(DatasetWarning):
            again = load_dataset(
                import_mcap(next((tmp_path / "bag").glob("*.mcap")), tmp_path / "again"),
                check_model=False,
            )
        np.testing.assert_array_equal(again.experiments[0].y, run.y)


def test_joint_states_as_json_in_mcap(tmp_path):
    writer_of = pytest.importorskip("mcap.writer").Writer
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = writer_of(stream)
        writer.start()
        schema = writer.register_schema(name="JointStates", encoding="jsonschema", data=b"{}")
        channel = writer.register_channel(
            topic="/joints", message_encoding="json", schema_id=schema
        )
        for k in range(300):
            names = ["a", "b"] if k != 7 else ["a"]
            data = {"name": names, "position": Q[k, : len(names)].tolist()}
            writer.add_message(
                channel,
                log_time=int(T[k] * 1e9 + 0.5),
                publish_time=0,
                data=json.dumps(data).encode(),
            )
        writer.finish()
    with pytest.warns(DatasetWarning, match="1 messages with only some of the joints"):
        data = load_dataset(import_mcap(tmp_path / "a.mcap", tmp_path / "out"), check_model=False)
    np.testing.assert_array_equal(data.experiments[0].y, Q[np.r_[0:7, 8:300], :2])


@pytest.mark.parametrize("import_", [import_mcap, import_rosbag])
def test_what_is_no_bag_is_refused(tmp_path, import_):
    pytest.importorskip("rosbags")
    (tmp_path / "a.mcap").write_bytes(b"nothing of the kind")
    with pytest.raises(DatasetError, match="not readable as"):
        import_(tmp_path / "a.mcap", tmp_path / "out")


def test_episodes_of_lerobot(tmp_path):
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text(
        json.dumps({"fps": 30, "codebase_version": "v3.0"})
    )
    (tmp_path / "data" / "chunk-000").mkdir(parents=True)
    state = np.degrees(Q[:120, :3]).astype(np.float32)
    table = {
        "observation.state": list(state),
        "action": list(state + 1),
        "timestamp": np.tile(np.arange(60) / 30, 2).astype(np.float32),
        "episode_index": np.repeat([0, 1], 60),
    }
    pq.write_table(pa.table(table), tmp_path / "data" / "chunk-000" / "file-000.parquet")
    with pytest.raises(UsageError, match="--unit"):
        import_lerobot(tmp_path, tmp_path / "out")
    with pytest.warns(DatasetWarning, match="30 samples a second are too few"):
        data = load_dataset(
            import_lerobot(tmp_path, tmp_path / "out", unit="deg"), check_model=False
        )
    assert [e.name for e in data.experiments] == ["episode_0", "episode_1"]
    np.testing.assert_allclose(data.experiments[1].y, Q[60:120, :3], atol=1e-6)
    np.testing.assert_allclose(
        data.experiments[0].u - data.experiments[0].y, np.radians(1), atol=1e-6
    )


def test_any_csv_by_a_map_and_the_command(tmp_path, capsys):
    np.savetxt(
        tmp_path / "a.csv",
        np.column_stack([1e3 * T, np.degrees(Q[:, 0]), 1e3 * Q[:, 1]]),
        delimiter=",",
        header="millis,angle,milliamps",
        comments="",
    )
    channels = ["t=millis:ms", "q=angle:deg:output", "current=milliamps:mA"]
    arguments = ["import", "csv", str(tmp_path / "a.csv"), "--out", str(tmp_path / "out"), "--json"]
    assert main([*arguments, *(w for c in channels for w in ("--channel", c))]) == 0
    assert json.loads(capsys.readouterr().out)["channels"] == {"current": "A", "q": "rad"}
    data = load_dataset(tmp_path / "out", check_model=False)
    np.testing.assert_allclose(data.experiments[0].y[:, 0], Q[:, 0])
    np.testing.assert_allclose(data.experiments[0].u[:, 0], Q[:, 1])
    for bad, words in [
        (["q=angle:deg"], "state the time"),
        (["t=millis:ms", "q:angle"], "write NAME=COLUMN:UNIT"),
        (["t=millis:parsec", "q=angle:deg"], "unknown unit"),
        (["t=millis:ms", "q=angel:deg"], "did you mean 'angle'"),
    ]:
        with pytest.raises((UsageError, DatasetError), match=words):
            import_csv(tmp_path / "a.csv", tmp_path / "other", channels=bad)
