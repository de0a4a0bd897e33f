# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Batch runs: the recordings that are found, and the results of plain commands, whatever is killed or damaged."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mocap_ros.bags.journal import read_run
from mocap_ros.bags.reader import Bag, BagMessage
from mocap_ros.cli.main import main
from mocap_ros.errors import InputError, MocapError
from mocap_ros.formats.reading_options import ReadingOptions
from mocap_ros.formats.sequence_file import load_sequence, save_sequence
from tests.support.paths import ROOT
from tests.support.pipeline_inputs import FAST_CONFIG, FAST_VALUES, encode_demo_frames, write_keypoints_bag

distributed = pytest.importorskip('distributed')
fsspec = pytest.importorskip('fsspec')
pytest.importorskip('upath')
parquet = pytest.importorskip('pyarrow.parquet')

from mocap_ros.batch import run as batch_run  # noqa: E402
from mocap_ros.batch.job import Settings, provide_locally  # noqa: E402
from mocap_ros.batch.recordings import find_recordings  # noqa: E402
from mocap_ros.batch.recordings import open_path as path_of  # noqa: E402
from mocap_ros.batch.run import run_jobs  # noqa: E402
from mocap_ros.config import with_settings  # noqa: E402
from mocap_ros.runtime.replay import ReplayOptions  # noqa: E402

FRAMES = {'a': 40, 'sub/b': 25, 'c': 10}
FAST_ARGUMENTS = [word for name, value in FAST_VALUES.items() for word in ('--set', f'{name}={value}')]


def write_corpus(root: Path, frames: dict[str, int]) -> Path:
    """Write bags of some numbers of frames of the demo recording, by name, into a folder."""
    for name, count in frames.items():
        write_keypoints_bag(root / name, encode_demo_frames(count), start_ns=1_700_000_000_000_000_000)
    return root


def read_outputs(path: Path) -> list[BagMessage]:
    """Return the messages of a bag, without those that each file of a split bag repeats."""
    with Bag(path) as bag:
        repeated = ('/skeleton_definition', '/mocap_replay/journal')
        return list(bag.messages([t for t in bag.topics if t not in repeated]))


@pytest.fixture(scope='module')
def client() -> Iterator[Any]:
    """A client of a cluster in this process, with two workers."""
    options = {'n_workers': 2, 'threads_per_worker': 1, 'processes': False, 'dashboard_address': ':0'}
    with distributed.LocalCluster(**options) as local, distributed.Client(local) as connected:
        yield connected


@pytest.fixture(scope='module')
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_corpus(tmp_path_factory.mktemp('corpus'), FRAMES)


@pytest.fixture(scope='module')
def plain(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The messages that a plain replay of each bag gives."""
    out = tmp_path_factory.mktemp('plain')
    found = {}
    for name in FRAMES:
        folder = out / name.replace('/', '_')
        assert main(['replay', str(corpus / name), '-o', str(folder), *FAST_ARGUMENTS]) == 0
        found[name] = read_outputs(folder)
    return found


def make_settings(out: Path | str, work: str = 'replay', **values: Any) -> Settings:
    options = ReplayOptions(values.pop('config', FAST_CONFIG), changes=values.pop('changes', {}))
    return Settings(work, path_of(str(out)), options, **values)


def run(client: Any, corpus: Path | str, settings: Settings) -> dict[str, dict[str, Any]]:
    """Do the work on all recordings, and return what became of each (`status`) and its first row, by name."""
    recordings = find_recordings(str(corpus), print, only_bags=settings.work == 'replay')
    outcomes = list(run_jobs(client, recordings, settings, settings.compute_key()))
    assert len(outcomes) == len(recordings)
    return {o.rows[0]['bag']: {**o.rows[0], 'status': o.status} for o in outcomes}


def statuses(outcomes: dict[str, dict[str, Any]]) -> dict[str, str]:
    return {name: outcome['status'] for name, outcome in outcomes.items()}


@pytest.mark.slow
def test_the_command_gives_the_bags_of_plain_replays_and_goes_on_where_it_stopped(
    corpus: Path, plain: dict[str, Any], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """One of the bags is damaged: it is listed with a reason, and the others are done."""
    write_corpus(tmp_path / 'in', {'bad': 5})
    (bad,) = (tmp_path / 'in' / 'bad').glob('*.mcap')
    bad.write_bytes(bad.read_bytes()[:-20])
    listed = tmp_path / 'in' / 'list.txt'
    listed.write_text(f'{corpus}\n{bad.parent}\n')
    command = ['batch', str(listed), '-o', str(tmp_path / 'out'), '--workers', '1', *FAST_ARGUMENTS]
    assert main(command) == 1
    out, err = capfd.readouterr()
    assert '3 done, 1 failed' in out
    (line,) = [line for line in err.splitlines() if 'recordings; dashboard' not in line]
    assert line.startswith(f'mocap-ros: {bad.parent}: the recording was cut off')
    results = {p.parent.name: p.parent for p in (tmp_path / 'out' / 'results').rglob('metadata.yaml')}
    for name, messages in plain.items():
        assert read_outputs(results[Path(name).name]) == messages
    table = parquet.read_table(tmp_path / 'out' / 'table.parquet')
    assert (tmp_path / 'out' / 'summary.png').read_bytes().startswith(b'\x89PNG')
    assert not (tmp_path / 'out' / '.unfinished').exists()
    rows = {row['bag'].rpartition('/')[2]: row for row in table.to_pylist()}
    assert rows['bad']['error'] in line
    assert (rows['a']['person'], rows['a']['bag_frames'], rows['a']['error']) == ('person_1', 40, None)
    assert rows['a']['to_ns'] - rows['a']['from_ns'] == pytest.approx(37 / 30 * 1e9, abs=1e6)  # not tentative
    assert rows['a']['residual_px'] > 0
    assert rows['a']['bag_work_s'] > rows['c']['bag_work_s'] > 0
    assert main(command) == 1
    assert '3 done before, 1 failed' in capfd.readouterr().out
    assert parquet.read_table(tmp_path / 'out' / 'table.parquet').to_pylist() == table.to_pylist()


def test_only_what_changed_is_done_again(client: Any, tmp_path: Path) -> None:
    """What decides is the content of the recording, the settings and whether the result is there; no time."""
    corpus, out = write_corpus(tmp_path / 'in', {'a': 8, 'b': 8, 'c': 8, 'd': 8}), tmp_path / 'out'
    settings = make_settings(out)
    for status in ('done', 'done before'):
        assert set(statuses(run(client, corpus, settings)).values()) == {status}
    for path in corpus.rglob('*'):
        os.utime(path, (0, 0))
    (name,) = (corpus / 'b').glob('*.mcap')
    write_corpus(tmp_path / 'other', {'b': 9})
    name.write_bytes(next((tmp_path / 'other' / 'b').glob('*.mcap')).read_bytes())
    (out / 'results' / 'c' / 'metadata.yaml').unlink()
    (out / 'records' / 'replay' / 'd.json').write_text('{"content": ')
    (out / 'results' / 'c' / 'thesis.tex').write_text('mine')
    outcomes = run(client, corpus, settings)
    assert statuses(outcomes) == {'a': 'done before', 'b': 'done', 'c': 'done', 'd': 'done'}
    assert (out / 'results' / 'c' / 'thesis.tex').read_text() == 'mine'
    changed = make_settings(out, changes={'tracker.window': 1.5})
    assert set(statuses(run(client, corpus, changed)).values()) == {'done'}
    with Bag(out / 'results' / 'a') as bag:
        assert read_run(bag).parameters['tracker.window'] == 1.5


def test_remote_recordings_and_results(client: Any, corpus: Path, plain: dict[str, Any], tmp_path: Path) -> None:
    """The cluster is in this process, so its workers see the file system in the memory of this process."""
    fs, path = fsspec.url_to_fs('memory:///batch')
    fs.put(str(corpus), f'{path}/in', recursive=True)
    settings = make_settings('memory:///batch/out')
    for status in ('done', 'done before'):
        assert set(statuses(run(client, 'memory:///batch/in', settings)).values()) == {status}
    other = make_settings('memory:///batch/out', config=None)
    assert run(client, 'memory:///batch/in', other)['c']['status'] == 'done'
    run(client, 'memory:///batch/in', settings)
    fs.get(f'{path}/out/results', str(tmp_path / 'results'), recursive=True)
    for name, messages in plain.items():
        assert read_outputs(tmp_path / 'results' / name) == messages
    (mcap,) = (corpus / 'c').glob('*.mcap')
    fs.pipe_file(f'{path}/old.bag', mcap.read_bytes())
    (old,) = find_recordings('memory:///batch/old.bag', print, only_bags=True)
    assert provide_locally(old.path, tmp_path).read_bytes() == mcap.read_bytes()
    fs.rm(path, recursive=True)


@pytest.mark.parametrize('work', ['reconstruct', 'keyframes'])
def test_sequences_are_reconstructed_and_summarised(client: Any, tmp_path: Path, work: str) -> None:
    demo = load_sequence(ROOT / 'mocap_ros' / 'demo' / 'demo.npz')
    (tmp_path / 'in').mkdir()
    short = replace(demo, keypoints=demo.keypoints[:60], timestamps=demo.timestamps[:60], truth=None)
    save_sequence(tmp_path / 'in' / 'walk.npz', short)
    (tmp_path / 'in' / 'broken.npz').write_bytes(b'PK\x03\x04')
    config = with_settings(FAST_CONFIG, {'solver.max_iterations': 2})
    outcomes = run(client, tmp_path / 'in', make_settings(tmp_path / 'out', work, config=config))
    assert statuses(outcomes) == {'walk': 'done', 'broken': 'failed'}
    assert outcomes['broken']['error'].startswith(f'{tmp_path}/in/broken.npz: ')
    results = tmp_path / 'out' / 'results'
    if work == 'reconstruct':
        assert np.load(results / 'walk.npz')['joints3d'].shape == (60, 26, 3)
        assert outcomes['walk']['residual_px'] > 0
    else:
        assert 'keyframes:' in (results / 'walk.yaml').read_text()
        assert {p.name for p in results.glob('*.png')} == {'walk.png', 'walk_distances.png'}


def test_whatever_changes_results_changes_their_key(tmp_path: Path) -> None:
    (tmp_path / 'a.onnx').write_bytes(b'first')
    readings = [ReadingOptions(fps=25.0), ReadingOptions(image_size=(640, 480)), ReadingOptions(layout='coco17')]
    changes: list[dict[str, Any]] = [
        *({'reading': reading} for reading in readings),
        *({'work': 'reconstruct'}, {'config': None}, {'changes': {'tracker.lag': 0.2}}, {'suffix': '.bvh'}),
        *({'reading': ReadingOptions(detector=tmp_path / 'a.onnx')}, {}, {'out': 'elsewhere'}),
    ]
    keys = [make_settings(**{'out': 'out', **change}).compute_key() for change in changes]
    assert len(set(keys)) == len(keys) - 1
    assert keys[-2] == keys[-1]  # the folder of the run changes no result
    (tmp_path / 'a.onnx').write_bytes(b'second')
    assert make_settings('out', reading=ReadingOptions(detector=tmp_path / 'a.onnx')).compute_key() not in keys


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_its_bags_one_more_try(tmp_path: Path) -> None:
    """A worker is killed while it replays; every bag is there in the end, and none of what it had left."""
    write_corpus(tmp_path / 'in', dict.fromkeys('abc', 120))
    with batch_run.connect(None, workers=1) as connected:
        (pid,) = connected.run(os.getpid).values()

        def kill() -> None:
            while not list((tmp_path / 'out').glob('.unfinished/*/results/*/*.mcap')):
                time.sleep(0.02)
            os.kill(pid, signal.SIGKILL)

        killer = threading.Thread(target=kill, daemon=True)
        killer.start()
        outcomes = run(connected, tmp_path / 'in', make_settings(tmp_path / 'out'))
        killer.join()
        assert pid not in connected.run(os.getpid).values()
    assert statuses(outcomes) == dict.fromkeys('abc', 'done')
    assert len({tuple(read_outputs(tmp_path / 'out' / 'results' / name)) for name in 'abc'}) == 1


def test_a_scheduler_that_does_not_answer_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_run, 'CONNECT_SECONDS', 0.5)
    message = r'^tcp://127.0.0.1:9: no scheduler answers'
    with pytest.raises(MocapError, match=message), batch_run.connect('tcp://127.0.0.1:9'):
        pass


def test_a_worker_of_another_version_is_refused(client: Any, corpus: Path, tmp_path: Path) -> None:
    outcomes = run(client, corpus, make_settings(tmp_path / 'out', version='0.0.7'))
    assert set(statuses(outcomes).values()) == {'failed'}
    assert 'of mocap_ros, not 0.0.7' in outcomes['c']['error']


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['nowhere', '-o', 'out'], 'nowhere: No such file'),
        (['.', '-o', 'out', '--scheduler', 'tcp://x:1', '--workers', '2'], '--workers and --memory are for'),
        (['.', '-o', 'out', '--detector', 'no.onnx'], 'no.onnx: No such file or directory'),
        (['.', '-o', 'out', '--set', 'tracker.windo=2'], 'unknown parameter'),
    ],
)
def test_wrong_usage_is_one_line(
    tmp_path: Path, monkeypatch: Any, capfd: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['batch', *arguments]) == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert reason in line


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


def names(source: str, *, only_bags: bool = True) -> list[str]:
    return [recording.name for recording in find_recordings(source, print, only_bags=only_bags)]


def test_the_recordings_of_a_folder_are_found_largest_first(root: str) -> None:
    assert names(root) == BAGS
    everything = ['day2/b', 'day1/bag_a', 'GX01', 'day2/walk', 'day2/old', 'day2/c']
    assert names(root, only_bags=False) == everything
    lines: list[str] = []
    found = {recording.name: recording.path for recording in find_recordings(root, lines.append, only_bags=True)}
    assert [line.split(' and ')[0] for line in lines] == [f'{root}: 2 recordings are no bags']
    assert found['day2/c'] == path_of(f'{root}/day2/c.db3')
    others = find_recordings(root, print, only_bags=True, leave_out=[path_of(f'{root}/day2')])
    assert [recording.name for recording in others] == ['day1/bag_a']


def test_linked_folders_are_searched_once(tmp_path: Path) -> None:
    write_corpus(tmp_path / 'disk', {'a': 1})
    (tmp_path / 'in').mkdir()
    for name, target in {'disk': 'disk', 'again': 'disk', 'loop': 'in'}.items():
        (tmp_path / 'in' / name).symlink_to(tmp_path / target)
    (tmp_path / 'in' / 'gone.mcap').symlink_to('nowhere')
    assert len(names(str(tmp_path / 'in'))) == 1


def test_patterns_lists_and_single_recordings(root: str, tmp_path: Path) -> None:
    assert names(f'{root}/day2/*.db3') == ['c']
    assert names(f'{root}/*/b*') == ['day2/b', 'day1/bag_a']
    assert names(f'{root}/day1/bag_a') == ['bag_a']
    assert names(f'{root}/day2/b.mcap') == ['b']
    listed = tmp_path / 'list.txt'
    listed.write_text(f'# comment\n{root}/day2/c.db3\n\n{root}/day1/bag_a\n')
    base = '/'.join(path_of(root).parts[1:])
    assert names(str(listed)) == [f'{base}/day1/bag_a', f'{base}/day2/c']


@pytest.mark.parametrize(
    ('source', 'reason'),
    [
        ('nothing/here', 'No such file or directory'),
        ('day2/notes.md', 'there is no bag'),
        ('day2/*.xyz', 'there is no bag'),
    ],
)
def test_what_holds_no_recording_is_refused_in_one_line(root: str, source: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason) as raised:
        names(f'{root}/{source}')
    assert source in str(raised.value)


@pytest.mark.parametrize('other', ['day2/b.db3', 'day2/b/c.mcap'])
def test_recordings_whose_results_would_overwrite_each_other_are_refused(root: str, other: str) -> None:
    fs, path = fsspec.url_to_fs(root)
    fs.makedirs(f'{path}/day2/b', exist_ok=True)
    fs.pipe_file(f'{path}/{other}', b'b')
    with pytest.raises(InputError, match=r'the results of day2/b and day2/b(/c)? '):
        names(root)
