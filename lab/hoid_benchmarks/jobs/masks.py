"""Accuracy of the filter's masks: which corners on moving and on static surfaces are removed.

The error of a trajectory shows the effect of one part of the filter only through the noise of
tracking. Here the kept corners on moving surfaces and the lost static corners are counted.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import islice

import cv2
import numpy as np
from tqdm import tqdm

from hoid_bags.tum.tum_folder import open_tum_folder
from hoid_benchmarks.jobs.labeled import Labeled, pasted_people, rendered_people
from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.plan.perturb import perturb_detections
from hoid_benchmarks.plan.plan import Job, Perturbation
from hoid_benchmarks.plan.sequences import PEOPLE_SUFFIX, Store
from hoid_bringup.run.detection_source import DetectionSource
from hoid_bringup.run.run_config import TRUTH
from hoid_common.errors import ConfigError
from hoid_common.values import BoolArray, Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.model.model_path import find_model
from hoid_detector.onnx_detector import OnnxDetector
from hoid_filter.config import FilterConfig, PlusConfig
from hoid_filter.extraction.extractor import OrbExtractor
from hoid_filter.strategy import FilterInput, Verdict, make_strategy
from hoid_filter.strategy_registry import STRATEGIES
from hoid_synth.config import SceneConfig

_EDGE_PX = 5  # corners this near to a moving surface are not counted
_SYNTH = 'synth-'
SHARES = ('moving kept', 'static lost', 'moving among kept')
_COLUMNS = ('variant', 'frames that differ', *SHARES)


@dataclass(frozen=True)
class MaskCase:
    """A recording, a detector, and a perturbation of its detections."""

    sequence: str
    detector: str
    perturbation: Perturbation = field(default_factory=Perturbation)
    first_frame: int = 0
    end_frame: int | None = None


CASES: Mapping[str, MaskCase] = {
    'pasted-yolov8n': MaskCase('fr1_xyz_people', 'yolov8n_int8'),
    'pasted-yolox': MaskCase('fr1_xyz_people', 'yolox_nano'),
    'pasted-missed': MaskCase('fr1_xyz_people', 'yolov8n_int8', Perturbation(missed_every=3)),
    'static-false': MaskCase('fr1_xyz', 'yolox_nano', Perturbation(false_every=10)),
    'pasted-false': MaskCase('fr1_xyz_people', 'yolox_nano', Perturbation(false_every=10)),
    'rendered-1': MaskCase('synth-1', TRUTH),
    'rendered-2': MaskCase('synth-2', TRUTH),
    'rendered-missed': MaskCase('synth-1', TRUTH, Perturbation(missed_every=3)),
}


@dataclass
class Tally:
    """How many corners on moving and on static surface the filter kept or removed.

    Corners on static surface within 5 px of a moving surface are not counted.
    """

    moving: int = 0
    moving_kept: int = 0
    static: int = 0
    static_lost: int = 0
    frames_that_differ: int = 0  # frames whose verdict differs from that of the first variant

    def add(self, moving: BoolArray, static: BoolArray, kept: BoolArray) -> None:
        """Count the corners of a frame; each argument is a (K,) mask."""
        self.moving += _count(moving)
        self.moving_kept += _count(moving & kept)
        self.static += _count(static)
        self.static_lost += _count(static & ~kept)

    def shares(self) -> tuple[float, ...]:
        """Return the shares named in `SHARES`, each in [0, 1]."""
        kept = self.moving_kept + self.static - self.static_lost
        return (
            self.moving_kept / max(self.moving, 1),
            self.static_lost / max(self.static, 1),
            self.moving_kept / max(kept, 1),
        )


def mask_report(only: Sequence[str], store: Store) -> str:
    """Return a table of removed and lost corners for each named case, or for all cases.

    Args:
        only: Names of cases, with frames if not all count: `pasted-yolox@150-330`.
        store: Folders of the recordings.

    Raises:
        HoidError: A case is unknown, or its recording or detector is missing.
    """
    cases = [(name, find_case(name)) for name in only or CASES]
    return '\n'.join(_table(name, case, store) for name, case in cases)


def mask_rows(job: Job, store: Store) -> list[list[str | float]]:
    """Return a row for each variant: its name, the number of frames that differ, and `SHARES`.

    Raises:
        HoidError: The recording or the detector is missing.
    """
    case = MaskCase(job.sequence, job.detector, job.perturbation)
    tallies = evaluate_masks(case, variants(), store)
    return [[name, n.frames_that_differ, *n.shares()] for name, n in tallies.items()]


def find_case(text: str) -> MaskCase:
    """Return a case by its name, restricted to the frames after an "@" (FIRST-END).

    Raises:
        ConfigError: There is no such case, or the frames are malformed.
    """
    name, at, frames = text.partition('@')
    if name not in CASES:
        raise ConfigError(f'masks: no case {name}: {", ".join(CASES)}')
    if not at:
        return CASES[name]
    first, _, end = frames.partition('-')
    if not (first.isdigit() and end.isdigit()):
        raise ConfigError(f'masks: {text}: frames are given as in {name}@150-330')
    return replace(CASES[name], first_frame=int(first), end_frame=int(end))


def variants() -> dict[str, FilterConfig]:
    """Return the configurations: hoid+, hoid+ without each part, and the other strategies."""
    plus = FilterConfig()
    switches = [f.name for f in fields(PlusConfig) if isinstance(getattr(plus.plus, f.name), bool)]
    without = {f'without {name}': plus.updated({f'plus.{name}': False}) for name in switches}
    without['with coast_s 0'] = plus.updated({'plus.coast_s': 0.0})
    others = {name: replace(plus, strategy=name) for name in STRATEGIES if name != plus.strategy}
    return {plus.strategy: plus, **without, **others}


def _table(name: str, case: MaskCase, store: Store) -> str:
    rows = [
        (variant, str(n.frames_that_differ), *(f'{100 * share:.1f} %' for share in n.shares()))
        for variant, n in evaluate_masks(case, variants(), store).items()
    ]
    return f'{_title(name, case)}\n\n{markdown_table(_COLUMNS, rows)}'


def _title(name: str, case: MaskCase) -> str:
    default = vars(Perturbation())
    words = [f'{k}={v}' for k, v in vars(case.perturbation).items() if v != default[k]]
    return f'{name}: {case.sequence}, {", ".join([case.detector, *words])}'


def evaluate_masks(
    case: MaskCase, configs: Mapping[str, FilterConfig], store: Store
) -> dict[str, Tally]:
    """Return the counts of each variant on the corners of a recording."""
    strategies = {name: make_strategy(config) for name, config in configs.items()}
    tallies = {name: Tally() for name in configs}
    for view, moving, static in _views(case, store):
        num_corners = len(view.corner_pixels)
        kept = [_kept(strategy.classify(view), num_corners) for strategy in strategies.values()]
        for tally, keep in zip(tallies.values(), kept, strict=True):
            tally.add(moving, static, keep)
            tally.frames_that_differ += not np.array_equal(keep, kept[0])
    return tallies


def _views(case: MaskCase, store: Store) -> Iterator[tuple[FilterInput, BoolArray, BoolArray]]:
    """Yield each frame as the strategies receive it, and (K,) masks of moving, static corners."""
    exact: dict[int, Detections] = {}
    detect = perturb_detections(_detector(case, exact), case.perturbation, seed=0)
    extractor = OrbExtractor(FilterConfig().extraction)
    kernel = np.ones((2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1), np.uint8)
    shown = islice(_open(case.sequence, store), case.first_frame, case.end_frame)
    for frame, moving, boxes in tqdm(shown, unit='frame'):
        if boxes is not None:
            exact[frame.stamp_ns] = boxes
        gray = cv2.cvtColor(frame.image_bgr, cv2.COLOR_BGR2GRAY)
        pixels = extractor.detect(np.asarray(gray, np.uint8)).pixel
        near = cv2.dilate(moving.view(np.uint8), kernel) > 0
        view = FilterInput(frame.stamp_ns, detect(frame), frame.depth_m, pixels)
        yield view, moving.ravel()[pixels], ~near.ravel()[pixels]


def _open(name: str, store: Store) -> Iterator[Labeled]:
    if name.startswith(_SYNTH):
        config = SceneConfig(seed=int(name.removeprefix(_SYNTH)))
        return rendered_people(config, os.cpu_count() or 1)
    people = open_tum_folder(store.find(name))
    base = open_tum_folder(store.find(name.removesuffix(PEOPLE_SUFFIX)))
    return pasted_people(people, base)


def _detector(case: MaskCase, exact: Mapping[int, Detections]) -> DetectionSource:
    if case.detector == TRUTH:
        return lambda frame: exact[frame.stamp_ns]
    detector = OnnxDetector(find_model(case.detector), DetectorConfig())
    return lambda frame: detector.detect(frame.image_bgr, frame.stamp_ns)


def _kept(verdict: Verdict, num_corners: int) -> BoolArray:
    """Return the (K,) flags of the corners that are kept."""
    keep = np.zeros(num_corners, np.bool_)
    keep[slice(None) if verdict.kept is None else verdict.kept] = True
    return keep


def _count(flags: BoolArray) -> int:
    return int(np.count_nonzero(flags))
