"""Two visits of a rendered room: the map of the first one is loaded for the second one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.sequence import Sequence
from hoid_benchmarks.rooms.object_truth import true_objects
from hoid_benchmarks.rooms.room_run import map_room
from hoid_benchmarks.rooms.visits.true_changes import TrueVisits, true_visits
from hoid_bringup.run.offline import MapFiles
from hoid_bringup.run.run_config import RunConfig
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import NS_PER_S, Detections, RgbdFrame, Trajectory
from hoid_scene.objects.mapped_object import MapObject
from hoid_synth.config import SceneConfig
from hoid_synth.room_truth import RoomTruth

_OF_SECOND = ('away=', 'start=', 'people-seed=')  # options of a recording
_AWAY_NS = 3600 * NS_PER_S  # chosen: how much later the second visit is


class Visits(NamedTuple):
    """The objects of the map at the end of the first visit, and of the second one by mode."""

    saved: tuple[MapObject, ...]
    now: dict[str, tuple[MapObject, ...]]


def first_name(name: str) -> str:
    """Return the name of the recording of the first visit, from that of the second one."""
    head, dash, options = name.partition('-')
    seed, _, rest = options.partition('-')
    kept = [o for o in rest.split('+') if not o.startswith(_OF_SECOND)]
    return f'{head}{dash}{seed}-{"+".join(kept)}'.removesuffix('-')


def first_scene(scene: SceneConfig) -> SceneConfig:
    """Return the scene before it was rearranged, seen from the start of the camera path."""
    return replace(scene, away_seed=0, start_s=0.0, people_seed=0)


def map_visits(first: Path, second: Path, config: RunConfig) -> Visits:
    """Map the first visit, save the map, and map the second visit with the loaded map.

    The second visit is mapped twice: the loaded map is extended, or stays as it is.

    Args:
        first: Bag of the first visit.
        second: Bag of the second visit.
        config: Parameters of all stages.
    """
    now = {}
    with tempfile.TemporaryDirectory(prefix='hoid-visits-') as folder:
        path = Path(folder) / 'first.hoidmap'
        saved = map_room(BagSequence(first), config, files=MapFiles(save=path)).objects
        for mode, localize in (('mapping', False), ('localization', True)):
            later = _Later(BagSequence(second))
            files = MapFiles(load=path, localize=localize)
            now[mode] = map_room(later, config, files=files).objects
    return Visits(saved, now)


def truth_of(scene: SceneConfig) -> TrueVisits:
    """Return the true objects and changes of a second visit, in the map frame of the first."""
    before, after = (RoomTruth(s, T_BODY_OPTICAL) for s in (first_scene(scene), scene))
    after.T_world_map = before.T_world_map  # the loaded map keeps its frame
    num_known = len(before.stage.world.class_names)
    return true_visits(true_objects(before), true_objects(after), after, num_known)


class _Later:
    """A recording as if it had been made an hour later, without ground-truth poses."""

    ground_truth: Trajectory | None = None

    def __init__(self, base: Sequence) -> None:
        self._base = base
        self.name, self.camera, self.fault = base.name, base.camera, base.fault
        self.true_detections: Mapping[int, Detections] | None = {
            stamp_ns + _AWAY_NS: replace(found, stamp_ns=stamp_ns + _AWAY_NS)
            for stamp_ns, found in (base.true_detections or {}).items()
        }

    def __len__(self) -> int:
        return len(self._base)

    def __iter__(self) -> Iterator[RgbdFrame]:
        for frame in self._base:
            yield RgbdFrame(frame.stamp_ns + _AWAY_NS, frame.image_bgr, frame.depth_m)
