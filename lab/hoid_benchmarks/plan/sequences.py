"""The sequences of the experiments: where they are, and how missing ones are made."""

from __future__ import annotations

import argparse
import hashlib
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import hoid_synth
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M
from hoid_benchmarks.plan.official import WHERE, find_official, official_name, packed_official
from hoid_common.errors import InputError
from hoid_common.io.yaml_file import read_yaml
from hoid_synth.commands import add_synth_arguments, scene_config
from hoid_synth.config import SceneConfig

PEOPLE_SUFFIX = '_people'
IMU_SUFFIX = '_imu'
"""Suffix of a sequence that is run with the IMU of its recording."""
_SYNTH = 'synth-'
# Recordings whose name does not tell the camera, which `camera.yaml` in the folder has: depth
# units per meter.
_OF_OWN_CAMERA = {'d435_office': 1000, 'd435_desk': 1000}
_PEOPLE_DEPTH_SCALE = 0.36  # the default of the script: people about a meter from the camera
_MAKE_PEOPLE = 'tools/make_people_sequence.py'
_SCENES = Path(__file__).parent / 'experiments' / 'scenes.yaml'


@dataclass(frozen=True)
class Store:
    """Folders of recorded sequences and of rendered or derived ones."""

    shared: Path  # recordings beside the repository; may be absent
    made: Path  # rendered and derived sequences
    official: Path | None = None  # unpacked TUM and Bonn sequences (--data)

    def find(self, name: str) -> Path:
        """Return the folder or bag of a sequence, which is made if it is missing and can be made.

        Raises:
            InputError: The sequence is missing and cannot be made.

        """
        name = name.removesuffix(IMU_SUFFIX)
        path = self.locate(name)
        if path is None:
            raise InputError(f'sequence {name} is missing: {_advice(name)}')
        if not path.exists():
            if recipe := self.recipe(name):
                _call([sys.executable, '-m', 'hoid_bringup', *recipe])
            else:
                self._paste_people(name, path)
        return path

    def locate(self, name: str) -> Path | None:
        """Return the path of a sequence, also if it is still to be made; None if it is missing."""
        name = name.removesuffix(IMU_SUFFIX)
        if options := scene_options(name):
            return self._bag(name, options)
        if path := self._official().get(name):
            return path
        recording = self.shared / 'data' / name
        if recording.is_dir():
            return self.made / name if name in _OF_OWN_CAMERA else recording
        return self.made / name if name.endswith(PEOPLE_SUFFIX) else None

    def official_sequences(self) -> tuple[str, ...]:
        """Return the short names of the available official sequences.

        Raises:
            InputError: The folder of --data does not exist or contains no official sequence.
        """
        if self.official is None:
            return ()
        if not self.official.is_dir():
            raise InputError(f'{self.official}: no such folder')
        names = tuple(self._official())
        if not names:
            packed = packed_official(self.official)
            todo = f'unpack {packed[0]}' if packed else f'download from {WHERE} and unpack there'
            raise InputError(
                f'{self.official}: has no folder with an official name, such as '
                f'{official_name("fr3_walking_xyz")}; {todo}'
            )
        return names

    def recipe(self, name: str) -> list[str]:
        """Return the `hoid` arguments that make a sequence; empty for one that is there."""
        if options := scene_options(name):
            return ['synth', str(self._bag(name, options)), *options]
        if name in _OF_OWN_CAMERA:
            return self._conversion(name, self.shared / 'data' / name, self.made / name)
        return []

    def _conversion(self, camera: str, folder: Path, bag: Path) -> list[str]:
        """Return the `hoid` arguments that convert a folder with a recording's own camera."""
        calibration = str(self.shared / 'data' / camera / 'camera.yaml')
        units_per_m = str(_OF_OWN_CAMERA[camera])
        options = ['--calibration', calibration, '--depth-factor', units_per_m]
        return ['convert', str(folder), str(bag), *options]

    def _official(self) -> dict[str, Path]:
        folder = self.official
        return find_official(folder) if folder is not None and folder.is_dir() else {}

    def _bag(self, name: str, options: list[str]) -> Path:
        """Return the path of a rendered bag, by a digest of scene and renderer code."""
        made_by = Path(hoid_synth.__file__).parent
        text = ' '.join(options).encode() + b''.join(
            p.read_bytes() for p in sorted(made_by.rglob('*.py'))
        )
        return self.made / f'{name}-{hashlib.sha256(text).hexdigest()[:8]}'

    def _paste_people(self, name: str, path: Path) -> None:
        recording = name.removesuffix(PEOPLE_SUFFIX)
        found = self.find(recording)
        tool = self.shared / _MAKE_PEOPLE
        if not tool.is_file():
            raise InputError(f'sequence {name} is missing, as is its script {_MAKE_PEOPLE}')
        unfinished = path.with_name(f'.{name}.unfinished')
        shutil.rmtree(unfinished, ignore_errors=True)
        paste = [sys.executable, str(tool)]
        if recording in _OF_OWN_CAMERA:
            # The object that is carried is pasted in the depth units of TUM only.
            share = _OF_OWN_CAMERA[recording] / TUM_DEPTH_UNITS_PER_M
            options = ['--no-object', '--depth-scale', str(_PEOPLE_DEPTH_SCALE * share)]
            folder = self.shared / 'data' / recording
            _call([*paste, str(folder), str(unfinished), *options])
            convert = self._conversion(recording, unfinished, path)
            _call([sys.executable, '-m', 'hoid_bringup', *convert])
            shutil.rmtree(unfinished)
        else:
            _call([*paste, str(found), str(unfinished)])
            unfinished.rename(path)


def scene_options(name: str) -> list[str]:
    """Return the `hoid synth` options of a rendered scene; empty for a recording.

    Scenes are named in `experiments/scenes.yaml`, or by their options as `synth-SEED[-OPTION+…]`,
    such as `synth-3-no-people` or `synth-1-path=loop+frames=600`.
    """
    scenes: dict[str, str] = read_yaml(_SCENES)
    name = name.removesuffix(IMU_SUFFIX)
    if name in scenes:
        return scenes[name].split()
    if not name.startswith(_SYNTH):
        return []
    _, seed, *options = name.split('-', 2)
    return ['--seed', seed, *(f'--{o}' for text in options for o in text.split('+'))]


def scene_of(name: str) -> SceneConfig | None:
    """Return the configuration of a rendered scene; None for a recording."""
    options = scene_options(name)
    if not options:
        return None
    parser = argparse.ArgumentParser()
    add_synth_arguments(parser)
    return scene_config(parser.parse_args(['-', *options]))


def _advice(name: str) -> str:
    if folder := official_name(name):
        return f'unpack {folder} ({WHERE}) and pass its parent folder as --data DIR'
    return 'the name is neither official nor in experiments/scenes.yaml'


def _call(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError((done.stderr.strip().splitlines() or [f'{command[2]} failed'])[-1])
