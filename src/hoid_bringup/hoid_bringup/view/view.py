"""`hoid view`: a recording or a finished run in the Rerun viewer, or as one file to share."""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from hoid_bags.options import chosen_camera
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bringup.run.options import (
    add_method_arguments,
    add_recording_arguments,
    recording,
    run_config,
)
from hoid_common.errors import InputError

_SUFFIX = '.rrd'
_NO_VIEWER = (
    'the viewer is not installed: "./hoid view" installs it, or '
    '"pip install -r requirements/view.lock"'
)


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid view`."""
    add_recording_arguments(parser, 'TUM folder, bag, or output folder of a run')
    parser.add_argument(
        '--save',
        type=Path,
        metavar='FILE',
        help=f'write FILE{_SUFFIX} to share instead of opening a window; needs no display',
    )
    parser.add_argument(
        '--recording', type=Path, metavar='PATH', help='of a run, if it is not where it was'
    )
    add_method_arguments(parser)


def view_command(args: argparse.Namespace) -> None:
    """Show a recording or a run, or write what would be shown to a file."""
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
    from hoid_bringup.view.view_log import ViewLog
    from hoid_bringup.view.view_recording import log_images, log_recording, with_exact_boxes
    from hoid_bringup.view.view_run import is_run, log_run, open_run

    with ViewLog(path) as log:
        if not is_run(args.input):
            sequence = recording(args)
            log_recording(log, sequence, with_exact_boxes(run_config(args), sequence))
            return
        run = open_run(args.input)
        found = _recording_of_run(args, run.recording)
        log_run(log, run, found)
        if found is not None:
            log_images(
                log, found, with_exact_boxes(run_config(args, run.config), found), run.final
            )


def _recording_of_run(args: argparse.Namespace, noted: Path | None) -> Sequence | None:
    """Return the recording of a run, or None, which is said, when it is not there any more."""
    path = args.recording or noted
    if path is None or not (args.recording or path.exists()):
        where = path or 'not noted in its summary'
        sys.stdout.write(f'no images, as the recording is gone ({where}); give --recording PATH\n')
        return None
    return open_sequence(path, chosen_camera(args), args.depth_factor)


def _check_display() -> None:
    is_linux = sys.platform.startswith('linux')
    if is_linux and not (os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')):
        raise InputError('no display here: use --save FILE and open the file where there is one')


def _open(path: Path) -> None:
    """Show a file until its window is closed; only this machine can reach the viewer."""
    command = [sys.executable, '-m', 'rerun', '--bind', '127.0.0.1', '--port', 'auto', str(path)]
    status = subprocess.run(command, check=False).returncode
    if status:
        raise InputError(f'the viewer ended with status {status}; --save FILE needs no window')
