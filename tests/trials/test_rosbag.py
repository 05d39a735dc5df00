"""ROS 2 bags without ROS: both storages, messages of ROS 2 and of the bench's own, stamps, errors, damage."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mcap", reason="mcap (extra `logs`) is not installed")
pytest.importorskip("rosbags", reason="rosbags (extra `logs`) is not installed")

from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter

from hystmpc.trials.check import check
from hystmpc.trials.errors import LogError
from hystmpc.trials.mcap_ import open_bag
from hystmpc.trials.read import expand_logs, read_log, read_trials

from .message_logs import JOINTS, assert_prefix, bag_types, columns, mapping, read_or_refused, write_bag

PLUGINS = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]
ROWS = [(10 + 0.02 * k, 0.001 * k, math.radians(2 * k)) for k in range(50)]
STAMPED = mapping(command={"signal": "/cmd.data", "unit": "m"}, angle={"signal": "/tip/angle.data", "unit": "rad"})
BY_NAME = mapping(
    command={"signal": "/joints.position[tendon]", "unit": "m"},
    angle={"signal": "/joints.position[1]", "unit": "rad"},
    time="header",
)


@pytest.fixture(scope="module", params=PLUGINS, ids=lambda plugin: plugin.name)
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "trial_01", request.param, ROWS)


def storage(bag: Path) -> Path:
    """The bag's one storage file."""
    return next(file for file in bag.iterdir() if file.name != "metadata.yaml")


def test_topics_of_different_stamps_are_one_trial(bag: Path) -> None:
    """Command and angle are logged 3 ms apart: the angle's stamps count, the last angle has no command after it."""
    trial = read_log(bag, STAMPED)
    assert (trial.units.command, trial.source) == ("mm", str(bag))
    np.testing.assert_allclose(trial.t, 0.02 * np.arange(49) + 0.003, atol=1e-9)
    np.testing.assert_allclose(trial.command, np.arange(49))
    np.testing.assert_allclose(trial.angle, 2.0 * np.arange(49))


def test_joints_are_found_by_index_and_by_name(bag: Path) -> None:
    trial = read_log(bag, BY_NAME)
    np.testing.assert_allclose(trial.t, 0.02 * np.arange(50), atol=1e-9)
    np.testing.assert_allclose(trial.command, np.arange(50))
    np.testing.assert_allclose(trial.angle, 2.0 * np.arange(50))


def test_the_storage_file_alone_will_do(bag: Path, tmp_path: Path) -> None:
    """What a recorder that was killed leaves has no metadata.yaml."""
    assert columns(read_log(storage(bag), STAMPED)) == columns(read_log(bag, STAMPED))
    shutil.copy(storage(bag), tmp_path)
    assert expand_logs([tmp_path]) == [tmp_path / storage(bag).name]
    assert len(read_trials([tmp_path], STAMPED)) == 1


def test_a_bag_is_one_log_and_a_folder_of_bags_many(bag: Path) -> None:
    assert expand_logs([bag]) == [bag]
    assert expand_logs([bag.parent]) == [bag]
    assert check(bag, STAMPED).of("values")[0].severity == "ok"


def test_a_bag_without_a_mapping_lists_what_it_holds(bag: Path) -> None:
    with pytest.raises(
        LogError, match=r"mapping file after --layout; available: /cmd\.data, /tip/angle\.header"
    ) as caught:
        read_log(bag)
    assert "/joints.position[1]" in open_bag(bag).names()
    assert "(8 in all)" in str(caught.value)  # texts cannot be mapped


@pytest.mark.parametrize(
    ("signal", "text"),
    [
        ("/cmnd.data", r"no topic of signal '/cmnd\.data'; topics: /cmd, /joints, /notes, /tip/angle"),
        ("/cmd.value", r"topic '/cmd' \(std_msgs/msg/Float64\) has no 'value' .*available: data"),
        ("/joints.position[wrist]", r"has no 'position\.wrist'"),
        ("/joints.position[2]", r"has no 'position\[2\]'"),
        ("/joints.effort[0]", r"has no 'effort\[0\]'"),
        ("/notes.data", r"'data' is str, expected a number"),
        ("/joints.position", r"'position' is no single number"),
    ],
)
def test_errors_name_file_topic_and_what_there_is(signal: str, text: str, bag: Path) -> None:
    with pytest.raises(LogError, match=text) as caught:
        read_log(bag, mapping(command=signal, angle="/tip/angle.data"))
    assert str(bag) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("plugin", PLUGINS)
def test_a_bag_without_messages_is_refused(plugin: StoragePlugin, tmp_path: Path) -> None:
    write_bag(tmp_path / "empty", plugin, [])
    with pytest.raises(LogError, match="message"):
        open_bag(tmp_path / "empty")
    with BagWriter(tmp_path / "one", version=9, storage_plugin=plugin) as writer:
        store = bag_types()
        connection = writer.add_connection("/joints", JOINTS, typestore=store)
        writer.write(connection, 5, b"\x00\x01\x00\x00rubbish")
    with pytest.raises(LogError, match=r"topic '/joints': a message cannot be read: sensor_msgs/msg/JointState"):
        read_log(tmp_path / "one", BY_NAME)
    with pytest.raises(LogError, match="no such file"):
        open_bag(tmp_path / "absent")


@settings(max_examples=25)
@given(data=st.data())
def test_a_bag_cut_anywhere_gives_what_it_still_holds(
    data: st.DataObject, bag: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    whole = read_log(bag, STAMPED)
    content = storage(bag).read_bytes()
    cut = data.draw(st.integers(0, len(content)))
    damaged = tmp_path_factory.mktemp("cut") / "trial_01"
    shutil.copytree(bag, damaged)
    storage(damaged).write_bytes(content[:cut])
    for place in (damaged, storage(damaged)):
        assert_prefix(read_or_refused(place, STAMPED), whole)


@settings(max_examples=20)
@given(data=st.data())
def test_any_bytes_are_read_or_refused(
    data: st.DataObject, bag: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    damaged = tmp_path_factory.mktemp("flip") / "trial_01"
    shutil.copytree(bag, damaged)
    for file in damaged.iterdir():
        content = bytearray(file.read_bytes())
        for at in data.draw(st.lists(st.integers(0, len(content) - 1), max_size=3)):
            content[at] = data.draw(st.integers(0, 255))
        file.write_bytes(content)
    read_or_refused(damaged, STAMPED)


@pytest.mark.parametrize("package", ["rosbags", "mcap"])
def test_a_missing_package_is_named_with_its_extra(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, ROWS[:3])
    monkeypatch.setitem(sys.modules, package, None)  # Python then finds no such package
    path = tmp_path / ("bag" if package == "rosbags" else "a.mcap")
    with pytest.raises(LogError, match=rf"needs the package {package}: pip install 'hystmpc\[logs\]'"):
        read_log(path, STAMPED)
