"""Storage of bags as recorders leave it: compressed, without metadata, or killed."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import pytest
from backports import zstd
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import StoragePlugin, Writer

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_reader import BagReader, is_bag
from hoid_bags.bag.metadata import METADATA
from hoid_bags.storage import bag_types
from hoid_common.errors import InputError
from hoid_common.values import CameraModel

from .bag_copies import read_messages

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

    monkeypatch.setattr('hoid_bags.storage.write_ahead_log.shutil.copyfile', full)
    with pytest.raises(
        InputError, match=r'live\.db3-wal: the messages in this log cannot be read'
    ):
        stamps_ns(file)


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('has_metadata', [True, False])
def test_a_file_that_is_cut_off_costs_no_other_file(
    plugin: StoragePlugin, has_metadata: bool, tmp_path: Path
) -> None:
    bag = write(tmp_path / 'bag', plugin)
    file = next(path for path in bag.iterdir() if path.name != METADATA)
    packed = zstd.compress(file.read_bytes())
    file.unlink()
    for i in range(3):
        data = packed if i < 2 else packed[: len(packed) // 8]
        (bag / f'bag_{i}{file.suffix}.zstd').write_bytes(data)
    if has_metadata:
        names = ''.join(f'\n  - bag_{i}{file.suffix}.zstd' for i in range(3))
        text = (bag / METADATA).read_text().replace(f'\n  - {file.name}', names)
        (bag / METADATA).write_text(text)
    else:
        (bag / METADATA).unlink()
    with BagReader(bag) as reader:
        assert sum(1 for _ in reader.messages()) == 2 * NUM_MESSAGES
        assert 'bag_2' in (reader.fault or '') or 'cut off' in (reader.fault or '')


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize(
    'qos',
    [
        '- durability: 1\n  reliability: 2',
        '- durability: transient_local\n  reliability: best_effort',
    ],
)
def test_qos_profiles_may_lack_entries(plugin: StoragePlugin, qos: str, tmp_path: Path) -> None:
    bag = write(tmp_path / 'bag', plugin)
    (bag / METADATA).unlink()
    file = next(iter(bag.iterdir()))
    if plugin == StoragePlugin.SQLITE3:
        with sqlite3.connect(file) as database:
            database.execute('UPDATE topics SET offered_qos_profiles = ?', (qos,))
    else:
        rewrite_mcap(file, qos)
    assert stamps_ns(bag) == list(range(NUM_MESSAGES))
    with BagReader(bag) as reader:
        (topic,) = reader.topics
        assert topic.qos is not None
        assert topic.qos.durability == QosDurability.TRANSIENT_LOCAL
        assert topic.qos.reliability == QosReliability.BEST_EFFORT


def rewrite_mcap(file: Path, qos: str) -> None:
    """Write the messages of an MCAP file anew, with another text for the QoS of the topic."""
    whole = read_messages(file)
    with file.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start('ros2')
        schema = writer.register_schema(bag_types.CAMERA_INFO, 'ros2msg', b'')
        channel = writer.register_channel('/info', 'cdr', schema, {'offered_qos_profiles': qos})
        for message in whole:
            writer.add_message(channel, message.log_ns, message.data, message.log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
