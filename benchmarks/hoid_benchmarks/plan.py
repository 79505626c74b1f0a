"""What is to be run: experiments declared in YAML, expanded to independent jobs."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from hoid_common.errors import ConfigError

_FOLDER = Path(__file__).parent / 'experiments'
_LISTS = ('sequences', 'filters', 'detectors', 'seeds')
_VIEWS = ('comparison', 'curve', 'ablation', 'accuracy', 'stages', 'detectors', 'cost')


@dataclass(frozen=True)
class Perturbation:
    """What is done to a recording or to its detections before the system sees them."""

    missed_share: float = 0.0  # of the frames whose detections are lost, at random
    missed_every: int = 0  # 3: the detections of every third frame are lost
    missed_run: int = 0  # frames lost in a row, once every 3 s
    detector_hz: float = 0.0  # detections only so often; 0 = every frame
    depth_noise: float = 0.0  # added sigma (m) at 1 m, growing with depth squared
    depth_missing_share: float = 0.0  # of the pixels without a reading
    covered_share: float = 0.0  # of the image's width hidden by a moving person-like box
    loops: int = 1  # the recording forth and back so many times


@dataclass(frozen=True)
class Job:
    """One run of the system: everything that its result depends on, beside the code."""

    sequence: str
    filter: str
    detector: str
    seed: int
    live: bool = False
    parameters: tuple[tuple[str, Any], ...] = ()  # dotted name, value
    perturbation: Perturbation = field(default_factory=Perturbation)

    @property
    def key(self) -> str:
        """Return a name that differs when anything in the job differs."""
        text = json.dumps(asdict(self), sort_keys=True)
        return f'{self.sequence}-{self.filter}-{hashlib.sha256(text.encode()).hexdigest()[:12]}'

    @property
    def label(self) -> str:
        """Return a short description for progress and error rows."""
        extra = [f'{k}={v}' for k, v in self.parameters]
        default = asdict(Perturbation())
        extra += [f'{k}={v}' for k, v in asdict(self.perturbation).items() if v != default[k]]
        words = [self.sequence, self.filter, self.detector, *extra, f'seed {self.seed}']
        return ' '.join(['live', *words] if self.live else words)


@dataclass(frozen=True)
class Experiment:
    """A table or figure: which jobs it needs and how it is shown."""

    id: str
    title: str
    view: str  # how it is tabled and drawn: one of _VIEWS
    about: str  # one or two sentences for the reader
    differs: str  # from the paper's setting; empty when it is ours
    varied: str  # the parameter or perturbation on the curve's axis; empty when none
    jobs: tuple[Job, ...]


@dataclass(frozen=True)
class Plan:
    """All experiments of one call."""

    name: str
    experiments: tuple[Experiment, ...]

    def jobs(self) -> tuple[Job, ...]:
        """Return each distinct job once, in order."""
        return tuple(dict.fromkeys(job for e in self.experiments for job in e.jobs))

    def only(self, ids: Sequence[str]) -> Plan:
        """Return the plan with just the named experiments; all of them when none is named."""
        known = [e.id for e in self.experiments]
        unknown = [name for name in ids if name not in known]
        if unknown:
            raise ConfigError(f'no experiment {unknown[0]} in {self.name}: {", ".join(known)}')
        return replace(
            self, experiments=tuple(e for e in self.experiments if not ids or e.id in ids)
        )


def load_plan(name_or_path: str) -> Plan:
    """Read a plan that ships with the project by name, or any YAML file."""
    path = Path(name_or_path)
    if path.suffix not in ('.yaml', '.yml'):
        path = _FOLDER / f'{name_or_path}.yaml'
    if not path.is_file():
        known = ', '.join(sorted(p.stem for p in _FOLDER.glob('*.yaml')))
        raise ConfigError(f'no experiments "{name_or_path}": give a YAML file or one of {known}')
    try:
        document = yaml.safe_load(path.read_text())
        return Plan(path.stem, tuple(_experiment(entry) for entry in document['experiments']))
    except (yaml.YAMLError, KeyError, TypeError) as error:
        raise ConfigError(f'{path}: {str(error).splitlines()[0]}: see experiments/') from error


def _experiment(entry: Mapping[str, Any]) -> Experiment:
    for name in _LISTS:
        if name != 'detectors' and not isinstance(entry.get(name), list):
            raise ConfigError(f'experiment {entry.get("id")}: "{name}" must be a list')
    if entry.get('view') not in _VIEWS:
        raise ConfigError(f'experiment {entry["id"]}: view must be one of {", ".join(_VIEWS)}')
    varied = entry.get('vary', {})
    return Experiment(
        entry['id'],
        entry['title'],
        entry['view'],
        entry.get('about', ''),
        entry.get('differs', ''),
        next(iter(varied), ''),
        tuple(_expand(entry, varied)),
    )


def _expand(entry: Mapping[str, Any], varied: Mapping[str, list[Any]]) -> Iterator[Job]:
    live = bool(entry.get('live', False))
    names = list(varied)
    settings = [dict(zip(names, row, strict=True)) for row in itertools.product(*varied.values())]
    settings += entry.get('variants', [])
    for sequence, method, setting, detector, seed in itertools.product(
        entry['sequences'],
        entry['filters'],
        settings,
        entry.get('detectors', ['']),
        entry['seeds'],
    ):
        # Without a filter no detector runs: one job, whatever detectors are listed.
        used = '' if method == 'none' else detector
        yield _job(sequence, method, used, seed, live, setting)


def _job(
    sequence: str, method: str, detector: str, seed: int, live: bool, setting: Mapping[str, Any]
) -> Job:
    known = set(asdict(Perturbation()))
    perturbation = Perturbation(**{k: v for k, v in setting.items() if k in known})
    parameters = tuple(sorted((k, v) for k, v in setting.items() if k not in known))
    return Job(sequence, method, detector, seed, live, parameters, perturbation)
