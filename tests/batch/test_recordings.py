# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The recordings of a corpus, in folders, patterns and lists, on the local and on another file system."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from mocap_ros.errors import InputError

fsspec = pytest.importorskip('fsspec')
pytest.importorskip('upath')

from mocap_ros.batch.recordings import Work, find_recordings  # noqa: E402

FILES = {
    'day1/bag_a/metadata.yaml': b'a',
    'day1/bag_a/bag_a_0.mcap': b'aaaa',
    'day1/bag_a/bag_a_1.mcap': b'aa',
    'day2/b.mcap': b'bbbbbbbbbbbb',
    'day2/c.db3': b'c',
    'day2/old.bag': b'cc',
    'day2/walk.npz': b'walk',
    'GX01.MP4': b'film',
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
    lines: list[str] = []
    find_recordings(root, Work.REPLAY, (), lines.append)
    assert [line.split(' and ')[0] for line in lines] == [f'{root}: 2 recordings are no bags']
    found = {r.name: r for r in find_recordings(root, Work.REPLAY)}
    assert len(found['day1/bag_a'].files) == 3
    assert found['day1/bag_a'].size_bytes == 7
    assert found['day2/c'].url == f'{root}/day2/c.db3'
    assert names(root, Work.RECONSTRUCT) == ['day2/b', 'day1/bag_a', 'GX01', 'day2/walk', 'day2/old', 'day2/c']


def test_patterns_lists_and_single_recordings(root: str, tmp_path: Path) -> None:
    assert names(f'{root}/day2/*.db3') == ['c']
    assert names(f'{root}/*/b*') == ['day2/b', 'day1/bag_a']
    assert names(f'{root}/day1/bag_a') == ['bag_a']
    assert names(f'{root}/day2/b.mcap') == ['b']
    listed = tmp_path / 'list.txt'
    listed.write_text(f'# comment\n{root}/day2/c.db3\n\n{root}/day1/bag_a\n')
    assert names(str(listed)) == ['day1/bag_a', 'day2/c']


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


@pytest.mark.parametrize('other', ['day2/b.db3', 'day2/b/c.mcap'])
def test_recordings_whose_results_would_overwrite_each_other_are_refused(root: str, other: str) -> None:
    fs, path = fsspec.url_to_fs(root)
    fs.makedirs(f'{path}/day2/b', exist_ok=True)
    fs.pipe_file(f'{path}/{other}', b'b')
    with pytest.raises(InputError, match=r'the results of day2/b and day2/b(/c)? '):
        find_recordings(root, Work.REPLAY)
