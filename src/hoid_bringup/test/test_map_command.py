"""`hoid map` describes saved maps, and joins those that show the same places."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hoid_bringup.cli import main
from hoid_bringup.run.offline import MapFiles, run_offline
from hoid_bringup.run.run_config import RunConfig
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.store import map_file

from .test_offline import WallSequence


@dataclass
class OtherWall(WallSequence):
    """A recording of the same motion along a wall with another texture."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.wall = np.ascontiguousarray(self.wall[::-1, ::-1])


def _map_of(sequence: WallSequence, folder: Path, name: str) -> str:
    config = RunConfig().updated({'filter.strategy': 'none'})
    path = folder / name
    run_offline(sequence, config, folder / 'out', maps=MapFiles(save=path), show_progress=False)
    return str(path)


@pytest.fixture(scope='module')
def maps(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Return the files of two maps of different walls."""
    folder = tmp_path_factory.mktemp('maps')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('hoid_bringup.run.outputs.plot_run', lambda *_: None)
        walls = WallSequence(), OtherWall()
        one, other = (_map_of(wall, folder, f'{n}.hoidmap') for n, wall in enumerate(walls))
    return one, other


def test_info_prints_the_size_and_the_camera(
    maps: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['map', 'info', *maps]) == 0
    lines = capsys.readouterr().out.splitlines()
    state = map_file.load(Path(maps[0])).map
    assert lines[0].startswith(f'{maps[0]}: ')
    assert lines[1].startswith(f'keyframes  {len(state)}, over ')
    assert lines[2] == f'points     {len(state.position_m)}'
    assert '320x240, fx=260' in lines[3]
    assert len(lines) == 10


def test_maps_of_one_place_are_joined(
    maps: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'new' / 'folder' / 'joined.hoidmap'
    assert main(['map', 'merge', maps[0], maps[0], '--out', str(out)]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith(f'{maps[0]}: joined with {maps[0]}')
    joined, single = map_file.load(out).map, map_file.load(Path(maps[0])).map
    assert len(joined) == 2 * len(single)
    assert (joined.map_id == 0).all()
    assert len(joined.position_m) < 1.2 * len(single.position_m)


def test_maps_of_different_places_are_not_joined(
    maps: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'new' / 'joined.hoidmap'
    assert main(['map', 'merge', *maps, '--out', str(out)]) == 1
    printed = capsys.readouterr()
    assert f'{maps[1]}: not joined' in printed.out
    assert 'nothing is written' in printed.err
    assert not out.parent.exists()


def test_the_loops_of_a_map_are_listed_with_their_evidence(
    maps: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, path = map_file.load(Path(maps[0])), tmp_path / 'with_loop.hoidmap'
    edge = LoopEdge(0, 2, np.eye(4), np.eye(6), 123, 0.987, 'closed', 0.0123, is_used=False)
    map_file.save(path, content._replace(uids=None, loops=(edge,)))
    assert main(['map', 'loops', str(path), maps[1]]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f'{path}: 1 loops and joins'
    assert lines[2].split() == ['0', 'closed', '0', '2', '123', '99', '%', '0.012', 'm', 'no']
    assert lines[3] == f'{maps[1]}: 0 loops and joins'
    opened = tmp_path / 'opened.hoidmap'
    assert main(['map', 'remove-loop', str(path), '0', '--out', str(opened)]) == 0
    assert f'{opened}: without loop 0, 0 loops' in capsys.readouterr().out
    assert len(map_file.load(opened).map) == len(content.map)
    assert main(['map', 'remove-loop', str(opened), '0']) == 1
    assert 'no loop 0: the map has 0' in capsys.readouterr().err
    assert main(['map', 'remove-loop', str(opened)]) == 1
    assert 'needs a map and the number of a loop' in capsys.readouterr().err


def test_a_pair_that_must_stay_apart_is_not_joined(
    maps: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy, out = tmp_path / 'copy.hoidmap', str(tmp_path / 'joined.hoidmap')
    shutil.copy(maps[0], copy)
    pair = [maps[0], str(copy)]
    assert main(['map', 'merge', *pair, '--out', out, '--apart', *pair]) == 1
    assert f'{copy}: not joined' in capsys.readouterr().out
    assert main(['map', 'merge', *pair, '--out', out, '--join', *pair]) == 0
    assert '% of the points that are expected there' in capsys.readouterr().out
    assert main(['map', 'merge', *pair, '--out', out, '--join', maps[0], maps[1]]) == 1
    assert '--join and --apart take two of the maps' in capsys.readouterr().err


def test_a_merge_without_output_is_refused(
    maps: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['map', 'merge', *maps]) == 1
    assert '--out' in capsys.readouterr().err
