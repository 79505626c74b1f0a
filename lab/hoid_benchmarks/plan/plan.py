"""Plans: experiments declared in YAML and expanded to independent jobs."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from hoid_common.errors import ConfigError, InputError
from hoid_common.io.yaml_file import read_yaml
from hoid_filter.config import ExtractionConfig

_FOLDER = Path(__file__).parent / 'experiments'
_SCENES = 'scenes'  # a file in the folder that is no plan
_PROFILES = Path(__file__).parent / 'profiles'
_LISTS = ('sequences', 'filters', 'seeds')
_KEYS = (
    *_LISTS, 'id', 'title', 'view', 'mode', 'about', 'differs', 'part', 'detectors', 'vary',
    'variants', 'fixed', 'profile',
)  # fmt: skip
_VIEWS = (
    'comparison', 'curve', 'ablation', 'accuracy', 'stages', 'detectors', 'verdicts', 'cost',
    'pictures', 'masks', 'imu',
)  # fmt: skip
_MODES = ('offline', 'timed', 'live', 'detect', 'verdicts', 'pictures', 'masks')
_OFFICIAL = 'official'  # in `sequences`: every sequence in the folder of --data
EXACT = 'exact'
"""Name of the oracle filter, which removes the features on moving surfaces (`exact.py`)."""
_WITHOUT_DETECTOR = ('none', 'motion', EXACT)
_BUDGET = 'filter.extraction.num_features'
_BUDGET_STEP = 0.01


@dataclass(frozen=True)
class Perturbation:
    """Changes of a recording or its detections before the system processes them."""

    missed_share: float = 0.0  # of the frames whose detections are lost, at random
    missed_every: int = 0  # 3: the detections of every third frame are lost
    missed_run: int = 0  # frames lost in a row, once every 3 s
    missed_people: float = 0.0  # share of the people who are not detected, at random
    detector_dead_s: float = 0.0  # time after which there are no more detections; 0 = never
    detector_hz: float = 0.0  # rate of the detections; 0 = that of the detector
    depth_noise: float = 0.0  # sigma (m) of added noise at 1 m; grows with depth squared
    depth_missing_share: float = 0.0  # of the pixels whose depth is removed
    # Of the image width, hidden by a moving box with the texture of noise.
    covered_share: float = 0.0
    screen_m: float = 0.0  # width of a screen with a moving picture; needs ground truth
    loops: int = 1  # number of passes over the recording, alternately forward and backward
    black_images: int = 0  # number of successive black images from the middle of the recording on
    cut_images: int = 0  # number of images left out after the black ones
    jump_back: int = 0  # number of images by which the recording jumps back in the middle
    keep_every: int = 1  # 2: only every second image is kept
    stamp_jitter_ms: float = 0.0  # largest error of the stamps
    half_size: bool = False  # images of half the width and height
    focal_factor: float = 1.0  # ratio of the stated to the recorded focal length
    extra_boxes: int = 0  # number of false objects in each frame
    false_every: int = 0  # 10: a false person of low score in every tenth frame
    imu: str = ''  # change of the samples of the IMU (`imu_changes.py`)


@dataclass(frozen=True)
class Job:
    """One run of the system, with everything that determines its result except the code."""

    sequence: str
    filter: str
    detector: str
    seed: int
    mode: str = 'offline'  # one of _MODES
    parameters: tuple[tuple[str, Any], ...] = ()  # dotted name, value
    perturbation: Perturbation = field(default_factory=Perturbation)

    @property
    def key(self) -> str:
        """Return a unique name, which depends on every field of the job."""
        text = json.dumps(asdict(self), sort_keys=True)
        return f'{self.sequence}-{self.filter}-{hashlib.sha256(text.encode()).hexdigest()[:12]}'

    @property
    def label(self) -> str:
        """Return a short description for progress and error rows."""
        words = [self.sequence, self.filter, self.detector, self.variant, f'seed {self.seed}']
        return ' '.join(w for w in ([] if self.mode == 'offline' else [self.mode]) + words if w)

    @property
    def strategy(self) -> str:
        """Return the filter strategy of the system for this job."""
        return 'none' if self.filter == EXACT else self.filter

    @property
    def variant(self) -> str:
        """Return the changed parameters and perturbations as text; empty if there are none."""
        default = asdict(Perturbation())
        done = {k: v for k, v in asdict(self.perturbation).items() if v != default[k]}
        return ', '.join(f'{k}={v}' for k, v in [*self.parameters, *done.items()])

    def settings(self) -> dict[str, Any]:
        """Return the parameters that differ from the defaults, by dotted name.

        Offline runs are repeatable, and their random samples have little influence. A seed other
        than 0 therefore also changes the number of features by 1 or 2 %, so that the runs of
        several seeds vary as the runs of a user would.
        """
        settings = dict(self.parameters)
        if self.seed:
            budget = settings.get(_BUDGET, ExtractionConfig().num_features)
            share = _BUDGET_STEP * ((self.seed + 1) // 2) * (1 if self.seed % 2 else -1)
            settings[_BUDGET] = round(budget * (1 + share))
        return settings


@dataclass(frozen=True)
class Experiment:
    """A table or figure: its jobs and its presentation."""

    id: str
    title: str
    view: str  # kind of table and figures: one of _VIEWS
    about: str  # one or two sentences for the reader of the page
    differs: str  # difference from the paper's setting; empty without one
    varied: str  # parameter or perturbation on the axis of the curve; may be empty
    jobs: tuple[Job, ...]
    part: str = 'Beyond the paper'  # heading on the page


@dataclass(frozen=True)
class Plan:
    """The experiments of one YAML file."""

    name: str
    experiments: tuple[Experiment, ...]
    command: str = ''  # shell command that runs the plan

    def jobs(self) -> tuple[Job, ...]:
        """Return each distinct job once, in order."""
        return tuple(dict.fromkeys(job for e in self.experiments for job in e.jobs))

    def only(self, ids: Sequence[str]) -> Plan:
        """Return the plan with only the named experiments; with all if `ids` is empty."""
        known = [e.id for e in self.experiments]
        unknown = [name for name in ids if name not in known]
        if unknown:
            raise ConfigError(f'no experiment {unknown[0]} in {self.name}: {", ".join(known)}')
        return replace(
            self, experiments=tuple(e for e in self.experiments if not ids or e.id in ids)
        )

    def on(self, sequences: Collection[str]) -> Plan:
        """Return the plan with only the jobs on some sequences, without empty experiments."""
        kept = (
            replace(e, jobs=tuple(j for j in e.jobs if j.sequence in sequences))
            for e in self.experiments
        )
        return replace(self, experiments=tuple(e for e in kept if e.jobs))

    def job(self, key: str) -> Job:
        """Return the job with a key, which the page shows."""
        found = [job for job in self.jobs() if job.key == key]
        if not found:
            raise ConfigError(f'no run {key} in {self.name}: its page lists them')
        return found[0]

    def with_detector(self, detector: str) -> Plan:
        """Return the plan with one detector instead of all others."""
        return replace(
            self,
            command=f'{self.command} --detector {detector}',
            experiments=tuple(
                replace(e, jobs=tuple(dict.fromkeys(_detected_by(j, detector) for j in e.jobs)))
                for e in self.experiments
            ),
        )


def load_plan(name_or_path: str, official: Sequence[str] = ()) -> Plan:
    """Read a plan of the project by name, or any YAML file.

    Args:
        name_or_path: Name of a plan in `experiments`, or a path with a suffix.
        official: Sequences that replace the entry "official" of experiments.

    Raises:
        ConfigError: There is no such plan, or the file is not a plan.
    """
    path = Path(name_or_path)
    if path.suffix not in ('.yaml', '.yml'):
        path = _FOLDER / f'{name_or_path}.yaml'
    if not path.is_file():
        known = ', '.join(plan_names())
        raise ConfigError(f'no experiments "{name_or_path}": give a YAML file or one of {known}')
    try:
        document = read_yaml(path)
        experiments = tuple(_experiment(entry, official) for entry in document['experiments'])
        return Plan(path.stem, experiments)
    except InputError as error:
        raise ConfigError(str(error)) from error
    except (KeyError, TypeError) as error:
        raise ConfigError(f'{path}: {str(error).splitlines()[0]}: see experiments/') from error


def plan_names() -> list[str]:
    """Return the names of the project's plans."""
    return sorted({path.stem for path in _FOLDER.glob('*.yaml')} - {_SCENES})


def experiment_ids(name: str) -> list[str]:
    """Return the names of the experiments in a plan of the project."""
    return [entry['id'] for entry in read_yaml(_FOLDER / f'{name}.yaml')['experiments']]


def load_profile(name: str) -> dict[str, Any]:
    """Return the parameters of a profile by dotted name.

    Raises:
        ConfigError: There is no such profile.
    """
    path = _PROFILES / f'{name}.yaml'
    if not path.is_file():
        known = ', '.join(sorted(p.stem for p in _PROFILES.glob('*.yaml')))
        raise ConfigError(f'no profile "{name}": there is {known}')
    return dict(read_yaml(path))


def _experiment(entry: Mapping[str, Any], official: Sequence[str]) -> Experiment:
    unknown = set(entry) - set(_KEYS)
    if unknown:
        raise ConfigError(f'experiment {entry.get("id")}: unknown "{min(unknown)}"')
    for name in _LISTS:
        if not isinstance(entry.get(name), list):
            raise ConfigError(f'experiment {entry.get("id")}: "{name}" must be a list')
    if entry.get('view') not in _VIEWS:
        raise ConfigError(f'experiment {entry["id"]}: view must be one of {", ".join(_VIEWS)}')
    if entry.get('mode', 'offline') not in _MODES:
        raise ConfigError(f'experiment {entry["id"]}: mode must be one of {", ".join(_MODES)}')
    varied = entry.get('vary', {})
    named = entry['sequences']
    if _OFFICIAL in named:
        named = [*(name for name in named if name != _OFFICIAL), *official]
    return Experiment(
        entry['id'],
        entry['title'],
        entry['view'],
        entry.get('about', ''),
        entry.get('differs', ''),
        next(iter(varied), ''),
        tuple(dict.fromkeys(_expand({**entry, 'sequences': dict.fromkeys(named)}, varied))),
        entry.get('part', Experiment.part),
    )


def _expand(entry: Mapping[str, Any], varied: Mapping[str, list[Any]]) -> Iterator[Job]:
    mode = entry.get('mode', 'offline')
    names = list(varied)
    settings = [dict(zip(names, row, strict=True)) for row in itertools.product(*varied.values())]
    fixed = load_profile(entry['profile']) if 'profile' in entry else {}
    fixed |= entry.get('fixed', {})
    settings = [{**fixed, **s} for s in settings + entry.get('variants', [])]
    for sequence, method, setting, detector, seed in itertools.product(
        entry['sequences'],
        entry['filters'],
        settings,
        entry.get('detectors', ['']),
        entry['seeds'],
    ):
        # A filter without a detector has one job, however many detectors are listed.
        used = '' if method in _WITHOUT_DETECTOR and mode != 'detect' else detector
        yield _job(sequence, method, used, seed, mode, setting)


def _detected_by(job: Job, detector: str) -> Job:
    return replace(job, detector=detector) if job.detector else job


def _job(
    sequence: str, method: str, detector: str, seed: int, mode: str, setting: Mapping[str, Any]
) -> Job:
    known = set(asdict(Perturbation()))
    perturbation = Perturbation(**{k: v for k, v in setting.items() if k in known})
    parameters = tuple(sorted((k, v) for k, v in setting.items() if k not in known))
    return Job(sequence, method, detector, seed, mode, parameters, perturbation)
