# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of the tracker's state: a snapshot never changes, and the tracker continues from it bit for bit."""

import numpy as np
import pytest

import mocap_ros.tracking.tracker as tracker_module
from mocap_ros.config import Config, with_values
from mocap_ros.errors import InputError
from mocap_ros.formats.sequence_file import load_sequence
from mocap_ros.geometry.intrinsics import Intrinsics
from mocap_ros.keypoints.person import Person2D
from mocap_ros.models.model_file import load_base_pose_models
from mocap_ros.people import Person3D
from mocap_ros.tracking.tracker import Tracker
from tests.support.frozen_state import forbid_writing, list_values
from tests.support.paths import ROOT

SEQUENCE = load_sequence(ROOT / 'mocap_ros' / 'demo' / 'demo.npz')
FIRST_CAMERA = SEQUENCE.intrinsics(1.0)
SECOND_CAMERA = Intrinsics(FIRST_CAMERA.focal * 1.3, (300.0, 260.0), is_focal_known=True)
CAMERA_CHANGE, LAST = 70, 110  # frames
EXPECTED_FIELDS = {
    *('tracks', 'newest_stamp_ns', 'pose_memory', 'is_work_pending', 'name_count', 'swapped_frames', 'vertical')
}


def make_detection(frame: int, name: str, offset: float) -> Person2D:
    keypoints = np.nan_to_num(SEQUENCE.keypoints[frame])
    return Person2D(name, SEQUENCE.joint_names, keypoints[:, :2] + [offset, 0], keypoints[:, 2])


def feed(tracker: Tracker, first: int, last: int) -> list[tuple[Person3D, ...]]:
    """Track frames of two people: one with an id, and one without, who is hidden in frames 40 to 75."""
    output = []
    for frame in range(first, last):
        people = [make_detection(frame, 'ann', 0.0)]
        if not 40 <= frame < 75:
            people.append(make_detection(frame + 150, '', 500.0))
        camera = FIRST_CAMERA if frame < CAMERA_CHANGE else SECOND_CAMERA
        output.append(tracker.update(round(frame * 1e9 / 30), people, camera))
        if frame % 3 == 0:
            tracker.run_deferred_work()
    return output


@pytest.fixture(params=['learned', 'pca'])
def tracker(request: pytest.FixtureRequest) -> Tracker:
    """A tracker that has lost nobody yet and has made several hypothesis checks."""
    config = with_values(Config(), {'solver.prior': request.param, 'tracker.components': 12})
    return Tracker(load_base_pose_models('auto'), config)


@pytest.mark.parametrize('taken_after', [1, 30, 50])
def test_a_snapshot_is_not_changed_by_what_follows(tracker: Tracker, taken_after: int) -> None:
    feed(tracker, 0, taken_after)
    snapshot = tracker.snapshot()
    before = list_values(snapshot)
    assert {'.' + name for name in EXPECTED_FIELDS} <= before.keys()
    assert before['.tracks'] == len(snapshot.tracks) > 0
    assert forbid_writing(snapshot) > 20  # from here on a write into one of its arrays raises an error
    feed(tracker, taken_after, LAST)
    tracker.reset()
    assert list_values(snapshot) == before


def test_a_tracker_continues_from_a_snapshot_bit_for_bit(tracker: Tracker) -> None:
    feed(tracker, 0, 35)
    snapshot = tracker.snapshot()
    expected = list_values(tuple(feed(tracker, 35, LAST)))
    expected_state = list_values(tracker.snapshot())
    assert expected_state['.swapped_frames'] == tracker.swapped_frames
    assert len(tracker.snapshot().pose_memory.poses) > 0, 'the person who was hidden was forgotten'
    fresh = Tracker(load_base_pose_models('auto'), tracker.config)
    for restored in (tracker, fresh):
        restored.restore(snapshot)
        assert list_values(restored.snapshot()) == list_values(snapshot)
        assert list_values(tuple(feed(restored, 35, LAST))) == expected
        assert list_values(restored.snapshot()) == expected_state


def test_a_tracker_continues_in_the_middle_of_a_check(tracker: Tracker) -> None:
    """Another tracker does the slices of the check again that were done, and takes over the same answer."""
    frame, slices_done = 30, 0
    while slices_done < 3:
        feed(tracker, frame, frame + 1)
        tracker.run_deferred_work()
        begun = tracker.snapshot().begun_work
        frame, slices_done = frame + 1, 0 if begun is None else begun.slices_done
    snapshot = tracker.snapshot()
    assert forbid_writing(snapshot) > 20
    fresh = Tracker(load_base_pose_models('auto'), tracker.config)
    fresh.restore(snapshot)
    outputs = [list_values(tuple(feed(t, frame, frame + 30))) for t in (tracker, fresh)]
    assert outputs[0] == outputs[1]
    assert list_values(tracker.snapshot()) == list_values(fresh.snapshot())
    tracker.restore(snapshot)
    assert list_values(tuple(feed(tracker, frame, frame + 30))) == outputs[0], 'its own slices are further on'


@pytest.mark.parametrize(
    ('models', 'components', 'prior', 'message'),
    [
        ('walk', 12, 'pca', r'this tracker has the models walk \(12 base poses\) and no lifter'),
        (
            'all',
            5,
            'pca',
            r'with the models all \(12 base poses\) and no lifter; this tracker .* \(5 base poses\)',
        ),
        ('all', 12, 'learned', 'and no lifter; this tracker .* and a lifter'),
    ],
)
@pytest.mark.parametrize('after_reset', [False, True])
def test_the_state_of_another_tracker_is_refused(
    models: str, components: int, prior: str, message: str, after_reset: bool
) -> None:
    def make_tracker(name: str, count: int, its_prior: str) -> Tracker:
        config = with_values(Config(), {'solver.prior': its_prior, 'tracker.components': count})
        return Tracker(load_base_pose_models(name), config)

    tracker, other = make_tracker('all', 12, 'pca'), make_tracker(models, components, prior)
    if after_reset:
        tracker.reset()
    feed(tracker, 0, 2)
    before = list_values(other.snapshot())
    with pytest.raises(InputError, match=message):
        other.restore(tracker.snapshot())
    with pytest.raises(InputError, match='state: expected a TrackerState, got NoneType'):
        other.restore(None)  # type: ignore[arg-type]
    assert list_values(other.snapshot()) == before


def test_a_frame_that_fails_leaves_no_trace(tracker: Tracker, monkeypatch: pytest.MonkeyPatch) -> None:
    feed(tracker, 0, 20)
    tracker.run_deferred_work()
    before = list_values(tracker.snapshot())
    with monkeypatch.context() as patch:

        def fail(*_: object) -> None:
            raise np.linalg.LinAlgError('no solution')

        patch.setattr(tracker_module, 'solve', fail)
        with pytest.raises(np.linalg.LinAlgError):
            feed(tracker, 20, 21)
    assert list_values(tracker.snapshot()) == before
    assert [p.id for p in feed(tracker, 20, 21)[0]] == ['ann', 'person_1']


def test_a_reset_forgets_people_but_keeps_counting(tracker: Tracker) -> None:
    feed(tracker, 0, 3)
    tracker.update(200_000_000, [Person2D('', SEQUENCE.joint_names, np.ones((17, 2)), np.ones(17))], FIRST_CAMERA)
    tracker.reset()
    state = tracker.snapshot()
    assert (state.tracks, state.newest_stamp_ns, state.name_count) == ((), None, 0)
    assert (state.is_work_pending, state.begun_work) == (False, None)
    assert state.unusable_people == tracker.unusable_people == 1
