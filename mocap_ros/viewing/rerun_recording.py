# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A scene as a recording of Rerun: entities, time lines and a layout that shows all of them at once.

    world/camera                    the camera; photo: its image; input/N: 2D input; people/NAME: the 3D result
    world/people/NAME/joints        joints and bones; inferred: those that were not seen; deviation: ellipsoids
    world/people/NAME/trail         places of the pelvis in the last seconds
    world/truth                     true joints, where they are known
    curves/residual, cadence/NAME   px and Hz
    states/NAME/motion              kind of motion
    states/NAME/detection           seen, predicted or tentative, and undone swaps of left and right
    marks                           dropped inputs and keyframes

Rerun is an optional dependency and is imported where it is used.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_ros.errors import MocapError, tell_installation
from mocap_ros.people import MotionKind
from mocap_ros.skeleton import Skeleton
from mocap_ros.viewing.plots import INFERRED_COLOUR, TRUTH_COLOUR, make_printable
from mocap_ros.viewing.scene import (
    INPUT_COLOUR,
    MARK_COLOURS,
    PALE_COLOUR,
    TRAIL_JOINT,
    Scene,
    SceneImage,
    SceneKeypoints,
    ScenePerson,
    choose_joint_colours,
    choose_person_colour,
)

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Array32 = NDArray[np.float32]

APPLICATION = 'mocap_ros'  # name under which Rerun keeps the layout
TIMELINE = 'time'  # name of the time line; s from the beginning of the scene
JOINT_RADIUS_M = 0.03  # m; joints stand out from bones and hide nothing
INFERRED_RADIUS_M = 0.038  # m; a little more, because they are drawn over the joints
TRAIL_RADIUS_M = 0.01  # m; a dot a frame
IMAGE_RADIUS_PX = 3.0  # px of the image
INPUT_RADIUS_PX = 2.0  # px of the image
PIECE_ROWS = 4096  # rows that are sent at a time, as many as the viewer keeps together
TRAIL_S = 2.0  # s; length of the trails
DEVIATION_ALPHA = 40  # of 255; joints are seen through the ellipsoids
CAMERA_PLANE_M = 0.5  # m; distance of the image plane in the picture of the camera
WRITE_TIMEOUT_S = 60.0  # s; Rerun waits without an end for its writer after that has failed, as on a full disk
MAX_LIVE_PEOPLE = 32  # people; of those who are gone, only the last are kept in a live drawing's layout
BACKGROUND = (255, 255, 255)  # white, as in the page, because the colours were chosen for it
# Place of the first view in distances from the camera to the people: beside, above and a little behind the camera,
# so that the camera and the people are seen
EYE_PLACE = np.array([-0.45, -0.22, -0.12])  # 1
TARGET_SHARE = 0.75  # of the way from the camera to the people: the target of the first view
ALONE_COLOUR = '#4c9be8'  # blue; curves of somebody who is alone, readable on Rerun's dark ground
GRID_COLOUR = '#c8c8c8'  # light grey
TRUTH_CLASS = 0  # number of the truth in the annotation context; people have the numbers from 1
FIRST_INPUT_CLASS = 1000  # number of the first keypoint layout in the annotation context; people have smaller ones
CURVES = {'residual': 'px', 'cadence': 'Hz'}  # curves of a person, and their units
MOTION_STATES = {
    MotionKind.UNKNOWN: ('unknown', '#dddddd'),
    MotionKind.PERIODIC: ('periodic', '#8fbf8f'),
    MotionKind.NON_PERIODIC: ('not periodic', '#b9a3d0'),
}
# States of the detection of a person, the later ones before the earlier ones.
DETECTION_STATES = {
    'seen': '#c8d8e8',
    'tentative': PALE_COLOUR,
    'predicted': '#444444',
    'swap undone': '#d62728',
}


def import_rerun() -> Any:
    """Import Rerun.

    Raises:
        MocapError: Rerun is not installed; the error says what to install.
    """
    try:
        import rerun.blueprint  # loaded on demand; this makes `rerun` known, too
    except ImportError:
        raise MocapError(
            f'this view needs Rerun, with Python 3.11 or later: {tell_installation("view")}; a page of a '
            'recording, for any browser, does without: mocap-ros view IN -o page.html'
        ) from None
    return rerun


def make_entity_name(person_id: str) -> str:
    """Return a name for entity paths: ids come from anywhere, and a path must not depend on their characters."""
    return re.sub(r'[^A-Za-z0-9_-]', '_', person_id) or '_'


def write_recording(
    scene: Scene, path: Path, play_state: str = 'playing', images: Iterable[SceneImage] = ()
) -> None:
    """Write a scene as .rrd.

    Args:
        scene: what to write.
        path: the file.
        play_state: what a viewer that opens the file does at first, as for `build_blueprint`.
        images: images of the camera, which are drawn behind the 2D input.

    Raises:
        MocapError: Rerun is not installed, or it could not write the file.
    """
    rr = import_rerun()
    title = make_printable(scene.title)
    recording = rr.RecordingStream(APPLICATION, recording_id=title, send_properties=False)
    try:
        recording.save(path, default_blueprint=build_blueprint(scene, play_state))
        recording.send_recording_name(title)
        send_scene(recording, scene)
        for image in images:
            recording.set_time(TIMELINE, duration=image.time_s)
            recording.log('world/camera/photo', rr.EncodedImage(contents=image.data, media_type=image.media_type))
        recording.flush(timeout_sec=WRITE_TIMEOUT_S)
    except RuntimeError as error:  # of Rerun's writer, which logs the cause itself
        raise MocapError(f'{path.name}: Rerun could not write it ({error}); is the disk full?') from None
    recording.disconnect()


def name_people(scene: Scene) -> list[str]:
    """Return the name of each person in entity paths; `_2` is appended to a name until it is unique."""
    names: list[str] = []
    for person in scene.people:
        name = make_entity_name(person.id)
        while name in names:
            name += '_2'
        names.append(name)
    return names


def send_scene(recording: Any, scene: Scene) -> None:
    """Send all of a scene to a recording of Rerun, column by column, which takes a fraction of single messages."""
    rr = import_rerun()
    names = name_people(scene)
    send_static(recording, scene, names)
    times = scene.times
    for index, (name, person) in enumerate(zip(names, scene.people, strict=True)):
        writer = _PersonWriter(recording, name, index + 1, scene.skeleton)
        is_whole = _all_known(person.joints), _all_known(person.image)
        writer.send_looks(choose_person_colour(scene, index), *is_whole)
        writer.send(person, times)
        recording.flush(timeout_sec=WRITE_TIMEOUT_S)  # so that what waits for being written takes no memory
        for lane, states in name_states(person, scene.swapped[index]).items():
            if lane != 'motion' or scene.has_motion:
                writer.send_states(lane, find_changes(times, person.frames, states))
    for layout, keypoints in enumerate(scene.keypoints):
        _send_keypoints(rr, recording, times, keypoints, layout, set())
    if scene.truth is not None:
        _send_truth(rr, recording, scene, scene.truth)
    if scene.marks:
        column = rr.TimeColumn(TIMELINE, duration=[mark.time_s for mark in scene.marks])
        texts = [f'{mark.kind.value}: {mark.text}' if mark.text else mark.kind.value for mark in scene.marks]
        colours = [_to_rgba(MARK_COLOURS[mark.kind]) for mark in scene.marks]
        recording.send_columns('marks', [column], rr.TextLog.columns(text=texts, color=colours))


def send_static(recording: Any, scene: Scene, names: Sequence[str]) -> None:
    """Send what does not change: joint names and bones, the camera, and the looks of curves and states."""
    rr = import_rerun()
    skeleton = scene.skeleton
    classes = [
        _describe_class(rr, TRUTH_CLASS, 'truth', skeleton, [TRUTH_COLOUR] * len(skeleton.joints), TRUTH_COLOUR)
    ]
    for index, person in enumerate(scene.people):
        own = choose_person_colour(scene, index)
        classes.append(
            _describe_class(rr, index + 1, person.id, skeleton, choose_joint_colours(scene, index), own)
        )
    for index, keypoints in enumerate(scene.keypoints):
        layout = keypoints.skeleton
        black = [INPUT_COLOUR] * len(layout.joints)
        label = layout.name or 'keypoints'
        classes.append(_describe_class(rr, FIRST_INPUT_CLASS + index, label, layout, black, INPUT_COLOUR))
    recording.log('world', rr.ViewCoordinates.RDF, rr.AnnotationContext(classes), static=True)
    width, height = scene.image_size
    recording.log(
        'world/camera',
        rr.Pinhole(
            focal_length=scene.intrinsics.focal_lengths,
            principal_point=scene.intrinsics.center,
            width=width,
            height=height,
            image_plane_distance=CAMERA_PLANE_M,
            camera_xyz=rr.ViewCoordinates.RDF,
        ),
        static=True,
    )
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]])
    recording.log('world/camera/frame', rr.LineStrips2D([corners], colors=[_to_rgba('#999999')]), static=True)
    for index, (name, person) in enumerate(zip(names, scene.people, strict=True)):
        colour = [_to_rgba(choose_person_colour(scene, index) if len(scene.people) > 1 else ALONE_COLOUR)]
        for curve in _list_curves(scene):
            recording.log(f'curves/{curve}/{name}', rr.SeriesLines(colors=colour, names=[person.id]), static=True)
        lanes = {'motion': dict(MOTION_STATES.values()), 'detection': DETECTION_STATES}
        for lane, states in lanes.items() if scene.has_motion else [('detection', DETECTION_STATES)]:
            recording.log(
                f'states/{name}/{lane}',
                rr.StateConfiguration(values=list(states), colors=[_to_rgba(c) for c in states.values()]),
                static=True,
            )


def build_blueprint(scene: Scene, play_state: str = 'playing') -> Any:
    """Return the layout that shows 3D, 2D, curves and states without a click.

    Args:
        scene: what is shown.
        play_state: what the viewer does at first: `playing`, `paused` or `following` the newest frame.
    """
    rr = import_rerun()
    rrb = rr.blueprint
    target = TARGET_SHARE * scene.centre
    up = (-scene.to_level[1]).tolist()
    trail = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    space = rrb.Spatial3DView(
        origin='world',
        name='3D',
        background=list(BACKGROUND),
        line_grid=rrb.LineGrid3D(
            visible=True,
            spacing=1.0,
            plane=rr.components.Plane3D(up, -scene.floor_y),
            color=_to_rgba(GRID_COLOUR),
        ),
        eye_controls=rrb.EyeControls3D(
            position=scene.to_level.T @ EYE_PLACE * max(float(np.linalg.norm(scene.centre)), scene.extent),
            look_target=target,
            eye_up=up,
        ),
        overrides={f'world/people/{name}/trail': trail for name in name_people(scene)},
    )
    image = rrb.Spatial2DView(origin='world/camera', name='2D input and result', background=list(BACKGROUND))
    curves = [
        rrb.TimeSeriesView(origin=f'curves/{curve}', name=f'{curve}, {CURVES[curve]}')
        for curve in _list_curves(scene)
    ]
    kinds = [*['motion'] * scene.has_motion, 'detection', *['swaps'] * bool(scene.keypoints)]
    states = rrb.StateTimelineView(origin='states', name=', '.join(kinds))
    rows: list[Any] = [rrb.Horizontal(space, image, column_shares=[3, 2])]
    if curves:
        rows.append(rrb.Horizontal(*curves))
    if scene.marks:
        states = rrb.Horizontal(states, rrb.TextLogView(origin='marks', name='marks'), column_shares=[3, 1])
    return rrb.Blueprint(
        rrb.Vertical(*rows, states, row_shares=[5, *[2] * len(rows)]),
        rrb.TimePanel(
            state='collapsed',
            timeline=TIMELINE,
            play_state=play_state,
            loop_mode='off' if play_state == 'following' else 'all',
        ),
        rrb.SelectionPanel(state='collapsed'),
        rrb.BlueprintPanel(state='collapsed'),
        auto_views=False,
        auto_layout=False,
    )


class _PersonWriter:
    """Sends one person; the looks of the person's entities do not change and are sent once.

    Args:
        recording: recording of Rerun.
        name: name of the person in entity paths.
        number: number of the person's class in the annotation context.
        skeleton: skeleton of the person's joints.
    """

    def __init__(self, recording: Any, name: str, number: int, skeleton: Skeleton) -> None:
        self._rr, self._recording, self._name, self._number = import_rerun(), recording, name, number
        self._skeleton = skeleton
        self._is_space_whole = self._is_image_whole = False
        self.entity, self.image_entity = f'world/people/{name}', f'world/camera/people/{name}'

    def send_looks(self, colour: str, is_space_whole: bool = False, is_image_whole: bool = False) -> None:
        """Send radii and colours.

        Args:
            colour: the person's colour.
            is_space_whole: whether all joints are known in all frames, so that their numbers are sent once.
            is_image_whole: likewise in the image.
        """
        rr = self._rr
        self._is_space_whole, self._is_image_whole = is_space_whole, is_image_whole
        joints = len(self._skeleton.joints)
        looks = {
            'joints': _make_looks(rr.Points3D, self._number, JOINT_RADIUS_M, joints if is_space_whole else 0),
            'inferred': rr.Points3D.from_fields(radii=[INFERRED_RADIUS_M], colors=[_to_rgba(INFERRED_COLOUR)]),
            'deviation': rr.Ellipsoids3D.from_fields(
                colors=[_to_rgba(colour, DEVIATION_ALPHA)], fill_mode='solid'
            ),
            'trail': rr.Points3D.from_fields(radii=[TRAIL_RADIUS_M], colors=[_to_rgba(colour)]),
        }
        for part, archetype in looks.items():
            self._recording.log(f'{self.entity}/{part}', archetype, static=True)
        image = _make_looks(rr.Points2D, self._number, IMAGE_RADIUS_PX, joints if is_image_whole else 0)
        self._recording.log(self.image_entity, image, static=True)

    def send(self, person: ScenePerson, times: Array) -> None:
        """Send joints, deviations, trail, image points and curves.

        Args:
            person: the person in N frames.
            times: (F,) s, times of the frames.
        """
        for first in range(0, len(person.frames), PIECE_ROWS):
            rows = slice(first, first + PIECE_ROWS)
            following = person.frames[first + PIECE_ROWS :][:1].tolist()
            self._send_piece(person.cut(rows), times, following[0] if following else None)

    def _send_piece(self, person: ScenePerson, times: Array, next_frame: int | None) -> None:
        """Send some rows of a person; `next_frame` is as for `end_runs`."""
        rr, joints = self._rr, person.joints
        is_finite = np.asarray(np.isfinite(joints).all(axis=2))
        counts, columns = _make_point_columns(rr.Points3D, joints, self._is_space_whole)
        self._send_rows(f'{self.entity}/joints', person, times, next_frame, counts, columns)
        inferred = person.inferred & is_finite
        counts = inferred.sum(axis=1)
        is_told = (counts > 0) | (np.diff(counts, prepend=1) != 0)  # nobody need be told twice that there are none
        columns = rr.Points3D.columns(positions=joints[inferred])
        self._send_rows(f'{self.entity}/inferred', person, times, next_frame, counts, columns, is_told)
        known = np.isfinite(person.std) & is_finite
        if known.any():
            half_sizes = np.repeat(person.std[known][:, None], 3, axis=1)
            columns = rr.Ellipsoids3D.columns(centers=joints[known], half_sizes=half_sizes)
            self._send_rows(f'{self.entity}/deviation', person, times, next_frame, known.sum(axis=1), columns)
        trail = self._skeleton.index(TRAIL_JOINT)
        columns = rr.Points3D.columns(positions=joints[is_finite[:, trail], trail])
        counts = is_finite[:, trail].astype(int)
        self._send_rows(f'{self.entity}/trail', person, times, next_frame, counts, columns)
        counts, columns = _make_point_columns(rr.Points2D, person.image, self._is_image_whole)
        self._send_rows(self.image_entity, person, times, next_frame, counts, columns)
        for curve, values in (('residual', person.residual), ('cadence', person.cadence)):
            if np.isfinite(values).any():  # NaN interrupts a curve
                column = rr.TimeColumn(TIMELINE, duration=times[person.frames])
                scalars = rr.Scalars.columns(scalars=values.astype(np.float64))
                self._recording.send_columns(f'curves/{curve}/{self._name}', [column], scalars)

    def send_states(self, lane: str, changes: Sequence[tuple[float, str | None]]) -> None:
        """Send changes of a state as times in s and names; None where the person is absent."""
        if changes:
            column = self._rr.TimeColumn(TIMELINE, duration=[time for time, _ in changes])
            columns = self._rr.StateChange.columns(state=[state for _, state in changes])
            self._recording.send_columns(f'states/{self._name}/{lane}', [column], columns)

    def _send_rows(
        self,
        entity: str,
        person: ScenePerson,
        times: Array,
        next_frame: int | None,
        counts: Indices,
        columns: Any,
        is_told: NDArray[np.bool_] | None = None,
    ) -> None:
        """Send the rows that are told, of different lengths, and an empty row after each run of frames."""
        ends, lengths = end_runs(times, person.frames, counts, next_frame, is_told)
        if len(ends):
            column = self._rr.TimeColumn(TIMELINE, duration=ends)
            self._recording.send_columns(entity, [column], columns.partition(lengths))


class LiveDrawing:
    """Draws people as they come, in the entities and the layout of `send_scene`.

    Args:
        recording: recording of Rerun, which a viewer receives.
    """

    def __init__(self, recording: Any) -> None:
        self._rr, self._recording = import_rerun(), recording
        self._people: dict[str, ScenePerson] = {}  # the people of the layout by id, as they were first seen
        self._writers: dict[str, _PersonWriter] = {}
        self._states: dict[tuple[str, str], str] = {}  # last state by id and lane
        self._inputs: set[str] = set()  # entities of the 2D input so far
        self._shown_inputs: set[str] = set()  # those that the last frame had
        self._layouts: dict[str, SceneKeypoints] = {}  # all keypoint layouts so far, as they were first seen

    def draw(self, scene: Scene, time_s: float) -> None:
        """Draw a scene of one frame.

        Args:
            scene: the people and the keypoints in one frame.
            time_s: time of the frame in s, on the time line of the drawing.
        """
        is_known = self._layouts.keys() >= {k.skeleton.name for k in scene.keypoints}
        if not (is_known and self._people.keys() >= {person.id for person in scene.people}):
            self._send_static(scene)
        times = np.array([time_s])
        for person, swapped in zip(scene.people, scene.swapped, strict=True):
            self._writers[person.id].send(person, times)
            for lane, states in name_states(person, swapped).items():
                self._change_state(person.id, lane, time_s, states[0])
        for person_id in {known for known, _ in self._states} - {person.id for person in scene.people}:
            self._remove(person_id, time_s)
        shown: set[str] = set()
        for keypoints in scene.keypoints:
            number = list(self._layouts).index(keypoints.skeleton.name)
            shown |= _send_keypoints(self._rr, self._recording, times, keypoints, number, self._inputs)
        self._recording.set_time(TIMELINE, duration=time_s)
        for entity in sorted(self._shown_inputs - shown):
            self._recording.log(entity, self._rr.Clear(recursive=False))
        self._shown_inputs = shown

    def _send_static(self, scene: Scene) -> None:
        """Send what does not change as long as nobody new is seen; a second person changes the colours."""
        for person in scene.people:
            # every curve and state has its place from the beginning, whatever is known of the person so far
            known: dict[str, Any] = {'motion': np.full_like(person.motion, MotionKind.NON_PERIODIC.value)}
            known |= {name: np.zeros_like(getattr(person, name)) for name in CURVES}
            self._people.setdefault(person.id, replace(person, **known))
        self._forget_people({person.id for person in scene.people})
        for keypoints in scene.keypoints:
            self._layouts.setdefault(keypoints.skeleton.name, keypoints)
        everybody = replace(scene, people=tuple(self._people.values()), keypoints=tuple(self._layouts.values()))
        names = name_people(everybody)
        self._recording.send_blueprint(build_blueprint(everybody, 'following'))
        send_static(self._recording, everybody, names)
        for index, (person_id, name) in enumerate(zip(self._people, names, strict=True)):
            self._writers[person_id] = _PersonWriter(self._recording, name, index + 1, everybody.skeleton)
            self._writers[person_id].send_looks(choose_person_colour(everybody, index))

    def _forget_people(self, present: set[str]) -> None:
        """Forget those who came first of the people who are gone, as long as there are too many."""
        gone = [person_id for person_id in self._people if person_id not in present]
        for person_id in gone[: max(len(self._people) - MAX_LIVE_PEOPLE, 0)]:
            if not any(known == person_id for known, _ in self._states):  # else the view still shows the person
                del self._people[person_id], self._writers[person_id]

    def _change_state(self, person_id: str, lane: str, time_s: float, state: str) -> None:
        """Send a state unless it is the last one."""
        if self._states.get((person_id, lane)) != state:
            self._states[person_id, lane] = state
            self._writers[person_id].send_states(lane, [(time_s, state)])

    def _remove(self, person_id: str, time_s: float) -> None:
        """Draw a person no longer."""
        writer = self._writers[person_id]
        self._recording.set_time(TIMELINE, duration=time_s)
        for entity in (writer.entity, writer.image_entity):
            self._recording.log(entity, self._rr.Clear(recursive=True))
        for lane in [lane for known, lane in self._states if known == person_id]:
            writer.send_states(lane, [(time_s, None)])
            del self._states[person_id, lane]


def name_states(person: ScenePerson, swapped: NDArray[np.bool_]) -> dict[str, list[str]]:
    """Return the states of a person in N frames by lane: the kind of motion, and how the person was detected.

    Args:
        person: the person.
        swapped: (N,) True where a swap of left and right was undone.
    """
    motions = {kind.value: name for kind, (name, _) in MOTION_STATES.items()}
    flags = [swapped, person.predicted, person.tentative]
    return {
        'motion': [motions.get(kind, motions[MotionKind.UNKNOWN]) for kind in person.motion.tolist()],
        'detection': np.select(flags, ['swap undone', 'predicted', 'tentative'], 'seen').tolist(),
    }


def find_changes(times: Array, frames: Indices, states: Sequence[str]) -> list[tuple[float, str | None]]:
    """Return times in s and states where these change, and None where a person becomes absent.

    Args:
        times: (F,) s.
        frames: (N,) indices of the frames of the states, increasing.
        states: (N,) states.
    """
    changes: list[tuple[float, str | None]] = []
    last_frame, last_state = -1, ''
    for frame, state in zip(frames.tolist(), states, strict=True):
        if last_state and frame > last_frame + 1:
            changes.append((float(times[last_frame + 1]), None))
            last_state = ''
        if state != last_state:
            changes.append((float(times[frame]), state))
        last_frame, last_state = frame, state
    if last_state and last_frame + 1 < len(times):
        changes.append((float(times[last_frame + 1]), None))
    return changes


def end_runs(
    times: Array,
    frames: Indices,
    lengths: Indices,
    next_frame: int | None = None,
    is_told: NDArray[np.bool_] | None = None,
) -> tuple[Array, Indices]:
    """Return times and lengths of rows, with a row of length 0 after each run of frames.

    Rerun shows the last row of an entity until the next one, also long after a person has left.

    Args:
        times: (F,) s.
        frames: (N,) indices of the frames of the rows, increasing.
        lengths: (N,) lengths of the rows.
        next_frame: index of the frame of the row that comes after these; None if they are the last ones.
        is_told: (N,) False for rows to leave out; None for none.
    """
    ends = np.flatnonzero(np.diff(frames, append=len(times) + 1 if next_frame is None else next_frame) > 1)
    ends = ends[frames[ends] + 1 < len(times)]
    told = np.insert(np.ones(len(frames), bool) if is_told is None else is_told, ends + 1, True)
    all_frames = np.insert(frames, ends + 1, frames[ends] + 1)
    return times[all_frames][told], np.insert(lengths, ends + 1, 0)[told]


def _send_truth(rr: Any, recording: Any, scene: Scene, truth: Array32) -> None:
    """Send the true joints."""
    known = np.flatnonzero(np.isfinite(truth).any(axis=(1, 2)))
    counts, columns = _make_point_columns(rr.Points3D, truth[known], is_whole=False)
    ends, lengths = end_runs(scene.times, known, counts)
    recording.send_columns('world/truth', [rr.TimeColumn(TIMELINE, duration=ends)], columns.partition(lengths))
    looks = _make_looks(rr.Points3D, TRUTH_CLASS, JOINT_RADIUS_M, 0)
    recording.log('world/truth', looks, static=True)


def _make_looks(archetype: Any, number: int, radius: float, joints: int) -> Any:
    """Return what does not change of the points of a skeleton.

    Args:
        archetype: Points2D or Points3D of Rerun.
        number: number of the skeleton's class.
        radius: radius of a point in m or px.
        joints: number of joints if all of them are in every row, so that their numbers do not change; else 0.
    """
    numbers = {'keypoint_ids': np.arange(joints)} if joints else {}
    return archetype.from_fields(radii=[radius], class_ids=[number], show_labels=False, **numbers)


def _make_point_columns(archetype: Any, points: Array32, is_whole: bool) -> tuple[Indices, Any]:
    """Return how many points of (N, J, 2) or (N, J, 3) are known in each row, and the columns of all known points.

    Args:
        archetype: Points2D or Points3D of Rerun.
        points: the points; NaN where unknown.
        is_whole: whether all are known in all rows, and their numbers do not change.
    """
    if is_whole:
        return np.full(len(points), points.shape[1]), archetype.columns(
            positions=points.reshape(-1, points.shape[2])
        )
    known = np.isfinite(points).all(axis=2)
    numbers = np.broadcast_to(np.arange(known.shape[1]), known.shape)[known]
    return known.sum(axis=1), archetype.columns(positions=points[known], keypoint_ids=numbers)


def _all_known(points: Array32) -> bool:
    return bool(np.isfinite(points).all())


def _list_curves(scene: Scene) -> list[str]:
    """Return the names of the curves of which the scene has values."""
    return [name for name in CURVES if any(np.isfinite(getattr(person, name)).any() for person in scene.people)]


def _send_keypoints(
    rr: Any, recording: Any, times: Array, keypoints: SceneKeypoints, layout: int, known: set[str]
) -> set[str]:
    """Send the 2D input; the first detections of all frames are an entity, so are the second ones, and so on.

    Args:
        rr: Rerun.
        recording: recording of Rerun.
        times: (F,) s.
        keypoints: the detections of one layout.
        layout: number of the layout.
        known: entities whose looks were sent; those of others are sent and added.

    Returns:
        The entities that were sent.
    """
    sent: set[str] = set()
    slots = np.arange(len(keypoints.frames)) - np.searchsorted(keypoints.frames, keypoints.frames)
    for slot in range(int(slots.max(initial=-1)) + 1):
        of_slot = np.flatnonzero(slots == slot)
        entity = f'world/camera/input/{layout}_{slot}'
        sent.add(entity)
        for first in range(0, len(of_slot), PIECE_ROWS):
            rows, following = of_slot[first : first + PIECE_ROWS], of_slot[first + PIECE_ROWS :][:1].tolist()
            counts, columns = _make_point_columns(rr.Points2D, keypoints.points[rows], is_whole=False)
            next_frame = int(keypoints.frames[following[0]]) if following else None
            ends, lengths = end_runs(times, keypoints.frames[rows], counts, next_frame)
            recording.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=ends)], columns.partition(lengths))
        if entity not in known:
            known.add(entity)
            looks = _make_looks(rr.Points2D, FIRST_INPUT_CLASS + layout, INPUT_RADIUS_PX, 0)
            recording.log(entity, looks, static=True)
    return sent


def _describe_class(
    rr: Any, number: int, label: str, skeleton: Skeleton, joint_colours: Sequence[str], colour: str
) -> Any:
    """Return the description of a skeleton for the annotation context."""
    return rr.ClassDescription(
        info=rr.AnnotationInfo(number, label, _to_rgba(colour)),
        keypoint_annotations=[
            rr.AnnotationInfo(joint, name, _to_rgba(joint_colour))
            for joint, (name, joint_colour) in enumerate(zip(skeleton.joints, joint_colours, strict=True))
        ],
        keypoint_connections=list(skeleton.bones),
    )


def _to_rgba(colour: str, alpha: int = 255) -> tuple[int, int, int, int]:
    """Return red, green, blue and alpha of a colour such as `#1f77b4`."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue, alpha
