"""Storage of bags as recorders leave it: compressed, without metadata, or killed."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import pytest
from backports import zstd
from rosbags.rosbag2 import StoragePlugin, Writer

from hoid_bags.bag import bag_messages, bag_types
from hoid_bags.bag.bag_reader import BagReader, is_bag
from hoid_bags.bag.metadata import METADATA
from hoid_common.errors import InputError
from hoid_common.values import CameraModel

NUM_MESSAGES = 20
CAMERA = CameraModel(32, 24, 30, 30, 15.5, 11.5)


def write(path: Path, plugin: StoragePlugin, *, packed: bool = False) -> Path:
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        store = bag_types.shared_typestore()
        topic = writer.add_connection('/info', bag_types.CAMERA_INFO, typestore=store)
        for i in range(NUM_MESSAGES):
            message = bag_messages.camera_info(i, CAMERA)
            data = bytes(bag_types.serialize(message, bag_types.CAMERA_INFO))
            writer.write(topic, i, zstd.compress(data) if packed else data)
    return path


def stamps_ns(path: Path) -> list[int]:
    with BagReader(path) as reader:
        kinds = {topic.name: topic.type_name for topic in reader.topics}
        found = [bag_types.deserialize(m.data, kinds[m.topic]) for m in reader.messages()]
        assert reader.fault is None
    return [message.header.stamp.nanosec for message in found]


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('has_metadata', [True, False])
@pytest.mark.parametrize('packed', ['', 'message', 'file'])
def test_every_storage_is_read(
    plugin: StoragePlugin, has_metadata: bool, packed: str, tmp_path: Path
) -> None:
    bag = write(tmp_path / 'bag', plugin, packed=packed == 'message')
    if packed == 'file':
        file = next(path for path in bag.iterdir() if path.name != METADATA)
        file.with_name(f'{file.name}.zstd').write_bytes(zstd.compress(file.read_bytes()))
        file.unlink()
        text = (bag / METADATA).read_text().replace(file.name, f'{file.name}.zstd')
        (bag / METADATA).write_text(text)
    if not has_metadata:
        (bag / METADATA).unlink()
    assert is_bag(bag)
    assert stamps_ns(bag) == list(range(NUM_MESSAGES))


def test_an_empty_storage_identifier_does_not_matter(tmp_path: Path) -> None:
    bag = write(tmp_path / 'bag', StoragePlugin.MCAP)
    text = (bag / METADATA).read_text()
    (bag / METADATA).write_text(text.replace('storage_identifier: mcap', "storage_identifier: ''"))
    assert stamps_ns(bag) == list(range(NUM_MESSAGES))


def kill_recorder(tmp_path: Path) -> Path:
    """Return a .db3 file whose messages from the tenth on are in its log, as after SIGKILL."""
    whole = next(write(tmp_path / 'whole', StoragePlugin.SQLITE3).glob('*.db3'))
    live, killed = tmp_path / 'live.db3', tmp_path / 'killed'
    shutil.copyfile(whole, live)
    killed.mkdir()
    recorder = sqlite3.connect(live)
    late = recorder.execute('SELECT * FROM messages WHERE id > 10').fetchall()
    recorder.execute('DELETE FROM messages WHERE id > 10')
    recorder.commit()
    recorder.execute('PRAGMA journal_mode=WAL')
    recorder.execute('PRAGMA wal_autocheckpoint=0')
    recorder.executemany('INSERT INTO messages VALUES (?, ?, ?, ?)', late)
    recorder.commit()
    for name in ('live.db3', 'live.db3-wal', 'live.db3-shm'):
        shutil.copyfile(tmp_path / name, killed / name)
    recorder.close()
    return killed / 'live.db3'


def test_messages_in_the_log_of_a_killed_sqlite_recording_are_read(tmp_path: Path) -> None:
    file = kill_recorder(tmp_path)
    before = {path.name: path.read_bytes() for path in file.parent.iterdir()}
    assert stamps_ns(file) == stamps_ns(file.parent) == list(range(NUM_MESSAGES))
    assert {path.name: path.read_bytes() for path in file.parent.iterdir()} == before


def test_a_log_that_cannot_be_copied_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = kill_recorder(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('hoid_bags.mcap.write_ahead_log.shutil.copyfile', full)
    with pytest.raises(
        InputError, match=r'live\.db3-wal: the messages in this log cannot be read'
    ):
        stamps_ns(file)
