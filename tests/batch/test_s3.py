# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A batch run on S3, against moto's server on this machine: `pip install -e '.[s3]' 'moto[s3,server]>=5,<6'`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mocap_ros.cli.main import main
from tests.support.bag_corpus import FAST_ARGUMENTS, read_outputs, write_corpus
from tests.support.pipeline_inputs import FAST_CONFIG

distributed = pytest.importorskip('distributed')
pytest.importorskip('s3fs')
moto = pytest.importorskip('moto.server')
pytest.importorskip('pyarrow')

import fsspec  # noqa: E402

from mocap_ros.batch.cluster import run_jobs  # noqa: E402
from mocap_ros.batch.job import Job, Outcome, Settings, provide_locally  # noqa: E402
from mocap_ros.batch.recordings import Work, compute_content_key, find_recordings  # noqa: E402


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The file system with an empty bucket `fleet`."""
    server = moto.ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name in ('AWS_ACCESS_KEY_ID', 'AWS_SECRET_ACCESS_KEY'):
        monkeypatch.setenv(name, 'test')
    monkeypatch.setitem(fsspec.config.conf, 's3', {'endpoint_url': f'http://{host}:{port}', 'anon': False})
    fs = fsspec.filesystem('s3', skip_instance_cache=False)
    fs.mkdir('fleet')
    yield fs
    fs.rm('fleet', recursive=True)
    server.stop()
    fsspec.filesystem('s3').clear_instance_cache()


def run(client: Any, out: str) -> dict[str, str]:
    settings = Settings(Work.REPLAY, out, FAST_CONFIG).seal()
    outcomes: list[Outcome] = []
    jobs = [Job(recording, settings) for recording in find_recordings('s3://fleet/in', Work.REPLAY)]
    run_jobs(client, jobs, outcomes.append)
    return {o.job.recording.name: o.status.value for o in outcomes}


def test_bags_in_a_bucket_are_replayed_into_a_bucket(bucket: Any, tmp_path: Path) -> None:
    corpus = write_corpus(tmp_path / 'in', {'a': 20, 'day/b': 10})
    bucket.put(str(corpus), 'fleet/in', recursive=True)
    options = {'n_workers': 2, 'threads_per_worker': 1, 'processes': False, 'dashboard_address': ':0'}
    with distributed.LocalCluster(**options) as local, distributed.Client(local) as client:
        assert run(client, 's3://fleet/out') == {'a': 'done', 'day/b': 'done'}
        assert run(client, 's3://fleet/out') == {'a': 'done before', 'day/b': 'done before'}
        changed = next((tmp_path / 'in' / 'a').glob('*.mcap'))
        write_corpus(tmp_path / 'other', {'a': 21})
        bucket.put_file(str(next((tmp_path / 'other' / 'a').glob('*.mcap'))), f'fleet/in/a/{changed.name}')
        assert run(client, 's3://fleet/out') == {'a': 'done', 'day/b': 'done before'}
    bucket.get('fleet/out/results/day/b', str(tmp_path / 'b'), recursive=True)
    assert main(['replay', str(corpus / 'day' / 'b'), '-o', str(tmp_path / 'plain'), *FAST_ARGUMENTS]) == 0
    assert read_outputs(tmp_path / 'b') == read_outputs(tmp_path / 'plain')


def test_a_bag_in_mcap_is_read_by_ranges_and_known_by_the_checksum_of_the_store(
    bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    corpus = write_corpus(tmp_path / 'in', {'a': 20})
    bucket.put(str(corpus), 'fleet/in', recursive=True)
    (found,) = find_recordings('s3://fleet/in', Work.REPLAY)
    key = compute_content_key(found)
    with monkeypatch.context() as patched:
        patched.setattr(type(bucket), 'open', lambda *_, **__: pytest.fail('the file was read'))
        assert compute_content_key(found) == key
    path = provide_locally(found, tmp_path)
    assert str(path) == 's3://fleet/in/a'
    assert read_outputs(path) == read_outputs(corpus / 'a')
