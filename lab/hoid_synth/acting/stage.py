"""What is decided before rendering: world, camera path, people's and objects' tracks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hoid_common.values import FloatArray
from hoid_synth.acting.acting import BodyTrack, ObjectTrack, body_track, object_tracks
from hoid_synth.acting.camera_path import camera_poses
from hoid_synth.acting.events import mover_track, write_carriers
from hoid_synth.acting.group import write_group
from hoid_synth.acting.script import Part, Playwright
from hoid_synth.config import FRAME_RATE_HZ, SceneConfig
from hoid_synth.mesh import Mesh, merged
from hoid_synth.noise import Rng
from hoid_synth.people.body import Joints, skin_mesh
from hoid_synth.people.gait import joints
from hoid_synth.room.layout import WIDTHS_M, build_world
from hoid_synth.room.world import Rect, World

_CAMERA_ZONE: Rect = (WIDTHS_M[0] / 2 - 1.6, 0.0, WIDTHS_M[0] / 2 + 1.6, 1.45)


@dataclass(frozen=True, eq=False)
class Stage:
    """A whole recording before rendering; tracks have one row more than there are frames."""

    config: SceneConfig
    world: World
    T_world_camera: FloatArray  # (N + 1, 4, 4)
    parts: tuple[Part, ...]
    bodies: tuple[BodyTrack, ...]
    objects: tuple[ObjectTrack, ...]  # in the order of world.props
    mover: ObjectTrack | None = None  # of what an event moves

    @cached_property
    def static_mesh(self) -> Mesh:
        """Return all that does not move during the recording."""
        resting = [
            placed.prop.mesh.as_instance(placed.instance).transformed(track.T_world_object[0])
            for placed, track in zip(self.world.props, self.objects, strict=True)
            if not track.handled.any()
        ]
        return merged([self.world.static, *resting])

    def joints(self, person: int, i: int) -> Joints:
        """Return a person's joints in frame i."""
        return joints(self.bodies[person].stance(i), self.world.wardrobes[person].build)

    def moving_mesh(self, i: int) -> Mesh | None:
        """Return people and handled objects in frame i, with the same faces in every frame."""
        world = self.world
        meshes = [
            skin_mesh(self.joints(n, i), w).as_instance(instance)
            for n, (w, instance) in enumerate(
                zip(world.wardrobes, world.person_instances, strict=True)
            )
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


def set_stage(config: SceneConfig) -> Stage:
    """Build the world and write the play of a configuration."""
    world = build_world(config)
    times_s = config.start_s + np.arange(config.frames + 1) / FRAME_RATE_HZ
    T_world_camera = camera_poses(config, times_s)
    rng = np.random.default_rng([config.seed, 4, *config.people_stream])
    shown, count = config.play_frames, config.play_length
    T_play_camera = T_world_camera[np.searchsorted(shown, np.arange(count))]
    parts = _write_parts(config, world, T_play_camera, rng)
    bodies = [body_track(part, count, rng) for part in parts]
    objects = object_tracks(world, parts, bodies, count)
    mover = None
    if config.event:
        mover = mover_track(config, world, parts, bodies, T_play_camera, rng).at(shown)
    return Stage(
        config,
        world,
        T_world_camera,
        tuple(parts),
        tuple(body.at(shown) for body in bodies),
        tuple(track.at(shown) for track in objects),
        mover,
    )


def _write_parts(
    config: SceneConfig, world: World, T_world_camera: FloatArray, rng: Rng
) -> list[Part]:
    if config.carriers:
        return write_carriers(config)
    if config.together:
        return write_group(world, config, rng)
    keep_out = () if config.path == 'loop' else (_CAMERA_ZONE,)
    playwright = Playwright(world, T_world_camera, rng, keep_out, config.near_m)
    return playwright.write(config.num_people)
