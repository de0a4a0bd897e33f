# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results are written whole or not at all, and remote recordings are read in place or through a bounded copy."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

import pytest

from mocap_ros.bags.reader import Bag
from mocap_ros.errors import DiskFull, InputError, MocapError, RecordingError
from mocap_ros.formats.text_files import replace_output
from mocap_ros.runtime.save_results import SUFFIXES
from tests.support.bag_corpus import read_outputs, write_demo_bag

fsspec = pytest.importorskip('fsspec')
pytest.importorskip('upath')

from mocap_ros.batch import storage  # noqa: E402
from mocap_ros.batch.recordings import Work, find_recordings  # noqa: E402

MEMORY = 'memory:///storage'


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_demo_bag(tmp_path / 'corpus' / 'bag', 20)


@pytest.fixture
def remote(bag: Path) -> Iterator[str]:
    """The URL of a remote folder with the bag."""
    fs, path = fsspec.url_to_fs(MEMORY)
    fs.put(str(bag), f'{path}/corpus/bag', recursive=True)
    yield f'{MEMORY}/corpus'
    fs.rm(path, recursive=True)


def test_a_remote_bag_in_mcap_is_read_in_place(bag: Path, remote: str, tmp_path: Path) -> None:
    (found,) = find_recordings(remote, Work.REPLAY)
    scratch = tmp_path / 'scratch'
    scratch.mkdir()
    path = storage.provide_locally(found, scratch, copy_limit_bytes=0)
    assert str(path).startswith('memory://')
    assert read_outputs(path) == read_outputs(bag)
    assert not list(scratch.iterdir())


def test_another_remote_recording_is_copied_up_to_a_limit(remote: str, tmp_path: Path) -> None:
    fs, path = fsspec.url_to_fs(remote)
    fs.pipe_file(f'{path}/old.bag', bytes(1000))
    (old,) = find_recordings(f'{remote}/old.bag', Work.REPLAY)
    assert storage.provide_locally(old, tmp_path, 1000).read_bytes() == bytes(1000)
    with pytest.raises(InputError, match=rf'^{remote}/old.bag: must be copied .* --copy-limit'):
        storage.provide_locally(old, tmp_path, 999)


def test_a_copy_that_does_not_fit_on_the_disk_is_not_begun(
    remote: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fs, path = fsspec.url_to_fs(remote)
    fs.pipe_file(f'{path}/old.bag', bytes(1000))
    (old,) = find_recordings(f'{remote}/old.bag', Work.REPLAY)
    monkeypatch.setattr(storage, 'FREE_BYTES', 1 << 60)
    with pytest.raises(DiskFull, match='no space for a copy'):
        storage.provide_locally(old, tmp_path, 10_000)
    assert not (tmp_path / 'old.bag').exists()


@pytest.mark.parametrize('out', ['local', MEMORY])
def test_a_bag_is_published_whole_and_replaces_what_was_there(bag: Path, tmp_path: Path, out: str) -> None:
    url = f'{tmp_path if out == "local" else out}/results/day/bag'
    other = write_demo_bag(tmp_path / 'other', 5)
    storage.publish(other, url)
    expected = read_outputs(bag)
    storage.publish(bag, url)
    assert set(storage.list_sizes(url)) == {'/bag_0.mcap', '/metadata.yaml'}
    fs, path = fsspec.url_to_fs(url)
    fs.get(path, str(tmp_path / 'read'), recursive=True)
    assert read_outputs(tmp_path / 'read') == expected
    storage.remove_result(url)
    assert storage.list_sizes(url) == {}


def test_a_remote_bag_is_no_bag_before_it_is_whole(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The description of a bag is sent last, so a worker that dies before leaves nothing that looks like a bag."""
    fs, path = fsspec.url_to_fs(f'{MEMORY}/out/bag')
    put_file, sent = type(fs).put_file, []

    def fail_at_second(own: object, source: str, target: str, **options: object) -> None:
        sent.append(target)
        if len(sent) == 2:
            raise OSError(errno.EIO, 'the network failed')
        put_file(own, source, target, **options)

    monkeypatch.setattr(type(fs), 'put_file', fail_at_second)
    with pytest.raises(OSError, match='the network failed'):
        storage.publish(bag, f'{MEMORY}/out/bag')
    assert not fs.exists(f'{path}/metadata.yaml')
    assert sent[-1].endswith('metadata.yaml')


@pytest.mark.parametrize('suffix', SUFFIXES)
def test_a_result_of_every_format_is_replaced(tmp_path: Path, suffix: str) -> None:
    place = tmp_path / f'walk{suffix}'
    for content in ('first', 'second'):
        (tmp_path / 'new').write_text(content)
        storage.publish(tmp_path / 'new', str(place))
    assert place.read_text() == 'second'


def test_foreign_files_are_never_removed(bag: Path, tmp_path: Path) -> None:
    place = tmp_path / 'results' / 'bag'
    place.mkdir(parents=True)
    (place / 'thesis.tex').write_text('mine')
    with pytest.raises(RecordingError, match=r'not replaced, because no run writes the file .*thesis.tex'):
        storage.publish(bag, str(place))
    assert (place / 'thesis.tex').read_text() == 'mine'
    with Bag(bag) as whole:
        assert whole.count(['/keypoints']) == 20


@pytest.mark.parametrize('content', [b'', b'{"a": 1', b'[1]', b'\xff'])
def test_a_damaged_record_counts_as_none(tmp_path: Path, content: bytes) -> None:
    (tmp_path / 'record.json').write_bytes(content)
    assert storage.read_json_file(str(tmp_path / 'record.json')) == {}
    assert storage.read_json_file(str(tmp_path / 'missing.json')) == {}


def test_a_full_disk_is_told_from_other_errors() -> None:
    assert storage.is_disk_full(OSError(errno.ENOSPC, ''))
    assert storage.is_disk_full(DiskFull('x'))
    assert not storage.is_disk_full(OSError(errno.EIO, ''))
    assert not storage.is_disk_full(RecordingError('x'))


def test_a_full_disk_is_known_behind_the_error_of_a_file_that_could_not_be_written(tmp_path: Path) -> None:
    with pytest.raises(MocapError) as told, replace_output(tmp_path / 'x.npz'):
        raise OSError(errno.ENOSPC, 'No space left on device')
    assert storage.is_disk_full(told.value)
    with pytest.raises(MocapError) as told, replace_output(tmp_path / 'x.npz'):
        raise OSError(errno.EIO, 'Input/output error')
    assert not storage.is_disk_full(told.value)
