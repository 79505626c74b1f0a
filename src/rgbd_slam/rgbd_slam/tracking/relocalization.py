"""Relocalization: finds a lost camera near a given pose, or in the whole map."""

from __future__ import annotations

import logging

import numpy as np

from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.place_finder import FoundPlace, PlaceFinder
from rgbd_slam.places.pose_hint import PoseHint
from rgbd_slam.tracking.tracker import Tracker, TrackerOutput

_logger = logging.getLogger(__name__)

# Chosen: number of frames in which the camera is first searched for near a given pose, which takes
# about 20 ms each.
_HINTED_FRAMES = 30
_FOUND = 'found {:.1f} m and {:.0f} degrees from the pose given'
_NOT_THERE = 'not found at the pose given; looking everywhere'


class Relocalizer:
    """Relocalizes single frames in the map.

    The place index is updated only if a frame is relocalized, so that it takes no time while the
    camera is tracked.
    """

    def __init__(self, atlas: Atlas, finder: PlaceFinder, tracker: Tracker) -> None:
        self.num_found = 0  # number of relocalized frames
        self._atlas, self._finder, self._tracker = atlas, finder, tracker
        self._hint: PoseHint | None = None
        self._num_hinted = 0  # number of frames that were searched near the hint
        self._note = self._logged = ''

    def relocalize_near(self, hint: PoseHint) -> None:
        """Search near an approximate pose first, until the camera is found or for 30 frames."""
        self._hint, self._num_hinted, self._logged = hint, 0, ''

    def consume_note(self) -> str:
        """Return the message about the search near the hint, once; '' if there is none."""
        note, self._note = self._note, ''
        return note

    def relocalize(self, frame: Frame, *, in_main_map: bool) -> TrackerOutput | None:
        """Return the tracked frame; None if its place is not found or ambiguous, or fits badly.

        With `in_main_map`, only the main map is searched.
        """
        place = self._locate(frame, in_main_map)
        if place is None:
            return None
        points = np.full(len(frame), NO_POINT, np.int64)
        points[place.match.k] = place.match.j
        tracking = self._tracker.track_relocalized(
            frame, place.match.T_camera_map, points, int(self._atlas.keyframes.uid[place.keyframe])
        )
        if tracking is not None:
            self.num_found += 1
            self._report_distance(tracking)
        return tracking

    def _locate(self, frame: Frame, in_main_map: bool) -> FoundPlace | None:
        hint = self._hint
        if hint is None:
            return self._finder.locate(frame, in_main_map=in_main_map)
        if self._num_hinted < _HINTED_FRAMES:
            self._num_hinted += 1
            place = self._finder.locate_near(frame, hint)
            if place is not None:
                return place
        self._report(_NOT_THERE)
        return self._finder.locate(frame, in_main_map=in_main_map)

    def _report_distance(self, tracking: TrackerOutput) -> None:
        if self._hint is not None:
            (distance_m,), (turn_rad,) = self._hint.distances(tracking.tracked.T_map_camera[None])
            self._hint = None
            self._report(_FOUND.format(distance_m, np.degrees(turn_rad)))

    def _report(self, note: str) -> None:
        self._note = note
        if note != self._logged:
            self._logged = note
            _logger.info(note)
