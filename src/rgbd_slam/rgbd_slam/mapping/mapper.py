"""Local mapping: inserts keyframes into the map and refines the map around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import FeatureVerdicts, FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.local_mapping.culling import cull_keyframes, cull_new_points
from rgbd_slam.local_mapping.fusion import fuse, fuse_with_neighbors
from rgbd_slam.local_mapping.retraction import retract_observations
from rgbd_slam.local_mapping.triangulation import triangulate_with_neighbors
from rgbd_slam.loops.loop_closer import LoopCloser, LoopCounts
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_change import MapChange
from rgbd_slam.model.map_state import MapState, restore
from rgbd_slam.model.points import PointCounts
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.optimize.bundle_adjustment import local_bundle_adjustment


@dataclass(frozen=True, eq=False)
class KeyframeRequest:
    """A frame that becomes a keyframe, and the tracker's statistics since the last keyframe."""

    uid: int  # uid of the new keyframe
    # Its reference keyframe may still be pending. It names points by uid, because rows may be
    # reused.
    tracked: TrackedFrame
    # How often points should have been visible and were found since the last keyframe.
    counts: PointCounts
    measured_camera: StereoCamera  # the camera model with the measured noise
    moved: IntArray  # (M,) rows of points that turned out to be on moving objects
    moved_uids: IntArray  # (M,) uids of these points


class Mapper:
    """Owns the map, inserts keyframes into it, and refines it.

    It uses two camera models that differ only in their noise (decision 003). Creating, fusing and
    culling points hardly depends on the noise and uses the configured model, as does loop closing,
    which measures the noise itself. Local bundle adjustment uses the model with the noise that the
    tracker has measured, to weight residuals. With `background`, global adjustment runs in a
    separate process.
    """

    def __init__(
        self, camera: StereoCamera, atlas: Atlas, config: SlamConfig, *, background: bool = False
    ) -> None:
        self.map = atlas
        self._configured_camera = camera
        self._config = config
        self._background = background
        self.closer = LoopCloser(atlas, camera, config, background=background)
        self.loops = LoopCounts()
        self._close_limit_m = config.camera.close_limit_m

    def start_map(self, uid: int, frame: Frame, T_map_camera: FloatArray, map_id: int) -> int:
        """Create the first keyframe of a map, with points at all depths, and return its row."""
        i = self.map.add_keyframe(frame, T_map_camera, map_id, uid=uid)
        self._add_depth_points(i, np.inf)
        return i

    def insert(self, request: KeyframeRequest) -> int | None:
        """Insert a keyframe, refine the map around it, close loops, and return the keyframe's row.

        If neither the reference keyframe nor an ancestor of it is in the map, or if the pose is
        invalid (`PoseGuard`), nothing is inserted, and None is returned.
        """
        i = self._add(request)
        if i is None:
            return None
        cull_new_points(self.map, self._configured_camera, i, self._config.mapping)
        self._add_depth_points(i, self._close_limit_m)
        self.map.update_connections(i)
        triangulate_with_neighbors(
            self.map, self._configured_camera, i, self._config.mapping.triangulation
        )
        fuse_with_neighbors(self.map, self._configured_camera, i, self._config.mapping)
        self.map.update_connections(i)
        local_bundle_adjustment(self.map, request.measured_camera, i, self._config.mapping)
        cull_keyframes(self.map, i, self._config.mapping, self._close_limit_m)
        self.loops = self.loops.with_event(self.closer.process(i))
        return i

    def retract(self, verdicts: FeatureVerdicts) -> None:
        retract_observations(self.map, verdicts)

    def load(
        self, state: MapState, first_uid: int, *, keep: bool, loops: Sequence[LoopEdge] = ()
    ) -> None:
        """Load a saved map (`restore`), and index its places if loop closing is enabled."""
        if not keep:
            self.close()  # the place index is that of the old map
            self.closer = LoopCloser(
                self.map, self._configured_camera, self._config, background=self._background
            )
        camera = self._configured_camera
        restore(self.map, state, camera, first_uid, keep=keep, loops=loops)
        self.closer.index_places()

    def resume(self, whole: MapChange, loops: LoopCounts) -> None:
        """Continue the map of a mapping process that has died; the own map must be empty."""
        self.map.apply(whole)
        self.map.version += 1  # version of later changes
        self.loops = loops

    def close(self) -> None:
        self.closer.adjuster.close()

    def _add(self, request: KeyframeRequest) -> int | None:
        """Add the keyframe to the map; return its row, or None as `insert` does.

        Points on moving objects are removed, and the statistics of other points are updated. If
        the keyframe has few observations, points around its reference keyframe are searched too.
        """
        keyframes, points = self.map.keyframes, self.map.points
        tracked = request.tracked
        anchor = self.map.anchor(tracked.reference_uid)
        if anchor is None or anchor.row is None:
            return None
        reference = anchor.row
        T_reference_camera = anchor.T_anchor_keyframe @ tracked.T_reference_camera
        T_map_camera = keyframes.T_map_camera[reference] @ T_reference_camera
        if not self.map.guard.is_valid(T_map_camera, 'keyframes'):
            return None
        self.map.add_point_counts(request.counts)
        is_there = points.uid[request.moved] == request.moved_uids
        self.map.remove_points(np.unique(request.moved[is_there]))
        i = self.map.add_keyframe(
            tracked.frame,
            se3.orthonormalized(T_map_camera),
            int(keyframes.map_id[reference]),
            reference,
            request.uid,
        )
        seen = tracked.current_points(self.map)
        k = np.flatnonzero(seen != NO_POINT)
        self.map.observe(i, k, seen[k])
        self.map.refresh(seen[k])
        if len(k) < self._config.tracking.min_inliers:
            self._match_neighborhood(i, reference)
        return i

    def _match_neighborhood(self, i: int, reference: int) -> None:
        """Search the points around keyframe `reference` in keyframe `i`, and add observations.

        If the mapper is late, these points did not exist yet when the tracker searched the frame.
        Without common points, keyframe `i` would not be connected with the map.
        """
        around = np.r_[reference, self.map.covisible(reference)]
        fuse(
            self.map, self._configured_camera, i, self.map.points_of(around), self._config.mapping
        )
        self.map.refresh(self.map.points_of(np.array([i])))

    def _add_depth_points(self, i: int, limit_m: float) -> None:
        """Create points from features with depth that observe no point yet.

        All such features nearer than `limit_m` become points. If keyframe `i` then has fewer near
        points than `keyframes.min_new_points`, the nearest others are added up to it.
        """
        keyframes = self.map.keyframes
        n = int(keyframes.num_features[i])
        depth = keyframes.depth_m[i, :n]
        free = (depth > 0) & (keyframes.point_of_feature[i, :n] == NO_POINT)
        k = np.flatnonzero(free & keyframes.may_seed[i, :n])
        k = k[np.argsort(depth[k], kind='stable')]
        have = int(np.count_nonzero((depth > 0) & (depth < limit_m) & ~free))
        wanted = max(self._config.keyframes.min_new_points - have, 0)
        close = int(np.count_nonzero(depth[k] < limit_m))
        k = np.sort(k[: max(close, wanted)])
        camera_m = self._configured_camera.back_project(
            keyframes.measurement_px[i, k, :2], depth[k]
        )
        self.map.add_points(i, k, se3.transform(keyframes.T_map_camera[i], camera_m))
