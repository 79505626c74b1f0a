"""`hoid run --save-map` saves the object map, and `hoid objects` lists it."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from hoid_bringup.cli import main
from hoid_bringup.run.offline import MapFiles, run_offline
from hoid_bringup.run.run_config import RunConfig
from hoid_common.io.image_size import image_size_px, is_jpeg
from hoid_common.values import Detections, RgbdFrame
from hoid_scene.store import scene_file
from rgbd_slam.store import map_file

from .test_offline import PERIOD_NS, WALL_M, WallSequence


class WallWithPicture(WallSequence):
    """A recording of a wall with a picture, which the detector calls a screen."""

    def detect(self, frame: RgbdFrame) -> Detections:
        x, y = (2 * step for step in self.step(frame.stamp_ns // PERIOD_NS))
        box = np.array([[160 - x, 90 - y, 240 - x, 150 - y]], np.float32)
        return Detections(frame.stamp_ns, box, ('tv',), np.array([0.9], np.float32))


def save(folder: Path, name: str, *, enabled: bool, dense: bool = False) -> Path:
    parameters = {'filter.strategy': 'hoid2d', 'object_map.enabled': enabled}
    wall, path = WallWithPicture(), folder / name
    run_offline(
        wall,
        RunConfig().updated(parameters),
        folder / 'out',
        detect=wall.detect,
        dense=dense,
        maps=MapFiles(save=path),
        show_progress=False,
    )
    return path


@pytest.fixture(scope='module')
def maps(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the files of two maps, with and without objects."""
    folder = tmp_path_factory.mktemp('maps')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('hoid_bringup.run.outputs.plot_run', lambda *_: None)
        one, other = (save(folder, f'{on}.hoidmap', enabled=on) for on in (True, False))
    return one, other


def test_the_objects_of_a_map_are_listed_and_exported(
    maps: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'objects.yaml'
    assert main(['objects', str(maps[0]), '--yaml', str(out)]) == 0
    header, line = capsys.readouterr().out.splitlines()
    assert header.split()[:2] == ['id', 'class']
    assert line.split()[:2] == ['1', 'tv']
    (entry,) = yaml.safe_load(out.read_text())['objects']
    width_m, height_m = sorted(entry['size'])[1:][::-1]
    assert width_m == pytest.approx(80 / 260 * WALL_M, abs=0.08)
    assert height_m == pytest.approx(60 / 260 * WALL_M, abs=0.08)
    assert entry['center'][0] == pytest.approx(WALL_M, abs=0.1)  # x is forward
    assert entry['state'] == 'at_rest'


def test_objects_are_listed_by_class_place_and_state(
    maps: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for words, count in (
        (['--class', 'tv'], 1),
        (['--class', 'cup'], 0),
        (['--state', 'gone'], 0),
        (['--near', '2', '0', '0', '--radius', '0.5'], 1),
        (['--near', '9', '0', '0', '--radius', '0.5'], 0),
    ):
        assert main(['objects', str(maps[0]), *words]) == 0
        assert len(capsys.readouterr().out.splitlines()) == 1 + count, words


def test_a_map_without_objects_is_refused_and_otherwise_the_same(
    maps: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['objects', str(maps[1])]) == 1
    assert 'object_map.enabled' in capsys.readouterr().err
    with_objects, without = (map_file.load(path) for path in maps)
    assert with_objects.map.digest() == without.map.digest()
    assert main(['map', 'info', *map(str, maps)]) == 0
    assert capsys.readouterr().out.count('objects    1, listed by') == 1


def test_a_run_with_a_saved_map_finds_the_same_objects(
    maps: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('hoid_bringup.run.outputs.plot_run', lambda *_: None)
    wall, again = WallWithPicture(), tmp_path / 'again.hoidmap'
    run_offline(
        wall,
        RunConfig().updated({'filter.strategy': 'hoid2d', 'object_map.enabled': True}),
        tmp_path / 'out',
        detect=wall.detect,
        maps=MapFiles(load=maps[0], localize=True, save=again),
        show_progress=False,
    )
    before, after = (scene_file.read_file(path).objects for path in (maps[0], again))
    assert before is not None
    assert after is not None
    assert after.object_id.tolist() == before.object_id.tolist()
    assert after.num_sightings[0] > before.num_sightings[0]


def listed(capsys: pytest.CaptureFixture[str], *argv: object) -> list[str]:
    assert main([*map(str, argv)]) == 0
    return capsys.readouterr().out.splitlines()


def test_objects_are_found_in_words_and_by_time(
    maps: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (['screen'], ['the', 'television'], ['anything'], ['--since', '1h']):
        assert len(listed(capsys, 'objects', maps[0], *words)) == 2
    for words in (['cup'], ['tv', 'in', 'the', 'kitchen'], ['--since', '2100-01-01']):
        assert len(listed(capsys, 'objects', maps[0], *words)) == 1
    for name in ('monitor', '1'):
        title, event = listed(capsys, 'objects', maps[0], '--history', name)
        assert title == '1 tv'
        assert event.endswith('  new')
    with pytest.raises(SystemExit):
        main(['objects', str(maps[0]), '--since', 'tuesday'])
    assert 'neither a time, as 2026-11-27T18:00, nor an age' in capsys.readouterr().err


def test_pictures_and_json_of_objects_are_written(
    maps: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = tmp_path / 'one.json', tmp_path / 'other.json'
    listed(capsys, 'objects', maps[0], '--json', one, '--pictures', tmp_path / 'pictures')
    picture, every = sorted((tmp_path / 'pictures').iterdir())
    assert (picture.name, every.name) == ('1_tv.jpg', 'all.jpg')
    assert image_size_px(every.read_bytes()) == (150, 172)
    assert is_jpeg(picture.read_bytes())
    (line,) = listed(capsys, 'map', 'export', maps[0], '--out', other)
    assert line.startswith(f'{other}: 1 object, ')
    assert one.read_bytes() == other.read_bytes()
    (entry,) = json.loads(one.read_text())['objects']
    assert base64.b64decode(entry['picture']) == picture.read_bytes()
    assert main(['map', 'export', str(maps[0]), '--out', str(tmp_path / 'a.obj')]) == 1
    assert 'FILE.ply, FILE.glb or FILE.json' in capsys.readouterr().err
    assert main(['map', 'export', str(maps[0]), '--out', str(tmp_path / 'a.ply')]) == 1
    assert 'there is no dense map' in capsys.readouterr().err


@pytest.mark.slow
def test_a_map_is_exported_as_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('trimesh', reason='meshes are an optional extra: requirements/mesh.lock')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('hoid_bringup.run.outputs.plot_run', lambda *_: None)
        path = save(tmp_path, 'dense.hoidmap', enabled=True, dense=True)
    for name, options in (('a.ply', []), ('b.ply', ['--semantic']), ('c.glb', [])):
        (line,) = listed(capsys, 'map', 'export', path, '--out', tmp_path / name, *options)
        assert ' triangles, ' in line
    assert b'comment label 1 tv\n' in (tmp_path / 'b.ply').read_bytes()
    assert b'label' not in (tmp_path / 'a.ply').read_bytes()[:600]
    assert (tmp_path / 'c.glb').read_bytes()[:4] == b'glTF'


@pytest.mark.slow
def test_a_saved_map_is_shown_with_boxes_and_pictures_of_its_objects(
    maps: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    why = 'the viewer is an optional extra: requirements/view.lock'
    reader = pytest.importorskip('rerun.chunk', reason=why).RrdReader
    out = tmp_path / 'a.rrd'
    listed(capsys, 'view', maps[0], '--save', out)
    shown = {
        chunk.entity_path: chunk.to_record_batch().to_pydict() for chunk in reader(out).stream()
    }
    boxes = shown['/map/objects']
    assert boxes['Boxes3D:labels'] == [['tv 1']]
    assert boxes['Boxes3D:centers'][0][0][0] == pytest.approx(WALL_M, abs=0.1)
    assert shown['/pictures']['EncodedImage:blob']
    assert '/map/keyframes' in shown
