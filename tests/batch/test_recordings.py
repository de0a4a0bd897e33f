# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The recordings of a corpus, in folders, patterns and lists, on the local and on another file system."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from mocap_ros.errors import InputError

fsspec = pytest.importorskip('fsspec')
pytest.importorskip('upath')

from mocap_ros.batch.recordings import Work, compute_content_key, find_recordings  # noqa: E402

FILES = {
    'day1/bag_a/metadata.yaml': b'a',
    'day1/bag_a/bag_a_0.mcap': b'aaaa',
    'day1/bag_a/bag_a_1.mcap': b'aa',
    'day2/b.mcap': b'bbbbbbbbbbbb',
    'day2/c.db3': b'c',
    'day2/old.bag': b'cc',
    'day2/walk.npz': b'walk',
    'day2/notes.md': b'not a recording',
}
BAGS = ['day2/b', 'day1/bag_a', 'day2/old', 'day2/c']  # largest first


@pytest.fixture(params=['local', 'memory'])
def root(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """The URL of a folder with recordings."""
    url = str(tmp_path / 'corpus') if request.param == 'local' else 'memory:///corpus'
    fs, path = fsspec.url_to_fs(url)
    for name, content in FILES.items():
        fs.makedirs(f'{path}/{name}'.rpartition('/')[0], exist_ok=True)
        fs.pipe_file(f'{path}/{name}', content)
    yield url
    fs.rm(path, recursive=True)


def names(source: str, work: Work = Work.REPLAY, *leave_out: str) -> list[str]:
    return [r.name for r in find_recordings(source, work, leave_out)]


def test_the_bags_of_a_folder_are_found_largest_first(root: str) -> None:
    assert names(root) == BAGS
    found = {r.name: r for r in find_recordings(root, Work.REPLAY)}
    assert len(found['day1/bag_a'].files) == 3
    assert found['day1/bag_a'].size_bytes == 7
    assert found['day2/c'].url == f'{root}/day2/c.db3'
    assert names(root, Work.RECONSTRUCT) == ['day2/b', 'day1/bag_a', 'day2/walk', 'day2/old', 'day2/c']


def test_what_is_not_replayed_is_said(root: str) -> None:
    lines: list[str] = []
    find_recordings(root, Work.REPLAY, (), lines.append)
    assert lines == [f'{root}: 1 recordings are no bags and are left out; --work reconstruct takes them']
    find_recordings(root, Work.RECONSTRUCT, (), lines.append)
    find_recordings(f'{root}/day1', Work.REPLAY, (), lines.append)
    assert len(lines) == 1


def test_a_folder_may_have_the_characters_of_a_pattern_in_its_name(tmp_path: Path) -> None:
    (tmp_path / 'corpus[2024]').mkdir()
    (tmp_path / 'corpus[2024]' / 'y.mcap').write_bytes(b'y')
    assert names(str(tmp_path / 'corpus[2024]')) == ['y']


def test_recordings_that_would_share_a_picture_are_refused(tmp_path: Path) -> None:
    for name in ('x.npz', 'x_distances.npz'):
        (tmp_path / name).write_bytes(b'x')
    assert len(names(str(tmp_path), Work.RECONSTRUCT)) == 2
    with pytest.raises(InputError, match='x and x_distances would share a picture'):
        names(str(tmp_path), Work.KEYFRAMES)


def test_the_suffix_of_a_video_may_have_capital_letters(tmp_path: Path) -> None:
    (tmp_path / 'GX01.MP4').write_bytes(b'video')
    assert names(str(tmp_path), Work.RECONSTRUCT) == ['GX01']


def test_patterns_lists_and_single_recordings(root: str, tmp_path: Path) -> None:
    assert names(f'{root}/day2/*.db3') == ['c']
    assert names(f'{root}/*/b*') == ['day2/b', 'day1/bag_a']
    assert names(f'{root}/day1/bag_a') == ['bag_a']
    assert names(f'{root}/day2/b.mcap') == ['b']
    listed = tmp_path / 'list.txt'
    listed.write_text(f'# comment\n{root}/day2/c.db3\n\n{root}/day1/bag_a\n')
    assert names(str(listed)) == ['day1/bag_a', 'day2/c']


def test_the_folder_of_the_results_is_not_searched(root: str) -> None:
    assert names(root, Work.REPLAY, f'{root}/day2', f'{root}/day1/bag') == ['day1/bag_a']


@pytest.mark.parametrize(
    ('source', 'reason'),
    [
        ('nothing/here', 'no such file, and no folder with files'),
        ('day2/notes.md', 'there is no bag'),
        ('day2/*.xyz', 'no such file'),
        ('list.txt', 'No such file or directory'),
    ],
)
def test_what_holds_no_recording_is_refused_in_one_line(root: str, source: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as raised:
        find_recordings(f'{root}/{source}', Work.REPLAY)
    assert str(raised.value).startswith(f'{root}/{source}')


@pytest.mark.parametrize('url', ['data:,hello', 'reference://'])
def test_a_file_system_without_files_is_refused_in_one_line(url: str) -> None:
    with pytest.raises(InputError, match=f'^{url}: '):
        find_recordings(url, Work.REPLAY)


def test_an_unknown_file_system_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r'^nowhere://x: .*nowhere'):
        find_recordings('nowhere://x', Work.REPLAY)


def test_two_recordings_of_one_name_are_refused(root: str) -> None:
    fs, path = fsspec.url_to_fs(root)
    fs.pipe_file(f'{path}/day2/b.db3', b'b')
    with pytest.raises(InputError, match='2 recordings would have results of the name day2/b'):
        find_recordings(root, Work.REPLAY)


def test_recordings_whose_results_would_lie_in_each_other_are_refused(root: str) -> None:
    """The result of the outer one would be replaced together with that of the inner one."""
    fs, path = fsspec.url_to_fs(root)
    fs.makedirs(f'{path}/day2/b')
    fs.pipe_file(f'{path}/day2/b/c.mcap', b'c')
    with pytest.raises(InputError, match='the result of day2/b/c would be inside that of day2/b'):
        find_recordings(root, Work.REPLAY)


def test_the_content_and_no_time_stamp_identifies_a_recording(root: str) -> None:
    (bag,) = find_recordings(f'{root}/day1', Work.REPLAY)
    key = compute_content_key(bag)
    fs, path = fsspec.url_to_fs(f'{root}/day1/bag_a/bag_a_1.mcap')
    fs.pipe_file(path, b'aa')
    if '://' not in root:
        os.utime(path, (0, 0))
    assert compute_content_key(bag) == key
    fs.pipe_file(path, b'ab')
    assert compute_content_key(bag) != key


def test_a_name_without_a_scheme_is_a_local_path_whatever_is_in_it(tmp_path: Path) -> None:
    bag = tmp_path / 'a::b' / 'c::d.mcap'
    bag.parent.mkdir()
    bag.write_bytes(b'bag')
    (found,) = find_recordings(str(tmp_path), Work.REPLAY)
    assert (found.name, found.url) == ('a::b/c::d', str(bag))
    assert names(str(bag.parent)) == names(str(bag)) == names(f'{bag.parent}/*.mcap') == ['c::d']
    assert len(compute_content_key(found)) == 64


def test_links_are_followed_and_what_is_reached_twice_is_taken_once(tmp_path: Path) -> None:
    corpus, elsewhere = tmp_path / 'corpus', tmp_path / 'elsewhere'
    for folder in (corpus / 'day1', elsewhere):
        folder.mkdir(parents=True)
    (corpus / 'day1' / 'a.mcap').write_bytes(b'aa')
    (elsewhere / 'b.mcap').write_bytes(b'b')
    (corpus / 'abroad').symlink_to(elsewhere)
    (corpus / 'again').symlink_to(elsewhere)
    (corpus / 'all').symlink_to(corpus)
    (corpus / 'day0').symlink_to(corpus / 'day1')
    (corpus / 'broken.mcap').symlink_to(tmp_path / 'nothing')
    (corpus / 'newest.mcap').symlink_to(corpus / 'day1' / 'a.mcap')
    assert names(str(corpus)) == ['day1/a', 'abroad/b']
    assert names(str(corpus / 'again')) == ['b']
    assert names(str(corpus / 'newest.mcap')) == ['newest']
