"""The sequences of the experiments: found, made, or said to be missing."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from hoid_common.errors import InputError

# Official names (TUM RGB-D, Bonn RGB-D Dynamic) by the short ones that experiments use.
OFFICIAL = {
    'fr1_xyz': 'rgbd_dataset_freiburg1_xyz',
    'fr1_desk': 'rgbd_dataset_freiburg1_desk',
    'fr1_room': 'rgbd_dataset_freiburg1_room',
    'fr2_xyz': 'rgbd_dataset_freiburg2_xyz',
    'fr2_desk': 'rgbd_dataset_freiburg2_desk',
    'fr3_office': 'rgbd_dataset_freiburg3_long_office_household',
    'fr3_walking_static': 'rgbd_dataset_freiburg3_walking_static',
    'fr3_walking_xyz': 'rgbd_dataset_freiburg3_walking_xyz',
    'fr3_walking_halfsphere': 'rgbd_dataset_freiburg3_walking_halfsphere',
    'fr3_walking_rpy': 'rgbd_dataset_freiburg3_walking_rpy',
    'fr3_sitting_static': 'rgbd_dataset_freiburg3_sitting_static',
    'fr3_sitting_xyz': 'rgbd_dataset_freiburg3_sitting_xyz',
    'fr3_sitting_halfsphere': 'rgbd_dataset_freiburg3_sitting_halfsphere',
    'fr3_sitting_rpy': 'rgbd_dataset_freiburg3_sitting_rpy',
    'bonn_crowd': 'rgbd_bonn_crowd',
    'bonn_moving_box': 'rgbd_bonn_moving_nonobstructing_box',
    'bonn_person_tracking': 'rgbd_bonn_person_tracking',
    'bonn_synchronous': 'rgbd_bonn_synchronous',
}
PEOPLE_SUFFIX = '_people'
_MAKE_PEOPLE = 'tools/make_people_sequence.py'


@dataclass(frozen=True)
class Store:
    """Where sequences lie and where made ones are kept."""

    shared: Path  # the project's recordings, beside the repository; need not exist
    made: Path  # rendered and derived sequences
    official: Path | None = None  # unpacked official folders (--data)

    def find(self, name: str) -> Path:
        """Return the folder or bag of a sequence, making it if it can be made.

        Raises:
            InputError: the sequence is missing and cannot be made here.

        """
        if name.startswith('synth'):
            return self._rendered(name)
        if self.official is not None and name in OFFICIAL:
            folder = self.official / OFFICIAL[name]
            if folder.is_dir():
                return folder
        recording = self.shared / 'data' / name
        if recording.is_dir():
            return recording
        if name.endswith(PEOPLE_SUFFIX):
            return self._with_people(name)
        raise InputError(f'sequence {name} is missing: {self._advice(name)}')

    def _advice(self, name: str) -> str:
        if name in OFFICIAL:
            return f'unpack {OFFICIAL[name]} and pass its parent folder as --data DIR'
        return 'it is not an official name; see benchmarks/README.md'

    def _rendered(self, name: str) -> Path:
        """Render `synth-SEED[-OPTION…]`, such as `synth-3-no-people` or `synth-1-path=loop`."""
        bag = self.made / name
        if not bag.exists():
            _, seed, *options = name.split('-', 2)
            extra = [f'--{o}' for o in options[0].split('+')] if options else []
            _call(
                [sys.executable, '-m', 'hoid_bringup', 'synth', str(bag), '--seed', seed, *extra]
            )
        return bag

    def _with_people(self, name: str) -> Path:
        base = self.find(name.removesuffix(PEOPLE_SUFFIX))
        folder = self.made / name
        tool = self.shared / _MAKE_PEOPLE
        if folder.exists():
            return folder
        if not tool.is_file():
            raise InputError(f'sequence {name} is missing: it is made by {_MAKE_PEOPLE}, not here')
        unfinished = folder.with_name(f'.{name}.unfinished')
        shutil.rmtree(unfinished, ignore_errors=True)
        _call([sys.executable, str(tool), str(base), str(unfinished)])
        unfinished.rename(folder)
        return folder


def _call(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError((done.stderr.strip().splitlines() or [f'{command[2]} failed'])[-1])
