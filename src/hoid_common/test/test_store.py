"""Databases of maps: nothing committed is lost, and nothing of a foreign file is trusted."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from hoid_common.errors import MapFileError
from hoid_common.io.records import Record, column
from hoid_common.store.database import SUFFIX, Database, OwnerLock, kept, replaced, side_files
from hoid_common.store.table import Table, pack, sealed, unpack
from hoid_common.values import BoolArray, ByteArray, FloatArray


@dataclass(frozen=True, eq=False)
class Things(Record):
    """Two named axes."""

    is_red: Annotated[BoolArray, column('?', 'things')]
    position_m: Annotated[FloatArray, column('f8', 'things', 3)]
    voxel: Annotated[ByteArray, column('u1', 'voxels', 2)]


THINGS = Table(
    'scene_things', 'uid', {'stamp_ns': int, 'share': float, 'name': str, 'arrays': Things}
)
OTHER = Table('scene_other', 'uid', {'stamp_ns': int})
BIG = 2**62  # numbers keep all of their 64 bits


def things(count: int, seed: int = 0) -> Things:
    rng = np.random.default_rng(seed)
    return Things(
        rng.random(count) > 0.5,
        rng.normal(size=(count, 3)),
        rng.integers(0, 256, (2 * count, 2)).astype(np.uint8),
    )


def made(path: Path, count: int = 5) -> Path:
    """Make a finished file of some rows, and return its path."""
    with replaced(path) as aside, Database.create(aside, [THINGS]) as database:
        rows = ((uid, BIG + uid, uid / 3, f'thing {uid}', things(uid)) for uid in range(count))
        database.put(THINGS, rows)
    return path


def check(database: Database, count: int = 5) -> None:
    """Check that the rows of `made` come back to the bit."""
    rows = list(database.rows(THINGS))
    assert [row[:4] for row in rows] == [
        (uid, BIG + uid, uid / 3, f'thing {uid}') for uid in range(count)
    ]
    for uid, *_, record in rows:
        assert record.digest() == things(uid).digest()


@pytest.mark.parametrize('count', [0, 1, 7])
def test_records_come_back_to_the_bit_in_aligned_arrays(count: int) -> None:
    back = unpack(Things, pack(things(count)))
    assert back.digest() == things(count).digest()
    assert all(array.flags.aligned for array in back.arrays().values())


@pytest.mark.parametrize('seed', range(30))
def test_bytes_of_another_size_are_no_record(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = pack(things(3))[8:]
    cut = data[: rng.integers(len(data))]
    longer = data + bytes(int(rng.integers(1, 50)))
    huge = np.array(rng.choice([4, -1, 2**62, 2**31]), '<i8').tobytes() + data[8:]
    flag = data[:16] + b'\2' + data[17:]
    for wrong in (cut, longer, huge, flag):
        with pytest.raises(MapFileError, match=r'length|Boolean'):
            unpack(Things, sealed(wrong))
    with pytest.raises(MapFileError, match=r'lengths|checksum'):
        unpack(Things, pack(things(3))[: rng.integers(len(data))])


def test_a_finished_file_is_one_file_that_a_read_only_folder_may_hold(tmp_path: Path) -> None:
    path = made(tmp_path / f'home{SUFFIX}')
    assert list(tmp_path.iterdir()) == [path]
    tmp_path.chmod(0o500)
    try:
        with Database.read(path, [THINGS, OTHER]) as database:
            check(database)
            assert database.row(THINGS, 3) is not None
            assert database.row(THINGS, 9) is None
            assert database.count(THINGS) == 5
            assert (database.has(THINGS), database.has(OTHER)) == (True, False)
            with pytest.raises(MapFileError, match=r'home\.hoidmap: cannot be written'):
                database.clear(THINGS)
    finally:
        tmp_path.chmod(0o700)
    assert list(tmp_path.iterdir()) == [path]


def test_another_package_adds_its_tables_to_a_finished_file(tmp_path: Path) -> None:
    path = made(tmp_path / f'home{SUFFIX}')
    with Database.open(path, [OTHER]) as database, database.transaction():
        database.put(OTHER, [(7, 1)])
    with Database.read(path, [THINGS, OTHER]) as database:
        check(database)
        assert list(database.rows(OTHER)) == [(7, 1)]
    with Database.read(path, [THINGS]) as database:  # the other one's tables are no hindrance
        check(database)
    assert list(tmp_path.iterdir()) == [path]


def test_a_copy_of_a_database_in_use_is_a_finished_file(tmp_path: Path) -> None:
    path, copy = tmp_path / f'running{SUFFIX}', tmp_path / f'home{SUFFIX}'
    copy.write_text('an older one')
    with Database.start(path, [OTHER]) as database:
        with database.transaction():
            database.put(OTHER, [(1, 10), (2, 20)])
        with database.transaction():
            database.put(OTHER, [(2, 21)])
            database.delete(OTHER, [1, 5])
        with replaced(copy) as aside:
            database.copy_to(aside)
        with Database.read(path, [OTHER]) as reader:  # also the running one may be read
            assert list(reader.rows(OTHER)) == [(2, 21)]
        with pytest.raises(MapFileError, match='exists already'):
            Database.start(path, [OTHER])
    assert not any(side.exists() for side in side_files(copy))
    with Database.read(copy, [OTHER]) as database:
        assert list(database.rows(OTHER)) == [(2, 21)]


def fail_after_clearing(database: Database) -> None:
    database.clear(OTHER)
    raise MapFileError('of the block')


def test_what_a_block_wrote_before_it_failed_is_undone(tmp_path: Path) -> None:
    with Database.start(tmp_path / f'a{SUFFIX}', [OTHER]) as database:
        with database.transaction():
            database.put(OTHER, [(1, 10)])
        with pytest.raises(MapFileError), database.transaction():
            fail_after_clearing(database)
        assert list(database.rows(OTHER)) == [(1, 10)]


def test_a_failed_replacement_leaves_the_old_file(tmp_path: Path) -> None:
    path = made(tmp_path / f'home{SUFFIX}')
    before = path.read_bytes()
    with pytest.raises(MapFileError, match=rf'^{path}: exists already'), replaced(path) as aside:
        Database.start(made(aside, 2), [OTHER])
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


_WRITER = """
import sys
from pathlib import Path
from hoid_common.store.database import Database
sys.path.insert(0, sys.argv[2])
from test_store import THINGS, things
with Database.start(Path(sys.argv[1]), [THINGS]) as database:
    for number in range(1, 1000000):
        with database.transaction():
            database.clear(THINGS)
            database.put(THINGS, ((uid, number, 0., '', things(50)) for uid in range(100)))
        print(number, flush=True)
"""


@pytest.mark.parametrize('seed', range(8))
def test_a_killed_writer_leaves_its_last_transaction(seed: int, tmp_path: Path) -> None:
    path = tmp_path / f'running{SUFFIX}'
    command = [sys.executable, '-c', _WRITER, str(path), str(Path(__file__).parent)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == '1\n'
        time.sleep(np.random.default_rng(seed).uniform(0, 0.3))
        writer.send_signal(signal.SIGKILL)
        told = [1, *map(int, writer.stdout.read().split())]
    with Database.open(path, [THINGS]) as database:
        numbers = [row[1] for row in database.rows(THINGS)]
        assert len(numbers) == 100
        assert len(set(numbers)) == 1
        assert numbers[0] in (told[-1], told[-1] + 1)
        with database.transaction():
            database.clear(THINGS)
        database.finish()
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_leaves_the_last_transaction(tmp_path: Path) -> None:
    path = tmp_path / f'running{SUFFIX}'
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    with Database.start(path, [THINGS]) as database:
        with database.transaction():
            database.put(THINGS, [(0, 1, 0.5, 'kept', things(5))])
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, limits[1]))
            match = rf'^{path}: cannot be .*written.*free space'
            with pytest.raises(MapFileError, match=match), database.transaction():
                database.put(THINGS, ((n, 1, 0.5, 'new', things(2000)) for n in range(100)))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            signal.signal(signal.SIGXFSZ, handler)
        assert [row[3] for row in database.rows(THINGS)] == ['kept']
        with database.transaction():
            database.put(THINGS, ((n, 1, 0.5, 'new', things(2000)) for n in range(1, 100)))
    with Database.read(path, [THINGS]) as database:
        assert [row[3] for row in database.rows(THINGS)] == ['kept'] + 99 * ['new']


def test_a_database_has_one_owner_until_its_process_ends(tmp_path: Path) -> None:
    lock = tmp_path / 'maps' / '.running.lock'
    code = (
        'import sys, time; from pathlib import Path\n'
        'from hoid_common.store.database import OwnerLock\n'
        'lock = OwnerLock(Path(sys.argv[1]), "/a/rgbd_slam")\n'
        'print("locked", flush=True); time.sleep(100)\n'
    )
    with subprocess.Popen(
        [sys.executable, '-c', code, str(lock)], stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == 'locked\n'
        with pytest.raises(MapFileError) as caught:
            OwnerLock(lock, '/b/rgbd_slam')
        text = str(caught.value)
        assert f'another /b/rgbd_slam runs already: process {owner.pid} on ' in text
        assert os.uname().nodename in text
        assert len(text.splitlines()) == 1
        owner.kill()
    with OwnerLock(lock, '/b/rgbd_slam'), pytest.raises(MapFileError, match=f'{os.getpid()}'):
        OwnerLock(lock, '/c/rgbd_slam')  # of the same process
    OwnerLock(lock, '/c/rgbd_slam').release()


def test_a_kept_database_takes_its_journal_along_and_overwrites_nothing(tmp_path: Path) -> None:
    name = tmp_path / f'unfinished{SUFFIX}'
    for number, found in enumerate((name, name.with_name(f'unfinished-2{SUFFIX}')), 1):
        path = tmp_path / f'.running{SUFFIX}'
        database = Database.start(path, [OTHER])
        with database.transaction():
            database.put(OTHER, [(1, number)])
        for file in (path, *side_files(path)):  # as a killed process leaves them
            if file.exists():
                shutil.copy(file, tmp_path / f'copy{file.name[len(path.stem) :]}')
        database.close()
        assert kept(tmp_path / f'copy{SUFFIX}', name) == found
        path.unlink()
    for number, found in enumerate((name, name.with_name(f'unfinished-2{SUFFIX}')), 1):
        with Database.read(found, [OTHER]) as database:
            assert list(database.rows(OTHER)) == [(1, number)]


def foreign(path: Path, *statements: str) -> Path:
    """Change a file with SQLite itself, as anybody can."""
    connection = sqlite3.connect(path, isolation_level=None)
    for statement in statements:
        connection.execute(statement)
    connection.close()
    return path


_SET = "UPDATE scene_things SET arrays = x'{}'"
_SECOND = 'CREATE TABLE second (a INTEGER PRIMARY KEY, b TEXT NOT NULL) STRICT'


@pytest.mark.parametrize(
    ('statements', 'fault'),
    [
        (['CREATE VIEW v AS SELECT 1'], 'foreign part'),
        (
            ['CREATE TRIGGER t AFTER DELETE ON scene_things BEGIN DELETE FROM scene_things; END'],
            'foreign part',
        ),
        (['CREATE INDEX i ON scene_things (stamp_ns)'], 'foreign part'),
        (['CREATE VIRTUAL TABLE f USING fts5(a)'], 'foreign part'),
        (['CREATE TABLE a (b INTEGER PRIMARY KEY CHECK (zeroblob(1000000000)))'], 'foreign part'),
        (['CREATE TABLE a (b INTEGER PRIMARY KEY, c AS (zeroblob(1000000000)))'], 'foreign part'),
        (['CREATE TABLE a (b INTEGER PRIMARY KEY AUTOINCREMENT)'], 'foreign part'),
        (['ALTER TABLE scene_things RENAME TO x', _SECOND], 'foreign part'),
        (['ALTER TABLE scene_things DROP COLUMN name'], 'another version'),
        (['PRAGMA user_version = 77'], 'version 77'),
        (['PRAGMA application_id = 77'], 'is no map file'),
        (["UPDATE scene_things SET arrays = x'0000'"], 'shorter than its lengths'),
        (["UPDATE scene_things SET arrays = CAST(arrays || 'x' AS BLOB)"], 'checksum'),
        ([_SET.format(sealed(bytes(16)).hex())], None),
        ([_SET.format(sealed(bytes(17)).hex())], 'another size'),
        (
            [
                'PRAGMA writable_schema = ON',
                "UPDATE sqlite_schema SET sql = replace(sql, 'STRICT', 'WITHOUT ROWID')",
            ],
            'foreign part|damaged',
        ),
        (
            [
                'PRAGMA writable_schema = ON',
                "UPDATE sqlite_schema SET sql = replace(sql, ') STRICT', ')')",
                'PRAGMA writable_schema = RESET',
                "UPDATE scene_things SET name = 5, stamp_ns = 'text'",
                'PRAGMA writable_schema = ON',
                "UPDATE sqlite_schema SET sql = sql || ' STRICT'",
            ],
            'damaged',
        ),
    ],
)
def test_nothing_but_plain_tables_is_read(
    statements: list[str], fault: str | None, tmp_path: Path
) -> None:
    path = foreign(made(tmp_path / f'home{SUFFIX}'), *statements)
    if fault is None:
        with Database.read(path, [THINGS]) as database:
            assert all(len(row[4].is_red) == 0 for row in database.rows(THINGS))
        return
    for opened in (Database.read, Database.open):
        with pytest.raises(MapFileError, match=fault) as caught, opened(path, [THINGS]) as db:
            list(db.rows(THINGS))
        assert str(caught.value).startswith(f'{path}: ')
        assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ('content', 'fault'),
    [
        (b'', 'is no map file'),
        (b'SQLite format 3\0', 'is no map file'),
        (b'no map at all' * 100, 'is no map file'),
        (b'PK\x03\x04' + bytes(200), 'version 0.3'),
    ],
)
def test_other_files_are_no_maps(content: bytes, fault: str, tmp_path: Path) -> None:
    path = tmp_path / f'home{SUFFIX}'
    path.write_bytes(content)
    with pytest.raises(MapFileError, match=fault):
        Database.read(path, [THINGS])
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_no_regular_file_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / f'pipe{SUFFIX}')
    (tmp_path / f'folder{SUFFIX}').mkdir()
    for name, fault in (
        ('pipe', 'not a regular file'),
        ('folder', 'not a regular file|cannot be read'),
        ('missing', 'no such file'),
    ):
        with pytest.raises(MapFileError, match=fault):
            Database.read(tmp_path / f'{name}{SUFFIX}', [THINGS])


@pytest.mark.parametrize('seed', range(120))
def test_a_file_with_any_damaged_bytes_is_read_or_refused(seed: int, tmp_path: Path) -> None:
    path = made(tmp_path / f'home{SUFFIX}', 40)
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(seed)
    for _ in range(rng.choice([1, 10, 100])):
        # The pages' headers and lengths lie at their beginnings.
        page = 16_384 * int(rng.integers(len(data) // 16_384))
        at = min(page + int(rng.exponential(200)), len(data) - 1)
        data[at] = int(rng.choice([0, 255, int(rng.integers(256))]))
    del data[int(rng.choice([len(data), len(data), int(rng.integers(len(data)))])) :]
    path.write_bytes(data)
    try:
        with Database.read(path, [THINGS]) as database:
            for row in database.rows(THINGS):
                assert all(np.asarray(array).size >= 0 for array in row[4].arrays().values())
    except MapFileError as error:
        text = str(error)
        assert (text.startswith(f'{path}: '), len(text.splitlines())) == (True, 1)
    assert list(tmp_path.iterdir()) == [path]
