"""`hoid view --save`, read back with the viewer's own reader; no window is needed."""

from __future__ import annotations

import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bringup import cli
from hoid_bringup.run.outputs import write_outputs
from hoid_bringup.run.summary import FilterCounts, RunResult
from hoid_bringup.view import view
from hoid_common import se3
from hoid_common.slam_status import SlamState, SlamStatus
from hoid_common.values import FloatArray, Trajectory
from hoid_scene.dense.submap import ColoredCloud
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig

pytestmark = pytest.mark.thorough

_WHY = 'the viewer is an optional extra: requirements/view.lock'
log = pytest.importorskip('hoid_bringup.view.view_log', reason=_WHY, exc_type=ModuleNotFoundError)
RrdReader = pytest.importorskip('rerun.chunk', reason=_WHY).RrdReader

FRAMES = 8
POINTS_M = np.arange(30, dtype=np.float32).reshape(10, 3)
T_MAP_WORLD = se3.exp(np.array([0.3, -0.2, 1.0, 0.5, -1.0, 2.0]))


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered recording, with ground-truth poses and boxes."""
    path = tmp_path_factory.mktemp('view') / 'scene'
    write_bag(SceneConfig(num_frames=FRAMES, width_px=160, near_m=1.5), path, workers=1)
    return path


@pytest.fixture
def run(bag: Path, tmp_path: Path) -> Path:
    """The output folder of a run that estimated the true trajectory, in another map frame."""
    truth = BagSequence(bag).ground_truth
    assert truth is not None
    final = Trajectory(truth.stamps_ns, T_MAP_WORLD @ truth.T_world_camera)
    colors = np.full((10, 3), (10, 20, 30), np.uint8)
    result = RunResult(
        input_name='scene',
        options={'filter': 'hoid2d', 'seed': 3, 'rate': 1.0, 'filter.classes': ['cup']},
        frames_total=FRAMES,
        frames_processed=FRAMES,
        final=final,
        online=final,
        keyframes=Trajectory(final.stamps_ns[::4], final.T_world_camera[::4]),
        map_points_m=POINTS_M.astype(np.float64),
        ground_truth=truth,
        status=SlamStatus(SlamState.TRACKING, keyframes=2, map_points=10),
        filter_counts=FilterCounts(),
        stage_ms={},
        peak_rss_mb=1.0,
        cloud=ColoredCloud(POINTS_M, colors),
        recording=bag,
    )
    write_outputs(tmp_path / 'run', result)
    return tmp_path / 'run'


Columns = dict[str, dict[str, list[Any]]]


def saved(argv: list[str], path: Path) -> Columns:
    """Run `hoid view` and return the rows of the file by entity and component."""
    assert cli.main(['view', *argv, '--save', str(path)]) == 0
    out: Columns = defaultdict(lambda: defaultdict(list))
    for chunk in RrdReader(path).stream():
        entity = chunk.entity_path.removeprefix('/')
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            values = batch.column(name)
            is_time = name == 'time'
            out[entity][name] += (values.cast('int64') if is_time else values).to_pylist()
    return out


def strip_m(columns: Columns, entity: str) -> FloatArray:
    """Return the (N, 3) positions of a trajectory that is one line strip."""
    (strips,) = columns[entity]['LineStrips3D:strips']
    return np.array(strips[0])


def test_a_recording_is_shown_image_by_image(bag: Path, tmp_path: Path) -> None:
    shown = saved([str(bag)], tmp_path / 'a b.rrd')
    sequence = BagSequence(bag)
    truth = sequence.ground_truth
    assert truth is not None
    stamps_ns = truth.stamps_ns.tolist()
    for entity in (log.CAMERA, log.IMAGE, log.DEPTH, log.BOXES, log.KEPT, log.REMOVED):
        assert sorted(shown[entity]['time']) == stamps_ns
    assert not {log.ESTIMATED_PATH, log.KEYFRAMES, log.POINTS, log.CLOUD} & shown.keys()
    np.testing.assert_allclose(
        strip_m(shown, log.TRUE_PATH), truth.T_world_camera[:, :3, 3], atol=1e-5
    )
    frame = next(iter(sequence))
    blobs = shown[log.IMAGE]['EncodedImage:blob'] + shown[log.DEPTH]['EncodedDepthImage:blob']
    color, depth_mm = (
        np.asarray(cv2.imdecode(np.array(blobs[i][0], np.uint8), cv2.IMREAD_UNCHANGED))
        for i in (0, FRAMES)
    )
    assert np.abs(color.astype(float) - frame.image_bgr).mean() < 6  # JPEG
    np.testing.assert_allclose(depth_mm / 1000, frame.depth_m[::2, ::2], atol=6e-4)
    assert all(len(points) > 20 for points in shown[log.KEPT]['Points2D:positions'])
    true = sequence.true_detections
    assert true is not None
    named = [' '.join(labels or ()) for labels in shown[log.BOXES]['Boxes2D:labels']]
    people = [list(true[stamp_ns].class_names).count('person') for stamp_ns in stamps_ns]
    assert [text.count('person') for text in named] == people
    assert sum(people) > 0


def test_a_run_is_shown_with_map_keyframes_and_ground_truth(run: Path, tmp_path: Path) -> None:
    shown = saved([str(run)], tmp_path / 'run.rrd')
    np.testing.assert_array_equal(shown[log.POINTS]['Points3D:positions'][0], POINTS_M)
    np.testing.assert_array_equal(shown[log.CLOUD]['Points3D:positions'][0], POINTS_M)
    assert set(shown[log.CLOUD]['Points3D:colors'][0]) == {30 << 24 | 20 << 16 | 10 << 8 | 255}
    assert len(shown[log.KEYFRAMES]['LineStrips3D:strips'][0]) == 2
    assert len(shown[log.IMAGE]['EncodedImage:blob']) == FRAMES
    # The ground truth is aligned with the estimate, whose frame differs.
    np.testing.assert_allclose(
        strip_m(shown, log.TRUE_PATH), strip_m(shown, log.ESTIMATED_PATH), atol=1e-3
    )
    first_m = shown[log.CAMERA]['Transform3D:translation'][0][0]
    np.testing.assert_allclose(first_m, strip_m(shown, log.ESTIMATED_PATH)[0], atol=1e-5)


def test_a_run_whose_recording_is_gone_is_shown_without_images(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = run / 'summary.json'
    summary.write_text(summary.read_text().replace('scene"', 'elsewhere"'))
    shown = saved([str(run)], tmp_path / 'run.rrd')
    assert {log.ESTIMATED_PATH, log.POINTS, log.CLOUD, log.KEYFRAMES} <= shown.keys()
    assert log.IMAGE not in shown
    assert 'elsewhere' in capsys.readouterr().out


def test_a_moved_recording_is_given_by_an_option(run: Path, bag: Path, tmp_path: Path) -> None:
    summary = run / 'summary.json'
    summary.write_text(summary.read_text().replace('scene"', 'elsewhere"'))
    shown = saved([str(run), '--recording', str(bag), '--filter', 'none'], tmp_path / 'run.rrd')
    assert len(shown[log.IMAGE]['EncodedImage:blob']) == FRAMES
    assert not any(shown[log.BOXES].get('Boxes2D:labels', []))


def test_the_viewer_accepts_the_file(run: Path, tmp_path: Path) -> None:
    saved([str(run)], tmp_path / 'run.rrd')
    argv = [sys.executable, '-m', 'rerun', 'rrd', 'verify', str(tmp_path / 'run.rrd')]
    done = subprocess.run(argv, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr


def complaint(argv: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(['view', *argv]) == 1
    error = capsys.readouterr().err.splitlines()[-1]  # after the topics that were chosen in a bag
    assert error.startswith('hoid view: ')
    return error


def test_unreadable_input_is_reported_and_leaves_no_file(
    run: Path, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save = ['--save', str(tmp_path / 'out.rrd')]
    assert 'no such' in complaint([str(tmp_path / 'nothing'), *save], capsys)
    assert 'no such' in complaint([str(run), '--recording', 'nothing', *save], capsys)
    (run / 'map.ply').write_bytes(b'ply')
    assert 'map.ply: not a PLY' in complaint([str(run), *save], capsys)
    (run / 'summary.json').write_text('[]')
    assert 'is no summary of a run' in complaint([str(run), *save], capsys)
    assert 'cannot be written' in complaint([str(bag), '--save', '/proc/x/a.rrd'], capsys)
    assert [p.name for p in tmp_path.iterdir()] == ['run']


def test_a_missing_viewer_or_display_is_reported_with_a_remedy(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ('DISPLAY', 'WAYLAND_DISPLAY'):
        monkeypatch.delenv(name, raising=False)
    assert '--save FILE' in complaint([str(bag)], capsys)
    monkeypatch.setattr(view, 'find_spec', lambda _name: None)
    argv = [str(bag), '--save', str(tmp_path / 'x.rrd')]
    assert 'requirements/view.lock' in complaint(argv, capsys)
