"""The command `view`: shows a recording, run or saved map in Rerun, or saves it to a file."""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from hoid_bags.options import add_recording_arguments, open_recording
from hoid_bags.sequence import Sequence
from hoid_bringup.run.options import add_method_arguments, recording, run_config
from hoid_common.errors import InputError
from hoid_common.store.database import SUFFIX

_SUFFIX = '.rrd'
_NO_VIEWER = (
    'the Rerun viewer is not installed: run "./hoid view", which installs it, or '
    '"pip install -r requirements/view.lock"'
)


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    add_recording_arguments(parser, 'TUM folder, bag, output folder of a run, or saved map')
    parser.add_argument(
        '--save',
        type=Path,
        metavar='FILE',
        help=f'write FILE{_SUFFIX} instead of opening a window',
    )
    parser.add_argument(
        '--recording', type=Path, metavar='PATH', help='recording of the run, if it was moved'
    )
    add_method_arguments(parser)


def view_command(args: argparse.Namespace) -> None:
    if not args.input.exists():
        raise InputError(f'{args.input}: no such file or folder')
    if args.save is not None:
        path = args.save if args.save.suffix == _SUFFIX else Path(f'{args.save}{_SUFFIX}')
        _write(args, path)
        size_mb = path.stat().st_size / 1e6
        how = f'./hoid env rerun {shlex.quote(str(path))}'
        sys.stdout.write(f'{path} ({size_mb:.1f} MB); to open it: {how}\n')
        return
    _check_display()
    with tempfile.TemporaryDirectory(prefix='hoid-view-') as folder:
        path = Path(folder) / f'{args.input.resolve().name}{_SUFFIX}'
        _write(args, path)
        _open(path)


def _write(args: argparse.Namespace, path: Path) -> None:
    if find_spec('rerun') is None:
        raise InputError(_NO_VIEWER)
    from hoid_bringup.view import view_content
    from hoid_bringup.view.view_log import ViewLog

    is_map = args.input.suffix == SUFFIX
    with ViewLog(path, is_map=is_map) as log:
        if is_map:
            view_content.log_map(log, args.input)
            return
        if not view_content.is_run(args.input):
            sequence = recording(args)
            view_content.log_recording(log, sequence, run_config(args))
            return
        run = view_content.open_run(args.input)
        found = _recording_of_run(args, run.recording)
        view_content.log_run(log, run, found)
        if found is not None:
            view_content.log_images(log, found, run_config(args, run.config), run.final)


def _recording_of_run(args: argparse.Namespace, recorded_path: Path | None) -> Sequence | None:
    """Return the recording of a run; if it is not found, print a note and return None."""
    path = args.recording or recorded_path
    if path is None or not (args.recording or path.exists()):
        where = f'{path} does not exist' if path else 'its summary names none'
        sys.stdout.write(f'no images without the recording ({where}); give --recording PATH\n')
        return None
    return open_recording(args, path)


def _check_display() -> None:
    is_linux = sys.platform.startswith('linux')
    if is_linux and not (os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')):
        raise InputError(
            'no display found: use --save FILE, and open the file on a computer with a display'
        )


def _open(path: Path) -> None:
    """Show a file in the viewer, and wait until its window is closed.

    The viewer accepts connections only from this computer.
    """
    command = [sys.executable, '-m', 'rerun', '--bind', '127.0.0.1', '--port', 'auto', str(path)]
    status = subprocess.run(command, check=False).returncode
    if status:
        raise InputError(f'the viewer ended with status {status}; use --save FILE instead')
