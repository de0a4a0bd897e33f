"""Every default of the package, once: ROS parameters, YAML and command-line flags are made from here.

A parameter's outside name is `group.field`, for example `solver.bone_weight`.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, cast, get_type_hints

import yaml

from mocap_ros.errors import ConfigError

Value = bool | int | float | str

LONGEST_SHOWN = 60
HEAVIEST = 1e6
# Parameters of version 0.1 under another name, by old name: recordings of it hold these.
RENAMED_SINCE_0_1 = {
    'solver.lifted_weight': 'solver.lifter_weight',
    'solver.lifted_robust': 'solver.lifter_robust_scale',
    'solver.lifted_prior': 'solver.lifter_prior_factor',
    'solver.lifted_turn': 'solver.lifter_flip_factor',
    'solver.lifted_smooth': 'solver.lifter_smooth_factor',
    'solver.upright_prior': 'solver.heading_prior_factor',
    'solver.upright_turn': 'solver.heading_flip_factor',
    'solver.upright_hypotheses': 'solver.heading_hypotheses',
    'solver.gait_prior': 'solver.periodic_prior_factor',
    'solver.drift_weight': 'solver.camera_velocity_weight',
    'solver.steady_weight': 'solver.camera_acceleration_weight',
    'tracker.refine': 'tracker.refine_seconds',
    'tracker.challenge_every': 'tracker.hypothesis_check_interval',
    'keyframes.largest': 'keyframes.max_matrix_frames',
    'keyframes.own_share': 'keyframes.frame_pose_share',
}

YAML_1_1_MISSES = re.compile(r'[-+]?\d+(\.\d*)?[eE][-+]?\d{1,3}')  # numbers like 1e-4, which it takes for text


def _p(
    default: Value,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
) -> Any:
    return field(
        default=default,
        metadata={'doc': doc, 'low': low, 'high': high, 'choices': choices, 'read_only': read_only},
    )


def _weight(default: float, doc: str) -> Any:
    return _p(default, doc, low=0.0, high=HEAVIEST)


@dataclass(frozen=True)
class SolverConfig:
    """Weights of the objective's terms, and when the solvers stop."""

    components: int = _p(40, 'number of base poses; a model that has fewer uses all of them', low=1, high=60)
    prior: str = _p(
        'learned',
        'prior of non-periodic motion: learned (the shipped lifter together with the base poses), '
        'pca (the base poses '
        'alone, as in the paper), or the path of a lifter trained by train-lifter',
        read_only=True,
    )
    lifter_weight: float = _weight(
        2e-4, "m^2, weight of the squared distance from the lifted pose, in the lifter's own standard deviations"
    )
    lifter_robust_scale: float = _p(
        3.0,
        "standard deviations, distance from the lifted pose beyond which Cauchy's loss discounts a joint",
        low=0.1,
        high=1e3,
    )
    lifter_prior_factor: float = _weight(0.3, 'factor on prior_weight where there are lifted poses')
    lifter_flip_factor: float = _weight(0.25, 'factor on flip_weight where there are lifted poses')
    lifter_smooth_factor: float = _weight(5.0, 'factor on smooth_weight where there are lifted poses')
    prior_weight: float = _weight(
        1e-4, 'm^2, weight of the Gaussian prior of the base-pose weights, per squared standard deviation'
    )
    heading_prior_factor: float = _weight(
        0.25,
        'factor on prior_weight for base poses that were aligned by heading: one category of motion '
        'varies less than '
        'people do, so its prior has to be weaker',
    )
    bone_weight: float = _weight(60.0, 'weight of the variance of the bone lengths over time (beta, eq. 20)')
    flip_weight: float = _weight(
        0.02, 'm^2 s, weight of the squared change of the camera between frames (gamma, eq. 12)'
    )
    heading_flip_factor: float = _weight(
        0.025,
        'factor on flip_weight for base poses that were aligned by heading: there the camera also '
        'takes up how the '
        'body turns with every stride',
    )
    tilt_weight: float = _weight(
        1.0,
        'm^2 s, weight of the squared change of the image of the vertical between frames, for base '
        'poses that were '
        'aligned by heading: only the camera can change it',
    )
    scale_weight: float = _weight(
        0.02, "m^2 s, weight of the squared change of the logarithm of the camera's scale between frames"
    )
    smooth_weight: float = _weight(
        3e-6, 'm^2 s, weight of the squared change of the base-pose weights between frames, in standard deviations'
    )
    robust_scale: float = _weight(
        0.05, "m, reprojection error beyond which Cauchy's loss discounts a point; 0 selects least squares"
    )
    adapt_noise: bool = _p(
        True,
        'estimate the image noise from the residual and adapt all weights above to it: they are '
        'given for a noise of '
        '10 mm and are multiplied by (noise / 10 mm)^2; robust_scale is multiplied by noise / 10 mm '
        'where the noise is '
        'above 10 mm. The alternation does not adapt',
    )
    noise_floor: float = _p(0.0005, 'm, smallest image noise that is assumed', low=1e-5, high=1.0)
    relative_bones: bool = _p(False, 'measure the variance of a bone length relative to the length of that bone')
    harmonics: int = _p(3, 'number of harmonics of the periodic model', low=1, high=8)
    periodic_prior_factor: float = _weight(
        1.0,
        'factor on prior_weight for the coefficients of the periodic model, which occur once a '
        'window and not once a '
        'frame',
    )
    camera_velocity_weight: float = _weight(
        0.001, 'm^2 s, weight of the squared velocity of the camera in the periodic model'
    )
    camera_acceleration_weight: float = _weight(
        0.0003, 'm^2 s^3, weight of the squared acceleration of the camera in the periodic model'
    )
    paper_sines: bool = _p(
        False, "use the paper's periodic model: one sine for each base pose, with a frequency of its own (eq. 17)"
    )
    method: str = _p(
        'joint',
        'joint: Levenberg-Marquardt over cameras and weights together; alternation: Algorithm 1 of the paper',
        choices=('joint', 'alternation'),
    )
    norm: str = _p(
        'squared',
        'norms of the alternation: squared, or frobenius as printed in the paper (eq. 13 and 21)',
        choices=('squared', 'frobenius'),
    )
    hypotheses: int = _p(
        2,
        'number of initial cameras that are tried: the closed-form one, its Necker reversal, then a '
        'ring of headings',
        low=1,
        high=10,
    )
    start_window: float = _p(
        1.0, 's, frames within this span share one closed-form initial camera', low=0.0, high=60.0
    )
    heading_hypotheses: int = _p(
        1, 'number of initial cameras that are tried for base poses that were aligned by heading', low=1, high=10
    )
    max_iterations: int = _p(60, 'maximum number of solver iterations', low=1, high=10_000)
    tolerance: float = _weight(3e-4, 'relative decrease of the objective below which the solver stops')


@dataclass(frozen=True)
class ClassifierConfig:
    """Periodic or not: thresholds chosen on CMU walk, run and jump trials (benchmarks/classification.py)."""

    section: float = _p(
        2.0, 's, length of the newest section of the window, which is classified', low=0.3, high=20.0
    )
    walk_residual: float = _p(
        0.0175, 'largest RMS 2D residual of a walk, as a fraction of body height', low=0.0, high=1.0
    )
    run_residual: float = _p(
        0.021, 'largest RMS 2D residual of a run, as a fraction of body height', low=0.0, high=1.0
    )
    walk_cadence: float = _p(0.5, 'Hz, smallest cadence of a walk (full cycles)', low=0.0, high=5.0)
    run_cadence: float = _p(1.0, 'Hz, smallest cadence of a run (full cycles)', low=0.0, high=5.0)
    amplitude: float = _p(
        0.03,
        'smallest RMS movement of a joint in a periodic motion, as a fraction of body height',
        low=0.0,
        high=1.0,
    )
    components: int = _p(25, 'number of base poses of the periodic model', low=1, high=60)
    hysteresis: float = _p(
        1.1, 'factor by which a threshold must be passed before the answer changes', low=1.0, high=3.0
    )


@dataclass(frozen=True)
class TrackerConfig:
    """The sliding window of each person."""

    model: str = _p(
        'auto',
        'name of a shipped base-pose model, path of a trained one, or auto: the most likely shipped model of each '
        'person (with the learned prior: the model of all motions)',
        read_only=True,
    )
    window: float = _p(2.0, 's, length of the sliding window', low=0.1, high=20.0)
    components: int = _p(40, 'number of base poses used live, at most solver.components', low=1, high=60)
    refine_seconds: float = _p(
        0.15, 's, newest part of the window, which is solved again at every frame', low=0.0, high=20.0
    )
    iterations: int = _p(2, 'number of solver iterations at every frame', low=1, high=100)
    hypothesis_check_interval: float = _p(
        0.5,
        's between hypothesis checks of a person: the window is fitted with another candidate model, '
        'whose solution '
        'replaces the current one if it is more likely',
        low=0.05,
    )
    lag: float = _p(
        0.0, 's, delay of the output behind the newest frame; more delay makes it steadier', low=0.0, high=5.0
    )
    undo_swaps: bool = _p(True, 'detect where the detector has exchanged left and right, and undo it')
    min_score: float = _p(0.1, 'keypoints with a lower score count as not seen', low=0.0, high=1.0)
    min_joints: int = _p(6, 'smallest number of seen joints that makes a detection usable', low=4, high=15)
    forget_after: float = _p(1.0, 's without detection after which a person is forgotten', low=0.0, high=60.0)
    predict_for: float = _p(
        0.5, 's without detection for which a person is predicted, and flagged as predicted', low=0.0, high=10.0
    )
    restart_after: float = _p(
        1.0,
        's; where stamps go back by more than this tracking starts afresh, and where they go back by '
        'less the frame '
        'is dropped',
        low=0.0,
    )
    body_height: float = _p(1.70, 'm, body height that is assumed of everybody', low=0.3, high=2.6)
    perspective: bool = _p(True, 'use the true perspective projection where CameraInfo is known')
    nominal_focal_length: float = _p(
        1.0, 'focal length in image widths that is assumed where no CameraInfo is known', low=0.1, high=20.0
    )


@dataclass(frozen=True)
class NodeConfig:
    """Topics and limits of the live node."""

    autostart: bool = _p(True, 'the node configures and activates itself', read_only=True)
    input_type: str = _p(
        'mocap_ros_msgs/msg/Keypoints2DArray',
        'message type of the keypoints: mocap_ros_msgs/msg/Keypoints2DArray, yolo_msgs/msg/DetectionArray, '
        'hri_msgs/msg/Skeleton2D (one topic for each body that /humans/bodies/tracked lists), '
        'zed_msgs/msg/ObjectsStamped or openpose_ros2_msgs/msg/PoseKeyPointsList',
        read_only=True,
    )
    rectified_input: bool = _p(
        False,
        'the keypoints belong to the rectified image, so the distortion of CameraInfo is not undone',
        read_only=True,
    )
    image_width: int = _p(
        0, 'px, image width where neither the message nor CameraInfo gives it; 0: unknown', low=0, high=100_000
    )
    image_height: int = _p(
        0, 'px, image height where neither the message nor CameraInfo gives it; 0: unknown', low=0, high=100_000
    )
    queue: int = _p(
        10,
        'maximum number of waiting messages; if there are more, all but the newest are dropped',
        low=1,
        high=1000,
    )
    max_people: int = _p(
        20, 'maximum number of people in a message; a larger message is refused', low=1, high=1000
    )
    max_joints: int = _p(
        200, 'maximum number of joints of a person; a message with more is refused', low=4, high=10_000
    )
    max_text: int = _p(
        100,
        'maximum number of characters of an id or a joint name; a message with a longer one is refused',
        low=8,
        high=1000,
    )
    silence_warning: float = _p(5.0, 's without keypoints after which the node warns', low=0.1)
    publish_tf: bool = _p(
        False, 'publish people as frames on /tf, where CameraInfo gives a true scale', read_only=True
    )
    frame_prefix: str = _p(
        '', 'prefix of the names of these frames, which tells several cameras apart', read_only=True
    )
    marker_lifetime: float = _p(0.5, 's for which a marker stays after its last message', low=0.0, high=60.0)


@dataclass(frozen=True)
class RecorderConfig:
    """Recording to MCAP."""

    enabled: bool = _p(False, 'record while the node is active; may be changed at any time')
    folder: str = _p('mocap_recordings', 'folder that bags are written into', read_only=True)
    compression: str = _p('zstd', 'compression of the chunks', choices=('zstd', 'lz4', 'none'), read_only=True)
    chunk_bytes: int = _p(65_536, 'bytes after which a chunk is closed', low=1024, high=16_777_216)
    chunk_seconds: float = _p(0.25, 's after which a chunk is closed', low=0.01, high=10.0)
    split_mb: int = _p(0, 'MB after which a bag continues in a new file; 0: never', low=0, high=1_000_000)
    split_seconds: float = _p(0.0, 's after which a bag continues in a new file; 0: never', low=0.0)
    min_free_mb: int = _p(
        200,
        'MB; with less free disk space a recording is finished, and none is started',
        low=0,
        high=1_000_000,
    )
    backlog: int = _p(
        1000,
        'maximum number of inputs that wait for the disk; further ones are counted, not recorded',
        low=1,
        high=100_000,
    )


@dataclass(frozen=True)
class KeyframesConfig:
    """Long sequences by keyframes (Loy et al. 2004)."""

    alpha: float = _p(
        0.95, 'share of the frames that are represented by a keyframe or can be interpolated', low=0.0, high=1.0
    )
    gap: float = _p(
        0.2,
        's; frames between well-represented frames that are less than this apart are interpolated (T)',
        low=0.0,
        high=1e6,
    )
    beta: float = _p(0.18, 'torso lengths; poses nearer than this count as the same', low=0.01, high=10.0)
    max_matrix_frames: int = _p(
        3600,
        'maximum number of frames of one distance matrix; a longer sequence is processed in sections',
        low=2,
        high=20_000,
    )
    poses: str = _p(
        'solver',
        'source of the 3D key poses: solver (as for whole sequences) or lifter (the lifter alone, '
        'which is faster)',
        choices=('solver', 'lifter'),
    )
    frame_pose_share: float = _p(
        0.8,
        "share of a control frame's own pose estimate in its pose; the rest is the key pose's, 0 "
        'takes the key pose '
        'alone',
        low=0.0,
        high=1.0,
    )
    step: float = _p(0.2, 'step of the gradient descent on the reprojection error (lambda)', low=0.0, high=0.5)
    smoothing: float = _p(0.04, 's, standard deviation of the low-pass filter after each step', low=0.0, high=1.0)
    iterations: int = _p(40, 'maximum number of steps of the gradient descent', low=0, high=10_000)


@dataclass(frozen=True)
class Config:
    """All parameters, by concern."""

    solver: SolverConfig = SolverConfig()
    classifier: ClassifierConfig = ClassifierConfig()
    tracker: TrackerConfig = TrackerConfig()
    node: NodeConfig = NodeConfig()
    recorder: RecorderConfig = RecorderConfig()
    keyframes: KeyframesConfig = KeyframesConfig()


@dataclass(frozen=True)
class Parameter:
    """One parameter as the outside sees it."""

    name: str
    kind: type
    default: Value
    doc: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    read_only: bool

    def check(self, value: object) -> Value:
        """The value in the parameter's own type.

        Raises:
            ConfigError: wrong type or outside the range; the message names the parameter.
        """
        if self.kind is float and isinstance(value, str) and YAML_1_1_MISSES.fullmatch(value):
            value = float(value)
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        number = _as_float(value) if is_number else math.nan
        if type(value) is not self.kind and not (self.kind is float and is_number):
            raise ConfigError(f'{self.name} = {shown(value)}: expected a {self.kind.__name__}')
        if isinstance(value, str) and self.choices and value not in self.choices:
            raise ConfigError(f'{self.name} = {shown(value)}: expected {", ".join(self.choices)}')
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        if is_number and not (math.isfinite(number) and low <= number <= high):
            raise ConfigError(f'{self.name} = {shown(value)}: expected {low:g} to {high:g}')
        return number if self.kind is float else cast(Value, value)


def _as_float(value: Any) -> float:
    """The number, infinite where it is too large."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def shown(value: object) -> str:
    """A value as an error shows it: on one line, and not all of it where it is long."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers of thousands of digits; what is nested too deep
        return 'a huge value'
    return text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + '...'


def parameters() -> Iterator[Parameter]:
    """Every parameter, in the order of the dataclasses."""
    for group in dataclasses.fields(Config):
        group_type = type(getattr(Config(), group.name))
        hints = get_type_hints(group_type)
        for f in dataclasses.fields(group_type):
            name = f'{group.name}.{f.name}'
            yield Parameter(name, hints[f.name], cast(Value, f.default), **f.metadata)


def with_values(config: Config, values: Mapping[str, object]) -> Config:
    """A copy with some parameters changed, by outside name.

    Raises:
        ConfigError: unknown name, wrong type or value out of range.
    """
    known = {p.name: p for p in parameters()}
    for name, value in values.items():
        if name not in known:
            raise ConfigError(f'unknown parameter {shown(name)}; {hint(name, known)}')
        group_name, field_name = name.split('.')
        checked = known[name].check(value)
        group = dataclasses.replace(getattr(config, group_name), **{field_name: checked})
        config = dataclasses.replace(config, **{group_name: group})
    return config


def hint(name: str, known: Iterable[str]) -> str:
    """Return what a name that is no parameter may have been meant for."""
    if name in RENAMED_SINCE_0_1:
        return f'it is {RENAMED_SINCE_0_1[name]!r} since version 0.2'
    by_field = {full.rpartition('.')[2]: full for full in known}
    close = difflib.get_close_matches(name.rpartition('.')[2], by_field, n=1)
    return f'did you mean {by_field[close[0]]!r}?' if close else '`mocap-ros config` lists them all'


def current_names(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return the values by the names that parameters have now, from names that may be those of version 0.1."""
    return {RENAMED_SINCE_0_1.get(name, name): value for name, value in values.items()}


def values(config: Config) -> dict[str, Value]:
    """Every parameter's value, by outside name."""
    groups = dataclasses.asdict(config)
    return {f'{g}.{name}': v for g, fields in groups.items() for name, v in fields.items()}


class _Loader(yaml.SafeLoader):
    """No aliases, which can make a small file huge, and no key twice."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """As in the base class."""
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(problem='aliases are not allowed', problem_mark=mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """As in the base class."""
        seen = set()
        for key, _ in node.value:
            name = key.value if key.tag == 'tag:yaml.org,2002:str' else None
            if name is None or name in seen:
                what = 'a key that is no text' if name is None else f'{shown(name)} twice'
                raise yaml.MarkedYAMLError(problem=what, problem_mark=key.start_mark)
            seen.add(name)
        return super().construct_mapping(node, deep)


def load_yaml(text: str, source: str) -> Any:
    """The content of a YAML text without aliases; keys are text, each there once.

    Raises:
        ConfigError: it is none; names `source`.
    """
    try:
        return yaml.load(text, _Loader)  # noqa: S506, a SafeLoader
    except yaml.MarkedYAMLError as error:
        line = f'line {error.problem_mark.line + 1}: ' if error.problem_mark else ''
        raise ConfigError(f'{source}: not YAML: {line}{error.problem}') from None
    except yaml.YAMLError as error:
        raise ConfigError(f'{source}: not YAML: {" ".join(str(error).split())}') from None
    except RecursionError:
        raise ConfigError(f'{source}: not YAML: nested too deep') from None
    except ValueError as error:  # numbers and dates that Python refuses
        raise ConfigError(f'{source}: not YAML: {error}') from None


def from_yaml(text: str, source: str) -> Config:
    """A configuration from a ROS parameter file (any node name) or a plain nested mapping.

    Raises:
        ConfigError: not YAML as `load_yaml` wants it, not a mapping, or a parameter is wrong; names `source`.
    """
    tree = load_yaml(text, source)
    tree = {} if tree is None else tree
    if isinstance(tree, dict) and len(tree) == 1:
        (only,) = tree.values()
        if isinstance(only, dict) and 'ros__parameters' in only:
            tree = only['ros__parameters']
    if not isinstance(tree, dict):
        raise ConfigError(f'{source}: expected a mapping of parameters')
    try:
        return with_values(Config(), dict(_flatten(tree)))
    except ConfigError as error:
        raise ConfigError(f'{source}: {error}') from None


def _flatten(tree: Mapping[object, object], prefix: str = '') -> Iterator[tuple[str, object]]:
    for key, value in tree.items():
        name = f'{prefix}{key}'
        if isinstance(value, dict):
            yield from _flatten(value, name + '.')
        else:
            yield name, value


def to_yaml(config: Config, node: str = 'mocap_node') -> str:
    """A commented ROS parameter file holding every parameter."""
    lines = [
        '# Every parameter of the node with its default. Made by `mocap-ros config`.',
        f'{node}:',
        '  ros__parameters:',
    ]
    current = values(config)
    group = ''
    for p in parameters():
        head, _, name = p.name.partition('.')
        if head != group:
            group = head
            lines.append(f'    {group}:')
        limits = ', '.join(p.choices) or _range(p.low, p.high)
        comment = p.doc + (f' ({limits})' if limits else '') + (' [read-only]' if p.read_only else '')
        lines += ['      # ' + line for line in textwrap.wrap(comment, 90, break_on_hyphens=False)]
        lines.append(f'      {name}: {_scalar(current[p.name])}')
    return '\n'.join(lines) + '\n'


def _scalar(value: Value) -> str:
    """A value as YAML, on one line."""
    style = '"' if isinstance(value, str) and not value.isprintable() else None
    return yaml.safe_dump(value, default_style=style, width=math.inf).split('\n')[0]


def _range(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ''
    if high is None:
        return f'from {low:g}'
    return f'{low:g} to {high:g}'
