# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The page of a live scene: what its server answers, and what Chromium draws of the frames."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from mocap_ros.errors import MocapError
from mocap_ros.skeleton import CMU15
from mocap_ros.viewing.live_page import LiveScene, PageServer, make_person
from tests.support.browser import count_colours
from tests.support.scenes import INTRINSICS, STEP_NS, make_scene_person

PEOPLE = 3
UP = np.array([0.0, -1.0, 0.0])
START_NS = 10**18


def publish(scene: LiveScene, frame: int) -> None:
    """Publish three people side by side, the first with its keypoints."""
    people = make_scene_person('', range(PEOPLE), (0.0, 0.0, 5.0))
    people.joints[:] += np.arange(PEOPLE)[:, None, None] * [0.8, 0, 0] + [0.001 * frame, 0, 0]
    ids = [f'walker {i}' for i in range(PEOPLE)]
    keypoints = [(CMU15, people.image[0].astype(float))]
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
def test_only_pages_of_the_server_get_an_answer(
    server: PageServer, path: str, headers: dict[str, str], status: int
) -> None:
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


def test_an_image_without_people_is_a_frame_without_people() -> None:
    scene, nobody = LiveScene('Live'), make_person('', len(CMU15.joints), INTRINSICS)
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
    wait_for(page, lambda page: page.inner_text('#clock') == text)


def wait_for(page: Any, is_met: Callable[[Any], bool]) -> None:
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
