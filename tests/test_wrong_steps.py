"""The transcript of wrong first steps is what the commands print."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_system_tests.started_suite import HOID, LIMIT_S

ROOT = Path(__file__).parents[1]
TRANSCRIPT = (ROOT / 'docs/howto/wrong_steps.txt').read_text()
STEPS = [
    (command.removeprefix('$ ./hoid '), line)
    for command, line in pairwise(TRANSCRIPT.splitlines())
    if command.startswith('$ ')
]


@pytest.fixture(scope='module')
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recordings and maps of the transcript."""
    place = tmp_path_factory.mktemp('steps')
    for name in ('walk_fr3', 'desk'):
        for kind, image in (
            ('rgb', np.full((48, 64, 3), 128, np.uint8)),
            ('depth', np.full((48, 64), 5000, np.uint16)),
        ):
            (place / name / kind).mkdir(parents=True)
            cv2.imwrite(str(place / name / kind / '1.png'), image)
            (place / name / f'{kind}.txt').write_text(f'1.0 {kind}/1.png\n')
    (place / 'empty').mkdir()
    (place / 'maps').mkdir()
    (place / 'maps' / 'home.hoidmap').write_bytes(b'')
    return place


def test_the_transcript_has_twenty_wrong_steps() -> None:
    assert len(STEPS) >= 20


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize(('command', 'line'), STEPS, ids=[command for command, _ in STEPS])
def test_a_wrong_step_prints_the_line_of_the_transcript(
    command: str, line: str, place: Path
) -> None:
    before = sorted(place.rglob('*'))
    done = subprocess.run(
        (*HOID, *shlex.split(command)), cwd=place, capture_output=True, text=True,
        timeout=LIMIT_S, check=False,
    )  # fmt: skip
    printed = done.stderr.splitlines()[0].replace(
        f'domain {os.environ["ROS_DOMAIN_ID"]} ', 'domain 0 '
    )
    assert printed == line
    assert done.returncode in (1, 2)
    assert 'Traceback' not in done.stderr
    assert sorted(place.rglob('*')) == before


@pytest.fixture(scope='module')
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the launcher reads in a clone in which nothing is installed."""
    clone = tmp_path_factory.mktemp('clone')
    for name in ('hoid', 'docs/reference/commands.md', 'src/hoid_bringup/package.xml'):
        (clone / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, clone / name)
    return clone


@pytest.mark.parametrize(
    ('words', 'text'),
    [
        ('', 'run SLAM on every frame'),
        ('--help', 'run SLAM on every frame'),
        ('view --help', '--save FILE'),
        ('bench -h', '--quick'),
        ('--version', 'hoid '),
        ('fly', 'there is no command fly'),
    ],
)
def test_help_installs_nothing(words: str, text: str, clone: Path) -> None:
    before = sorted(clone.rglob('*'))
    done = subprocess.run(
        ('./hoid', *words.split()), cwd=clone, capture_output=True, text=True, timeout=10,
        check=False,
    )  # fmt: skip
    assert text.lower() in (done.stdout + done.stderr).lower()
    assert sorted(clone.rglob('*')) == before


@pytest.mark.parametrize(
    ('line', 'expected'),
    [
        ('hoid st', {'status'}),
        ('hoid run --filt', {'--filter'}),
        ('hoid nodes --only ', {'hoid_detector', 'hoid_filter', 'rgbd_slam'}),
    ],
)
def test_words_are_completed(line: str, expected: set[str], tmp_path: Path) -> None:
    answer = tmp_path / 'answer'
    environment = {
        '_ARGCOMPLETE': '1', '_ARGCOMPLETE_IFS': '\n', '_ARGCOMPLETE_SHELL': 'bash',
        '_ARGCOMPLETE_STDOUT_FILENAME': str(answer), 'COMP_LINE': line,
        'COMP_POINT': str(len(line)), 'COMP_TYPE': '9',
    }  # fmt: skip
    subprocess.run(HOID, env={**os.environ, **environment}, timeout=LIMIT_S, check=False)
    assert {word.strip() for word in answer.read_text().split('\n')} >= expected


@pytest.mark.parametrize('shell', ['bash', 'zsh'])
def test_the_script_of_completion_is_of_the_shell(shell: str) -> None:
    argv = (*HOID, 'completion', shell)
    done = subprocess.run(argv, capture_output=True, text=True, timeout=LIMIT_S, check=True)
    assert 'hoid' in done.stdout
    if program := shutil.which(shell):
        subprocess.run((program, '-n'), input=done.stdout, text=True, timeout=LIMIT_S, check=True)
