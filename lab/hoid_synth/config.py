"""Configuration of rendered scenes, with all defaults."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from hoid_common.config import Config, param
from hoid_common.errors import ConfigError
from hoid_common.values import CameraModel, IntArray
from hoid_synth.floor.route import floor_route

EPOCH_NS = 1_700_000_000_000_000_000
"""Stamp of frame 0; it is fixed, so that equal configurations give identical bytes."""
FRAME_RATE_HZ = 30.0
FLOOR = 'floor'
PATHS = ('room', 'loop', 'xyz', 'rpy', 'static', 'takes', FLOOR)
LAYOUTS = ('home', 'repeated')
CARRIED = ('carry_box', 'carry_chair', 'carry_screen', 'pull_door', 'push_trolley', 'take_chair')
"""Events in which people handle a large, near object with many corners."""
EVENTS = (*CARRIED, 'door', 'trolley', 'robot', 'followed', 'ball', 'cat', 'picture', 'panel')
"""All events; those not in CARRIED move by themselves, mostly without a class of a detector."""
PASSING_MPS = {
    'carry_box': 0.7, 'carry_chair': 0.7, 'carry_screen': 0.7, 'push_trolley': 0.7,
    'trolley': 0.6, 'robot': 0.6, 'ball': 1.1, 'cat': 0.45,
}  # fmt: skip
"""Default speeds of objects that pass the camera to and fro."""
MOST_NEAR_TOGETHER_M = 1.8  # largest `near_m` of a group; furniture stands beyond
_VGA_WIDTH_PX = 640
_VGA_FOCAL_PX = 525.0
_DEFAULT_FRAMES = 300
_LOOP_FRAMES = 1200


@dataclass(frozen=True)
class SceneConfig(Config):
    """A scene and its recording; equal configurations give identical bytes."""

    seed: int = param(0, 'seed of all random choices', limits=(0, inf))
    num_frames: int = param(
        0,
        'number of frames; 0: 300, 1200 for loop, or all of floor',
        limits=(0, inf),
    )
    width_px: int = param(
        640, 'width of the images in pixels; the height is 3/4', limits=(64, 1280)
    )
    path: str = param('room', 'camera motion', choices=PATHS)
    layout: str = param(
        'home', 'furniture: a home, or rows of identical pieces (repeated)', choices=LAYOUTS
    )
    turned: bool = param(False, 'furniture and screens stand at random angles')
    bare: bool = param(False, 'no pictures hang on the walls')
    num_people: int = param(2, 'number of people', limits=(0, 6))
    near_m: float = param(1.7, 'distance to the camera that people keep in m', limits=(1.0, 5.0))
    together: bool = param(False, 'people walk past the camera as one group')
    event: str = param(
        '',
        'object that people carry or that moves by itself',
        choices=('', *EVENTS),
    )
    speed_mps: float = param(
        0.0,
        'speed of that object, which then stays in view; 0: its own',
        limits=(0.0, 2.0),
    )
    played_s: float = param(
        0.0, 'time of people and event before the first frame in s', limits=(0.0, 1e4)
    )
    rest_s: float = param(0.0, 'time for which these stand still at first in s', limits=(0.0, 1e4))
    people_seed: int = param(0, 'seed of the people; 0: that of the scene', limits=(0, inf))
    away_seed: int = param(
        0,
        'seed of what was moved, taken and added unseen; 0: nothing',
        limits=(0, inf),
    )
    num_rooms: int = param(
        12, 'least number of rooms on the path floor', limits=(2, 16),
    )  # fmt: skip
    every: int = param(
        1,
        'images of the 30 Hz camera for each rendered one',
        limits=(1, 30),
    )
    start_s: float = param(0.0, 'start time on the camera path in s', limits=(0.0, 1e4))
    pitch_deg: float = param(
        0.0, 'angle by which the camera looks down in degrees', limits=(0.0, 60.0)
    )
    roll_deg: float = param(
        0.0, 'angle by which the camera is rolled in degrees', limits=(-180.0, 180.0)
    )
    pace: float = param(1.0, 'relative speed of the camera', limits=(0.1, 10.0))
    shutter_s: float = param(
        0.0,
        'time between the first and the last row of the images in s',
        limits=(0.0, 0.05),
    )
    color_every: int = param(
        1,
        'depth images for each new color image, which is repeated, as in the dark',
        limits=(1, 10),
    )
    exposure_swing: float = param(
        0.07, 'amplitude of the slow changes of the exposure', limits=(0.0, 0.4)
    )
    color_noise: float = param(1.0, 'scale of the color noise', limits=(0.0, 10.0))
    motion_blur: float = param(1.0, 'scale of the exposure time', limits=(0.0, 10.0))
    depth_noise: float = param(1.0, 'scale of the depth noise', limits=(0.0, 10.0))
    smooth_depth: bool = param(False, 'depth as of a phone with LiDAR')
    depth_holes: bool = param(True, 'remove depth at edges, and on grazing and dark surfaces')

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.together and self.path in ('loop', FLOOR):
            raise ConfigError(f'SceneConfig.together is not possible with the path "{self.path}"')
        if self.together and self.near_m > MOST_NEAR_TOGETHER_M:
            raise ConfigError(
                f'SceneConfig.near_m must be at most {MOST_NEAR_TOGETHER_M} for people together, '
                f'got {self.near_m}'
            )

        if self.event and (self.together or self.path in ('loop', FLOOR)):
            raise ConfigError(
                f'SceneConfig.event is not possible with the path "{self.path}" or with together'
            )
        if self.speed_mps and self.event not in PASSING_MPS:
            raise ConfigError(
                f'SceneConfig.speed_mps needs a passing object: event must be one of '
                f'{", ".join(PASSING_MPS)}, got "{self.event}"'
            )
        if self.turned and (self.together or self.path in ('loop', FLOOR)):
            raise ConfigError(
                f'SceneConfig.turned is not possible with the path "{self.path}" or with together'
            )
        if self.away_seed and self.path == FLOOR:
            raise ConfigError(f'SceneConfig.away_seed is not possible with the path "{FLOOR}"')
        if self.rest_s and self.event == 'followed':
            raise ConfigError('SceneConfig.rest_s is not possible with the event "followed"')

    @property
    def carriers(self) -> int:
        """Return the number of people that the event needs."""
        return (self.event in CARRIED) + (self.event == 'carry_screen')

    @property
    def frames(self) -> int:
        """Return the number of rendered frames."""
        default = _LOOP_FRAMES if self.path == 'loop' else _DEFAULT_FRAMES
        if self.path == FLOOR:
            default = round(floor_route(self.num_rooms).duration_s * self.rate_hz)
        return self.num_frames or default

    @property
    def rate_hz(self) -> float:
        """Return the number of rendered frames per second."""
        return FRAME_RATE_HZ / self.every

    @property
    def timeline_frames(self) -> IntArray:
        """Return (N + 1,) the frame of the planned motions that each rendered frame shows."""
        begun, rest = (round(s * FRAME_RATE_HZ) for s in (self.played_s, self.rest_s))
        shown = self.every * np.arange(self.frames + 1)
        return np.asarray(begun + np.maximum(shown - rest, 0), np.int64)

    @property
    def timeline_length(self) -> int:
        """Return the number of frames of the planned motions, including those not rendered."""
        return int(self.timeline_frames[-1]) + 1

    @property
    def height_px(self) -> int:
        """Return the image height in pixels."""
        return self.width_px * 3 // 4

    @property
    def scale(self) -> float:
        """Return the image size relative to VGA."""
        return self.width_px / _VGA_WIDTH_PX

    @property
    def camera(self) -> CameraModel:
        """Return the camera, which has no distortion."""
        focal_px = _VGA_FOCAL_PX * self.scale
        center = ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
        return CameraModel(self.width_px, self.height_px, focal_px, focal_px, *center)

    @property
    def people_stream(self) -> tuple[int, ...]:
        """Return the last part of the seed of people's random numbers."""
        return (self.people_seed,) if self.people_seed else ()

    def stamp_ns(self, i: int) -> int:
        """Return the stamp of frame i in ns."""
        return EPOCH_NS + round(i * 1e9 / self.rate_hz)

    def time_s(self, i: int) -> float:
        """Return the time of frame i since the first frame in s."""
        return i / self.rate_hz
