# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scenes, their pictures and the images behind the points; the page, of files and live: its arrays, its size, its
server, and what Chromium, without a window, draws of it. Where Chromium is missing, these tests are skipped."""

import base64
import gzip
import hashlib
import http.client
import json
import os
import re
import shutil
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy.spatial.transform import Rotation

from mocap_ros.bags.recorder import Recorder
from mocap_ros.cli.main import main
from mocap_ros.cli.view import POSES, save_picture
from mocap_ros.config import NodeConfig, RecorderConfig
from mocap_ros.demo.scene import make_recording
from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.sequence_file import save_sequence
from mocap_ros.formats.video import VideoReader
from mocap_ros.keypoints.keypoint_sequence import KeypointSequence
from mocap_ros.messages.images import IMAGE
from mocap_ros.people import PoseSequence
from mocap_ros.recordings.build_scene import read_images
from mocap_ros.skeleton import CMU15
from mocap_ros.units import NS_PER_S
from mocap_ros.viewing import live_page, plots
from mocap_ros.viewing import scene as scenes
from mocap_ros.viewing.live_page import LiveScene, PageServer, make_nobody
from mocap_ros.viewing.overlay import MAX_OFFSET_S, Overlay, StampedImage, find_frame, reduce_images
from mocap_ros.viewing.page import NOT_A_NUMBER, UNKNOWN_STD, build_page
from mocap_ros.viewing.scene import Scene, SceneKeypoints, SidedPoints, project_joints
from tests.support.blob_people import write_video
from tests.support.bodies import make_swinging_body
from tests.support.camera_messages import encode, encode_pixels
from tests.support.foreign_messages import create_blank_message
from tests.support.input_files import QUICK_OPTIONS
from tests.support.paths import ROOT
from tests.support.scenes import (
    INTRINSICS,
    STEP_NS,
    count_colours,
    make_keypoints,
    make_scene,
    make_scene_person,
    write_and_open,
)

PROGRAMS = ('chromium', 'chromium-browser', 'google-chrome')
# Software WebGL, and nothing that would reach a network.
OPTIONS = (
    '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
    '--disable-component-update', '--disable-sync', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
)  # fmt: skip
WINDOW = {'width': 1280, 'height': 800}  # px
TIMEOUT_MS = 60_000  # ms; a busy machine takes seconds


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip('Chromium is not installed')
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(OPTIONS))
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page of Playwright without a network, whose errors fail the test."""
    errors: list[str] = []
    page = browser.new_page(viewport=WINDOW)
    page.set_default_timeout(TIMEOUT_MS)
    page.on('pageerror', lambda error: errors.append(str(error)))
    page.on('console', lambda message: errors.append(message.text) if message.type == 'error' else None)
    page.context.set_offline(True)
    yield page
    page.context.close()
    assert not errors


TIMEOUT_S = 60.0  # s; a busy machine draws a picture a second
TELEPHONE = {'width': 390, 'height': 844}  # px
FILES = ROOT / 'mocap_ros' / 'viewing' / 'page_files'


def read_element(page: str, element_id: str) -> str:
    found = re.search(rf'<script type="[^"]*" id="{element_id}">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return found[1]


class ReadPage:
    """The scene that a page holds, its arrays read as the script of the page reads them."""

    def __init__(self, scene: Scene) -> None:
        page = build_page(scene)
        self.scene: dict[str, Any] = json.loads(read_element(page, 'scene'))
        self._bytes = np.frombuffer(gzip.decompress(base64.b64decode(read_element(page, 'data'))), np.uint8)

    def read(self, layout: dict[str, int]) -> np.ndarray:
        offset, rows, columns, size = (layout[key] for key in ('offset', 'rows', 'columns', 'size'))
        planes = self._bytes[offset : offset + rows * columns * size].reshape(size, columns, rows)
        steps = sum(planes[plane].astype(np.int64) << 8 * plane for plane in range(size))
        values = np.cumsum(steps, axis=1) % (1 << 8 * size)
        signed = values - (1 << 8 * size) * (values >= 1 << (8 * size - 1)) if size > 1 else values
        return np.asarray(signed).T


@pytest.fixture
def scene() -> Scene:
    scene = make_scene()
    scene.people[0].joint_std[3:6] = np.nan
    scene.people[0].cadence[:10] = np.nan
    scene.keypoints[0].points[7] = np.nan
    return scene


def test_the_arrays_are_those_of_the_scene_to_a_millimetre(scene: Scene) -> None:
    scene.people[0].tentative[:4] = True
    scene.keypoints[0].points[10] = scene.keypoints[0].points[10, list(CMU15.mirror)]  # of the first person alone
    page = ReadPage(scene)
    for person, described in zip(scene.people, page.scene['people'], strict=True):
        arrays = {name: page.read(layout) for name, layout in described['arrays'].items()}
        assert arrays['frames'][:, 0].tolist() == scene.find_frames(person).tolist()
        joints = arrays['joints'].reshape(-1, 15, 3) * page.scene['metrePerStep']
        assert np.abs(joints - person.joints).max() < 0.00051
        image = arrays['image'].reshape(-1, 15, 2) * page.scene['pixelPerStep']
        assert np.abs(image - project_joints(person)).max() < 0.07
        unknown = np.isnan(person.joint_std)
        assert ((arrays['std'] == UNKNOWN_STD) == unknown).all()
        assert np.abs(arrays['std'] * page.scene['stdPerStep'] - person.joint_std)[~unknown].max() < 0.0011
        inferred = arrays['inferred'] >> np.arange(15) & 1
        assert (inferred == person.inferred).all()
        is_swapped = (scene.find_frames(person) == 10) & (person is scene.people[0])
        for bit, values in enumerate((person.predicted, person.tentative, is_swapped)):
            assert ((arrays['state'][:, 0] >> bit & 1) == values).all()
        assert ((arrays['state'][:, 0] >> 4 & 3) == person.motion).all()
        assert ((arrays['state'][:, :1] >> [6, 7] & 1) == (person.contact > 0.5)).all()
        assert ((arrays['cadence'][:, 0] == NOT_A_NUMBER) == np.isnan(person.cadence)).all()
    points = page.read(page.scene['keypoints'][0]['arrays']['points'])
    assert (points[7] == NOT_A_NUMBER).all()
    seconds = page.read(page.scene['times'])[:, 0] * page.scene['tickS']
    assert np.abs(seconds - scene.times).max() < 6e-5


def test_no_text_of_an_input_becomes_html(scene: Scene) -> None:
    page = build_page(replace(scene, title=os.fsdecode(b'walk\xff.npz')))
    assert '<title>walk\\udcff.npz</title>' in page
    assert page.encode('utf-8')
    page = build_page(scene)
    assert page.count('</script>') == 5
    assert '<b>en' not in page
    assert '<title>two &lt;/script&gt; people</title>' in page
    assert json.loads(read_element(page, 'scene'))['people'][1]['id'] == '<b>en'


def test_the_page_is_small_and_needs_no_other_file_and_no_network() -> None:
    page = build_page(make_scene(1800))
    assert len(page) < 1_200_000, 'a minute of two people'
    assert "default-src 'none'" in page
    assert not re.search(r'(src|href)=["\']', page)
    assert '@license' in page
    assert 'three.js authors' in (FILES / 'three.LICENSE').read_text(encoding='utf-8')


def test_the_bundle_is_the_one_that_the_lock_file_makes() -> None:
    """`config/task.sh page` bundles it again and compares it with the same sum."""
    recorded, path = (ROOT / 'config' / 'page' / 'three.sha256').read_text(encoding='utf-8').split()
    assert hashlib.sha256((ROOT / path).read_bytes()).hexdigest() == recorded
    lock = json.loads((ROOT / 'config' / 'page' / 'package-lock.json').read_text(encoding='utf-8'))
    packages = {name: package for name, package in lock['packages'].items() if name}
    assert all(package['integrity'].startswith('sha512-') for package in packages.values())
    release = packages['node_modules/three']['version'].split('.')[1]
    assert f'"{release}"' in (FILES / 'three.js').read_text('utf-8')


def open_scene(page: Any, path: Path, scene: Scene) -> None:
    write_and_open(page, path, build_page(scene))
    page.wait_for_selector('body[data-ready]')


def test_chromium_draws_the_page(scene: Scene, tmp_path: Path, page: Any) -> None:
    open_scene(page, tmp_path / 'page.html', scene)
    assert page.title() == scene.title
    before = page.evaluate('mocapPage.pictures()')
    deadline = time.monotonic() + TIMEOUT_S
    # It plays at once. Playwright's own wait needs eval, which the page forbids
    while page.evaluate('mocapPage.pictures()') < before + 3:
        assert time.monotonic() < deadline
        page.wait_for_timeout(50)
    first, unsure, last = (page.evaluate(f'mocapPage.showTime({time})') for time in scene.times[[0, 4, -1]])
    picture = page.screenshot(path=tmp_path / 'page.png')
    image = page.locator('#image-view').screenshot()
    curves = page.locator('#curves-view').screenshot()
    page.set_viewport_size(TELEPHONE)
    fits = page.evaluate('document.documentElement.scrollWidth <= innerWidth')
    boxes = [page.locator(place).bounding_box() for place in ('#space', '#image', '#curves', 'footer')]
    assert first['frame'] == 0
    assert [person['id'] for person in first['people']] == ['anna']
    assert (first['jointsDrawn'], first['bonesDrawn'], first['cloudsDrawn']) == (15, 14, 15)
    assert (unsure['jointsDrawn'], unsure['cloudsDrawn']) == (15, 0)
    assert last['frame'] == len(scene.stamps_ns) - 1
    assert [person['id'] for person in last['people']] == ['anna', '<b>en']
    assert first['rows'] == ['residual, px', 'cadence, Hz', 'motion', 'swaps undone', 'not detected', 'marks']
    assert min(first['heights'][0]) == pytest.approx(0, abs=0.1)  # the feet are on the floor
    assert np.abs(np.array(last['people'][1]['joints']) - scene.people[1].joints[-1]).max() < 0.001
    assert count_colours(picture) > 100
    assert count_colours(image) > 10
    assert count_colours(curves) > 10
    assert fits
    assert all(box['width'] > 300 and box['height'] > 20 for box in boxes)


def test_the_view_jumps_skipped_frames_do_not_flicker_and_names_stand_apart(tmp_path: Path, page: Any) -> None:
    """Six people close together, who walk 6 m aside at 1 s and are missing in every fourth frame."""
    frames = [frame for frame in range(60) if frame % 4]
    people = [make_scene_person(f'walker_{i}', frames, (0.1 * i, 0, 4 + 0.1 * i)) for i in range(6)]
    for person in people:
        person.joints[np.array(frames) >= 30, :, 0] += 6
    crowd = replace(make_scene(60), people=tuple(people), keypoints=(), marks=())
    open_scene(page, tmp_path / 'page.html', crowd)
    shown = [page.evaluate(f'mocapPage.showTime({time})') for time in (0.1, 1.9, crowd.times[8])]
    page.evaluate("document.getElementById('time').value = 5")
    page.locator('#time').dispatch_event('input')
    page.wait_for_timeout(200)
    target = page.evaluate('mocapPage.target()')
    labels = page.locator('#names span:visible')
    boxes = [labels.nth(i).bounding_box() for i in range(labels.count())]
    assert shown[1]['target'][0] - shown[0]['target'][0] == pytest.approx(6, abs=0.3)
    assert target == pytest.approx(shown[0]['target'], abs=0.3)  # it is back at once
    assert shown[2]['jointsDrawn'] == 6 * 15  # in a frame that was skipped
    assert len(boxes) == 6
    for i, box in enumerate(boxes):
        for other in boxes[:i]:
            apart_x = abs(box['x'] - other['x']) >= min(box['width'], other['width']) - 6
            assert apart_x or abs(box['y'] - other['y']) >= 12


def test_what_is_not_known_has_no_row_and_people_are_upright(scene: Scene, tmp_path: Path, page: Any) -> None:
    turn = Rotation.from_euler('xz', [-30, 5], degrees=True).as_matrix()
    anna, nan = scene.people[0], np.float32(np.nan)
    joints = (anna.joints @ turn.T).astype(np.float32)
    joints[:, 4] = nan
    unknown = {
        'cadence': anna.cadence * nan,
        'joint_std': anna.joint_std * nan,
        'motion': np.zeros_like(anna.motion),
    }
    plain = replace(anna, joints=joints, **unknown)
    camera, vertical = replace(scene.intrinsics, is_focal_known=False), turn @ [0.0, -1.0, 0.0]
    tilted = replace(scene, people=(plain,), keypoints=(), marks=(), vertical=vertical, intrinsics=camera)
    open_scene(page, tmp_path / 'page.html', tilted)
    shown = page.evaluate('mocapPage.showTime(0)')
    assert not page.is_visible('#clouds')
    assert 'nominal focal length' in page.inner_text('#image-caption')
    assert shown['rows'] == ['residual, px', 'not detected']
    assert (shown['jointsDrawn'], shown['bonesDrawn']) == (14, 13)
    (heights,) = shown['heights']
    expected = anna.joints[0, :, 1].max() - anna.joints[0, :, 1]
    known = np.arange(15) != 4
    assert np.array(heights)[known] == pytest.approx(expected[known], abs=0.1)


def test_a_page_that_was_cut_off_says_so(scene: Scene, tmp_path: Path, page: Any) -> None:
    page_text = build_page(scene)
    data = read_element(page_text, 'data')
    write_and_open(page, tmp_path / 'page.html', page_text.replace(data, data[: len(data) // 2]))
    page.wait_for_selector('#fault:not([hidden])')
    assert 'cannot be shown' in page.inner_text('#fault')


PEOPLE = 3
UP = np.array([0.0, -1.0, 0.0])
START_NS = 10**18


def publish(scene: LiveScene, frame: int) -> None:
    people = make_scene_person('', range(PEOPLE), (0.0, 0.0, 5.0))
    people.joints[:] += np.arange(PEOPLE)[:, None, None] * [0.8, 0, 0] + [0.001 * frame, 0, 0]
    ids = [f'walker {i}' for i in range(PEOPLE)]
    keypoints = [(CMU15, project_joints(people)[0].astype(float))]
    scene.publish(START_NS + frame * STEP_NS, ids, people, keypoints, (640, 480), UP, CMU15)


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer(LiveScene('Live'), 0) as server:
        yield server


def ask(server: PageServer, path: str, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(urlsplit(server.address).netloc, timeout=30)
    connection.request('GET', path, headers=headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


@pytest.mark.parametrize(
    ('path', 'headers', 'status'),
    [
        ('/', {}, 200),
        ('/', {'Host': 'evil.example'}, 403),
        ('/frame?after=0', {'Origin': 'http://evil.example'}, 403),
        ('/frame?after=0', {'Origin': 'null'}, 403),
        ('/frame?after=x', {}, 404),
        ('/../setup.py', {}, 404),
    ],
)
def test_only_own_pages_get_an_answer(server: PageServer, path: str, headers: dict[str, str], status: int) -> None:
    assert ask(server, path, **headers)[0] == status


def test_a_slow_browser_gets_the_newest_frame_and_leaves_the_others_out(server: PageServer) -> None:
    assert not server.scene.is_viewed
    for frame in range(3):
        publish(server.scene, frame)
    status, content = ask(server, '/frame?after=1', Origin=server.address.rstrip('/'))
    frame = json.loads(content)
    assert (status, frame['number'], frame['ids']) == (200, 3, ['walker 0', 'walker 1', 'walker 2'])
    joints = np.array(frame['people']['joints']).reshape(PEOPLE, 15, 3) / 1000
    expected = make_scene_person('', range(PEOPLE), (0.002, 0.0, 5.0)).joints
    expected[:] += np.arange(PEOPLE)[:, None, None] * [0.8, 0, 0]
    assert joints == pytest.approx(expected, abs=0.001)
    assert server.scene.is_viewed


def test_the_age_of_skeletons_is_told_and_those_that_nobody_viewed_are_left_out(
    server: PageServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_page, 'WAIT_S', 0.01)

    def ask_for_frame() -> tuple[int, str | None]:
        connection = http.client.HTTPConnection(urlsplit(server.address).netloc, timeout=30)
        connection.request('GET', '/frame?after=0')
        with closing(connection), connection.getresponse() as answer:
            return answer.status, answer.headers['Age']

    assert ask_for_frame() == (204, None)
    publish(server.scene, 0)
    monkeypatch.setattr(server.scene, '_arrival_s', time.monotonic() - 12)
    assert ask_for_frame() == (200, '12')
    server.scene.leave_out()
    assert ask_for_frame() == (204, '0')


def test_an_image_without_people_is_a_frame_without_people() -> None:
    scene, nobody = LiveScene('Live'), make_nobody(CMU15, INTRINSICS)
    scene.publish(START_NS, [], nobody, [], (640, 480), UP, CMU15)
    frame = json.loads(scene.wait(0))
    assert (frame['ids'], set(map(str, frame['people'].values()))) == ([], {'[]'})


def test_a_port_that_is_taken_is_named() -> None:
    with socket.socket() as other:
        other.bind(('127.0.0.1', 0))
        port = other.getsockname()[1]
        with pytest.raises(MocapError, match=f'--port {port}: .*choose another'):
            PageServer(LiveScene('Live'), port)


def wait_for_clock(page: Any, text: str) -> None:
    """Wait for a text of the clock, but for the rate and the delay after it."""
    wait_for(page, lambda page: re.sub(r', \d+ (Hz|ms)', '', page.inner_text('#clock')) == text)


def wait_for(page: Any, is_met: Callable[[Any], object]) -> None:
    for _ in range(400):
        if is_met(page):
            return
        page.wait_for_timeout(50)
    raise AssertionError('the page does not get there')


def test_chromium_draws_the_newest_frame_and_can_pause(server: PageServer, page: Any) -> None:
    page.context.set_offline(False)
    publish(server.scene, 0)
    page.goto(server.address)
    page.wait_for_selector('body[data-ready]')
    # The page was made before the skeleton was known, so that it loads once more.
    wait_for(page, lambda page: page.evaluate('mocapPage.scene.frameCount') == 1)
    for frame in range(1, 91):
        publish(server.scene, frame)
        if frame % 30 == 0:
            wait_for_clock(page, f'{frame / 30:.2f} s, live')
    kept = page.evaluate('mocapPage.scene.frameCount')
    assert 4 <= kept <= 91
    assert page.locator('#names span:visible').all_inner_texts() == ['walker 0', 'walker 1', 'walker 2']
    shown = page.evaluate('mocapPage.showTime(1)')
    publish(server.scene, 91)
    wait_for(page, lambda page: page.evaluate('mocapPage.scene.frameCount') == kept + 1)
    assert shown['jointsDrawn'] == PEOPLE * 15
    assert 'live' not in page.inner_text('#clock')
    assert count_colours(page.locator('#image-view').screenshot()) > 5
    page.click('#play')
    wait_for_clock(page, '3.03 s, live')
    assert min(page.evaluate('mocapPage.delays()')) > 0


def wait_for_silence(page: Any, pattern: str) -> None:
    """Wait until the page says this of missing skeletons and is grey, or says nothing and has its colours."""
    state = 'body.silent' if pattern else 'body:not(.silent)'
    wait_for(page, lambda page: re.fullmatch(pattern, page.inner_text(f'{state} #silence')))


def test_chromium_says_that_no_skeletons_come(page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_page, 'WAIT_S', 0.05)
    page.context.set_offline(False)
    with PageServer(LiveScene('Live', '/robot/skeletons'), 0) as server:
        page.goto(server.address)
        wait_for_silence(page, 'waiting for /robot/skeletons')
        for frame in range(2):  # after the first one the page loads once more
            publish(server.scene, 30 * frame)
            wait_for_silence(page, '')
            wait_for_clock(page, f'{frame:.2f} s, live')
            monkeypatch.setattr(server.scene, '_arrival_s', time.monotonic() - 60)
            wait_for_silence(page, 'no skeletons for 6[0-9] s')
            wait_for_clock(page, f'{frame:.2f} s')


MIRROR = list(CMU15.mirror)
LEGS = [CMU15.index(side + joint) for side in 'lr' for joint in ('hip', 'knee', 'ankle')]


def find_swaps(person: PoseSequence, *inputs: SceneKeypoints) -> np.ndarray:
    frames = np.array(person.stamps_ns) // STEP_NS
    return scenes.find_undone_swaps(person, frames, SidedPoints.find(inputs))


@pytest.mark.parametrize('joints', [list(range(15)), LEGS], ids=['whole body', 'legs'])
def test_an_undone_swap_is_found_in_its_frames_only(joints: list[int]) -> None:
    person = make_scene_person('anna', range(100), (0.0, 0.0, 4.0))
    keypoints = make_keypoints([person])
    noise = np.random.default_rng(0).normal(0, 4, keypoints.points.shape)  # px; a person of 260 px
    points = keypoints.points + noise.astype(np.float32)
    swapped = points.copy()
    swapped[4:6, joints] = points[4:6, [MIRROR[joint] for joint in joints]]
    assert not find_swaps(person, replace(keypoints, points=points)).any()
    assert np.flatnonzero(find_swaps(person, replace(keypoints, points=swapped))).tolist() == [4, 5]
    assert not find_swaps(person).any(), 'without detections'
    assert not find_swaps(person, replace(keypoints, frames=keypoints.frames + 100, points=swapped)).any()


def test_a_swap_of_another_person_is_not_taken_for_the_persons() -> None:
    anna, ben = (make_scene_person(name, range(10), (x, 0.0, 4.0)) for name, x in (('anna', -0.7), ('ben', 0.7)))
    own, other = make_keypoints([anna]), make_keypoints([ben])
    other = replace(other, points=other.points[:, MIRROR])
    assert not find_swaps(anna, other, own).any()
    assert find_swaps(ben, own, other).all()


def test_the_space_holds_the_people() -> None:
    corners = scenes.image_corners((640, 480), INTRINSICS)
    assert INTRINSICS.project(corners) == pytest.approx(np.array([[0, 0], [640, 0], [640, 480], [0, 480]]))
    scene = make_scene()
    assert scene.centre == pytest.approx([0, 0.1, 4.5], abs=0.5)
    assert 1.5 < scene.extent < 3
    assert scene.floor_y == pytest.approx(0.95, abs=0.15)
    assert replace(scene, camera_height=1.3).floor_y == 1.3
    nameless = replace(scene.people[1], joints=np.full_like(scene.people[1].joints, np.nan))
    alone, with_unknown = (replace(scene, people=(scene.people[0], *more)) for more in ((), (nameless,)))
    assert (with_unknown.extent, with_unknown.floor_y) == (alone.extent, alone.floor_y)
    empty = replace(scene, people=())
    assert np.isfinite([*empty.centre, empty.extent, empty.floor_y]).all()


def test_the_floor_is_level_where_the_camera_is_not() -> None:
    """A camera that looks down by 30 degrees: the floor is where a level camera would have it."""
    scene = make_scene()
    turn = Rotation.from_euler('x', -30, degrees=True).as_matrix()
    seen = [replace(p, joints=(p.joints @ turn.T).astype(np.float32)) for p in scene.people]
    tilted = replace(scene, people=tuple(seen), vertical=turn @ [0.0, -1.0, 0.0])
    assert tilted.floor_y == pytest.approx(scene.floor_y, abs=1e-4)
    assert tilted.to_plot_data().to_level @ turn == pytest.approx(np.eye(3), abs=1e-6), 'pictures are level, too'
    assert replace(tilted, vertical=np.full(3, np.nan)).floor_y != pytest.approx(scene.floor_y, abs=0.5)


def test_a_picture_shows_the_person_seen_most_where_there_is_a_skeleton(monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(plots, 'save_figure', lambda figure, _: figures.append(figure))
    frames = range(101, 200, 3)
    anna, ben = make_scene_person('anna', range(20), (0, 0, 4)), make_scene_person('ben', frames, (1, 0, 4))
    scene = replace(make_scene(300), people=(anna, ben), keypoints=(make_keypoints([ben]),))
    save_picture(scene, Path('picture.png'))
    words = [text.get_text() for text in figures[0].findobj(Text)]
    assert not {'no skeleton', 'not detected'} & {*words}
    shown = [word for word in words if word.endswith(' s')]
    assert len(shown) == POSES
    assert (shown[0], shown[-1]) == tuple(f'{scene.times[frame]:.2f} s' for frame in (frames[0], frames[-1]))
    predicted = replace(ben, predicted=scene.find_frames(ben) == frames[3])
    points = replace(scene, people=(predicted,), keypoints=(make_keypoints([anna, ben]),)).to_plot_data().keypoints
    assert points is not None
    is_shown = [int(frame) for frame in np.flatnonzero(points[..., 2].any(axis=1))]
    assert is_shown == [frame for frame in frames if frame != frames[3]], 'none of another person'
    nameless = replace(ben, joints=np.full_like(ben.joints, np.nan))
    with pytest.raises(InputError, match=scene.title):
        save_picture(replace(scene, people=(anna, nameless)), Path('picture.png'))


FRAMES = 30


@pytest.fixture
def data() -> plots.PlotData:
    poses, times = make_swinging_body(FRAMES)
    truth = poses + [0.3, 0.1, 4.0]
    return plots.PlotData(
        times=times,
        keypoints=np.concatenate([truth[..., :2] * 100, np.ones((FRAMES, 15, 1))], axis=-1),
        keypoint_skeleton=CMU15,
        joints=truth,
        seen=np.ones((FRAMES, 15), bool),
        skeleton=CMU15,
        truth=truth,
    )


def read_errors_mm(data: plots.PlotData) -> np.ndarray:
    figure = plots.draw_poses_figure(data, [0, 10], 'title', ['a', 'b'])
    (line, *_) = figure.axes[-2].lines
    return np.asarray(line.get_ydata())


def test_the_error_is_that_of_the_centred_joints(data: plots.PlotData) -> None:
    assert read_errors_mm(replace(data, joints=data.joints + [0.5, 0, 1])) == pytest.approx(0, abs=1e-9)
    joints = data.joints.copy()
    joints[3, 0] += [0.15, 0, 0]  # the other 14 joints move by -10 mm with the centre
    errors = read_errors_mm(replace(data, joints=joints))
    assert errors[3] == pytest.approx((140 + 14 * 10) / 15)
    assert np.delete(errors, 3) == pytest.approx(0, abs=1e-9)


IMAGES = 40
SIZE = (480, 640, 3)
# The grey value of an image by a canvas pixel near its corner, in which nothing is drawn
READ_CORNER = """(() => {
  const canvas = document.getElementById('image-view'), [w, h] = mocapPage.scene.camera.imageSize;
  const scale = Math.min(canvas.width / w, canvas.height / h);
  const x = (canvas.width - w * scale) / 2 + 8, y = (canvas.height - h * scale) / 2 + 8;
  return canvas.getContext('2d').getImageData(x, y, 1, 1).data[0];
})()"""


def make_images(scene: Scene) -> list[StampedImage]:
    """Return an image for each frame, whose grey value is five times the frame."""
    return [StampedImage(s, np.full(SIZE, 5 * i, np.uint8)) for i, s in enumerate(scene.stamps_ns)]


def test_the_page_shows_the_image_of_the_frame_behind_its_points(tmp_path: Path, page: Any) -> None:
    scene = make_scene(IMAGES)
    images = make_images(scene)
    whole = sum(map(len, reduce_images(scene, images).jpegs))
    for step, max_bytes in ((1, whole), (4, whole // 3)):
        reduced = reduce_images(scene, images, max_bytes)
        assert (reduced.step, sum(map(len, reduced.jpegs)) <= max_bytes) == (step, True)
        path = tmp_path / f'{step}.html'
        write_and_open(page, path, build_page(replace(scene, images=reduced)))
        page.wait_for_selector('body[data-ready]')
        for frame in (0, 21, 39, 6):
            page.evaluate(f'mocapPage.showTime({scene.times[frame]})')
            shown = frame // step * step
            for _ in range(100):
                if page.evaluate('mocapPage.imageFrame()') == shown:
                    break
                page.wait_for_timeout(50)
            assert page.evaluate('mocapPage.imageFrame()') == shown
            assert page.evaluate(READ_CORNER) == pytest.approx(5 * shown, abs=3)


def test_an_image_belongs_to_the_nearest_frame() -> None:
    scene = make_scene(IMAGES)
    far = round((MAX_OFFSET_S + 0.01) * NS_PER_S)
    stamps = [scene.stamps_ns[3] + 10_000_000, scene.stamps_ns[-1] + far, scene.stamps_ns[0] - far]
    assert [find_frame(scene, stamp) for stamp in stamps] == [3, -1, -1]


def test_a_film_and_a_picture_show_points_in_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = make_scene(IMAGES)
    points = np.concatenate([project_joints(scene.people[0]), np.ones((IMAGES, 15, 1), np.float32)], axis=-1)
    save_sequence(tmp_path / 'in.npz', KeypointSequence(points, CMU15.joints, scene.times, (640, 480)))
    times = [i / 30 for i in range(IMAGES)]
    video = write_video(tmp_path / 'in.mkv', [image for _, image in make_images(scene)], times)
    arguments = ['view', str(tmp_path / 'in.npz'), '--video', str(video), *QUICK_OPTIONS, '-o']
    for name in ('film.mp4', 'picture.png'):
        assert main([*arguments, str(tmp_path / name)]) == 0
    with VideoReader(tmp_path / 'film.mp4') as reader:
        film = list(reader)
    assert [round(30 * time_s) for _, time_s in film] == [*range(IMAGES)]
    stamps = np.array(scene.times) + 9.0
    save_sequence(tmp_path / 'late.npz', KeypointSequence(points, CMU15.joints, stamps, (640, 480)))
    late = ['view', str(tmp_path / 'late.npz'), '--video', str(video), *QUICK_OPTIONS]
    assert main([*late, '-o', str(tmp_path / 'late.html')]) == 0
    assert 'in.mkv: no image is at the time of a frame' in capsys.readouterr().err
    for frame in (0, 20, 39):
        image = film[frame].image.astype(int)
        assert image[:20, :20].mean() == pytest.approx(5 * frame, abs=6)
        drawn = np.ptp(image, axis=-1) > 60  # blue and red bones
        x, y = np.nanmean(points[frame, :, :2], axis=0)
        assert drawn.sum() > 300
        assert np.argwhere(drawn).mean(axis=0) == pytest.approx([y, x], abs=40)


def test_a_film_without_images_is_white_and_one_without_pyav_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene(5)
    (_, first), *rest = Overlay(scene).draw_film(())
    assert len(rest) == 4
    assert (first[0, 0] == 255).all()
    assert (first < 100).any()
    short = replace(make_recording().sequence(), truth=None)
    short = replace(short, keypoints=short.keypoints[:12], timestamps=short.timestamps[:12])
    save_sequence(tmp_path / 'short.npz', short)
    monkeypatch.setitem(sys.modules, 'av', None)
    assert main(['view', str(tmp_path / 'short.npz'), *QUICK_OPTIONS, '-o', str(tmp_path / 'film.mp4')]) == 1
    assert "film.mp4: a film needs PyAV: pip install -e '.[video]'" in capsys.readouterr().err


def test_the_images_of_a_bag_are_those_of_its_camera(tmp_path: Path) -> None:
    with Recorder(tmp_path / 'bag', RecorderConfig()) as recorder:
        for frame in range(4):
            for topic, grey in (('/depth/image', 9), ('/image', 40 + frame)):
                message = create_blank_message(IMAGE)
                fields = encode_pixels(np.full((6, 8, 3), grey, np.uint8), 'rgb8')
                fields |= {'encoding': 'none'} if frame == 2 else {}
                for name, value in fields.items():
                    setattr(message, name, np.frombuffer(value, np.uint8) if name == 'data' else value)
                message.header.stamp.sec = frame + 1
                recorder.write(topic, IMAGE, encode(message, IMAGE), frame, frame)
    notes: list[str] = []
    images = [*read_images(tmp_path / 'bag', NodeConfig(), None, notes)]
    assert [(i.stamp_ns, int(i.image[0, 0, 0])) for i in images] == [(s * NS_PER_S, 39 + s) for s in (1, 2, 4)]
    (note,) = notes
    assert "/image: 1 images left out; encoding: 'none'" in note
