"""The cache of detections."""

from pathlib import Path

import numpy as np

from hoid_benchmarks.plan.detections import DetectionCache
from hoid_common.values import Detections, RgbdFrame


def frame(shown: int, stamp_ns: int | None = None) -> RgbdFrame:
    stamp_ns = shown if stamp_ns is None else stamp_ns
    return RgbdFrame(stamp_ns, np.full((4, 4, 3), shown, np.uint8), np.zeros((4, 4), np.float32))


class Detector:
    """Returns as many people as the brightness of the image, at different places."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def __call__(self, seen: RgbdFrame) -> Detections:
        n = int(seen.image_bgr[0, 0, 0])
        self.asked.append(n)
        boxes = np.arange(4 * n, dtype=np.float32).reshape(n, 4)
        names = tuple(f'person {k}' for k in range(n))
        return Detections(seen.stamp_ns, boxes, names, np.linspace(0, 1, n, dtype=np.float32))


def test_a_detector_is_asked_once_about_each_image(tmp_path: Path) -> None:
    path = tmp_path / 'new' / 'kept.npz'
    detector = Detector()
    first = DetectionCache(path, detector)
    detections = [first(frame(n)) for n in (3, 0, 1)]
    first.save()
    again = DetectionCache(path, detector)
    for before, n in zip(detections, (3, 0, 1), strict=True):
        after = again(frame(n))
        assert before is not None
        assert after is not None
        assert (after.stamp_ns, after.class_names) == (before.stamp_ns, before.class_names)
        np.testing.assert_array_equal(after.boxes_xyxy_px, before.boxes_xyxy_px)
        np.testing.assert_array_equal(after.scores, before.scores)
        assert after.boxes_xyxy_px.dtype == after.scores.dtype == np.float32
    assert detector.asked == [3, 0, 1]
    again(frame(2))
    again.save()
    DetectionCache(path, detector)(frame(2))
    assert detector.asked == [3, 0, 1, 2]
    assert list(path.parent.iterdir()) == [path]


def test_an_image_made_harder_is_asked_about_though_its_stamp_is_known(tmp_path: Path) -> None:
    detector = Detector()
    kept = DetectionCache(tmp_path / 'kept.npz', detector)
    assert [len(kept(frame(n, stamp_ns=7)) or ()) for n in (3, 2)] == [3, 2]
    later = kept(frame(3, stamp_ns=9))
    assert later is not None
    assert (later.stamp_ns, len(later)) == (9, 3)
    assert detector.asked == [3, 2]
