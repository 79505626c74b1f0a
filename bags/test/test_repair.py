"""Repair of the folder of a killed recorder, and of damaged bags."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.interfaces import QosDurability

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.info import summarize
from hoid_bags.bag.repair import repair
from hoid_bags.storage.bag_types import IMU
from hoid_bags.storage.qos_profiles import recorded_qos
from hoid_common.errors import InputError
from hoid_common.io.files import abandoned_scratch_folders

KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from hoid_bags.bag import bag_messages
from hoid_bags.storage.bag_types import IMU
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.storage.qos_profiles import recorded_qos
with BagWriter(Path(sys.argv[1])) as writer:
    writer.add_topic('imu', IMU, recorded_qos(latched=True))
    for i in range(100):
        writer.write('imu', 1 + i, bag_messages.imu(1 + i, np.full(3, float(i))))
        if i == 89:
            writer.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""


def killed_recording(bag: Path) -> Path:
    """Return the folder of a recorder that was killed ten messages after its last flush."""
    subprocess.run([sys.executable, '-c', KILLED, str(bag)], check=False, timeout=60)
    (left,) = abandoned_scratch_folders(bag.parent)
    return left


def test_all_that_was_flushed_is_in_the_repaired_bag(tmp_path: Path) -> None:
    left = killed_recording(tmp_path / 'a bag')
    assert left.name.startswith('.a bag.partial-')
    bag = repair(left)
    assert bag == tmp_path / 'a bag'
    assert not left.exists()
    summary = summarize(bag)
    assert (summary.fault, summary.num_messages) == (None, 90)
    with BagReader(bag) as reader:
        (topic,) = reader.topics
        assert (topic.name, topic.type_name) == ('/imu', IMU)
        assert topic.qos is not None
        assert topic.qos.durability == QosDurability.TRANSIENT_LOCAL
        assert [message.log_ns for message in reader.messages()] == list(range(1, 91))


def test_another_recording_of_the_name_stays(tmp_path: Path) -> None:
    left = killed_recording(tmp_path / 'bag')
    (tmp_path / 'bag').mkdir()
    assert repair(left) == tmp_path / 'bag_repaired'
    assert list((tmp_path / 'bag').iterdir()) == []


def test_a_damaged_bag_stays_beside_its_repair(bag: Path) -> None:
    file = bag / 'bag.mcap'
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    repaired = repair(bag)
    assert repaired == bag.with_name('bag_repaired')
    assert file.read_bytes() == data
    assert (summarize(repaired).fault, summarize(repaired).num_messages) == (None, 180 - 24)


def test_a_point_in_the_name_of_a_folder_is_no_suffix(bag: Path) -> None:
    assert repair(bag.rename(bag.with_name('run.2'))) == bag.with_name('run.2_repaired')


def test_what_is_still_recorded_is_left_alone(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('imu', IMU, recorded_qos())
        writer.write('imu', 1, bag_messages.imu(1, np.zeros(3)))
        (folder,) = tmp_path.glob('.bag.partial-*')
        with pytest.raises(InputError, match='is still being recorded'):
            repair(folder)
    assert summarize(tmp_path / 'bag').num_messages == 1


@pytest.mark.parametrize('name', ['.', '..'])
def test_a_folder_named_as_if_it_led_elsewhere_is_no_scratch_folder(
    tmp_path: Path, name: str
) -> None:
    folder = tmp_path / f'.{name}.partial-ab'
    folder.mkdir()
    with pytest.raises(InputError, match='not a bag'):
        repair(folder)
    assert folder.exists()
