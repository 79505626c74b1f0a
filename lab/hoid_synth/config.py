"""What to render: the one place of each default of the synthetic scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common.config import Config, param
from hoid_common.errors import ConfigError
from hoid_common.values import CameraModel, IntArray

EPOCH_NS = 1_700_000_000_000_000_000
"""Stamp of frame 0: recordings of one seed are equal to the byte."""
FRAME_RATE_HZ = 30.0
PATHS = ('room', 'loop', 'xyz', 'rpy', 'static')
LAYOUTS = ('home', 'repeated')
CARRIED = ('carry_box', 'carry_chair', 'carry_screen', 'pull_door', 'push_trolley', 'take_chair')
"""Events in which people handle something large, near, and rich in corners."""
EVENTS = (*CARRIED, 'door', 'trolley', 'robot', 'followed', 'ball', 'cat', 'picture', 'panel')
"""All events; the last ones move by themselves, and no detector knows them."""
PASSING_MPS = {
    'carry_box': 0.7, 'carry_chair': 0.7, 'carry_screen': 0.7, 'push_trolley': 0.7,
    'trolley': 0.6, 'robot': 0.6, 'ball': 1.1, 'cat': 0.45,
}  # fmt: skip
"""Usual speeds of what passes the camera, to and fro."""
MOST_NEAR_TOGETHER_M = 1.8  # beyond it stands furniture
_VGA_WIDTH_PX = 640
_VGA_FOCAL_PX = 525.0
_DEFAULT_FRAMES = 300
_LOOP_FRAMES = 1200


@dataclass(frozen=True)
class SceneConfig(Config):
    """A scene and the recording of it; equal configs give identical bytes."""

    seed: int = param(0, 'varies room, textures, people, objects and camera path', minimum=0)
    num_frames: int = param(0, 'frames at 30 Hz; 0 = 300, or one whole loop (1200)', minimum=0)
    width_px: int = param(640, 'image width; the height is 3/4 of it', minimum=64, maximum=1280)
    path: str = param('room', 'how the camera moves', choices=PATHS)
    layout: str = param('home', 'repeated: rows of identical furniture', choices=LAYOUTS)
    num_people: int = param(2, 'people who walk and handle objects', minimum=0, maximum=6)
    near_m: float = param(
        1.7, 'distance from the camera that people seek', minimum=1.0, maximum=5.0
    )
    together: bool = param(False, 'people walk as one group past the camera, back and forth')
    event: str = param(
        '', 'what else moves: carried past the camera, or by itself', choices=('', *EVENTS)
    )
    speed_mps: float = param(
        0.0,
        'of what passes, then near the middle all the time; 0: the usual one',
        minimum=0.0,
        maximum=2.0,
    )
    played_s: float = param(
        0.0, 'people and the event have gone on for so long', minimum=0.0, maximum=1e4
    )
    rest_s: float = param(0.0, 'they rest so long before they go on', minimum=0.0, maximum=1e4)
    people_seed: int = param(
        0, 'other people, who do other things in the same home; 0: those of the seed', minimum=0
    )
    start_s: float = param(
        0.0, "the recording begins so late on the camera's path", minimum=0.0, maximum=1e4
    )
    colour_noise: float = param(1.0, 'scale of the colour noise', minimum=0.0, maximum=10.0)
    motion_blur: float = param(1.0, 'scale of the exposure time', minimum=0.0, maximum=10.0)
    depth_noise: float = param(1.0, 'scale of the depth noise', minimum=0.0, maximum=10.0)
    depth_holes: bool = param(True, 'leave out depth at edges, grazing and dark surfaces')

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.together and self.path == 'loop':
            raise ConfigError('SceneConfig.together needs a camera that stays: no path "loop"')
        if self.together and self.near_m > MOST_NEAR_TOGETHER_M:
            raise ConfigError(
                f'SceneConfig.near_m of people together must be at most {MOST_NEAR_TOGETHER_M}, '
                f'got {self.near_m}'
            )

        if self.event and (self.together or self.path == 'loop'):
            raise ConfigError('SceneConfig.event needs one room, and people who are no group')
        if self.speed_mps and self.event not in PASSING_MPS:
            raise ConfigError(
                f'SceneConfig.speed_mps is of what passes: event must be one of '
                f'{", ".join(PASSING_MPS)}, got "{self.event}"'
            )
        if self.rest_s and self.event == 'followed':
            raise ConfigError('SceneConfig.rest_s: what the camera follows cannot rest')

    @property
    def carriers(self) -> int:
        """Return how many people the event needs."""
        return (self.event in CARRIED) + (self.event == 'carry_screen')

    @property
    def frames(self) -> int:
        """Return the number of frames rendered."""
        default = _LOOP_FRAMES if self.path == 'loop' else _DEFAULT_FRAMES
        return self.num_frames or default

    @property
    def play_frames(self) -> IntArray:
        """Return (N + 1,) which frame of the play of people and the event is shown when."""
        begun, rest = (round(s * FRAME_RATE_HZ) for s in (self.played_s, self.rest_s))
        return np.asarray(begun + np.maximum(np.arange(self.frames + 1) - rest, 0), np.int64)

    @property
    def play_length(self) -> int:
        """Return how many frames of the play there are, shown or not."""
        return int(self.play_frames[-1]) + 1

    @property
    def height_px(self) -> int:
        """Return the image height."""
        return self.width_px * 3 // 4

    @property
    def scale(self) -> float:
        """Return the image size relative to VGA."""
        return self.width_px / _VGA_WIDTH_PX

    @property
    def camera(self) -> CameraModel:
        """Return the distortion-free camera."""
        focal_px = _VGA_FOCAL_PX * self.scale
        center = ((self.width_px - 1) / 2, (self.height_px - 1) / 2)
        return CameraModel(self.width_px, self.height_px, focal_px, focal_px, *center)

    @property
    def people_stream(self) -> tuple[int, ...]:
        """Return what people's random numbers are seeded with, after the seed and a number."""
        return (self.people_seed,) if self.people_seed else ()

    def stamp_ns(self, i: int) -> int:
        """Return the stamp of frame i."""
        return EPOCH_NS + round(i * 1e9 / FRAME_RATE_HZ)

    def time_s(self, i: int) -> float:
        """Return the time of frame i since the first one."""
        return i / FRAME_RATE_HZ
