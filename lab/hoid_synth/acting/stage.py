"""Content of a recording before rendering: world, camera trajectory, tracks of all movers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from hoid_synth.acting.acting import BodyTrack, ObjectTrack, body_track, object_tracks
from hoid_synth.acting.camera_path import camera_poses
from hoid_synth.acting.events import carrier_motions, mover_track
from hoid_synth.acting.floor_people import floor_people
from hoid_synth.acting.group import group_motions
from hoid_synth.acting.script import MotionPlanner, PersonMotion
from hoid_synth.config import FLOOR, SceneConfig
from hoid_synth.mesh import Mesh, Rect, merged
from hoid_synth.noise import Rng
from hoid_synth.people.body import Joints, skin_mesh
from hoid_synth.people.gait import joints
from hoid_synth.room.floor_world import build_floor
from hoid_synth.room.layout import WIDTHS_M, build_world
from hoid_synth.room.world import World, pose

# A person farther away than this, and this far beside the viewing direction, casts no shadow that
# is visible: half the field of view is 37 degrees, and a shadow is at most 1.8 m long.
_NEAR_M, _SIDE_RAD = 5.0, np.radians(60)
_CUT_M = 0.4  # no camera moves as far between two images
_STEP_S = 1e-3  # chosen: of the differences that give a velocity
_BELOW_M = 100.0  # farther than the light of any lamp
_CAMERA_ZONE: Rect = (WIDTHS_M[0] / 2 - 1.6, 0.0, WIDTHS_M[0] / 2 + 1.6, 1.45)


@dataclass(frozen=True, eq=False)
class Stage:
    """Content of a recording before rendering; tracks have one row more than there are frames."""

    config: SceneConfig
    world: World
    T_world_camera: FloatArray  # (N + 1, 4, 4)
    motions: tuple[PersonMotion, ...]
    bodies: tuple[BodyTrack, ...]
    objects: tuple[ObjectTrack, ...]  # in the order of world.props
    mover: ObjectTrack | None = None  # of the object of an event

    def twist(self, i: int) -> FloatArray:
        """Return the camera's motion (6,) in frame i until the next one, rotation first.

        At a cut to another take, it is that of the frame before.
        """
        T = self.T_world_camera
        if np.linalg.norm(T[i + 1, :3, 3] - T[i, :3, 3]) > _CUT_M:
            i -= 1
        return se3.log(se3.inverse(T[i]) @ T[i + 1])

    def velocity(self, i: int) -> FloatArray:
        """Return the camera's velocity (6,) at frame i, rotation first [rad/s, m/s]."""
        config = self.config
        times_s = config.pace * (config.start_s + config.time_s(i) + np.array([0.0, _STEP_S]))
        now, after = camera_poses(config, times_s)
        return se3.log(se3.inverse(now) @ after) / _STEP_S

    @cached_property
    def static_mesh(self) -> Mesh:
        """Return the mesh of everything that does not move during the recording."""
        resting = [
            placed.prop.mesh.as_instance(placed.instance).transformed(track.T_world_object[0])
            for placed, track in zip(self.world.props, self.objects, strict=True)
            if not track.handled.any()
        ]
        return merged([self.world.static, *resting])

    def joints(self, person: int, i: int) -> Joints:
        """Return the joints of a person in frame i."""
        return joints(self.bodies[person].stance(i), self.world.wardrobes[person].build)

    def moving_mesh(self, i: int) -> Mesh | None:
        """Return the mesh of moving people and objects in frame i; all frames have equal faces."""
        world = self.world
        meshes = [
            self._person_mesh(n, i).as_instance(instance)
            for n, instance in enumerate(world.person_instances)
        ]
        meshes += [
            placed.prop.mesh.as_instance(placed.instance).transformed(track.T_world_object[i])
            for placed, track in zip(world.props, self.objects, strict=True)
            if track.handled.any()
        ]
        if world.mover is not None and self.mover is not None:
            (_, mesh), instance = world.mover
            meshes.append(mesh.as_instance(instance).transformed(self.mover.T_world_object[i]))
        return merged(meshes) if meshes else None

    def _person_mesh(self, person: int, i: int) -> Mesh:
        """Return the mesh of a person; on a floor, people out of sight are far below it."""
        if self.config.path == FLOOR and self._is_out_of_sight(person, i):
            return self._hidden[person]
        return skin_mesh(self.joints(person, i), self.world.wardrobes[person])

    def _is_out_of_sight(self, person: int, i: int) -> bool:
        T = self.T_world_camera[min(i, len(self.T_world_camera) - 1)]
        way_m = self.bodies[person].xy_m[i] - T[:2, 3]
        distance_m = float(np.linalg.norm(way_m))
        return distance_m > _NEAR_M and way_m @ T[:2, 2] < np.cos(_SIDE_RAD) * distance_m

    @cached_property
    def _hidden(self) -> list[Mesh]:
        below = pose(0, 0, -_BELOW_M, 0)
        return [
            skin_mesh(self.joints(n, 0), wardrobe).transformed(below)
            for n, wardrobe in enumerate(self.world.wardrobes)
        ]


def set_stage(config: SceneConfig) -> Stage:
    """Build the world of a configuration, and plan all motions in it."""
    world = build_floor(config) if config.path == FLOOR else build_world(config)
    times_s = config.start_s + np.arange(config.frames + 1) / config.rate_hz
    T_world_camera = camera_poses(config, config.pace * times_s)
    rng = np.random.default_rng([config.seed, 4, *config.people_stream])
    shown, count = config.timeline_frames, config.timeline_length
    T_timeline_camera = T_world_camera[np.searchsorted(shown, np.arange(count))]
    if config.path == FLOOR:
        motions, bodies = floor_people(config, world, T_timeline_camera, rng)
    else:
        motions = _plan_motions(config, world, T_timeline_camera, rng)
        bodies = [body_track(motion, count, rng) for motion in motions]
    objects = object_tracks(world, motions, bodies, count)
    mover = None
    if config.event:
        mover = mover_track(config, world, motions, bodies, T_timeline_camera, rng).at(shown)
    return Stage(
        config,
        world,
        T_world_camera,
        tuple(motions),
        tuple(body.at(shown) for body in bodies),
        tuple(track.at(shown) for track in objects),
        mover,
    )


def _plan_motions(
    config: SceneConfig, world: World, T_world_camera: FloatArray, rng: Rng
) -> list[PersonMotion]:
    if config.carriers:
        return carrier_motions(config)
    if config.together:
        return group_motions(world, config, rng)
    keep_out = () if config.path == 'loop' else (_CAMERA_ZONE,)
    planner = MotionPlanner(world, T_world_camera, rng, keep_out, config.near_m)
    return planner.plan(config.num_people)
