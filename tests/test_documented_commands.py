"""Every command in README and documents is accepted as written, and run if it is fast.

Other tests run the rest: `nodes`, `replay`, `play`, `record`, `bench`, `demo`, `view` and the
launch files.
"""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from hoid_benchmarks.commands import REPORTS
from hoid_benchmarks.jobs.speed import STAGES
from hoid_benchmarks.plan.plan import load_plan
from hoid_bringup.cli import argument_parser, main
from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_common.config import EXPERT
from hoid_common.io.tum_text import write_tum
from hoid_common.values import Trajectory
from hoid_synth.config import SceneConfig
from hoid_synth.scene import render
from hoid_system_tests import launch_stand_in
from hoid_system_tests.documented import PAGES, ROOT, Shown, shape, shown_commands

pytestmark = pytest.mark.thorough

ALL = [shown for page in PAGES for shown in shown_commands(page)]
OFFLINE = ('run', 'convert', 'info', 'evaluate')  # these are fast on ten images
# Files that are not in the repository, and an example package that is not installed.
NEEDS_MORE = ('my_model.onnx', 'FILE', '--set NAME=VALUE', '--imu', 'exhaustive')
# Other tests check their arguments, except for those of `security`, which the wheels lack.
ROS2_TOOLS = ('ros2 bag', 'ros2 param', 'ros2 security', 'ros2 topic')
FOREIGN = ('nav2_bringup', 'orbbec_camera', 'realsense2_camera', 'rtabmap_launch', 'tf2_ros')
FRAMES, PERIOD_NS = 10, 125_000_000  # 1.25 s, longer than the 1 s of the relative pose error
# Replacements for placeholders in commands; the recording is a folder that the test renders.
REPLACEMENTS = {
    'fr1_xyz': '{tum}', 'FOLDER': '{tum}', 'SEQUENCE': '{tum}', 'SEQ': '{tum}',
    'RECORDING': '{tum}',
    'BAG': 'a.bag', 'DIR': 'out', 'PRESET': 'realsense', 'NAME': 'hoid2d', 'R': '1', 'S': '1',
    'N': '1', 'MODEL': 'model.onnx', 'FILE': 'out/a.hoidmap', '...': 'x', 'CASE': 'pasted-yolox',
    'PROGRAM': 'true', 'touching': 'hoid2d',
}  # fmt: skip


def words_of(command: str, tum: Path = Path('tum')) -> list[str]:
    """Return the words of a command, with optional parts and with placeholders replaced."""
    text = re.sub(r'[\[\]]', '', command)
    text = re.sub(r'(\S+?)\|\S+', r'\1', text)
    words = [REPLACEMENTS.get(word, word) for word in shlex.split(text)]
    return [
        re.sub(r'^DATA/rgbd_dataset_freiburg3_walking_xyz', '{tum}', w).replace('{tum}', str(tum))
        for w in words
        if w
    ]


def of(*beginning: str) -> list[Shown]:
    """Return the commands that begin with these words, without duplicates."""
    length = len(beginning)
    found = {s.command: s for s in ALL if tuple(s.command.split()[:length]) == beginning}
    return list(found.values())


def of_ros2(verb: str) -> list[Shown]:
    """Return the `ros2` commands of a kind, without the `./hoid env` that some begin with."""
    inside = of('./hoid', 'env', 'ros2', verb)
    bare = [shown._replace(command=shown.command.removeprefix('./hoid env ')) for shown in inside]
    return [*of('ros2', verb), *bare]


RUNNING_NODES = 'test_map_files.py: test_the_commands_for_running_nodes_save_load_and_switch'
# The test that runs each command of README, or, for what needs hours, ROS's launch system or root,
# the one that checks it. Tests of this module check all other pages.
README_TESTS = {
    'sudo apt': 'test_documented_commands.py: test_apt_installs_all_tools_that_the_set_up_needs',
    'make demo': 'test_demo.py: test_the_demo_prints_the_output_shown_in_readme',
    'make test': 'test_project_files.py: test_make_targets_that_documents_name_exist',
    'make docs': 'test_site.py: test_tables_of_results_sort_by_mouse_and_by_keyboard',
    './hoid run': 'test_documented_commands.py: test_the_command_runs_and_prints_the_shown_output',
    './hoid synth': 'test_documented_commands.py: test_a_rendered_bag_can_be_run',
    './hoid nodes': 'test_replay_nodes.py: test_ctrl_c_ends_all_nodes_of_a_namespace',
    './hoid status': RUNNING_NODES,
    './hoid save-map': RUNNING_NODES,
    './hoid bench': 'test_bench_command.py: test_stopped_experiments_are_resumed',
}


def ids(shown: Shown) -> str:
    return f'{shown.page}: {shown.command}'[:90]


@pytest.mark.parametrize('shown', of('./hoid'), ids=ids)
def test_hoid_accepts_the_command(shown: Shown) -> None:
    _, *words = words_of(shown.command)
    if words[0] in ('env', 'dev'):
        assert words[1:2] != ['python'] or (ROOT / words[2]).is_file()
    elif words[0] not in ('setup', '--help', '-v', 'view') and words[1:] not in ([], ['--help']):
        args = argument_parser(words[0]).parse_args(words)
        if words[0] == 'bench' and args.what not in (*STAGES, *REPORTS):
            load_plan('quick' if args.quick else args.what).only(args.only)


@pytest.mark.parametrize('shown', of('make'), ids=ids)
def test_make_has_the_target(shown: Shown) -> None:
    makefile = (ROOT / 'Makefile').read_text()
    assert re.search(rf'^{words_of(shown.command)[1]}:', makefile, re.MULTILINE)


@pytest.mark.parametrize('shown', of('sudo'), ids=ids)
def test_apt_installs_all_tools_that_the_set_up_needs(shown: Shown) -> None:
    needed = re.findall(r"missing\+='([^']+)'", (ROOT / 'hoid').read_text())
    assert len(needed) >= 5
    assert set(' '.join(needed).split()) <= set(shown.command.split()[3:])


@pytest.fixture
def _stand_in() -> Iterator[None]:
    """Remove the stand-ins for ROS's launch packages after the test."""
    before = dict(sys.modules)
    yield
    for name in {*sys.modules} - before.keys():
        del sys.modules[name]
    sys.modules.update(before)


@pytest.mark.usefixtures('_stand_in')
@pytest.mark.parametrize('shown', of_ros2('launch'), ids=ids)
def test_the_launch_file_has_the_arguments(shown: Shown) -> None:
    package, file, *given = [w for w in words_of(shown.command)[2:] if not w.startswith('--')]
    if package in FOREIGN:
        return
    path = ROOT / 'src' / package / 'launch' / file
    declared = launch_stand_in.load(path, [])[1].launch_configurations
    assert {word.partition(':=')[0] for word in given} <= set(declared)


@pytest.mark.parametrize('shown', of('ros2', 'service', 'call'), ids=ids)
def test_the_service_takes_the_request(shown: Shown) -> None:
    name, kind, *request = words_of(shown.command)[3:]
    package, _, service = kind.split('/')
    message = getattr(import_module(f'{package}.srv'), service).Request()
    for text in request:
        for field, value in yaml.safe_load(text).items():
            setattr(message, field, value)  # raises if the field or its type is wrong
    services = (ROOT / 'docs/reference/services.md').read_text()
    assert f'~/{name.rpartition("/")[2]}' in services


@pytest.mark.parametrize('shown', of_ros2('run'), ids=ids)
def test_the_node_has_the_parameters(shown: Shown) -> None:
    package, *rest = words_of(shown.command)[2:]
    if package in FOREIGN:
        return
    known = {EXPERT, *(leaf.name for leaf in NODE_CONFIGS[package].node_params())}
    assert {word.partition(':=')[0] for word in rest if ':=' in word} <= known


def test_every_command_of_readme_has_a_test() -> None:
    commands = {' '.join(s.command.split()[:2]) for s in ALL if s.page == 'README.md'}
    assert commands == README_TESTS.keys()
    for test in README_TESTS.values():
        module, name = test.split(': ')
        assert f'def {name}' in (ROOT / 'tests' / module).read_text()


def test_no_other_command_is_shown() -> None:
    """A command of a kind that no test here checks could become outdated unnoticed."""
    known = {
        './hoid',
        'make',
        'export',
        'sudo apt',
        'ros2 launch',
        'ros2 run',
        'ros2 service',
        *ROS2_TOOLS,
    }
    for shown in ALL:
        first, second, *_ = shown.command.split()
        assert {first, f'{first} {second}'} & known, shown


@pytest.fixture(scope='module')
def tum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered recording as a TUM folder whose name contains that of the camera."""
    folder = tmp_path_factory.mktemp('data') / 'rgbd_dataset_freiburg3_walking_xyz'
    lists: dict[str, list[str]] = {'rgb': [], 'depth': []}
    stamps_ns: list[int] = []
    poses = []
    for frame in render(SceneConfig(num_frames=FRAMES, path='xyz'), 2):
        first_ns = stamps_ns[0] if stamps_ns else frame.frame.stamp_ns
        stamps_ns.append(first_ns + PERIOD_NS * len(stamps_ns))
        poses.append(frame.T_world_camera)
        stamp = f'{stamps_ns[-1] / 1e9:.6f}'
        depth = np.nan_to_num(frame.frame.depth_m * 5000).astype(np.uint16)
        for kind, image in (('rgb', frame.frame.image_bgr), ('depth', depth)):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / kind / f'{stamp}.png'), image)
            lists[kind].append(f'{stamp} {kind}/{stamp}.png')
    for kind, rows in lists.items():
        (folder / f'{kind}.txt').write_text('\n'.join(rows) + '\n')
    write_tum(folder / 'groundtruth.txt', Trajectory(np.array(stamps_ns), np.array(poses)))
    return folder


def is_cheap(shown: Shown) -> bool:
    words = shown.command.split()
    if words[0] != './hoid' or len(words) < 3 or words[1] not in OFFLINE:
        return False
    return not any(text in shown.command for text in (*NEEDS_MORE, '--help', '...', ' A', ' B '))


@pytest.mark.parametrize('page', sorted({s.page for s in ALL if is_cheap(s)}))
def test_the_command_runs_and_prints_the_shown_output(
    page: str,
    tum: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    here = [shown for shown in ALL if shown.page == page and is_cheap(shown)]
    main(['convert', str(tum), REPLACEMENTS['BAG']])
    capsys.readouterr()
    for shown in here:
        if 'convert' in shown.command:
            shutil.rmtree(REPLACEMENTS['BAG'])
        status = main(words_of(shown.command, tum)[1:])
        printed, errors = capsys.readouterr()
        assert status == 0, f'{shown.command}: {errors}'
        if shown.output:
            assert shape(printed.splitlines()) == shape(shown.output)


def test_a_rendered_bag_can_be_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = str(tmp_path / 'room')
    assert main(['synth', bag, '--frames', '3']) == 0
    assert main(['run', bag, '--out', str(tmp_path / 'out'), '--filter', 'motion']) == 0
    assert 'tracked    3 of 3 frames' in capsys.readouterr().out
